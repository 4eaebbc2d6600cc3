"""The parts of a trade, each alone: its time steps, its starts, its marks."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.errors import Errors, moved, pareto
from stepcore.experiment.motion import Motion
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import scheduled, time_steps
from stepcore.measure.trade.methods import Steps, digits
from stepcore.measure.trade.recommend import Recommendation
from stepcore.measure.trade.rows import Frontier, Further, TradeRow, orders
from stepcore.report.units import metres, seconds


def test_pareto():
    assert pareto([1, 2, 3, 2.5], [3, 2, 1, 2]) == [True, True, True, False]
    assert pareto([1, 1, 1], [2, 1, 1]) == [False, True, False]
    assert pareto([float("nan"), 2], [0, 1]) == [False, True]
    assert pareto([3, float("nan"), 2, 1], [5, 0, 1, 2]) == [False, False, True, True]
    assert pareto([1, 2], [float("inf"), 1]) == [False, True]


def test_time_steps_divide_the_period():
    steps, period = time_steps(0.002, None, None, 1.0)
    assert period == steps[0] == pytest.approx(0.008) and len(steps) == 6
    steps, period = time_steps(0.01, None, 0.05, 1.0)
    assert 0.01 in steps and period == 0.05
    assert all(abs(period / dt - round(period / dt)) < 1e-9 for dt in steps)
    steps, period = time_steps(0.002, [0.003], None, 1.0)
    assert steps == [0.003, 0.002] and period == pytest.approx(0.006)


def test_round_time_steps_are_near_and_divide_the_period():
    steps = Steps(period=0.02, shipped=0.002)
    assert steps.dt(28) == pytest.approx(714.2857e-6, rel=1e-6)
    assert [steps.dt(n) for n in steps.rounder(28)] == pytest.approx([0.8e-3, 0.625e-3])
    assert steps.rounder(10) == steps.rounder(16) == []  # 2 ms as shipped; 1.25 ms
    for pieces in range(1, 300):
        for n in steps.rounder(pieces):
            assert digits(steps.dt(n)) <= 3 and pieces / 1.2 <= n <= pieces * 1.15


def recommended(dt, worse=()):
    """The row that is recommended in place of one that passed with this step [s].

    Errors grow as dt, 0.8 mm at 1 ms; worse: steps at which a further start misses the error.
    """
    steps = Steps(period=0.02, shipped=0.002)

    def row(settings):
        errors = SimpleNamespace(high=0.8 * settings.dt, position_max=0.0)
        further = Further(2, 2, 0.0)
        return TradeRow(settings, errors, 1 / settings.dt, 0.0, flops=1.0, further=further)

    def test(settings, limit, error):
        return Further(2, 1, 1.0) if any(settings.dt == pytest.approx(w) for w in worse) else passed

    passed = Further(2, 2, 0.0)
    reference = SimpleNamespace(settings=sc.Settings(dt=1e-5))
    confirm = SimpleNamespace(
        scored=np.ones(1), test=test, cache=SimpleNamespace(reference=reference)
    )
    first = row(sc.Settings(dt=dt))
    frontier = Frontier.of([first], 0.0, 0.0, "time")
    return Recommendation(frontier, confirm, row, steps).rounded(first, 1e-3).settings.dt


def test_single_precision_is_chosen_only_where_it_saves_what_timing_can_tell():
    for single, chosen in ((0.99, "f64"), (0.91, "f64"), (0.85, "f32")):
        costs = {"f64": 1.0, "f32": single}
        rows = [
            TradeRow(
                sc.Settings(precision=precision),
                SimpleNamespace(high=1e-4, position_max=0.0),
                cost,
                0.0,
                flops=1.0,
            )
            for precision, cost in costs.items()
        ]
        frontier = Frontier.of(rows, 0.0, 0.0, "time")
        assert frontier.cheapest(1e-3).settings.precision == chosen
        # Alone there is no choice.
        assert Frontier.of(rows[1:], 0.0, 0.0, "time").cheapest(1e-3).cost == single


def test_of_settings_that_cost_the_same_the_far_more_accurate_one_is_chosen():
    def chosen(by, *points, shipped=None):
        rows = [
            TradeRow(
                sc.Settings(dt=1e-3 * (k + 1)),
                SimpleNamespace(high=error, position_max=error),
                cost,
                0.0,
                flops=cost,
                shipped=k == shipped,
            )
            for k, (cost, error) in enumerate(points)
        ]
        return Frontier.of(rows, 0.0, 0.0, by).cheapest(1e-3).cost

    # Timing cannot tell 1 from 1.05; it can tell 1.3, and counted work has no uncertainty.
    assert chosen("time", (1.0, 8e-4), (1.05, 2e-4), (1.3, 1e-5)) == 1.05
    assert chosen("time", (1.0, 8e-4), (1.05, 7e-4)) == 1.0
    assert chosen("flops", (1.0, 8e-4), (1.05, 2e-4)) == 1.0
    # The shipped settings stay where nothing gains measurably; not where something does.
    assert chosen("time", (1.0, 8e-4), (1.08, 8e-4), shipped=1) == 1.08
    assert chosen("time", (1.0, 8e-4), (1.2, 8e-4), shipped=1) == 1.0
    assert chosen("time", (1.0, 3e-4), (1.08, 8e-4), shipped=1) == 1.0
    assert chosen("flops", (1.0, 8e-4), (1.08, 8e-4), shipped=1) == 1.0


def test_a_rounder_step_is_recommended_where_it_passes_and_costs_little():
    assert recommended(0.02 / 21) == pytest.approx(1e-3)  # 952 µs: 1 ms keeps to the error
    assert recommended(0.02 / 28) == pytest.approx(0.8e-3)
    # Where 0.8 ms fails on a further start, 0.625 ms is next; where that fails too, none.
    assert recommended(0.02 / 28, [0.8e-3]) == pytest.approx(0.625e-3)
    assert recommended(0.02 / 28, [0.8e-3, 0.625e-3]) == pytest.approx(0.02 / 28)
    assert recommended(0.0025) == 0.0025


def test_the_first_start_is_the_first_key_named_or_not():
    scene = sc.Scene()
    body = scene.add_body("body", mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(body, "slide")
    for height in (1.0, 2.0, 3.0):
        scene.add_key(qpos=[height])
    model = scene.compile()
    for key, height in ((None, 1.0), (1, 2.0), (-1, 3.0)):
        start = scheduled(Motion(horizon=0.1, starts=1, key=key), model, 0.1).starts[0]
        assert start.qpos.tolist() == [height]


def test_starts_respect_quaternions_and_ranges():
    scene = sc.Scene(gravity=(0, 0, -9.81))
    ball = scene.add_body("ball", pos=(0, 0, 1))
    scene.add_joint(ball, "free")
    scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    arm = scene.add_body("arm", "ball", mass=0.1, inertia=(1e-3, 1e-3, 1e-3))
    scene.add_joint(arm, "hinge", range=(0.0, 0.005))
    model = scene.compile()
    coordinates = Coordinates(model)
    got = scheduled(Motion(horizon=1.0, starts=8, seed=3), model, 0.04)
    assert np.array_equal(got.starts[0].qpos, model.qpos0)
    for start in got.starts:
        assert np.linalg.norm(start.qpos[3:7]) == pytest.approx(1, abs=1e-14)
        assert 0 <= start.qpos[7] <= 0.005
    assert len({start.qpos.tobytes() for start in got.starts}) == 8
    # A change of the dofs and its inverse.
    change = np.random.default_rng(0).uniform(-0.5, 0.5, coordinates.nv)
    moved = coordinates.moved(got.starts[1].qpos, change)
    assert coordinates.change(got.starts[1].qpos, moved) == pytest.approx(change, abs=1e-14)


def test_the_order_of_a_table_is_the_slope_of_errors_over_steps():
    def row(dt, error, **options):
        settings = sc.Settings(dt=dt, integrator="euler", **options)
        errors = Errors(error, error, 0, 0, 0, 0, 0, 0, each=(error,))
        return TradeRow(settings, errors, 1.0, 1.0)

    second = [row(dt, 3 * dt**2) for dt in (0.01, 0.008, 0.004, 0.001)]
    assert orders(second, 0.0)["euler"] == pytest.approx(2)
    # Errors of events, not of the method: 2.4 is no order, and neither is a 2 made of 1 and 3.
    assert orders([row(dt, dt**2.4) for dt in (0.01, 0.005, 0.0025)], 0.0) == {}
    assert orders([row(dt, dt**0.15) for dt in (0.01, 0.005, 0.0025)], 0.0) == {}
    assert orders([row(4, 8.0), row(2, 4.0), row(1, 0.5)], 0.0) == {}
    # At the reference's own error a slope says nothing, and neither does it over a short span.
    assert orders(second[:2], 0.0) == {}
    assert orders([row(0.01, 1e-3), row(0.001, 1e-9)], 1e-6) == {}
    # Nor where errors are as large as the motion, or refsafe softens the rows.
    saturated = [row(0.01, 0.9), row(0.005, 0.7), row(0.0025, 0.05)]
    assert orders(saturated, 0.0, 0.1) == {}
    soft = [dataclasses.replace(one, clamped=True) for one in second[:3]]
    assert orders([*soft, second[3]], 0.0) == {}
    # Rows that differ in more than dt are no line.
    assert orders([row(0.01, 1e-3), row(0.001, 1e-5, sweeps=3)], 0.0) == {}


@pytest.mark.parametrize(
    ("value", "text"), [(9.996e-4, "1 mm"), (9.99e-4, "999 µm"), (0.9996, "1 m"), (12.0, "12 m")]
)
def test_a_length_is_told_in_the_unit_that_it_is_rounded_to(value, text):
    assert metres(value) == text
    assert seconds(value) == text[:-1] + "s"


def test_a_horizon_that_cannot_end_is_refused_up_front():
    spring = sc.load("lesson:spring")
    said = r"horizon = 1e\+09: .* dt = 0.01 s that is 8e\+11 steps; must be at most 1e\+09"
    for measured in (sc.trade, sc.predict):
        with pytest.raises(ValueError, match=said):
            measured(spring, horizon=1e9, progress=False)
    with pytest.raises(ValueError, match=r"in 8 cells .* that is 1.6e\+12 steps"):
        sc.stability_map(values=[10], dts=[0.01], horizon=2e9, progress=False)


def test_how_far_matter_moves_is_its_error_if_it_stood_still():
    """A mass on a spring from its keyframe: x = a cos ωt, less where it is first seen."""
    scene = sc.Scene(gravity=(0, 0, 0))
    mass = scene.add_body("mass", mass=1, inertia=(1, 1, 1))
    scene.add_joint(mass, "slide", stiffness=(2 * np.pi) ** 2)
    scene.add_key(qpos=[0.1])
    scene.options = {"dt": 0.01, "integrator": "rk4"}
    found = sc.trade(scene, horizon=1.0, starts=1, dts=[0.01, 0.02], by="flops", progress=False)
    x = 0.1 * np.cos(2 * np.pi * np.linspace(0.02, 1.0, 50))
    true = np.sqrt(np.mean((x - x[0]) ** 2))
    assert moved(found.reference.runs) == pytest.approx(true, rel=1e-6)


@pytest.mark.parametrize("kind", ["sines", "random", "move"])
def test_a_start_is_the_same_however_many_there_are(kind):
    """Trade has 8 starts and ablate 136: their errors as shipped are of the same motions."""
    model = sc.loads(
        """<mujoco><worldbody><body><joint name="j" axis="0 1 0" range="-90 90"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body></worldbody><actuator>
        <position joint="j" kp="20" kv="1" ctrlrange="-1 1"/></actuator></mujoco>"""
    ).compile()
    few, many = (scheduled(Motion(horizon=0.2, kind=kind), model, 0.01, starts=n) for n in (2, 5))
    ends = [
        Runner(model, schedule).run(model.settings, 1).quat[-1].tolist() for schedule in (few, many)
    ]
    assert ends[0] == ends[1]
