"""Gradients of rollouts, against differences, and by the checkers of PyTorch and JAX."""

import re

import numpy as np
import pytest

import stepcore as sc
from stepcore.engine.gradients import Steps, Tape, pulled

EXACT = {"solver": "newton", "tolerance": 1e-14, "sweeps": 200}
FLYER = """<mujoco><option timestep="0.005" integrator="Euler"/><worldbody>
 <body pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .3" mass="2"/>
 <body pos="0 0 .4"><joint type="ball" damping=".1"/><geom name="tip" type="capsule" size=".05"
  fromto="0 0 0 .1 .3 0" mass=".5"/></body></body></worldbody></mujoco>"""


def hopper(n=2):
    """In the air and on its foot."""
    gymnasium = pytest.importorskip("gymnasium")
    assert gymnasium
    model = sc.load("gymnasium:hopper").compile()
    batch = sc.Batch(model, n, dt=0.002, integrator="euler", threads=2, **EXACT)
    batch.qpos[:, 1] = np.linspace(1.3, 1.24, n)
    batch.qpos[:, 3:] += 0.1
    return batch


def test_a_rollout_of_32_steps_backward_and_forward():
    """Every gradient against an eighth-order difference of rollouts."""
    steps, n, path = 32, 2, "body/thigh/mass"
    rng = np.random.default_rng(1)
    ctrl = rng.uniform(-1, 1, (n, steps, 3))
    weights = rng.normal(size=(n, steps, 6)), rng.normal(size=(n, steps, 6))

    def loss(moved=0.0, change=None, start=(0.0, 0.0), value=None):
        batch = hopper(n)
        if value is not None:
            batch.param[path] = value
        batch.qpos += moved * start[0]
        batch.qvel += moved * start[1]
        run = batch.rollout(ctrl if change is None else ctrl + moved * change)
        return ((weights[0] * run.qpos).sum((1, 2)) + (weights[1] * run.qvel).sum((1, 2))), run

    batch = hopper(n)
    found = batch.vjp(ctrl, *weights, parameters=[path])
    assert np.array_equal(found.rollout.qpos, loss()[1].qpos)
    change = rng.normal(size=ctrl.shape)
    start = rng.normal(size=(n, 6)), rng.normal(size=(n, 6))
    stencil = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}

    def slope(make, h):
        return sum(w * (make(k * h) - make(-k * h)) for k, w in stencil.items()) / h

    true = slope(lambda h: loss(h, change)[0], 1e-4)
    own = (found.ctrl * change).sum((1, 2))
    assert np.abs(own - true).max() <= 1e-8 * np.abs(true).max()
    true = slope(lambda h: loss(h, None, start)[0], 1e-6)
    own = (found.qpos * start[0]).sum(1) + (found.qvel * start[1]).sum(1)
    assert np.abs(own - true).max() <= 1e-7 * np.abs(true).max()
    mass = float(batch.model.masses()["thigh"])
    true = slope(lambda h: loss(value=np.full(n, mass + h))[0], 1e-3)
    assert np.abs(found.parameters[path] - true).max() <= 1e-8 * np.abs(true).max()
    # Forward is the same number.
    batch = hopper(n)
    _, moved = batch.jvp(ctrl, *start, ctrl_change=change, parameters={path: 0.1})
    forward = (weights[0] * moved.qpos).sum((1, 2)) + (weights[1] * moved.qvel).sum((1, 2))
    back = (found.ctrl * change).sum((1, 2)) + 0.1 * found.parameters[path]
    back += (found.qpos * start[0]).sum(1) + (found.qvel * start[1]).sum(1)
    assert forward == pytest.approx(back, rel=1e-10)
    assert found.one_sided == []
    assert found.growth.shape == (n,)


def test_quaternions_turn_with_their_bodies():
    """Changes of qpos that keep quaternions unit, and others, which are made unit."""
    model = sc.loads(FLYER).compile()
    rng = np.random.default_rng(0)
    velocity = rng.normal(size=(1, model.nv))

    def run(qpos):
        batch = sc.Batch(model, 1, **EXACT)
        batch.qpos[:], batch.qvel[:] = qpos, velocity
        return batch.rollout(np.zeros((1, 10, 0))).qpos

    batch = sc.Batch(model, 1, **EXACT)
    batch.qvel[:] = velocity
    start, weights = np.array(batch.qpos), rng.normal(size=(1, 10, model.nq))
    found = batch.vjp(np.zeros((1, 10, 0)), weights)
    for entry in range(model.nq):
        h = np.zeros(model.nq)
        h[entry] = 1e-5
        true = ((run(start + h) - run(start - h)) * weights).sum() / 2e-5
        assert found.qpos[0, entry] == pytest.approx(true, abs=1e-6, rel=1e-6), entry


