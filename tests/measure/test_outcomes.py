"""`trade` of means: intervals of means, the numbers of runs, recommendations, and bad input."""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment import Change, Quantity, Study
from stepcore.experiment.outcomes import (
    PILOT,
    Numbers,
    difference,
    distance_of,
    exact_interval,
    quantile,
    ratio_of_spreads,
)

BALL = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
<body name="ball" pos="0 0 .3"><freejoint/><geom name="ball" size=".05" mass="1"/></body>
</worldbody></mujoco>"""


def height(xpos):
    return xpos[:, -1, 1, 2]


def low(xpos):
    return xpos[:, -1, 1, 2] < 0.0501


# --- statistics ---


@pytest.mark.parametrize("noise", [0.1, 3.0], ids=["paired", "unpaired"])
def test_intervals_cover_the_true_difference(noise):
    """Of 2,000 repeats 93 to 97 % cover it; common starts are used where that helps."""
    rng, covered, chosen = np.random.default_rng(0), 0, 0
    for _ in range(2000):
        start = rng.standard_exponential(96)
        apart = difference(start, start + 0.3 + noise * rng.standard_normal(96))
        covered += apart.low <= 0.3 <= apart.high
        chosen += apart.paired
    assert 0.93 < covered / 2000 < 0.97
    assert chosen > 1990 if noise < 1 else chosen < 1990


def test_intervals_of_shares_cover_at_least_95_percent():
    rng, covered = np.random.default_rng(0), 0
    for _ in range(1000):
        first = rng.random(132) < 0.3
        second = np.where(rng.random(132) < 0.9, first, ~first)
        apart = difference(first.astype(float), second.astype(float), binary=True)
        # A tenth of all changes: 0.3 of them down, 0.7 up.
        covered += apart.low <= 0.04 <= apart.high
    assert covered >= 950


def test_pilot_starts_are_not_used_again():
    first, second = np.zeros(100), np.zeros(100)
    second[:PILOT] = 1e6
    apart = difference(first, second)
    assert apart.value == 0 and apart.starts == 100 - PILOT


def test_failed_runs_are_left_out_and_counted():
    numbers = np.arange(100.0)
    failing = numbers.copy()
    failing[90:] = np.nan
    assert difference(numbers, failing).starts == 90 - PILOT
    assert difference(numbers, np.full(100, np.nan)).low == -np.inf


def test_closed_forms():
    # Student's t at 10 degrees of freedom; no hit of 100: 1 - 0.025 ** (1 / 100).
    assert quantile(10) == pytest.approx(2.2281, abs=1e-3)
    assert exact_interval(0, 100, 0.95)[1] == pytest.approx(1 - 0.025 ** (1 / 100), rel=1e-6)
    assert exact_interval(100, 100, 0.95)[0] == pytest.approx(0.025 ** (1 / 100), rel=1e-6)
    numbers = np.random.default_rng(0).normal(size=5000)
    ratio, least, most = ratio_of_spreads(numbers[:2500], 2 * numbers[2500:])
    assert least < 2 < most and ratio == pytest.approx(2, rel=0.05)
    assert distance_of(numbers, numbers)[0] == 0
    assert distance_of(numbers[:2500], numbers[2500:] + 5)[0] > 0.9


# --- numbers of runs ---


@pytest.mark.parametrize("engine", ["stepcore", "mujoco"])
def test_numbers_are_those_of_plain_loops(engine, tmp_path):
    file = tmp_path / "ball.xml"
    file.write_text(BALL)
    study = Study(str(file), quantity=height, horizon=0.5, starts=4, engine=engine)
    (numbers,) = Numbers(study).of([Change()], 4)
    model = sc.load(file).compile()
    for start, number in zip(study.schedule.starts, numbers, strict=True):
        sim = sc.Sim(model)
        start.put(sim)
        sim.step(round(study.schedule.horizon / model.settings.dt))
        assert number == pytest.approx(sim.xpos[1, 2], rel=1e-6)


def test_a_reduction_is_the_function_that_does_the_same():
    numbers = []
    for quantity in ("final(body/ball/z)", height):
        study = Study(sc.loads(BALL), quantity=quantity, horizon=0.3, starts=8)
        numbers += Numbers(study).of([Change()], 8)
    assert np.array_equal(*numbers)


def swing(time, sim):
    return -0.5 * sim.qvel[..., -1:] + np.sin(9 * time)


def test_a_batched_control_gives_the_runs_of_a_single_one():
    motion = {"horizon": 0.4, "control_dt": 0.02, "starts": 40}
    model, numbers = "gymnasium:inverted_pendulum", []
    for control in (swing, sc.batched(lambda time, worlds: swing(time, worlds))):
        study = Study(model, control=control, quantity="max(joint/hinge)", **motion)
        numbers += Numbers(study).of([Change(dt=0.005)], 40)
    assert np.array_equal(*numbers) and np.isfinite(numbers[0]).all()


def test_a_batched_control_of_another_shape_is_refused():
    control = sc.batched(lambda time, worlds: np.zeros(3))
    with pytest.raises(ValueError, match="shape"):
        Study("gymnasium:inverted_pendulum", control=control, control_dt=0.02)


def test_more_starts_continue_the_list():
    study = Study(sc.loads(BALL), quantity=height, horizon=0.2, starts=40)
    numbers = Numbers(study)
    (few,) = numbers.of([Change()], 40)
    (more,) = numbers.of([Change()], 70)
    assert np.array_equal(more[:40], few) and len(np.unique(more)) == 70
    assert study.runs == 70


# --- the answer ---


@pytest.fixture(scope="module")
def result():
    return sc.trade(sc.loads(BALL), quantity=height, horizon=0.1, starts=64)


def test_the_bias_of_a_fall_is_that_of_the_method(result):
    """Semi-implicit steps of dt fall g·t·dt/2 deeper than the exact parabola."""
    dt, g, t = result.settings.dt, 9.81, result.horizon
    assert result.shipped.difference.value == pytest.approx(-g * t * dt / 2, rel=0.02)
    assert result.agreed and result.resolved


def test_the_recommendation_holds(result):
    assert result.best() == result.chosen.settings
    assert result.chosen.within(result.error) and result.proof.within(result.error)
    assert all(row.cost >= result.chosen.cost for row in result.rows if row.within(result.error))


def test_the_result_is_data(result):
    data = json.loads(result.to_json())
    assert data["kind"] == "outcomes" and data["starts"] == 64
    assert {"mean", "difference", "low", "high", "sd_ratio", "failed"} <= data["rows"][0].keys()
    result.plot()


def both(xpos):
    return {"height": height(xpos), "low": low(xpos)}


def test_entries_of_a_dict_are_judged_together():
    entries = [Quantity(f"both:{entry}", both, entry) for entry in ("height", "low")]
    errors = {"error": [0.002, 0.5], "most": 64}
    result = sc.trade(sc.loads(BALL), quantity=entries, horizon=0.1, starts=64, **errors)
    reference = result.reference.numbers
    for row in result.rows:
        height_part, low_part = row.difference.parts
        apart = difference(reference[:, 0], row.numbers[:, 0]).value
        assert height_part.value == pytest.approx(apart / 0.002, rel=1e-9, abs=1e-12)
        assert row.within(1.0) == (height_part.bound <= 1 and low_part.bound <= 1)
    assert result.measure.binaries == (False, True) and result.chosen.within(1.0)
    assert "both:low" in result.to_dict()["rows"][0]
    result.plot()


def test_processes_give_the_numbers_of_threads():
    fall = {"quantity": low, "horizon": 0.3, "starts": 64, "most": 64}
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        results = [
            sc.trade(sc.loads(BALL), **fall, **workers)
            for workers in ({"executor": executor}, {"threads": 1})
        ]
    assert all(result.measure.binary for result in results)
    assert [row.record() for row in results[0].rows] == [row.record() for row in results[1].rows]


def test_axes_are_tried_and_the_cheapest_that_holds_is_chosen():
    """A fall errs by g·t·dt/2 under semi-implicit steps of dt."""
    dts = [0.002, 0.005, 0.01, 0.02]
    grid = {"dts": dts, "integrators": ["semi-implicit"], "error": 0.012}
    result = sc.trade(sc.loads(BALL), quantity=height, horizon=0.1, starts=64, most=64, **grid)
    biases = {row.dt: row.difference.value for row in result.rows}
    assert biases == pytest.approx({dt: -9.81 * 0.1 * dt / 2 for dt in biases}, rel=0.05, abs=1e-4)
    assert set(dts) <= set(biases) and result.chosen.dt == 0.02


def test_shares_of_successes():
    result = sc.trade(sc.loads(BALL), quantity=low, horizon=0.4, starts=64, error=0.5, seconds=20)
    assert result.measure.binary and 0 <= result.shipped.mean <= 1
    assert result.shipped.difference.high - result.shipped.difference.low > 0


def test_runs_that_fail_are_counted_and_never_recommended():
    text = """<mujoco><option timestep=".02"/><worldbody><body>
    <joint type="slide" stiffness="1e5"/><geom size=".1" mass="1"/></body></worldbody></mujoco>"""
    with pytest.warns(sc.StiffnessWarning):
        scene = sc.loads(text)
    result = sc.trade(scene, quantity="max(energy)", horizon=0.4, starts=64, seconds=30)
    assert result.shipped.failed == 64 and not result.shipped.within(1e9)
    assert result.chosen is None or not result.chosen.failed
    assert result.shipped.failing[0] > 0.9


# --- bad input ---


def wrong_shape(qpos):
    return qpos


def not_finite(qpos):
    return np.where(np.arange(len(qpos)) == 3, np.nan, qpos[:, -1, 0])


@pytest.mark.parametrize(
    ("quantity", "more", "words"),
    [
        ("body/ball/z", {"statistic": "mean"}, "not one number"),
        ("max(geom/*/z)", {}, "not one number"),
        (lambda qposs: 0, {}, "qposs"),
        (lambda *arrays: 0, {}, "parameters"),
        (wrong_shape, {}, "shape"),
        (not_finite, {}, "start 3"),
        (lambda qpos: 1 / 0, {}, "ZeroDivisionError"),
        (height, {"starts": 8}, "at least 64"),
        (height, {"most": 8}, "most"),
        (height, {"error": "-1"}, "error"),
        (height, {"error": 0}, "error"),
        (height, {"statistic": "median"}, "statistic"),
        (height, {"accuracies": ["1mm"]}, 'statistic="worst"'),
        (height, {"budget": "100x"}, 'statistic="worst"'),
        (both, {}, "both:height"),
        (Quantity("both:heigt", both, "heigt"), {}, 'nearest: "height"'),
        (Quantity("height:a", height, "a"), {}, "no dict"),
        (3, {}, "quantity"),
    ],
)
def test_bad_input_is_refused(quantity, more, words):
    scene = sc.loads(BALL.replace("</body>", '<geom name="a" size=".01"/></body>'))
    with pytest.raises(ValueError, match=words):
        sc.trade(scene, quantity=quantity, **{"horizon": 0.1, "starts": 64, **more})
