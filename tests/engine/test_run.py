"""`Sim.run`: what is recorded, and when controls act."""

import copy

import numpy as np
import pytest
from small import pendulum

import stepcore as sc


@pytest.fixture(scope="module")
def model():
    return pendulum().compile()


def test_run_records_every_step(model):
    sim = sc.Sim(model, dt=0.01)
    trajectory = sim.run(0.5, control=lambda time, sim: [np.sin(time)], record=("qpos", "energy"))
    assert len(trajectory) == 51
    assert trajectory.qpos.shape == (51, 2)
    assert trajectory.energy.shape == (51, 2)
    assert trajectory.time == pytest.approx(np.arange(51) * 0.01)
    other = sc.Sim(model, dt=0.01)
    for _ in range(50):
        other.ctrl[:] = np.sin(other.time)
        other.step()
    assert (trajectory.qpos[-1] == other.qpos).all()
    assert "qpos (51, 2)" in repr(trajectory)
    assert copy.deepcopy(trajectory).qpos.shape == (51, 2)


def test_run_holds_controls_for_their_period(model):
    table, dts = np.array([[0.5], [-0.5], [1.0]]), (0.01, 0.005)
    for dt in dts:
        run = sc.Sim(model, dt=dt).run(0.1, table, control_dt=0.02, record=("ctrl",))
        each = round(0.02 / dt)
        expected = np.repeat([0.5, -0.5, 1.0, 1.0, 1.0], each)
        # What is recorded at an instant is the control that led there.
        assert (run.ctrl[1:, 0] == expected).all()


def test_run_draws_itself(model, tmp_path):
    run = sc.Sim(model, dt=0.01).run(0.05, record="qpos")
    run.plot(str(tmp_path / "run.png"))
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e39])
def test_a_refused_control_leaves_no_trace(model, bad):
    sim = sc.Sim(model, dt=0.01, precision="f32")
    sim.ctrl[:] = 0.25

    def control(time, sim):
        return [bad if sim.time > 0.035 else 0.5]

    with pytest.raises(
        ValueError, match=r"returned .* for motor `motor` at time 0.04 s: .* finite"
    ):
        sim.run(0.1, control=control)
    assert sim.ctrl.tolist() == [0.5]
    assert sim.time == pytest.approx(0.04)
    sim.step()
    before = sim.state()
    for refused in ([[0.5], [bad]], lambda time, sim: [0.0, 0.0], lambda time, sim: "full"):
        with pytest.raises(ValueError, match=r"ctrl|control function"):
            sim.run(0.1, control=refused)
        assert sim.state() == before