def test_a_gradient_that_grows_without_bound_is_told():
    """A ball on a ball, or on a cone of nothing: a double pendulum that turns over for long."""
    text = """<mujoco><option timestep="0.01" gravity="0 0 -9.81"/><worldbody>
     <body><joint axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5" contype="0"
      conaffinity="0"/><body pos="0 0 -.5"><joint axis="0 1 0"/><geom type="capsule" size=".02"
      fromto="0 0 0 0 0 -.5" contype="0" conaffinity="0"/></body></body></worldbody></mujoco>"""
    batch = sc.Batch(sc.loads(text), 1)
    batch.qpos[:] = 3.0, 2.0
    weights = np.zeros((1, 2000, 2))
    weights[0, -1] = 1.0
    with pytest.warns(sc.GradientWarning, match="gradient of world 0 grows .* over 2000 steps"):
        found = batch.vjp(np.zeros((1, 2000, 0)), weights)
    assert found.growth[0] > 1e6


BOUNCE = """<mujoco><option timestep="{dt}" integrator="Euler" solver="Newton"/><worldbody>
 <geom name="floor" type="plane" size="1 1 .1" solref="{solref}" priority="1"/>
 <body pos="0 0 .6"><joint type="slide" axis="0 0 1"/><geom name="ball" size=".1" mass="1"/></body>
 </worldbody></mujoco>"""


def height(solref, dt=0.002):
    """The gradient of a ball's height after 1.2 s by its first height and speed."""
    batch, count = sc.Batch(sc.loads(BOUNCE.format(solref=solref, dt=dt)), 1), round(1.2 / dt)
    weights = np.zeros((1, count, 1))
    weights[0, -1] = 1.0
    return batch.vjp(np.zeros((1, count, 0)), weights, error_bar=True)


def test_a_gradient_that_is_another_in_shorter_steps_is_told():
    """A ball that bounces: its gradient has grown little, and any sign by the time step."""
    words = (
        r"world 0 by the initial state changes by \d+ % in steps half as long, "
        r".* the impact of `floor` with `ball` at"
    )
    signs = set()
    for dt in (0.005, 0.002):
        with pytest.warns(sc.GradientWarning, match=words):
            found = height("-5000 -2", dt)
        assert found.growth[0] < 100 and found.error[0] > 0.5
        signs.add(float(np.sign(found.qpos[0, 0])))
    assert signs == {-1.0, 1.0}


def test_nothing_is_told_where_the_gradient_is_that_of_the_motion(recwarn):
    """Of a ball that has come to rest nothing is left; a spring's error is of the first order."""
    assert height(".02 1").error[0] < 1e-6
    off = []
    for dt in (0.02, 0.01):
        model = sc.lesson.spring().compile().with_settings(dt=dt, integrator="semi-implicit")
        batch, count = sc.Batch(model, 1), round(1.0 / dt)
        batch.reset("start")
        weights = np.zeros((1, count, 1))
        weights[0, -1] = 1.0
        path = "joint/spring/stiffness"
        off.append(batch.vjp(np.zeros((1, count, 0)), weights, None, None, [path], True).error[0])
    assert 0.01 < off[0] < 0.5
    assert off[1] == pytest.approx(off[0] / 2, rel=0.3)
    assert not [one for one in recwarn if one.category is sc.GradientWarning]


SWING = """<mujoco><option timestep="0.005" integrator="Euler"/><worldbody>
 <body name="bob"><joint name="pin" axis="0 1 0"/>
 <geom name="ball" size=".1" pos=".3 0 0" mass="1"/></body></worldbody>
 <actuator><motor joint="pin"/></actuator></mujoco>"""


