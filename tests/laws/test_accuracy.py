"""Steps within an accuracy: what is delivered, where they end, and what they refuse."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stepcore as sc
from stepcore.cli import main

PENDULUM = """<mujoco><option timestep="{dt}" gravity="0 0 -9.81"/><worldbody>
 <body><joint name="pivot" axis="0 1 0"/><geom size=".05" pos="0 0 -1" mass="1"/></body>
 </worldbody></mujoco>"""
TOP = """<mujoco><option timestep="0.05" gravity="0 0 0"/><worldbody>
 <body><joint type="free"/><geom type="box" size=".1 .2 .3" mass="3"/></body>
 </worldbody></mujoco>"""
BALL = """<mujoco><option timestep="{dt}"/><worldbody><geom type="plane" size="2 2 .1"/>
 <body pos="0 0 0.6"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
 </worldbody></mujoco>"""
# A servo that is stiff, late at its bound, and held by friction; a foot that lands beside a wall.
ROBOT = """<mujoco><option timestep="{dt}" integrator="implicitfast"/><worldbody>
 <geom type="plane" size="2 2 .1"/><geom type="box" size=".02 .5 .5" pos="{wall} 0 .5"/>
 <body pos="0 0 .35"><joint name="rail" type="slide" axis="1 0 0" damping="1"/>
  <joint name="lift" type="slide" axis="0 0 1" frictionloss="{loss}"/>
  <geom type="box" size=".05 .05 .05" mass="1"/>
  <body><joint name="hip" axis="0 1 0" armature=".01" frictionloss="{loss}" range="-50 50"/>
   <geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.2" mass=".3"/>
   <body pos=".1 0 -.2"><joint name="knee" axis="0 1 0" damping=".1"/>
    <geom type="capsule" size=".02" fromto="0 0 0 -.1 0 -.1" mass=".2"/></body></body></body>
 </worldbody><actuator><position joint="hip" kp="{kp}" kv="1" forcerange="-3 3"/>
 <position joint="knee" kp="20" kv=".2"/></actuator></mujoco>"""


def largest(sim, other):
    return float(np.linalg.norm(sim.xpos - other.xpos, axis=1).max())


@pytest.mark.parametrize("accuracy", (1e-2, 1e-4, 1e-6, 1e-8))
@pytest.mark.parametrize("dt", (0.001, 0.05))
def test_a_pendulum_is_as_near_as_was_asked(accuracy, dt):
    """Truth: classical Runge-Kutta of a tiny step, 1e-12 from itself at half of it."""
    true = sc.Sim(sc.loads(PENDULUM.format(dt=1e-4)), integrator="rk4")
    sim = sc.Sim(sc.loads(PENDULUM.format(dt=dt)), accuracy=accuracy)
    true.qpos[0] = sim.qpos[0] = 3.0
    for _ in range(20):
        true.step(500)
        sim.step(round(0.05 / dt))
        # The pendulum is 1 m long: a radian is a metre.
        assert abs(sim.qpos[0] - true.qpos[0]) <= accuracy * sim.time
    assert sim.time == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("stiffness", (1e3, 2e4))
@pytest.mark.parametrize("dt", (0.001, 0.01))
def test_a_stiff_spring_without_a_damper_keeps_what_was_asked(stiffness, dt):
    """A link swings at up to 350 rad/s on a sled; what each step adds to its swing stays there.

    Truth: classical Runge-Kutta of 10 µs, 3e-9 m from itself at twice the step.
    """
    model = sc.loads(f"""<mujoco><option timestep="1e-5"/><worldbody><body>
     <joint type="slide" axis="1 0 0"/><geom size=".05" mass="1"/>
     <body><joint axis="0 1 0" stiffness="{stiffness}"/><geom type="capsule" size=".03"
      fromto="0 0 0 0 0 -.2" mass=".5" contype="0" conaffinity="0"/></body></body>
     </worldbody></mujoco>""")
    true = sc.Sim(model, integrator="rk4")
    sim = sc.Sim(model, dt=dt, accuracy=1e-5)
    true.qvel[1] = sim.qvel[1] = 5.0
    for _ in range(50):
        true.step(2000)
        sim.step(round(0.02 / dt))
        assert largest(sim, true) <= 0.2e-5


def test_finer_is_better_to_rounding():
    """A spinning box: its angular momentum is constant, and so is its energy."""
    for accuracy in (1e-3, 1e-5, 1e-7, 1e-9):
        sim = sc.Sim(sc.loads(TOP), accuracy=accuracy)
        sim.qvel[3:] = 0.1, 9.0, 0.2
        before, energy = np.array(sim.momentum.angular), sim.energy.kinetic
        sim.step(40)
        size = float(np.linalg.norm(before))
        assert np.linalg.norm(sim.momentum.angular - before) < 300 * accuracy * size
        assert abs(sim.energy.kinetic - energy) < 300 * accuracy * energy


@pytest.mark.parametrize("accuracy", (1e-2, 1e-3, 1e-4))
@pytest.mark.parametrize("dt", (0.002, 0.05))
def test_a_ball_lands_as_near_as_was_asked(accuracy, dt):
    """Truth: its contact by steps of a microsecond, which are 3e-6 m from ones of half of it."""
    true = sc.Sim(sc.loads(BALL.format(dt=1e-6)), refsafe=False)
    sim = sc.Sim(sc.loads(BALL.format(dt=dt)), accuracy=accuracy)
    for _ in range(10):
        true.step(50_000)
        sim.step(round(0.05 / dt))
        assert largest(sim, true) <= accuracy * sim.time + 6e-6


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    kp=st.sampled_from((5.0, 100.0, 5000.0)),
    loss=st.sampled_from((0.0, 0.2)),
    wall=st.sampled_from((0.12, 0.2, 3.0)),
    seed=st.integers(0, 99),
)
def test_no_step_adds_more_than_was_asked(kp, loss, wall, seed):
    """Each step from the state that it found, against the same in 2,000 pieces: whatever begins and
    ends in it, contacts, limits of forces, friction that holds."""
    text, dt, accuracy = ROBOT, 0.01, 1e-3
    pieces = 2000
    model = sc.loads(text.format(dt=dt / pieces, kp=kp, loss=loss, wall=wall)).compile()
    sim = sc.Sim(model, dt=dt, accuracy=accuracy)
    true = sc.Sim(model, refsafe=False)
    random = np.random.default_rng(seed)
    for _ in range(25):
        sim.ctrl[:] = true.ctrl[:] = random.uniform(-1.5, 1.5, 2)
        true.qpos[:], true.qvel[:] = sim.qpos, sim.qvel
        sim.step()
        true.step(pieces)
        # What happens at once may add as much as 0.03 s; the rest is of the pieces.
        assert largest(sim, true) <= accuracy * 0.03 + 1e-6


def test_steps_end_where_those_of_a_fixed_length_do():
    fixed = sc.Sim(sc.loads(BALL.format(dt=0.003)))
    sim = sc.Sim(sc.loads(BALL.format(dt=0.003)), accuracy="1mm")
    fixed.step(1000)
    sim.step(1000)
    assert sim.time == fixed.time
    trajectory = sim.run(0.3, record=("qpos",))
    assert trajectory.time.size == 101


def test_the_motion_is_a_function_of_the_state():
    """In one call or many, from a snapshot, a copy or a pickle, and with threads: the same bits."""
    model = sc.loads(ROBOT.format(dt=0.01, kp=200, loss=0.1, wall=0.2)).compile()
    sim = sc.Sim(model, accuracy=1e-3)
    sim.ctrl[:] = 0.5, -0.5
    sim.step(20)
    others = [sim.copy(), pickle.loads(pickle.dumps(sim)), sc.Sim(model, accuracy=1e-3, threads=2)]
    others[2].restore(sim.state())
    sim.step(20)
    for other in others:
        for _ in range(20):
            other.step()
        assert other.state() == sim.state()


@pytest.mark.parametrize("threads", (1, 3))
def test_worlds_of_a_batch_are_those_of_sims(threads):
    """Each with steps of its own: the same bits, in what is read too, and from a copy."""
    model = sc.loads(ROBOT.format(dt=0.01, kp=200, loss=0.1, wall=0.2)).compile()
    worlds, steps = 4, 30
    ctrl = np.random.default_rng(0).uniform(-1, 1, (worlds, steps, 2))
    batch = sc.Batch(model, worlds, threads=threads, accuracy=1e-3)
    states = batch.rollout(ctrl)
    other = pickle.loads(pickle.dumps(batch))
    for world in range(worlds):
        sim = sc.Sim(model, accuracy=1e-3)
        for row, qpos in zip(ctrl[world], states.qpos[world], strict=True):
            sim.ctrl[:] = row
            sim.step()
            assert np.array_equal(sim.qpos, qpos)
        for name in ("qvel", "qacc", "actuator_force", "constraint_force", "xpos"):
            for many in (batch, other):
                assert np.array_equal(getattr(sim, name), getattr(many, name)[world]), name
        assert np.array_equal(sim.contacts, batch.contacts[world])
    batch.step(5)
    other.step(5)
    assert np.array_equal(batch.qpos, other.qpos)


@pytest.mark.parametrize("seed", range(4))
def test_calls_of_a_batch_are_those_of_a_sim(seed):
    """Over long runs, in calls of any length, with controls that change between them."""
    random = np.random.default_rng(seed)
    kp, wall = random.uniform(20, 400), random.uniform(0.1, 0.3)
    model = sc.loads(ROBOT.format(dt=0.01, kp=kp, loss=0.1, wall=wall)).compile()
    sim = sc.Sim(model, accuracy=1e-3)
    batch = sc.Batch(model, 2, threads=1, accuracy=1e-3)
    for _ in range(30):
        steps = int(random.integers(1, 14))
        sim.ctrl[:] = batch.ctrl[:] = random.uniform(-1, 1, 2)
        sim.step(steps)
        batch.step(steps)
        assert np.array_equal(batch.qpos, [sim.qpos] * 2)
        assert np.array_equal(batch.qvel, [sim.qvel] * 2)


def test_a_world_that_no_step_is_short_enough_for_stands_alone():
    """The others, whose balls do not land, go on; the failed one keeps its last state."""
    batch = sc.Batch(sc.loads(BALL.format(dt=0.05)), 3, accuracy=1e-10, on_failure="go on")
    batch.qpos[::2, 0] = 100.0
    batch.step(20)
    assert list(batch.failures) == [1]
    assert "no step keeps the accuracy" in str(batch.failures[1])
    fallen = 100 - 9.81 / 2
    assert batch.qpos[:, 0] == pytest.approx([fallen, -0.46, fallen], abs=0.06)
    assert batch.time == pytest.approx(1.0)


def test_environments_take_it():
    gymnasium = pytest.importorskip("gymnasium")
    import stepcore.gymnasium  # noqa: F401

    fields = {"settings": {"accuracy": 1e-3}}
    one = gymnasium.make("stepcore/HalfCheetah-v0", **fields)
    many = gymnasium.make_vec("stepcore/HalfCheetah-v0", num_envs=2, **fields)
    one.reset(seed=0)
    many.reset(seed=0)
    action = np.linspace(-1, 1, 6)
    for _ in range(5):
        alone, beside = one.step(action), many.step(np.array([action, action]))
        assert np.array_equal(alone[0], beside[0][0])


def test_what_is_read_is_that_of_the_state():
    sim = sc.Sim(sc.loads(BALL.format(dt=0.05)), accuracy=1e-4)
    sim.step(60)
    assert sim.contacts["force"][0] == pytest.approx([0, 0, 9.81], abs=0.01)
    assert abs(sim.qacc[0]) < 0.01
    rows = sim.rows
    assert rows["force"].sum() == pytest.approx(9.81, abs=0.01)


@pytest.mark.parametrize("integrator", ("explicit", "implicit", "discrete", "midpoint", "rk4"))
def test_every_integrator_gives_the_same_motion(integrator):
    """Those of several stages go as "euler"."""
    text = ROBOT.format(dt=0.02, kp=50, loss=0.1, wall=3.0)
    one = sc.Sim(sc.loads(text), accuracy=1e-4)
    other = sc.Sim(sc.loads(text), accuracy=1e-4, integrator=integrator)
    one.step(25)
    other.step(25)
    assert largest(one, other) < 1e-4


def test_single_precision_keeps_what_it_can():
    true = sc.Sim(sc.loads(PENDULUM.format(dt=1e-4)), integrator="rk4")
    sim = sc.Sim(sc.loads(PENDULUM.format(dt=0.05)), accuracy=1e-3, precision="f32")
    true.qpos[0] = sim.qpos[0] = 2.0
    true.step(10_000)
    sim.step(20)
    assert abs(sim.qpos[0] - true.qpos[0]) < 1e-3


@pytest.mark.parametrize(
    "fields, message",
    [
        ({"accuracy": 0.0}, "accuracy = 0: must be None, or finite and >= 1e-10 m in f64"),
        ({"accuracy": math.nan}, "accuracy = NaN"),
        ({"accuracy": "1 parsec"}, "accuracy = '1 parsec': must be None, metres, or a length"),
        ({"accuracy": 1e-6, "precision": "f32"}, ">= 1e-4 m in f32"),
        ({"accuracy": 1e-3, "law": "lesson", "solver": "pgs"}, "law = lesson: must be 'solref'"),
        ({"accuracy": 1e-3, "ledger": True}, "ledger = True: must be False"),
        ({"accuracy": 1e-3, "sleep": True}, "sleep = True: must be False"),
        ({"accuracy": 1e-3, "stiction": True}, "stiction = True: must be False"),
    ],
)
def test_what_does_not_go_with_it_is_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        sc.Settings(**fields)


def test_what_regards_one_step_refuses_it():
    model = sc.loads(BALL.format(dt=0.01)).compile().with_settings(accuracy="1mm")
    sim = sc.Sim(model)
    for ask in (
        sim.linearize,
        lambda: sc.converge(model),
        lambda: sc.ablate(model),
    ):
        with pytest.raises(ValueError, match=r"accuracy = 0\.001: must be None"):
            ask()


def test_what_rests_takes_whole_steps():
    """Ten boxes, with steps of half their contacts' time constant: five evaluations each."""
    boxes = "".join(
        f'<body pos="0 0 {0.1 + 0.2 * k}"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
        for k in range(10)
    )
    sim = sc.Sim(
        sc.loads(f"""<mujoco><option timestep="0.01"/><worldbody>
         <geom type="plane" size="5 5 .1"/>{boxes}</worldbody></mujoco>"""),
        accuracy="1mm",
    )
    sim.step(500)
    before, energy, place = sim._core.evaluations, sum(sim.energy), np.array(sim.qpos)
    sim.step(1000)
    assert sim._core.evaluations - before <= 5000
    assert abs(sum(sim.energy) - energy) < 1e-9
    assert np.abs(sim.qpos - place).max() < 1e-8


