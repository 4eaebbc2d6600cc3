"""What `converge` says where runs fail, where rows push too much, and where a sweep solves all."""

import dataclasses

import numpy as np
import pytest
from test_converge import heavy_end

import stepcore as sc
from stepcore import lesson
from stepcore.experiment.failure import failure
from stepcore.experiment.run import Run
from stepcore.measure.convergence.numbers import share


@pytest.fixture(scope="module")
def heavy():
    settings = {"law": "rigid", "solver": "pgs", "sweeps": 3}
    return sc.converge(
        lesson.tower((1.0, 100.0)).with_settings(settings), horizon=1.0, progress=False
    )


def failing(result, fails):
    """The same result, of which the splits that `fails` takes have failed."""
    runs = dict(result.runs)
    for split in result.candidates.splits:
        run = dataclasses.replace(runs[split.settings], failure=None, error=1e-3)
        if fails(split):
            run = dataclasses.replace(run, failure="start 0: diverged", error=np.nan)
        runs[split.settings] = run
    return dataclasses.replace(result, runs=runs)


def work(result):
    return next(s for s in result.sentences if s.startswith("At equal work"))


def test_no_verdict_stands_over_a_row_of_failures(heavy):
    said = work(failing(heavy, lambda split: True))
    assert said.startswith("At equal work (row updates) both smaller steps and more sweeps fail")
    said = work(failing(heavy, lambda split: split.sweeps > split.steps))
    assert said.startswith("At equal work (row updates) only smaller steps do not fail")
    said = work(failing(heavy, lambda split: split.sweeps < split.steps))
    assert said.startswith("At equal work (row updates) only more sweeps do not fail")
    assert "fails" in said


def test_few_sweeps_can_hide_what_diverges(heavy):
    runs = dict(heavy.runs)
    solved = heavy.candidates.solved
    runs[solved] = dataclasses.replace(runs[solved], failure="start 0: far off", error=np.nan)
    found = dataclasses.replace(heavy, runs=runs, ending=None)
    assert found.verdict == "diverging"
    verdict, *_ = found.sentences
    assert verdict.startswith("Diverging: with converged forces the motion fails (start 0: far off")
    assert verdict.endswith("it runs only because sweeps are too few.")


def run(height, energy):
    com = np.zeros((5, 1, 3))
    com[:, 0, 2] = height
    return Run(com=com, balance=np.array(energy, float), kinetic=np.zeros(5))


def test_a_stack_that_climbs_is_diverging_and_not_under_solved():
    # 10 kg in a scene of 4 m: it may not gain 393 J, and has not moved at all.
    rest = run(0.0, [0, 0, 0, 0, 0])
    climbs = run(height=[0, 1, 2, 4, 9], energy=[0, 98, 196, 392, 883])
    why = failure([climbs], [rest], size=4.0, weight=98.1)
    assert why == "start 0: gains 883 J of energy that nothing gives it"
    settles = run(-1e-3, [-0.1] * 5)
    assert failure([settles], [rest], size=4.0, weight=98.1) is None


def test_what_one_sweep_solves_leaves_nothing(heavy):
    assert share(0.0) == share(1e-17) == "nothing"
    assert share(0.4871) == "0.4871"
    assert "0.0000" not in heavy.text(full=True)


def test_a_chain_that_gains_energy_is_diverging_although_it_is_still_in_its_place():
    # Four sweeps a step: 48 steps lose energy, then the joints whirl at 2,400 rad/s.
    scene = heavy_end(8).with_settings(law="solref", integrator="euler", dt=1 / 60, sweeps=4)
    found = sc.converge(scene, horizon=0.8, starts=1, states=2, progress=False)
    assert found.verdict == "diverging"
    assert "of energy that nothing gives it" in found.shipped.failure