@pytest.mark.filterwarnings("error")
def test_what_cancels_is_not_far_from_what_cancels():
    """The swing of a point does not depend on its mass: that gradient is rounding."""
    model = sc.loads(SWING.replace('size=".1"', 'size="1e-4"')).compile()
    batch, weights = sc.Batch(model, 1), np.zeros((1, 20, 1))
    weights[0, -1] = 1.0
    ctrl = np.zeros((1, 20, 1))
    found = batch.vjp(ctrl, weights, parameters=["geom/ball/mass"], error_bar=True)
    assert abs(found.parameters["geom/ball/mass"][0]) < 1e-12
    assert found.error[0] < 0.1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("steps", (0, 5))
def test_of_nothing_the_error_is_nothing(steps):
    for scene in (SWING, "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"):
        batch = sc.Batch(sc.loads(scene), 2)
        found = batch.vjp(np.zeros((2, steps, batch.model.nu)), error_bar=True)
        assert np.array_equal(found.error, [0, 0])


def test_a_part_of_a_gradient_that_parts_alone_is_named():
    """A ball falls upon a floor: its height by the gravity parts, after its first state did not."""
    model = sc.loads(BOUNCE.format(solref="-5000 -2", dt=0.005))
    batch, count = sc.Batch(model, 1), 240
    weights = np.zeros((1, count, 1))
    weights[0, -1] = 1.0
    with pytest.warns(sc.GradientWarning, match=r"world 0 by `?.+ changes by"):
        batch.vjp(np.zeros((1, count, 0)), weights, parameters=["gravity"], error_bar=True)


def test_a_rollout_that_fails_in_shorter_steps_keeps_its_gradient():
    """A step of 5 ms ends before the force is infinite, two of half as long do not."""
    model = sc.loads(SWING).compile()
    batch = sc.Batch(model, 2)
    steps = Steps(batch, np.zeros((2, 5, 1)), ()).roll()
    finer = steps.halved()
    finer.batch.qvel[1] = 1e308
    finer.batch.qfrc_applied[1] = 1e308
    finer.batch.step()
    given = {"qpos": np.ones((2, 5, 1)), "qvel": np.zeros((2, 5, 1)), "act": np.zeros((2, 5, 0))}
    with pytest.warns(sc.GradientWarning, match="world 1 has no error bar.*diverged in step"):
        found = pulled(steps, given, finer)
    assert np.isinf(found.error[1]) and found.error[0] < 1


def test_steps_of_any_length_are_refused_before_the_first():
    batch = sc.Batch(sc.loads(SWING), 2, accuracy=1e-3)
    for call in (batch.linearize, lambda: batch.vjp(np.zeros((2, 5, 1)))):
        with pytest.raises(ValueError, match=r"accuracy = 0\.001: must be None for linearize"):
            call()
    assert batch.time == 0


def test_what_does_not_fit_is_told():
    batch = hopper()
    with pytest.raises(ValueError, match="error_bar = 1: must be"):
        batch.vjp(np.zeros((2, 3, 3)), error_bar=1)
    ctrl = np.zeros((2, 3, 3))
    with pytest.raises(ValueError, match=r"qpos has shape \(2, 3\): must be \(2, 3, 6\)"):
        batch.vjp(ctrl, np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"ctrl has shape"):
        batch.vjp(np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r'no body is named "thig".*thigh'):
        batch.vjp(ctrl, parameters=["body/thig/mass"])
    with pytest.raises(ValueError, match=r"ctrl_change has shape"):
        batch.jvp(ctrl, ctrl_change=np.zeros(3))


def test_what_does_not_fit_changes_nothing():
    """Each argument is checked before the first step, and before a value of the model is set."""
    batch, ctrl, path = hopper(), np.zeros((2, 3, 3)), "body/thigh/mass"
    before = np.array(batch.qpos), np.array(batch.param[path])
    three = np.zeros((2, 3, 6))
    calls = (
        lambda: batch.vjp(ctrl, three[0]),
        lambda: batch.vjp(ctrl, act=three),
        lambda: batch.jvp(ctrl, qvel=three),
        lambda: batch.jvp(ctrl, ctrl_change=ctrl[0]),
        lambda: batch.jvp(ctrl, parameters={"body/thigh": 1.0}),
        lambda: batch.jvp(ctrl, parameters={path: np.zeros(3)}),
        lambda: batch.jvp(ctrl, parameters={"geom/floor/friction": 0.1}),
        lambda: Tape(batch, [path], *before[:1], three[0], ctrl, np.array([5.0, 6.0])),
        lambda: Tape(batch, [path], *before[:1], batch.qvel, ctrl[0], np.array([5.0, 6.0])),
        lambda: Tape(batch, [path], *before[:1], batch.qvel, ctrl, np.array([5.0])),
    )
    for call in calls:
        with pytest.raises(ValueError):
            call()
        assert batch.time == 0
        assert np.array_equal(batch.qpos, before[0])
        assert np.array_equal(batch.param[path], before[1])


