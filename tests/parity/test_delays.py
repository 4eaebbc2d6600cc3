"""Actuators whose controls are late, step by step against MuJoCo.

Law: a run under changing controls is MuJoCo's to 1e-9, under every integrator that both have.
"""

import pickle

import mujoco
import numpy as np
import peers
import pytest
import zoo

import stepcore as sc

TEXT = zoo.ZOO["late_controls"].text
INTEGRATORS = {
    "euler": "Euler",
    "implicitfast": "implicitfast",
    "implicit": "implicit",
    "rk4": "RK4",
}
STEPS = 60


def controls():
    return np.random.default_rng(5).normal(size=(STEPS, 5))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_runs(integrator):
    theirs = mujoco.MjModel.from_xml_string(
        TEXT.replace("<option ", f'<option integrator="{INTEGRATORS[integrator]}" ')
    )
    data, model = mujoco.MjData(theirs), sc.loads(TEXT).compile()
    sim = sc.Sim(model, integrator=integrator, **peers.EXACT)
    for ctrl in controls():
        data.ctrl[:] = sim.ctrl[:] = ctrl
        mujoco.mj_step(theirs, data)
        sim.step()
        assert sim.actuator_force == pytest.approx(data.actuator_force, abs=1e-9)
        for field in ("qpos", "qvel", "act"):
            assert getattr(sim, field) == pytest.approx(getattr(data, field), abs=1e-9)
    assert sim.ctrl_history.shape == (3 + 4 + 5 + 2,)
    assert sim.ctrl_history[:3] == pytest.approx(controls()[:-4:-1, 0])


@pytest.mark.parametrize("integrator", ["midpoint", "discrete", "rk4"])
def test_snapshots_go_on(integrator):
    """A snapshot, a pickle and a batch of lanes continue bit for bit."""
    sim = sc.Sim(sc.loads(TEXT), integrator=integrator)
    for ctrl in controls()[:20]:
        sim.ctrl[:] = ctrl
        sim.step()
    copies = [pickle.loads(pickle.dumps(sim)), sc.Sim(sim.model)]
    copies[1].restore(sim.state())
    batch = sc.Batch(sim.model, 9)
    batch.restore([sim.state()] * 9)
    again = [sim, *copies]
    for ctrl in controls()[20:]:
        for one in (*again, batch):
            one.ctrl[:] = ctrl
            one.step()
    for field in ("qpos", "qvel", "act", "ctrl_history"):
        for other in (*copies, *(batch_world(batch, world) for world in (0, 8))):
            assert np.array_equal(getattr(other, field), getattr(sim, field)), field
    sim.reset()
    assert not sim.ctrl_history.any()


class batch_world:
    """One world's arrays of a batch."""

    def __init__(self, batch, world):
        self.batch, self.world = batch, world

    def __getattr__(self, name):
        return getattr(self.batch, name)[self.world]


def test_readings_are_those_before_the_step():
    """The last solve, done once more, reads the controls of its own time."""
    sim, ahead = (sc.Sim(sc.loads(TEXT)) for _ in range(2))
    for ctrl in controls()[:10]:
        sim.ctrl[:] = ahead.ctrl[:] = ctrl
        sim.step()
        ahead.forward()
        assert np.array_equal(sim.cacc, ahead.cacc)
        ahead.step()


def test_the_ledger_balances():
    """What a late control puts into its servo's spring when it arrives is work."""
    sim = sc.Sim(sc.loads(TEXT), dt=1e-4, integrator="midpoint", ledger=True)
    for ctrl in controls():
        sim.ctrl[:] = ctrl
        sim.step(20)


def test_linearised_a_late_control_is_kept_and_moves_nothing_yet():
    sim = sc.Sim(sc.loads(TEXT))
    column, now = sim.linearize().B, 2 * sim.model.nv + sim.model.na
    assert not column[:now, :4].any() and column[:now, 4].any()
    assert (column[now:, :4].sum(axis=0) == 1).all()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"delay": 0.1}, "nsample = 0: must be >= 1 with a delay"),
        ({"delay": -0.1, "nsample": 2}, "delay"),
        ({"nsample": -1}, "nsample"),
        ({"interp": "spline"}, "interp"),
    ],
)
def test_bad_values(given, words):
    scene = sc.loads(zoo.ZOO["muscles"].text)
    with pytest.raises(ValueError, match=words):
        scene.add_actuator("a", **given)
        scene.compile()


def test_written_and_read():
    scene = sc.loads(TEXT)
    assert sc.loads(scene.to_mjcf()) == scene
    assert [actuator.interp for actuator in scene.actuators[:3]] == ["zoh", "linear", "cubic"]
