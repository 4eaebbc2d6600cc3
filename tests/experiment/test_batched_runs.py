"""Runs as worlds of batches have the bits of single runs, and say what they saved."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import stepcore as sc
from stepcore.experiment.arguments import BatchSpeedup, Timed, Workers
from stepcore.experiment.batched_runs import batched, can, helps, portions, screened
from stepcore.experiment.motion import Motion
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import scheduled, time_steps
from stepcore.loading import find_model

QUADRUPED = "dm_control:suite/quadruped"
CASES = {
    "cheetah": ("gymnasium:half_cheetah", {}),
    "cheetah, f32": ("gymnasium:half_cheetah", {"precision": "f32"}),
    "ant, rk4": ("gymnasium:ant", {"integrator": "rk4", "dt": 0.005}),
    "no actuators": ("lesson:drop", {}),
    "muscles with states": ("dm_control:suite/dog", {"dt": 0.01}),
    "some explode": (QUADRUPED, {"integrator": "rk4", "dt": 0.02}),
    "some diverge": ("spring", {}),
}


# It diverges where it is stiff, but from the first start, which is at rest where the spring is.
SPRING = """<mujoco><option timestep="0.01" integrator="Euler"/><worldbody><body>
<joint type="slide" axis="1 0 0" stiffness="1" name="x"/>
<geom size="0.1" mass="1"/></body></worldbody>
</mujoco>"""


def runner(name: str, starts: int = 8, horizon: float = 0.4, **fields) -> Runner:
    model = find_model(name) if name != "spring" else sc.loads(SPRING).compile()
    if name == "spring":
        model = model.with_values({"joint/x/stiffness": 1e12})
    motion = Motion(horizon=horizon, **fields)
    _, period = time_steps(model.settings.dt, None, 0.1 if name != "lesson:drop" else None, horizon)
    return Runner(model, scheduled(motion, model, period, starts=starts))


def alike(one: Run, other: Run) -> bool:
    arrays = all(np.array_equal(getattr(one, n), getattr(other, n)) for n in ("com", "quat"))
    return arrays and one.failure == other.failure


@pytest.mark.parametrize("case", CASES)
def test_worlds_of_a_batch_are_single_runs(case):
    name, changes = CASES[case]
    made = runner(name)
    settings = made.model.settings.replace(**changes)
    singly = [made.screen(settings, start) for start in range(8)]
    together = batched(made, settings, [3, 0, 7, 1, 2, 6, 5, 4])
    for start, path in zip([3, 0, 7, 1, 2, 6, 5, 4], together, strict=True):
        assert alike(path, singly[start]), (start, path.failure, singly[start].failure)
    if case in ("some explode", "some diverge"):
        assert any(path.failure for path in singly)
        assert case == "some explode" or not singly[0].failure


@pytest.mark.parametrize("threads", [1, 3])
def test_portions_of_many_starts_come_back_in_their_order(threads):
    made, told = runner("gymnasium:half_cheetah", starts=21), []
    settings = made.model.settings
    workers = Workers(threads, progress=lambda label, done, total: told.append((done, total)))
    paths = screened(made, settings, range(21), workers, "runs")
    assert all(alike(path, made.screen(settings, k)) for k, path in enumerate(paths))
    assert told[-1] == (21, 21)
    if helps(20, threads, BatchSpeedup()):
        assert (workers.speedup.runs, workers.speedup.batches) == (20, 3)
        assert workers.speedup.alone > 0 and workers.speedup.spent > 0


def test_controls_of_python_are_run_singly():
    made = runner("gymnasium:half_cheetah", control=lambda time, sim: np.zeros(6))
    assert not can(made)
    workers = Workers()
    assert len(screened(made, made.model.settings, range(8), workers, "runs")) == 8
    assert workers.speedup.batches == 0


def test_batches_are_made_where_they_end_sooner():
    assert helps(7, 1, BatchSpeedup())
    assert not helps(4, 1, BatchSpeedup())  # too few
    assert not helps(7, 8, BatchSpeedup())  # a thread for each is sooner
    assert helps(31, 4, BatchSpeedup())
    assert not helps(7, 1, BatchSpeedup(runs=8, batches=1, alone=1.0, spent=1.0))
    assert [len(some) for some in portions(range(20))] == [8, 8, 4]


def test_what_a_batch_refuses_each_run_says_itself(monkeypatch):
    def refused(*args, **fields):
        raise ValueError("no such worlds")

    monkeypatch.setattr("stepcore.experiment.batched_runs.Batch", refused)
    made = runner("gymnasium:half_cheetah")
    settings = made.model.settings
    assert alike(batched(made, settings, range(2))[1], made.screen(settings, 1))


def test_what_was_saved_is_said():
    saving = BatchSpeedup()
    assert saving.worth and saving.sentences == []
    saving.compare(Timed([Run()], 0.5), [Timed([Run()] * 8, 2.0), Timed([Run()] * 8, 1.6)])
    text = (
        "16 runs were made as 2 batches, 2.2 times quicker than singly (computing time of a core)"
    )
    assert saving.sentences == [text]
    saving.compare(Timed([Run(failure="diverged")], 0.1), [Timed([Run()] * 8, 9.0)])
    assert saving.runs == 16  # a run that ends early says nothing of time
    assert pickle.loads(pickle.dumps(saving)).sentences == [text]
    saving.compare(Timed([Run()], 0.1), [Timed([Run()] * 8, 9.0)])
    assert not saving.worth and saving.sentences == []


def test_a_run_that_explodes_ends_with_the_joint_that_does():
    made = runner(QUADRUPED)
    failures = [
        made.screen(made.model.settings.replace(integrator="rk4", dt=0.02), k).failure
        for k in range(8)
    ]
    assert any(text and text.startswith("exploded at time 0.") for text in failures)
    assert any(text and "moves" in text and "in a step" in text for text in failures)