def test_a_batch_is_linearised_as_its_worlds_are():
    batch = hopper(3)
    batch.param["body/thigh/mass"] = np.array([4.0, 4.5, 5.0])
    batch.ctrl[:] = np.random.default_rng(2).uniform(-1, 1, batch.ctrl.shape)
    path = "joint/thigh_joint/damping"
    for world, found in enumerate(batch.linearize([path])):
        sim = sc.Sim(batch.model_of(world))
        sim.qpos[:], sim.qvel[:] = batch.qpos[world], batch.qvel[world]
        sim.ctrl[:] = batch.ctrl[world]
        alone = sim.linearize([path])
        for name in ("A", "B", "P"):
            assert np.array_equal(getattr(found, name), getattr(alone, name)), name
    assert batch.time == 0


def test_worlds_whose_values_are_zero_elsewhere():
    """The columns are those of the batch's model; a world in which one is zero is named."""
    batch = sc.Batch(sc.loads(BOUNCE.format(solref=".02 1", dt=0.005)), 3)
    batch.param["gravity"] = np.array([[0, 0, -9.81], [0.5, 0, -9.8], [0, 0, -9.81]])
    found = batch.linearize(["gravity"])
    assert found.P.shape == (3, 2, 1)
    assert found.parameters == found[1].parameters == ("gravity[2]",)
    sim = sc.Sim(batch.model_of(1))
    sim.qpos[:] = batch.qpos[1]
    assert np.array_equal(found[1].P, sim.linearize(["gravity[2]"]).P)
    batch.param["gravity"] = np.array([[0, 0, -9.81], [0, 0, 0], [0, 0, -9.81]])
    with pytest.raises(ValueError, match=r"gravity\[2\] = 0: must be .* \(world 1\)"):
        batch.linearize(["gravity"])


LATE = """<mujoco><option timestep="0.01" integrator="Euler"/><worldbody>
 <body><joint name="a" axis="0 1 0" damping=".1"/><geom size=".1" pos=".3 0 0" mass="1"/>
 <body pos=".5 0 0"><joint name="b" axis="0 1 0"/><geom size=".1" pos=".2 0 0" mass="1"/></body>
 </body></worldbody><actuator><motor joint="a" delay=".035" nsample="6" interp="linear"/>
 <general joint="b" dyntype="filter" dynprm=".05" delay=".02" nsample="3"/></actuator></mujoco>"""


def test_controls_that_come_late():
    """Past controls are part of x: against differences of rollouts, and forward against back."""
    rng, count = np.random.default_rng(0), 12
    ctrl, push = rng.normal(size=(2, 1, count, 2))
    first, weights = rng.normal(size=9), rng.normal(size=(1, count, 2))

    def batch(ctrl_history=first):
        made = sc.Batch(sc.loads(LATE), 1)
        made.ctrl_history[0] = ctrl_history
        return made

    def number(**changed):
        rolled = batch(changed.get("ctrl_history", first)).rollout(changed.get("ctrl", ctrl))
        return (rolled.qpos * weights).sum()

    found = batch().vjp(ctrl, weights, parameters=["joint/a/damping"])
    ends = [number(ctrl=ctrl + h * push) for h in (-1e-5, 1e-5)]
    assert (found.ctrl * push).sum() == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=1e-7)
    # Of a control that comes after the end nothing is left.
    assert (found.ctrl[0, -2:] == 0).all() and (found.ctrl[0, :4] != 0).all()
    forward = batch().jvp(ctrl, ctrl_change=push, parameters={"joint/a/damping": 0.0})[1]
    assert (forward.qpos * weights).sum() == pytest.approx((found.ctrl * push).sum(), rel=1e-12)

    # A step: what was given moves along the list, and acts from it.
    linear = batch().linearize()[0]
    assert linear.A.shape == (14, 14) and linear.B.shape == (14, 2)
    for entry in range(9):
        ends = []
        for h in (-1e-6, 1e-6):
            made = batch(first + h * np.eye(9)[entry])
            made.step()
            state = [made.qpos, made.qvel, made.act, made.ctrl_history]
            ends.append(np.concatenate([rows[0] for rows in state]))
        assert np.abs(linear.A[:, 5 + entry] - (ends[1] - ends[0]) / 2e-6).max() < 1e-8
    with pytest.raises(ValueError, match="error_bar = True: must be False in a scene with late"):
        batch().vjp(ctrl, weights, error_bar=True)


