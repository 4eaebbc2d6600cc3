"""What a trade says of worlds in batches: the same motion and errors, another cost."""

import json
import math

import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment.batched_runs import BatchRun
from stepcore.experiment.cost import Stopwatch
from stepcore.experiment.errors import errors, pareto
from stepcore.experiment.motion import Motion
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import scheduled
from stepcore.loading import find_model
from stepcore.measure.trade.batch_cost import WORLDS, TimedBatch

FEW = {"horizon": 0.2, "starts": 2, "threads": 1, "progress": False}


@pytest.fixture(scope="module")
def trade():
    dts = [0.005, 0.01]
    return sc.trade("gymnasium:half_cheetah", dts=dts, error=1.0, further=0, **FEW)


def test_the_answers_settings_are_points_in_both_precisions(trade):
    points = trade.in_batch
    named = [trade.recommended, trade.shipped, *trade.offered]
    assert {p.row.settings for p in points} == {
        row.settings.replace(precision=precision) for row in named for precision in ("f64", "f32")
    }
    assert all(p.worlds == WORLDS == 16 and p.cost > 0 and p.row.cost > 0 for p in points)
    marks = pareto([p.cost for p in points], [p.error for p in points])
    assert [p.best for p in points] == marks


def test_their_errors_are_those_of_single_runs(trade):
    reference = trade.reference
    for point in trade.in_batch:
        settings = point.row.settings
        paths = [trade.runner.run(settings, start) for start in range(2)]
        apart = errors(paths, reference.runs, reference.scored).high
        assert point.error == max(apart, reference.high)


def test_what_is_printed_keeps_both_costs_apart(trade):
    text = " ".join(trade.text(100, full=True).split())
    assert "In a batch of 16 worlds on one thread, the recommended settings cost for each" in text
    assert "Cost per world when 16 worlds are stepped as a batch on one thread" in text
    records = json.loads(trade.to_json())["in_batch"]
    assert len(records) == len(trade.in_batch)
    assert {record["worlds"] for record in records} == {16}
    assert {record["precision"] for record in records} == {"f64", "f32"}


def test_nothing_is_timed_where_costs_are_counted_or_python_controls():
    assert sc.trade("lesson:spring", dts=[0.01], by="flops", **FEW).in_batch == []
    pendulum = "gymnasium:inverted_pendulum"
    own = sc.trade(pendulum, dts=[0.02], control=lambda time, sim: [0.0], **FEW)
    assert own.in_batch == []
    assert "In a batch" not in own.text(full=True)


@pytest.mark.parametrize("name", ["gymnasium:half_cheetah", "lesson:drop"])
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_the_timed_motion_is_that_of_single_runs(name, precision):
    model = find_model(name)
    period = 0.1 if model.nu else model.settings.dt
    runner = Runner(model, scheduled(Motion(horizon=0.4), model, period, starts=3))
    settings = model.settings.replace(precision=precision)
    run = BatchRun(runner, settings, [0, 1, 2, 0, 1])
    for _ in range(2):
        run.timed(Stopwatch())
        for world, start in enumerate(run.starts):
            sim = runner.sim(settings)
            runner.follow(sim, start)
            assert np.array_equal(run.batch.qpos[world], sim.qpos)
            assert np.array_equal(run.batch.qvel[world], sim.qvel)


def test_a_batch_in_which_a_world_fails_has_no_cost():
    scene = sc.Scene()
    body = scene.add_body("mass", mass=1.0, inertia=(1, 1, 1))
    scene.add_joint(body, "slide", stiffness=1e9, axis=(1, 0, 0))
    scene.add_key("out", qpos=[1.0])
    model = scene.compile().with_settings(dt=0.01, integrator="semi-implicit")
    runner = Runner(model, scheduled(Motion(horizon=2.0), model, 0.01, starts=3))
    timed = TimedBatch(runner, model.settings, False, 16)
    assert timed.again() == 0.0 and timed.failed and math.isnan(timed.cost)