def test_late_controls_are_sampled_once_a_step():
    """A delay of two periods, against steps a thousandth as long that hold each control as long."""
    text = """<mujoco><option timestep="{dt}" gravity="0 0 0"/><worldbody><body>
     <joint name="a" type="slide"/>
     <geom size=".1"/></body></worldbody>
     <actuator><motor joint="a" gear="50" delay="0.02" nsample="{n}"/></actuator></mujoco>"""
    sim = sc.Sim(sc.loads(text.format(dt=0.01, n=5)), accuracy=1e-6, error_bar=True)
    fine = sc.Sim(sc.loads(text.format(dt=1e-5, n=5000)), law="solref")
    for step in range(60):
        sim.ctrl[0] = fine.ctrl[0] = np.cos(0.3 * step)
        sim.step()
        fine.step(1000)
        assert sim.qpos[0] == pytest.approx(fine.qpos[0], abs=2e-4)
        assert (sim.qpos[0] == 0) == (step < 2)
    assert abs(sim.qpos[0]) > 0.01
    assert sim.error.largest < 1e-6
    again = sim.copy()
    for each in (sim, again):
        each.step(5)
    assert (again.qpos == sim.qpos).all()


def test_an_error_of_activations_counts_by_what_it_pulls():
    """A filter far faster than the step, before a motor: against the closed form."""
    tau, gear = 2e-3, 40.0
    sim = sc.Sim(
        sc.loads(f"""<mujoco><option timestep="0.05" gravity="0 0 0"/><worldbody><body>
         <joint name="a" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body></worldbody>
         <actuator><general joint="a" dyntype="filter" dynprm="{tau}" gainprm="{gear}"/></actuator>
         </mujoco>"""),
        accuracy=1e-5,
    )
    sim.ctrl[0] = 1.0
    for step in range(1, 21):
        sim.step()
        time = 0.05 * step
        lag = tau * (1 - np.exp(-time / tau))
        assert sim.qpos[0] == pytest.approx(gear * (time**2 / 2 - tau * (time - lag)), abs=1e-5)
        assert sim.act[0] == pytest.approx(1.0, abs=1e-4)


