"""A log plays at its recorded times, whatever the step: no row is delayed, lost or refused."""

from dataclasses import replace

import numpy as np
import pytest
from covering import every_pair

import stepcore as sc
from stepcore.experiment.control_table import ControlLog, Controls
from stepcore.experiment.engines import run
from stepcore.experiment.schedule import scheduled

CART = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="cart">
<joint name="x" type="slide"/><geom size="0.1" mass="2"/></body></worldbody>
<actuator><motor name="push" joint="x"/></actuator></mujoco>"""
SERVO = CART.replace('<motor name="push"', '<position name="push" kp="200" kv="30"')


def log(gap, count=24, seed=0):
    """A log of random forces, a row every `gap` on average; times as a logger writes them."""
    rng = np.random.default_rng(seed)
    gaps = gap * (np.ones(count) if seed == 0 else rng.uniform(0.3, 1.7, count))
    return {"time": 17.3 + np.cumsum(gaps), "push": rng.normal(size=count)}


def impulse(table, upto, linear):
    """The exact integral of the log, by quadrature on a fine grid."""
    times = np.asarray(table["time"]) - table["time"][0]
    fine = np.linspace(0, upto, 400001)
    fine = (fine[1:] + fine[:-1]) / 2
    held = table["push"][np.searchsorted(times, fine, side="right") - 1]
    values = np.interp(fine, times, table["push"]) if linear else held
    return float(np.mean(values) * upto)


@every_pair(
    **{"gap, seed": [(0.025, 0), (0.001, 0), (1 / 30, 0), (0.02, 1)]},
    dt=[0.001, 0.002, 0.005, 0.008, 0.04],
    linear=[False, True],
)
def test_a_motor_gets_the_impulse_of_the_log_at_every_step(gap, seed, dt, linear):
    """v = ∫u dt / m at the end of each step, to rounding: the step samples no force wrongly."""
    table = log(gap, seed=seed)
    way = "linear" if linear else "held"
    motion = sc.Motion(horizon=0.4, starts=1, ctrl=table, interpolation=way)
    model = sc.loads(CART).compile()
    assert motion.period(0.002) is None
    ran = run(model.with_settings(dt=dt), scheduled(motion, model, 0.04), [0], record=("qvel",))
    assert ran["qvel"][0, -1, 0] == pytest.approx(impulse(table, 0.4, linear) / 2, abs=2e-6)


def test_a_step_within_one_row_gets_exactly_this_row():
    values = np.random.default_rng(1).normal(size=(50, 2))
    recorded = ControlLog(0.002 * np.arange(50), values)
    assert (recorded.steps(0.0, 0.002, 50) == values).all()
    assert (recorded.steps(0.002 * 10, 0.001, 4) == values[[10, 10, 11, 11]]).all()
    assert (recorded.steps(0.002 * 49, 0.01, 3) == values[-1]).all()


def test_means_over_two_rows():
    """Half a step of 1 and half of 3; the line from 0 to 4 in four seconds."""
    two = ControlLog(np.array([0.0, 1.5]), np.array([[1.0], [3.0]]))
    assert two.steps(0.0, 1.0, 3)[:, 0] == pytest.approx([1.0, 2.0, 3.0], abs=1e-15)
    line = ControlLog(np.array([0.0, 4.0]), np.array([[0.0], [4.0]]), linear=True)
    assert line.steps(0.0, 1.0, 6)[:, 0] == pytest.approx([0.5, 1.5, 2.5, 3.5, 4, 4], abs=1e-15)
    bent = ControlLog(np.array([0.0, 1.5, 3.0]), np.array([[0.0], [3.0], [0.0]]), linear=True)
    assert bent.steps(0.0, 3.0, 1)[0, 0] == pytest.approx(1.5, abs=1e-15)


def test_a_batch_plays_a_log_as_single_runs_do():
    model = sc.loads(SERVO).compile()
    motion = sc.Motion(horizon=0.4, starts=6, ctrl=log(0.025))
    schedule = scheduled(motion, model, 0.008)
    for dt in (0.001, 0.004, 0.008):
        changed = model.with_settings(dt=dt)
        together = run(changed, schedule, schedule.indices)["xpos"]
        for start in schedule.indices:
            alone = run(changed, schedule, [start])["xpos"]
            np.testing.assert_array_equal(alone[0], together[start])


@pytest.mark.parametrize("linear", [False, True])
def test_the_error_of_sampling_a_log_falls_as_the_square_of_the_step(linear):
    """rk4 shows the error of sampling alone. Controls read as a step starts: as dt, tenfold."""
    model = sc.loads(SERVO).compile()
    table, way = log(0.025, seed=3), "linear" if linear else "held"
    motion = sc.Motion(horizon=0.4, starts=1, ctrl=table, interpolation=way)
    own = scheduled(motion, model, 0.008)

    def ended(dt, at_beginning=False):
        schedule = own
        if at_beginning:
            rows = [own.log.steps(k * dt, 1e-6, 1) for k in range(round(0.4 / dt))]
            log = ControlLog(dt * np.arange(len(rows)), np.concatenate(rows))
            schedule = replace(own, controls=Controls(log))
        ran = run(model.with_settings(dt=dt, integrator="rk4"), schedule, [0])
        return ran["xpos"][0, :, 1, 2]

    def error(dt, at_beginning=False):
        return np.abs(ended(dt, at_beginning) - ended(0.008 / 512)).max()

    errors = [error(dt) for dt in (0.008, 0.004, 0.002)]
    assert errors[2] < errors[1] / 2.5 < errors[0] / 8
    assert all(
        error(dt, True) > 10 * mean for dt, mean in zip((0.008, 0.004), errors, strict=False)
    )


@pytest.mark.parametrize("gap", [0.025, 0.001, 0.02])
def test_trade_may_try_steps_longer_than_the_model_s_under_a_log(gap):
    """40 Hz at 2 ms (25 is no whole number of steps), 1 kHz at 2 ms, and 50 Hz."""
    result = sc.trade(
        sc.loads(SERVO), horizon=0.4, starts=2, ctrl=log(gap, 400), by="flops", progress=False
    )
    steps = {row.settings.dt for row in result.rows}
    assert result.schedule.period > 0.0079 and min(steps) < 0.002
    assert gap == 0.001 or max(steps) > 0.0039
    # The uncertainty of the motion is a hundredth of the shipped error.
    assert result.reference.error <= 0.011 * result.shipped.error


def test_rows_are_told_at_their_own_rate():
    options = {"progress": False, "horizon": 0.2}
    even = sc.converge(sc.loads(SERVO), ctrl=log(0.025), **options)
    assert "driven by the controls given (575 ms at 40 Hz: control of push);" in even.ran
    uneven = sc.converge(sc.loads(SERVO), ctrl=log(0.025, seed=1), **options)
    assert "driven by the controls given (567 ms at about" in uneven.ran
    sampled = sc.converge(sc.loads(SERVO), ctrl=log(0.025), control_dt=0.01, **options)
    assert (
        "driven by the controls given (575 ms at 40 Hz: control of push), a row every 10 ms;"
        in sampled.ran
    )


def test_without_times_there_is_nothing_to_interpolate():
    with pytest.raises(ValueError, match="ctrl: has no times to interpolate between"):
        sc.run(sc.loads(CART), ctrl=[[0.0], [1.0]], interpolation="linear")
    with pytest.raises(ValueError, match="interpolation = 'cubic': must be"):
        sc.Motion(interpolation="cubic")


def test_a_run_plays_a_log_as_measurements_do():
    model = sc.loads(CART).compile()
    for dt in (0.002, 0.005, 0.01):
        scene = sc.loads(CART.replace("0.002", str(dt)))
        shown = sc.run(scene, horizon=0.4, ctrl=log(0.025))
        motion = sc.Motion(horizon=0.4, starts=1, ctrl=log(0.025))
        schedule = scheduled(motion, model, 0.02)
        qpos = run(model.with_settings(dt=dt), schedule, [0], record=("qpos",))["qpos"][0, -1]
        np.testing.assert_allclose(shown.sim.qpos, qpos, atol=1e-15)
