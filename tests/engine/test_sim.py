"""`Sim`: its arrays, stepping, snapshots, and what happens when it fails or is interrupted."""

import copy
import pickle
import signal
from functools import partial

import numpy as np
import pytest
from busy import when_busy
from small import ball, pendulum, unstable

import stepcore as sc


@pytest.fixture(scope="module")
def model():
    return pendulum().compile()


@pytest.fixture
def sim(model):
    return sc.Sim(model)


# The arrays.


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_arrays_are_float64_views_that_stay_the_sims(model, precision):
    sim = sc.Sim(model, precision=precision)
    before = sim.qpos
    sim.qpos[:] = [0.25, 0.5]
    sim.step(3)
    assert sim.qpos is before
    assert before[0] != 0.25
    assert all(
        array.dtype == np.float64
        for array in (sim.qpos, sim.qvel, sim.act, sim.ctrl, sim.qfrc_applied, sim.xfrc_applied)
    )
    shapes = [a.shape for a in (sim.qpos, sim.qvel, sim.act, sim.ctrl, sim.xfrc_applied)]
    assert shapes == [(2,), (2,), (0,), (1,), (3, 6)]


def test_an_array_outlives_its_sim(model):
    qpos = sc.Sim(model).qpos
    assert qpos.tolist() == [0.0, 0.0]


def test_assignment_fills_the_array(sim):
    array = sim.qpos
    sim.qpos = [0.5, 1]
    assert sim.qpos is array
    assert array.tolist() == [0.5, 1.0]


def test_whatever_is_done_to_a_view_the_sim_keeps_its_numbers(sim):
    sim.qpos[:] = [0.1, 0.2]
    sim.qpos.shape = (2, 1) if np.lib.NumpyVersion(np.__version__) < "2.5.0" else (2,)
    sim.qvel.flags.writeable = False
    sim.step()
    assert sim.time == sim.settings.dt
    with pytest.raises(ValueError, match="resize"):
        sim.ctrl.resize(5)


# Stepping.


def test_free_fall_is_what_its_integrator_says():
    # v ← v + dt g, then q ← q + dt v: after n steps q falls by g dt² n (n + 1) / 2.
    sim = sc.Sim(ball(), dt=0.01, integrator="semi-implicit")
    sim.qpos[2] = 10.0
    sim.step(7)
    assert sim.qvel[2] == pytest.approx(-9.81 * 0.07, rel=1e-14)
    assert 10.0 - sim.qpos[2] == pytest.approx(9.81 * 0.01**2 * 28, rel=1e-12)
    assert sim.time == 7 * 0.01


def test_step_n_is_n_steps(model):
    once, often = sc.Sim(model), sc.Sim(model)
    for sim in (once, often):
        sim.ctrl[0] = 0.4
    once.step(50)
    for _ in range(50):
        often.step()
    assert once.state() == often.state()


def test_forward_moves_nothing(sim):
    sim.qpos[:] = [0.3, 0.2]
    before = sim.state()
    sim.forward()
    assert sim.state() == before
    assert sim.qacc.shape == (2,)


def test_applied_forces_act(sim):
    sim.forward()
    free = sim.qacc.copy()
    sim.qfrc_applied[1] = 3.0
    sim.forward()
    pushed = np.linalg.solve(sim.mass_matrix(), [0.0, 3.0])
    assert sim.qacc - free == pytest.approx(pushed, rel=1e-9)
    sim.qfrc_applied[:] = 0.0
    sim.xfrc_applied[2] = [0, 0, 5.0, 0, 0.5, 0]
    sim.forward()
    centre = sim.model.body_ipos[2]
    lower = sim.jacobian("lower")
    arm = sim.body("lower").xmat @ centre
    at_centre = lower[:3] + np.cross(lower[3:].T, arm).T
    generalised = at_centre.T @ [0, 0, 5.0] + lower[3:].T @ [0, 0.5, 0]
    assert sim.qacc - free == pytest.approx(
        np.linalg.solve(sim.mass_matrix(), generalised), rel=1e-9
    )


def test_reset_goes_to_the_pose_of_the_scene_or_to_a_key(sim):
    sim.step(20)
    sim.xfrc_applied[1, 2] = 1.0
    sim.reset(key="bent")
    assert (sim.time, sim.qpos.tolist(), sim.ctrl.tolist()) == (0.5, [0.3, -0.5], [0.7])
    assert sim.qvel.tolist() == [0.1, 0.2]
    assert not sim.xfrc_applied.any()
    sim.step()
    assert sim.time == 0.5 + sim.settings.dt
    sim.reset()
    assert sim.state() == sc.Sim(sim.model).state()
    assert sim.reset(key=0) is None
    assert sim.time == 0.5