def test_an_impact_too_sharp_for_the_accuracy_is_told_by_name():
    """No step is short enough for 1e-10 m of a contact that begins; the state before it stays."""
    sim = sc.Sim(
        sc.loads(BALL.format(dt=0.05).replace("<body ", '<body name="egg" ')), accuracy=1e-10
    )
    with pytest.raises(sc.SimulationError, match="no step keeps the accuracy of") as caught:
        sim.step(20)
    assert caught.value.element == "body `egg`"
    assert 0.25 <= sim.time <= 0.35
    assert np.isfinite(sim.qpos).all()
    assert caught.value.replay.steps == 1


def test_the_command_line_takes_it(tmp_path, capsys):
    file = tmp_path / "ball.xml"
    file.write_text(BALL.format(dt=0.01))
    assert main(["run", str(file), "--accuracy", "1mm", "--horizon", "0.5"]) == 0
    assert "accuracy" in capsys.readouterr().out
    assert main(["run", str(file), "--set", "accuracy=0.1mm", "--horizon", "0.5"]) == 0
    assert main(["run", str(file), "--accuracy", "soon"]) == 2
    assert "accuracy = 'soon': must be None, metres" in capsys.readouterr().err


def test_a_share_of_the_scene_s_size():
    """Of the largest arm of a body and the largest half size of a geom."""
    from stepcore.scene.softness import extent

    scene = sc.loads(BALL.format(dt=0.02))
    asked = 1e-3 * extent(scene)
    assert sc.Sim(scene, accuracy="0.1%").settings.accuracy == pytest.approx(asked)
    model = scene.compile().with_settings(accuracy=" 0.1 % ")
    assert model.settings.accuracy == pytest.approx(asked)
    with pytest.raises(ValueError, match="accuracy = '-1%'"):
        sc.Sim(scene, accuracy="-1%")


