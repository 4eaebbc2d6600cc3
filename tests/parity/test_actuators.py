"""Actuators of every type and transmission against MuJoCo, and against their closed forms."""

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc

# Two hinges and a slide, a ball, a free body; sites and tendons to pull at.
TREE = """
<mujoco><option timestep="0.004"/>
  <worldbody>
    <site name="wall" pos=".1 .2 1.4" euler="20 30 40"/>
    <body pos="0 0 1"><joint name="a" axis="0 1 0" damping=".2" {a}/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".04" contype="0" conaffinity="0"/>
      <site name="u" pos=".2 .03 .04" euler="15 -20 70"/>
      <body pos=".4 0 0"><joint name="b" axis="0 .3 1" range="-2 2"/>
        <joint name="c" type="slide" axis="1 0 .2"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" contype="0" conaffinity="0"/>
        <site name="l" pos=".1 .02 .03" euler="40 10 -30"/></body></body>
    <body pos="0 1 1"><joint name="ball" type="ball" pos="0 0 .1"/>
      <geom type="box" size=".1 .2 .05" contype="0" conaffinity="0"/>
      <site name="s" pos=".05 .1 0" euler="10 20 30"/></body>
    <body pos="1 0 1"><joint name="free" type="free"/>
      <geom type="box" size=".1 .15 .05" contype="0" conaffinity="0"/>
      <site name="f" pos=".02 .03 0" euler="-10 50 30"/></body>
  </worldbody>
  <tendon><fixed name="both"><joint joint="a" coef=".7"/><joint joint="c" coef="-1.2"/></fixed>
    <spatial name="rope" {rope}><site site="wall"/><site site="l"/></spatial></tendon>
  <actuator>{actuators}</actuator>
  <sensor><tendonactuatorfrc tendon="both"/><tendonactuatorfrc tendon="rope"/>
    <jointactuatorfrc joint="a"/></sensor>
</mujoco>
"""

TYPES = {
    "motor": '<motor joint="a" gear="2.5" ctrlrange="-.5 .5"/>',
    "position": '<position joint="b" kp="30" kv="2" forcerange="-3 3"/>',
    "position with a ratio": '<position joint="b" kp="30" dampratio=".7" gear="1.5"/>',
    "position with a filter": '<position joint="b" kp="30" kv="2" timeconst=".03"/>',
    "velocity": '<velocity joint="c" kv="4" gear=".6"/>',
    "intvelocity": '<intvelocity joint="c" kp="40" kv="3" actrange="-.1 .3"/>',
    "damper": '<damper joint="a" kv="3" ctrlrange="0 2"/>',
    "cylinder": '<cylinder joint="c" timeconst=".05" area="3" bias=".2 -5 -.4"/>',
    "cylinder by diameter": '<cylinder joint="c" timeconst=".05" diameter="2"/>',
    "muscle": '<muscle joint="a" lengthrange="-1.5 1.5" force="30"/>',
    "muscle by scale": '<muscle tendon="rope" lengthrange=".2 1.4" gear="-1" scale="60"/>',
    "smooth muscle": '<muscle joint="b" lengthrange="-2 2" tausmooth=".4" timeconst=".02 .06" '
    'range=".6 1.3" force="9" lmin=".4" lmax="1.7" vmax="1.1" fpmax="1.6" fvmax="1.4"/>',
    "affine": '<general joint="b" gaintype="affine" gainprm="2 .5 -.3" biastype="affine" '
    'biasprm=".1 -4 -.6"/>',
    "integrator": '<general joint="a" dyntype="integrator" gainprm="3" actrange="-.2 .4"/>',
    "filter": '<general joint="a" dyntype="filter" dynprm=".03" gainprm="3" actearly="true"/>',
    "filterexact": '<general joint="a" dyntype="filterexact" dynprm=".003" gainprm="3" '
    'biastype="affine" biasprm="0 -2 -.3" actearly="true"/>',
    "muscle dynamics": '<general joint="a" dyntype="muscle" dynprm=".01 .04 0" gainprm="7"/>',
    "muscle curves": '<general joint="a" gaintype="muscle" biastype="muscle" lengthrange="-2 2" '
    'gainprm=".7 1.2 20 100 .5 1.6 1.5 1.3 1.2" biasprm=".7 1.2 20 100 .5 1.6 1.5 1.3 1.2"/>',
    "own damping": '<motor joint="a" gear="1.5" damping=".2 .3 .1" armature=".05"/>',
    "tendon damping": '<motor tendon="both" gear="1.5" damping=".2 .3 .1" armature=".05"/>',
    "tendon": '<motor tendon="both" gear="2"/><position tendon="rope" kp="20" kv="1"/>',
    "ball": '<motor joint="ball" gear="1 2 3"/>'
    '<position joint="ball" gear="0 0 2" kp="3" kv=".4"/>',
    "ball in parent": '<position jointinparent="ball" gear="1 -2 .5" kp="2" dampratio="1"/>',
    "free": '<motor joint="free" gear="1 2 3 .4 .5 .6"/>'
    '<velocity joint="free" gear="0 1 0 0 0 1"/>',
    "free in parent": '<velocity jointinparent="free" gear="1 2 0 .4 0 .6" kv=".5"/>',
    "site": '<motor site="l" gear="1 2 3 .4 .5 .6"/><velocity site="f" gear="0 0 1 .1 0 0"/>',
    "refsite": '<position site="l" refsite="u" gear="1 .5 0 0 0 0" kp="20" kv="1"/>'
    '<position site="f" refsite="wall" gear="0 0 0 0 1 .3" kp="5" dampratio=".8"/>'
    '<motor site="s" refsite="l" gear="1 0 2 .3 .4 0"/>',
    "slider-crank": '<motor cranksite="l" slidersite="wall" cranklength=".9" gear="1.5"/>'
    '<position cranksite="u" slidersite="wall" cranklength=".3" kp="6"/>',
}
# Contacts, those within their gap too, that are pulled at.
STICKY = """
<mujoco><option timestep="0.002"/><worldbody>
  <geom type="plane" size="2 2 .1"/>
  <body pos="0 0 .09"><freejoint/><geom type="box" size=".2 .15 .1" gap=".02"/>
    <body pos="0 0 .19"><joint axis="0 1 .2" damping=".1"/><geom size=".1" gap=".03"/></body></body>
  <body name="foot" pos=".5 0 .095"><freejoint/><geom size=".1"/>
    <geom size=".1" pos=".15 0 0"/></body>
  </worldbody>
  <actuator><adhesion body="foot" gain="30" ctrlrange="0 1"/>
    <general body="world" gainprm="7" gear="2"/></actuator></mujoco>
"""
INTEGRATORS = tuple(peers.INTEGRATORS)