# Snapshots and copies.


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("solver", ["pgs", "newton"])
def test_a_restored_snapshot_continues_bit_for_bit(solver, precision):
    sim = sc.Sim(pendulum(), solver=solver, precision=precision, sweeps=5, tolerance=0.0)
    sim.qpos[:] = [1.3, 0.9]
    sim.ctrl[0] = 0.9
    sim.step(100)
    snapshot = sim.state()
    sim.step(200)
    later = sim.state()
    sim.reset()
    sim.step(3)
    sim.restore(snapshot)
    assert sim.state() == snapshot
    sim.step(200)
    assert sim.state() == later
    for twin in (pickle.loads(pickle.dumps(sim)), copy.deepcopy(sim)):
        assert twin.settings == sim.settings
        assert twin.state() == later
        twin.step(50)
        sim.restore(later)
        sim.step(50)
        assert twin.state() == sim.state()


def test_time_goes_on_from_a_snapshot_under_another_dt(model):
    sim, other = sc.Sim(model, dt=0.01), sc.Sim(model, dt=0.004)
    sim.step(10)
    other.restore(sim.state())
    assert other.time == sim.time
    other.step()
    assert other.time == sim.time + 0.004
    other.time = 2.0
    other.step(3)
    assert other.time == 2.0 + 3 * 0.004


def test_time_is_counted_not_summed(model):
    sim = sc.Sim(model, dt=1e-3)
    sim.step(1000)
    assert sim.time == 1000 * 1e-3


# What goes wrong.


@pytest.mark.filterwarnings("ignore::stepcore.EnergyWarning")
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_divergence_names_its_element_and_keeps_the_last_finite_state(precision):
    sim = sc.Sim(unstable(), precision=precision)
    sim.qpos[:] = [1.0, 1.0]
    with pytest.raises(sc.SimulationError, match="spring of joint `wild`") as caught:
        sim.step(10_000)
    error = caught.value
    assert isinstance(error, RuntimeError)
    assert error.element == "spring of joint `wild`"
    assert error.world == 0
    assert error.time == sim.time == pytest.approx(error.step * 0.1)
    assert np.isfinite(sim.qpos).all() and np.isfinite(sim.qvel).all()
    assert abs(sim.qpos[1]) > 1e10
    again = sc.Sim(unstable(), precision=precision)
    again.qpos[:] = [1.0, 1.0]
    again.step(error.step)
    assert again.state() == sim.state()
    twin = pickle.loads(pickle.dumps(error))
    assert (twin.step, twin.element, str(twin)) == (error.step, error.element, str(error))


def test_an_interrupt_stops_a_long_call_between_two_steps_and_a_second_thread_is_refused(model):
    sim = sc.Sim(model, dt=1e-4)
    refused = []

    def meddle():
        # This thread runs only because the stepping one gave up the GIL.
        for call in (sim.step, sim.forward, sim.state, lambda: sim.xpos, lambda: sim.time):
            try:
                call()
            except RuntimeError as error:
                refused.append(str(error))
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        started = when_busy(sim, meddle)
        sim.step(10**9)
    started.join()
    assert refused == ["this Sim is busy in another thread"] * 5
    steps = round(sim.time / 1e-4)
    assert 0 < steps < 10**9
    other = sc.Sim(model, dt=1e-4)
    other.step(steps)
    assert other.state() == sim.state()


STACK = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
<body pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .1" mass="900"/></body></worldbody>
</mujoco>"""


@pytest.mark.parametrize("settings", [{"sweeps": 10**9}, {"sweeps": 5}], ids=["sweeps", "noslip"])
def test_an_interrupt_ends_a_step_of_a_billion_sweeps_which_is_not_taken(settings):
    scene = sc.loads(STACK)
    noslip = {"noslip_iterations": 10**9} if settings["sweeps"] == 5 else {}
    sim = sc.Sim(scene, solver="pgs", tolerance=0.0, **settings, **noslip)
    before = sim.state()
    with pytest.raises(KeyboardInterrupt):
        started = when_busy(sim, partial(signal.raise_signal, signal.SIGINT))
        sim.step()
    started.join()
    assert sim.state() == before and sim.time == 0
    other = sc.Sim(scene)
    sim = sc.Sim(sim.model.with_settings(sweeps=100, noslip_iterations=0, solver="newton"))
    for one in (sim, other):
        one.step(3)
    assert np.isfinite(sim.qpos).all()


def test_forces_of_elements_after_a_step_are_those_at_its_begin():
    """Not those of the velocity that it gave: the damper of a body at rest gives none."""
    scene = sc.Scene(gravity=(0, 0, -9.81))
    body = scene.add_body("load", mass=1.0, inertia=(1.0, 1.0, 1.0))
    scene.add_joint(body, "slide", axis=(0, 0, 1), damping=50.0, stiffness=300.0)
    sim = sc.Sim(scene, integrator="semi-implicit", dt=0.01)
    sim.qpos[0] = 0.1
    for _ in range(3):
        before = sim.qpos[0], sim.qvel[0]
        sim.step()
        forces = {kind: float(force[0]) for (kind, _), force in sim.element_forces().items()}
        expected = {"spring": -300.0 * before[0], "damper": -50.0 * before[1], "gravity": -9.81}
        assert {kind: forces.get(kind, 0.0) for kind in expected} == pytest.approx(expected)
        assert sum(forces.values()) * 0.01 == pytest.approx(sim.qvel[0] - before[1])