def test_a_run_says_where_the_file_relied_on_refsafe():
    text = BALL.format(dt=0.02).replace('size=".1"', 'size=".1" solref="0.01 1"')
    model = sc.loads(text).compile()
    hard = sc.run(model.with_settings(accuracy="1mm"), horizon=0.1)
    assert any("refsafe softens them to 40 ms" in note for note in hard.notes)
    assert not any("refsafe" in note for note in sc.run(model, horizon=0.1).notes)
    soft = sc.loads(BALL.format(dt=0.002)).compile().with_settings(dt=0.02, accuracy="1mm")
    assert not any("refsafe" in note for note in sc.run(soft, horizon=0.1).notes)


HEAVY_TOP = """<mujoco><option timestep="0.01"/><worldbody><body name="top">
<joint name="pivot" type="ball"/><geom type="cylinder" size=".05 .01" pos="0 0 .1" mass=".5"/>
</body></worldbody><keyframe><key qpos=".98 0 .2 0" qvel="0 0 {}"/></keyframe></mujoco>"""


@pytest.mark.parametrize("speed", [10, 60])
def test_a_run_says_of_a_fast_top_that_it_may_be_off_by_more(speed):
    model = sc.loads(HEAVY_TOP.format(speed)).compile().with_settings(accuracy="1mm")
    run = sc.run(model, horizon=0.2, progress=False)
    assert ("joint `pivot` turns at up to 60" in run.text()) == (speed > 1 / 0.03)