def test_errors_name_the_world():
    batch = sc.Batch(sc.loads(SWING), 3)
    batch.qpos[1] = np.nan
    with pytest.raises(ValueError, match=r"qpos\[0\] = NaN: must be finite \(.*`pin`, world 1\)"):
        batch.linearize()
    batch.qpos[1], batch.qvel[1], batch.qfrc_applied[1] = 0.0, 1e308, 1e308
    with pytest.raises(sc.SimulationError, match="in world 1") as told:
        batch.linearize()
    assert told.value.world == 1


def test_the_memory_of_linearisations_is_counted():
    batch = sc.Batch(sc.loads(SWING), 3)
    before = batch.nbytes
    batch.linearize()
    assert batch.nbytes > before + 10_000


BALL = """<mujoco><option timestep="0.002" integrator="Euler" solver="Newton"/><worldbody>
 <geom name="floor" type="plane" size="5 5 .1"/><body name="ball" pos="0 0 .5">
 <joint type="slide" axis="0 0 1"/>
 <geom name="shell" type="sphere" size=".1" solref="-1e6 -10"/></body></worldbody></mujoco>"""


def test_the_impact_at_which_a_gradient_grows_is_named():
    """A hard ball bounces: its last height by its first. The time is that of the overlap."""
    batch = sc.Batch(sc.loads(BALL), 2)
    batch.qpos[:] = [[0.0], [40.0]]
    weights = np.zeros((2, 1500, 1))
    weights[:, -1] = 1.0
    words = r"world 0 grows .* the impact of `floor` with `shell` at ([\d.]+) s"
    with pytest.warns(sc.GradientWarning, match=words) as told:
        found = batch.vjp(np.zeros((2, 1500, 0)), weights)
    assert found.growth[0] > 1e6 > found.growth[1]
    began = round(float(re.search(words, str(told[0].message))[1]) / 0.002)
    heights = 0.5 + found.rollout.qpos[0, :, 0]
    assert heights[began - 1] < 0.1 <= heights[began - 2]


def test_pytorch_checks_it():
    torch = pytest.importorskip("torch")
    from stepcore.torch import rollout

    batch, path = hopper(), "body/thigh/mass"
    rng = np.random.default_rng(3)
    start = [torch.tensor(np.array(x), requires_grad=True) for x in (batch.qpos, batch.qvel)]
    ctrl = torch.tensor(rng.uniform(-1, 1, (2, 4, 3)), requires_grad=True)
    mass = torch.tensor([4.0, 4.5], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda *given: rollout(batch, *given[:3], {path: given[3]}),
        (*start, ctrl, mass),
        eps=1e-5,
        atol=1e-5,
        rtol=1e-5,
    )
    qpos, qvel = rollout(batch, *start, ctrl.float())
    assert qpos.shape == (2, 4, 6) and qvel.dtype == torch.float64


def test_jax_checks_it():
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    from jax.test_util import check_grads

    from stepcore.jax import rollout

    batch, path = hopper(), "body/thigh/mass"
    rng = np.random.default_rng(3)
    start = [jax.numpy.array(np.array(x)) for x in (batch.qpos, batch.qvel)]
    ctrl = jax.numpy.array(rng.uniform(-1, 1, (2, 4, 3)))
    mass = jax.numpy.array([4.0, 4.5])

    def loss(qpos, qvel, ctrl, mass):
        states = rollout(batch, qpos, qvel, ctrl, {path: mass})
        return (states[0] ** 2).sum() + (states[1] ** 2).sum()

    check_grads(loss, (*start, ctrl, mass), order=1, modes=["rev"], eps=1e-5, rtol=1e-5)
    jitted = jax.jit(jax.grad(loss, argnums=(2, 3)))
    plain = jax.grad(loss, argnums=(2, 3))
    for one, other in zip(jitted(*start, ctrl, mass), plain(*start, ctrl, mass), strict=True):
        assert np.allclose(one, other, rtol=1e-12)