def pair(actuators, a="", rope="", **options):
    """Both engines on one scene."""
    text = TREE.format(actuators=actuators, a=a, rope=rope)
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model), sc.Sim(sc.loads(text), **options)


def draw(model, data, sim, rng):
    """Both engines at one random state."""
    mujoco.mj_resetData(model, data)
    peers.nudge(model, data.qpos, rng, 0.8)
    data.qvel[:] = 1.5 * rng.normal(size=model.nv)
    data.ctrl[:] = 1.5 * rng.normal(size=model.nu)
    data.act[:] = rng.uniform(-0.3, 1.2, model.na)
    for name in ("qpos", "qvel", "ctrl", "act"):
        getattr(sim, name)[:] = getattr(data, name)


def generalised(sim):
    """The force of all actuators on the dofs."""
    forces = sim.element_forces()
    return sum((f for key, f in forces.items() if key[0] == "actuator"), np.zeros(sim.model.nv))


@pytest.mark.parametrize("name", TYPES)
def test_forces_and_steps_at_100_states(name):
    """Force, generalised force, acceleration and a step of each integrator are MuJoCo's to 1e-9."""
    model, data, sim = pair(TYPES[name])
    assert (sim.model.nu, sim.model.na) == (model.nu, model.na)
    rng = np.random.default_rng(0)
    for _ in range(100):
        draw(model, data, sim, rng)
        mujoco.mj_forward(model, data)
        sim.forward()
        np.testing.assert_allclose(sim.actuator_force, data.actuator_force, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(generalised(sim), data.qfrc_actuator, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(sim.passive, data.qfrc_passive, rtol=1e-9, atol=1e-9)
        assert peers.apart(sim.qacc, data.qacc) < 1e-9
    for integrator in INTEGRATORS:
        model, data, sim = pair(TYPES[name], integrator=integrator)
        model.opt.integrator = peers.INTEGRATORS[integrator]
        for _ in range(30):
            draw(model, data, sim, rng)
            mujoco.mj_step(model, data)
            sim.step()
            assert peers.apart(sim.qpos, data.qpos) < 1e-9, integrator
            assert peers.apart(sim.qvel, data.qvel) < 1e-9, integrator
            np.testing.assert_allclose(sim.act, data.act, rtol=1e-12, atol=1e-12)


def test_joints_and_tendons_bound_the_force_of_all_their_actuators():
    """actuatorfrcrange of a hinge and of a tendon, at states within and beyond it."""
    actuators = (
        '<motor joint="a" gear="2"/><motor joint="a"/><motor tendon="both"/>'
        '<motor tendon="rope" gear="2"/><position tendon="rope" kp="9" kv="1"/>'
    )
    bounds = 'actuatorfrcrange="-1 1.5"'
    beyond = 0
    for integrator in INTEGRATORS:
        model, data, sim = pair(actuators, a=bounds, rope=bounds, integrator=integrator)
        model.opt.integrator = peers.INTEGRATORS[integrator]
        rng = np.random.default_rng(1)
        for _ in range(50):
            draw(model, data, sim, rng)
            mujoco.mj_forward(model, data)
            sim.forward()
            np.testing.assert_allclose(sim.actuator_force, data.actuator_force, atol=1e-12)
            np.testing.assert_allclose(sim.sensordata, data.sensordata, atol=1e-12)
            np.testing.assert_allclose(generalised(sim), data.qfrc_actuator, atol=1e-12)
            beyond += abs(data.qfrc_actuator[0]) in (1.0, 1.5)
            mujoco.mj_step(model, data)
            sim.step()
            assert peers.apart(sim.qvel, data.qvel) < 1e-9, integrator
    assert beyond > 10


HELD = """
<mujoco><option timestep="0.004"><flag actuation="{flag}"/></option>
  <worldbody>
    <body pos="0 0 1"><joint name="a" axis="0 1 .1" {driven} actuatorfrcrange="-3 2"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" contype="0" conaffinity="0"/>
      <body pos=".4 0 0" gravcomp=".9"><joint name="b" type="ball" {driven}/>
        <geom type="box" size=".1 .05 .03" pos=".1 0 0" contype="0" conaffinity="0"/>
        <body pos=".2 0 0" gravcomp="1.2"><joint name="c" type="slide" {driven}
          actuatorfrcrange="-2 4"/><joint name="d" axis="1 0 0"/>
          <geom size=".05" pos="0 .1 0" contype="0" conaffinity="0"/></body></body></body>
  </worldbody>
  <actuator>{actuators}</actuator>
  <sensor><jointactuatorfrc joint="a"/><jointactuatorfrc joint="c"/><jointactuatorfrc joint="d"/>
  </sensor>
</mujoco>
"""
DRIVEN = 'actuatorgravcomp="true"'
MOTORS = '<motor joint="a" gear="2"/><position joint="c" kp="9" kv="1"/><motor joint="d"/>'


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(
    ("driven", "actuators", "flag"),
    [
        (DRIVEN, MOTORS, "enable"),
        (DRIVEN, MOTORS, "disable"),
        (DRIVEN, "", "enable"),
        ("", MOTORS, "enable"),
    ],
)
def test_joints_bound_the_weight_that_their_actuators_hold(integrator, driven, actuators, flag):
    """Gravity compensation by actuators counts within actuatorfrcrange, and needs an actuator.

    Forces on the dofs, sensors, acceleration and a step are MuJoCo's; a world in lanes has the
    same bits.
    """
    text = HELD.format(driven=driven, actuators=actuators, flag=flag)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.integrator = peers.INTEGRATORS[integrator]
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(text), integrator=integrator)
    batch = sc.Batch(sim.model, 3, integrator=integrator)
    rng, beyond, within = np.random.default_rng(6), 0, 0
    for _ in range(40):
        draw(model, data, sim, rng)
        for name in ("qpos", "qvel", "ctrl"):
            getattr(batch, name)[:] = getattr(sim, name)
        mujoco.mj_forward(model, data)
        sim.forward()
        np.testing.assert_allclose(sim.sensordata, data.sensordata, atol=1e-11)
        if driven:
            held = sum(
                f for key, f in sim.element_forces().items() if key[0] == "gravity compensation"
            )
            held[-1] = 0.0  # joint d has it as a passive force
            np.testing.assert_allclose(generalised(sim) + held, data.qfrc_actuator, atol=1e-11)
        assert peers.apart(sim.qacc, data.qacc) < 1e-9
        beyond += data.qfrc_actuator[0] in (-3, 2)
        within += data.qfrc_actuator[0] not in (-3, 2, 0)
        mujoco.mj_step(model, data)
        sim.step()
        batch.step()
        assert peers.apart(sim.qvel, data.qvel) < 1e-9
        assert np.array_equal(batch.qvel[1], sim.qvel)
    assert not (driven and actuators and flag == "enable") or min(beyond, within) > 4


@pytest.mark.parametrize("bound", [0.5, 4.0])
def test_what_a_drive_withholds_of_a_weight_is_in_the_ledger(bound):
    """A pendulum whose drive holds up its weight within bounds: the energy is accounted for."""
    scene = sc.Scene()
    arm = scene.add_body(
        "arm", mass=1.0, inertia=(0.01, 0.01, 0.01), ipos=(0.3, 0, 0), gravcomp=1.0
    )
    fields = {"actuatorgravcomp": True, "actuatorfrcrange": (-bound, bound)}
    scene.add_joint(arm, "hinge", name="j", axis=(0, 1, 0), **fields)
    scene.add_actuator("j", "motor", ctrlrange=(-1, 1))
    sim = sc.Sim(scene, integrator="rk4", dt=0.001, ledger=True)
    sim.forward()
    weight = 9.81 * 0.3
    assert sim.element_forces()["gravity compensation", 1] == pytest.approx([-min(weight, bound)])
    sim.step(200)
    angle, speed = sim.qpos[0], sim.qvel[0]
    if bound > weight:
        assert (angle, speed) == (0, 0)
        return
    work = weight * np.sin(angle) - bound * angle
    assert weight * np.cos(angle) > bound, "still beyond it"
    assert 0.5 * (0.01 + 0.09) * speed**2 == pytest.approx(work, rel=1e-9)


def test_groups_of_actuators_are_left_out():
    """Their force is zero and their activation stays."""
    actuators = (
        '<general joint="a" group="2" dyntype="filter" dynprm=".1"/><motor joint="b" group="1"/>'
    )
    text = TREE.replace("<option", '<option actuatorgroupdisable="2 5"')
    text = text.format(actuators=actuators, a="", rope="")
    model = mujoco.MjModel.from_xml_string(text)
    data, scene = mujoco.MjData(model), sc.loads(text)
    assert [actuator.enabled for actuator in scene.actuators] == [False, True]
    sims = sc.Sim(scene), sc.Sim(sc.loads(scene.to_mjcf()))
    for sim in sims:
        sim.ctrl[:] = data.ctrl[:] = 1.0, 0.5
        sim.act[:] = data.act[:] = 0.3
        sim.step()
        assert sim.act[0] == 0.3
    mujoco.mj_step(model, data)
    for sim in sims:
        np.testing.assert_allclose(sim.qvel, data.qvel, atol=1e-14)
        assert data.act[0] == 0.3


def test_an_actuator_that_is_left_out_rests_within_its_bounds():
    """Under every integrator, in lanes too."""
    actuators = (
        '<intvelocity joint="a" group="2" kp="1" actrange="-.2 .3"/><motor joint="b" group="1"/>'
    )
    text = TREE.replace("<option", '<option actuatorgroupdisable="2"')
    text = text.format(actuators=actuators, a="", rope="")
    for name, integrator in peers.INTEGRATORS.items():
        model = mujoco.MjModel.from_xml_string(text)
        model.opt.integrator = integrator
        data, scene = mujoco.MjData(model), sc.loads(text)
        sim = sc.Sim(scene, integrator=name)
        sim.act[:] = data.act[:] = 0.7
        mujoco.mj_step(model, data)
        sim.step()
        assert sim.act[0] == data.act[0] == 0.3
    batch = sc.Batch(scene, 3, lanes=True)
    batch.act[:] = [[0.7], [-0.7], [0.1]]
    batch.step()
    np.testing.assert_array_equal(batch.act[:, 0], [0.3, -0.2, 0.1])


def test_shortcuts_inherit_as_in_mujoco():
    """The law of each shortcut from its own class, from one of another, and from <general>."""
    shortcuts = {
        "intvelocity": 'kp="7" kv=".3"',
        "damper": 'kv="2"',
        "cylinder": 'timeconst=".3" area="4" bias="1 2 3"',
        "muscle": 'timeconst=".02 .05" force="5" lmin=".4"',
        "position": 'kp="6" timeconst=".1"',
        "general": 'gainprm="3 0 0" biastype="affine" biasprm="0 -3 -1" dyntype="filter"',
    }
    more = {"damper": 'ctrlrange="0 1"', "muscle": 'lengthrange="-1 1"'}
    for outer, given in shortcuts.items():
        for own in shortcuts:
            text = f"""<mujoco><default><{outer} {given}/></default><worldbody><body>
              <joint name="j" damping="1"/><geom size=".1" pos=".1 0 0"/></body></worldbody>
              <actuator><{own} joint="j" {more.get(own, "")} lengthrange="-1 1"/></actuator>
              </mujoco>"""
            try:
                model = mujoco.MjModel.from_xml_string(text)
            except ValueError:
                continue
            data, sim = mujoco.MjData(model), sc.Sim(sc.loads(text))
            assert sim.model.na == model.na, (outer, own)
            data.qpos[:] = sim.qpos[:] = 0.3
            data.qvel[:] = sim.qvel[:] = -0.4
            data.ctrl[:] = sim.ctrl[:] = 0.7
            data.act[:] = sim.act[:] = 0.2
            mujoco.mj_step(model, data)
            sim.step()
            label = f"<{own}> in a class of <{outer}>"
            np.testing.assert_allclose(sim.actuator_force, data.actuator_force, err_msg=label)
            np.testing.assert_allclose(sim.act, data.act, err_msg=label)


def test_a_filter_is_the_exponential():
    """w(t) = u (1 − exp(−t/τ)): filterexact at every step, filter to first order in dt."""
    for kind, order in (("filterexact", None), ("filter", 1)):
        errors = []
        for dt in (0.01, 0.005):
            text = TREE.format(
                actuators=f'<general joint="a" dyntype="{kind}" dynprm=".07"/>', a="", rope=""
            )
            sim = sc.Sim(sc.loads(text), dt=dt)
            sim.ctrl[:] = 0.8
            sim.step(round(0.1 / dt))
            errors.append(abs(sim.act[0] - 0.8 * (1 - np.exp(-0.1 / 0.07))))
        if order is None:
            assert max(errors) < 1e-15
        else:
            assert 1.7 < errors[0] / errors[1] < 2.3


def test_midpoint_and_rk4_advance_a_filter_to_their_order():
    """The error of w falls by 4 and by 16 with half the step."""
    for integrator, ratio in (("midpoint", 4), ("rk4", 16)):
        errors = []
        for dt in (0.02, 0.01):
            text = TREE.format(
                actuators='<general joint="a" dyntype="filter" dynprm=".07"/>', a="", rope=""
            )
            sim = sc.Sim(sc.loads(text), dt=dt, integrator=integrator)
            sim.ctrl[:] = 0.8
            sim.step(round(0.2 / dt))
            errors.append(abs(sim.act[0] - 0.8 * (1 - np.exp(-0.2 / 0.07))))
        assert 0.8 * ratio < errors[0] / errors[1] < 1.3 * ratio


@pytest.mark.parametrize("name", TYPES)
def test_lanes_singles_and_written_files_are_the_same(name):
    """A lane equals a single world bit for bit, f32 to rounding, a written file exactly."""
    _, _, sim = pair(TYPES[name], integrator="implicitfast")
    batch = sc.Batch(sim.model, 9)
    single = sc.Sim(sim.model, precision="f32")
    text = sc.loads(sim.model.scene.to_mjcf()).to_mjcf()
    again = sc.Sim(sc.loads(text), integrator="implicitfast")
    rng = np.random.default_rng(5)
    batch.qvel[:] = rng.normal(size=batch.qvel.shape)
    batch.ctrl[:] = rng.normal(size=batch.ctrl.shape)
    batch.act[:] = rng.uniform(0, 1, batch.act.shape)
    for other in (sim, single, again):
        for field in ("qvel", "ctrl", "act"):
            getattr(other, field)[:] = getattr(batch, field)[4]
        other.step(40)
    batch.step(40)
    assert np.array_equal(batch.qpos[4], sim.qpos) and np.array_equal(batch.act[4], sim.act)
    np.testing.assert_allclose(single.qpos, sim.qpos, atol=2e-4)
    assert np.array_equal(again.qpos, sim.qpos) and np.array_equal(again.act, sim.act)


@pytest.mark.parametrize("name", TYPES)
def test_the_linearised_step_is_its_differences(name):
    """A and B of `linearize`, activations included, are central differences of steps."""
    model, data, sim = pair(TYPES[name], integrator="implicitfast")
    draw(model, data, sim, np.random.default_rng(2))
    start = sim.state()
    linear = sim.linearize()
    n, size = model.nv, 1e-6

    def after(velocity, act, ctrl):
        sim.restore(start)
        sim.qvel[:] += velocity
        sim.act[:] += act
        sim.ctrl[:] += ctrl
        sim.step()
        return np.concatenate([sim.qvel, sim.act])

    zero = [np.zeros(n), np.zeros(model.na), np.zeros(model.nu)]
    columns = (linear.A[n:, n : 2 * n], linear.A[n:, 2 * n :], linear.B[n:])
    for which, matrix in enumerate(columns):
        for k in range(len(zero[which])):
            both = []
            for sign in (1, -1):
                change = [x.copy() for x in zero]
                change[which][k] = sign * size
                both.append(after(*change))
            slope = (both[0] - both[1]) / (2 * size)
            np.testing.assert_allclose(matrix[:, k], slope, atol=2e-5 * max(1, abs(slope).max()))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_adhesion_pulls_contacts_together(integrator):
    """Forces on the dofs, acceleration and a step are MuJoCo's, with few and with many contacts."""
    model = peers.strict(mujoco.MjModel.from_xml_string(STICKY), integrator=integrator)
    data = mujoco.MjData(model)
    sim = sc.Sim(sc.loads(STICKY), integrator=integrator, **peers.EXACT)
    rng, counts = np.random.default_rng(3), set()
    for _ in range(60):
        mujoco.mj_resetData(model, data)
        peers.nudge(model, data.qpos, rng, 0.02)
        data.qvel[:] = 0.2 * rng.normal(size=model.nv)
        data.ctrl[:] = rng.uniform(0, 1.2, 2)
        for name in ("qpos", "qvel", "ctrl"):
            getattr(sim, name)[:] = getattr(data, name)
        mujoco.mj_forward(model, data)
        sim.forward()
        if len(sim.contacts) != data.ncon:
            continue
        counts.add(data.ncon)
        np.testing.assert_allclose(generalised(sim), data.qfrc_actuator, atol=1e-9)
        assert peers.apart(sim.qacc, data.qacc) < 1e-6
        mujoco.mj_step(model, data)
        sim.step()
        assert peers.apart(sim.qvel, data.qvel) < 1e-6
    assert len(counts) > 3


CRANKS = """<mujoco><worldbody><site name="w" pos="0 0 {z}"/><body>
<joint name="j"/><joint name="k" axis="1 0 0"/>
<inertial pos="0.0006921 0.00697 0.08874" mass="1.796" diaginertia="0.1102 0.1323 0.1543"/>
<site name="a" pos="-0.4201 -0.3336 -0.03299" axisangle="1.056 -0.8446 -0.6518 -72.12"/>
<site name="b" pos=".1 .2 0"/></body></worldbody>
<tendon><spatial name="t"><site site="w"/><site site="a"/></spatial></tendon>
<actuator><position {along} dampratio="0.3" kp="2"/></actuator></mujoco>"""
ALONG = (
    'cranksite="b" slidersite="a" cranklength="0.5431"',
    'cranksite="w" slidersite="a" cranklength="1.5"',
    'cranksite="b" slidersite="w" cranklength="1.5"',
    'site="a" refsite="w" gear="1 0 0 0 0 0"',
    'tendon="t"',
    'joint="j" gear="3"',
    'joint="j" gear="5e-9"',
    'joint="j" gear="2e-8"',
)


@pytest.mark.parametrize("z", [0.5, 0])
@pytest.mark.parametrize("along", ALONG)
def test_a_damping_ratio_of_arms_that_are_rounding(along, z):
    """Law: MuJoCo's damping and force; none below its smallest inverse inertia, 1e-15."""
    text = CRANKS.format(along=along, z=z)
    model = mujoco.MjModel.from_xml_string(text)
    data, sim = mujoco.MjData(model), sc.Sim(sc.loads(text))
    data.qvel[:] = sim.qvel[:] = 0.5, -0.7
    mujoco.mj_forward(model, data)
    sim.forward()
    assert sim.actuator_force == pytest.approx(data.actuator_force, rel=1e-9)
