"""`follow`: motions from several starts in one call are those of `Sim.step`, bit for bit."""

import numpy as np
import pytest
from small import ball, pendulum, unstable

import stepcore as sc
from stepcore import deadline
from stepcore.engine.control import ControlError
from stepcore.engine.follow import follow
from stepcore.engine.start import Start

RECORD = ("qpos", "qvel", "act", "ctrl", "xpos", "xquat", "energy", "qacc", "actuator_force")


@pytest.fixture(scope="module")
def hopper():
    return sc.load("gymnasium:hopper").compile()


def drawn(model, n, seed=3):
    rng = np.random.default_rng(seed)
    qpos = model.qpos0 + rng.normal(0, 0.05, (n, model.nq))
    return [Start(qpos[k], rng.normal(0, 0.5, model.nv)) for k in range(n)]


def stepped(model, start, steps, every, ctrl=None, hold=1, names=RECORD):
    """The same run, step by step."""
    sim = sc.Sim(model)
    start.put(sim)
    seen = {name: [np.array(getattr(sim, name))] for name in names}
    for step in range(steps):
        if ctrl is not None:
            sim.ctrl = ctrl[min(step // hold, len(ctrl) - 1)]
        sim.step()
        if (step + 1) % every == 0:
            for name in names:
                seen[name].append(np.array(getattr(sim, name)))
    return {name: np.array(values) for name, values in seen.items()}


@pytest.mark.parametrize("n, threads", [(1, 1), (3, 1), (9, 1), (9, 3), (17, 2)])
@pytest.mark.parametrize("settings", [{}, {"precision": "f32", "solver": "pgs"}])
def test_the_bits_are_those_of_single_steps(hopper, n, threads, settings):
    model, starts = hopper.with_settings(**settings), drawn(hopper, n)
    ctrl = np.random.default_rng(4).uniform(-1, 1, (n, 12, model.nu))
    run = follow(model, starts, 60, 4, ctrl=ctrl, hold=3, record=RECORD, threads=threads)
    assert run.times.tolist() == pytest.approx(np.arange(16) * 4 * model.settings.dt)
    assert run.failures == {}
    assert run.steps_made.tolist() == run.inner.tolist() == [60] * n
    for k in (0, n // 2, n - 1):
        for name, values in stepped(model, starts[k], 60, 4, ctrl[k], 3).items():
            assert run[name][k].tobytes() == values.tobytes(), name


def test_one_table_serves_all_starts_and_its_last_row_stays(hopper):
    starts, ctrl = drawn(hopper, 3), np.linspace(-1, 1, 2 * 3).reshape(1, 2, 3)
    run = follow(hopper, starts, 30, 10, ctrl=ctrl, hold=10, record=RECORD)
    for k, start in enumerate(starts):
        for name, values in stepped(hopper, start, 30, 10, ctrl[0], 10).items():
            assert run[name][k].tobytes() == values.tobytes(), name


def test_without_controls_and_with_late_ones():
    model = pendulum().compile()
    starts = drawn(model, 2)
    run = follow(model, starts, 20, 5, record=("qpos",))
    expected = stepped(model, starts[1], 20, 5, names=("qpos",))
    assert run["qpos"][1].tobytes() == expected["qpos"].tobytes()


def test_steps_within_an_accuracy_are_those_of_a_sim(hopper):
    model = hopper.with_settings(accuracy=1e-3)
    starts, ctrl = drawn(model, 3), np.full((1, 1, 3), 0.3)
    run = follow(model, starts, 12, 4, ctrl=ctrl, record=("qpos", "xpos"))
    for k, start in enumerate(starts):
        expected = stepped(model, start, 12, 4, ctrl[0], names=("qpos", "xpos"))
        assert run["xpos"][k].tobytes() == expected["xpos"].tobytes()
    assert (run.inner > run.steps_made).all()


@pytest.mark.parametrize("n", [1, 9])
def test_the_failure_of_one_start_does_not_end_the_others(n):
    model = unstable().compile()
    still = Start(model.qpos0, np.zeros(model.nv))
    starts = [Start(model.qpos0, np.ones(model.nv)), *[still] * (n - 1)]
    run = follow(model, starts, 4000, 10, record=("qpos",))
    assert list(run.failures) == [0]
    error = run.failures[0]
    assert "world" not in str(error)
    sim = sc.Sim(model)
    starts[0].put(sim)
    with pytest.raises(sc.SimulationError) as alone:
        sim.step(4000)
    assert error.step == run.steps_made[0] == alone.value.step < 4000
    assert run.steps_made[1:].tolist() == [4000] * (n - 1)
    last = error.step // 10
    assert np.isfinite(run["qpos"][0, : last + 1]).all()
    assert np.isnan(run["qpos"][0, last + 1 :]).all()
    assert np.isfinite(run["qpos"][1:]).all()


@pytest.mark.parametrize("n", [2, 11])
@pytest.mark.parametrize("record", [("xpos", "qpos"), ("xpos", "overlap")])
def test_a_run_ends_beyond_its_bound(n, record):
    model = ball(solver="pgs").compile()
    slow, fast = (Start(model.qpos0, np.array([v, 0, 0, 0, 0, 0.0])) for v in (0.1, 100.0))
    run = follow(model, [slow, fast, *[slow] * (n - 2)], 100, 10, bound=1.0, record=record)
    assert list(run.failures) == [1]
    assert "beyond the bound of 1" in str(run.failures[1])
    assert run.steps_made.tolist() == [100, run.failures[1].step, *[100] * (n - 2)]
    ended = run.steps_made[1] // 10
    far = np.linalg.norm(run["xpos"][1] - run["xpos"][1, 0], axis=-1).max(axis=-1)
    assert (far[:ended] <= 1.0).all()
    assert far[ended] > 1.0
    for name in record:
        assert np.isnan(run[name][1, ended + 1 :]).all()
        assert (run[name][[0, *range(2, n)]] == run[name][0]).all()
    assert (follow(model, [slow], 100, 10)["xpos"][0] == run["xpos"][0]).all()


def test_a_run_ends_beyond_its_bound_at_its_last_sample():
    model = ball(solver="pgs").compile()
    fast = Start(model.qpos0, np.array([100.0, 0, 0, 0, 0, 0]))
    run = follow(model, [fast], 10, 10, bound=1.0)
    assert (list(run.failures), run.steps_made.tolist()) == ([0], [10])
    assert np.isfinite(run["xpos"]).all()


def test_a_second_call_begins_anew(hopper):
    """A batch is kept between calls, with failures, impulses and mocap poses of the last one."""
    starts = [*drawn(hopper, 8), Start(hopper.qpos0, np.full(hopper.nv, 1e160))]
    ctrl = np.random.default_rng(4).uniform(-1, 1, (1, 30, 3))
    runs = [follow(hopper, starts, 60, 20, ctrl=ctrl, hold=2, record=RECORD) for _ in range(3)]
    assert [list(run.failures) for run in runs] == [[8]] * 3
    for name in RECORD:
        assert len({run[name].tobytes() for run in runs}) == 1
    assert (follow(hopper, starts[::-1], 20, record=("ctrl",))["ctrl"][-1] == 0).all()


def test_what_is_read_between_calls_is_what_is_sampled_within(hopper):
    starts, ctrl = drawn(hopper, 9), np.random.default_rng(4).uniform(-1, 1, (9, 7, 3))
    for settings in ({}, {"accuracy": 1e-3}, {"integrator": "implicitfast"}):
        model = hopper.with_settings(**settings)
        within = follow(model, starts, 20, 5, ctrl=ctrl, hold=2, record=("qpos", "energy"))
        between = follow(
            model, starts, 20, 5, ctrl=ctrl, hold=2, record=("qpos", "energy", "sensordata", "qacc")
        )
        assert within["qpos"].tobytes() == between["qpos"].tobytes()
        assert within["energy"].tobytes() == between["energy"].tobytes()


def test_the_operations_are_those_of_the_steps(hopper):
    starts, ctrl = drawn(hopper, 2), np.random.default_rng(4).uniform(-1, 1, (2, 50, 3))
    run = follow(hopper, starts, 200, 50, ctrl=ctrl, hold=4)
    for k, start in enumerate(starts):
        sim, whole = sc.Sim(hopper), 0
        start.put(sim)
        for step in range(200):
            sim.ctrl = ctrl[k, min(step // 4, 49)]
            whole += sim.count_flops()
            sim.step()
        assert run.operations[k] == pytest.approx(whole, rel=0.25)
    assert np.isnan(
        follow(hopper, starts, 4, control=lambda time, sim: np.zeros(3)).operations
    ).all()


def test_a_control_function_is_called_at_its_period_with_each_starts_own_sim(hopper):
    def push(time, sim):
        return 0.1 * np.sin(20 * time) - 0.2 * sim.qvel[3:]

    starts = drawn(hopper, 2)
    run = follow(hopper, starts, 40, 10, control=push, hold=5, record=("qpos", "ctrl"))
    for k, start in enumerate(starts):
        sim = sc.Sim(hopper)
        start.put(sim)
        for _ in range(8):
            sim.ctrl = push(sim.time, sim)
            sim.step(5)
        assert run["qpos"][k, -1].tobytes() == sim.qpos.tobytes()


def test_each_start_has_its_own_copy_of_a_callable_object(hopper):
    class Growing:
        calls = 0

        def __call__(self, time, sim):
            self.calls += 1
            return np.full(3, 0.01 * self.calls)

    starts, control = drawn(hopper, 1) * 2, Growing()
    run = follow(hopper, starts, 20, 10, control=control, record=("qpos",))
    assert run["qpos"][0].tobytes() == run["qpos"][1].tobytes()
    assert control.calls == 0


@pytest.mark.parametrize(
    "change, text",
    [
        ({"starts": []}, "starts"),
        ({"steps": -1}, "steps"),
        ({"every": 7}, "steps = 20: must be a multiple of every = 7"),
        ({"hold": 0}, "hold"),
        ({"record": ("qpso",)}, "qpso"),
        ({"bound": 0.0}, "bound"),
        (
            {"ctrl": np.zeros((2, 4, 3))},
            r"ctrl has shape \(2, 4, 3\): must be \(3 or 1, rows, 3\)",
        ),
        ({"ctrl": np.zeros((3, 0, 3))}, "at least one row"),
        ({"ctrl": np.full((1, 2, 3), np.nan)}, r"ctrl\[0, 0, 0\] = nan"),
        ({"ctrl": np.zeros((1, 1, 3)), "control": lambda time, sim: 0}, "control"),
        ({"control": lambda time, sim: 1j}, "control function"),
        ({"threads": 0}, "threads"),
    ],
)
def test_bad_arguments_are_refused(hopper, change, text):
    own = {"starts": drawn(hopper, 3), "steps": 20, "every": 5} | change
    with pytest.raises(ValueError, match=text):
        follow(hopper, **own)


def test_a_failing_control_function_is_no_failure_of_a_start(hopper):
    def bad(time, sim):
        raise ValueError("no")

    with pytest.raises(ControlError, match="bad"):
        follow(hopper, drawn(hopper, 2), 10, control=bad)


def test_a_start_that_is_not_finite_is_refused(hopper):
    starts = [Start(np.full(hopper.nq, np.nan), np.zeros(hopper.nv))]
    with pytest.raises(ValueError, match="qpos"):
        follow(hopper, starts, 10)


def test_the_deadline_ends_it(hopper):
    with deadline.Deadline(0.0).opened(), pytest.raises(deadline.OutOfTime):
        follow(hopper, drawn(hopper, 2), 1000)


BOUNCING = """<mujoco><option timestep="0.01" integrator="RK4"/><worldbody>
<geom type="plane" size="1 1 1"/><body pos="0 0 .05"><freejoint/>
<geom size=".05" mass="1" solref="-1e6 -10"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("recorded", (("qpos",), ("qacc",)))
def test_steps_within_an_accuracy_end_at_an_allowance(recorded):
    """Until then they are those of a run without one; a step in which it ends is not made.

    What the engine samples itself, and what a Sim is read for, alike.
    """
    model = sc.loads(BOUNCING).with_settings(accuracy=1e-7).compile()
    starts = [Start(np.array([0, 0, height, 1, 0, 0, 0]), np.zeros(6)) for height in (0.06, 3.0)]
    whole = follow(model, starts, 30, record=recorded)
    assert not whole.failures and whole.inner[0] > 4 * whole.inner[1]
    most = whole.inner[0] // 2
    cut = follow(model, starts, 30, record=recorded, most=most)
    assert [*cut.failures] == [0] and "more evaluations" in str(cut.failures[0])
    made, name = cut.steps_made[0], recorded[0]
    assert 0 < made < 30 and most < cut.inner[0] < whole.inner[0]
    if name == "qpos":
        # Where it ends a stretch is tried whole.
        assert cut.inner[0] < most + 100
    assert np.array_equal(cut[name][0, :made], whole[name][0, :made], equal_nan=True)
    assert np.isnan(cut[name][0, made + 1 :]).all()
    assert np.array_equal(cut[name][1], whole[name][1], equal_nan=True)
    # Steps of a fixed length have none.
    fixed = sc.loads(BOUNCING).compile()
    assert not follow(fixed, starts, 30, record=recorded, most=1).failures
