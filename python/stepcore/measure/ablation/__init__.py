"""`ablate`: the cost of each modelled feature, and the error that removing it adds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from concurrent.futures import Executor
from functools import partial
from typing import Unpack

import numpy as np

from stepcore import checks
from stepcore.engine.features import RemovableFeatures, Removal, without
from stepcore.engine.model import Model
from stepcore.experiment.arguments import Source, Workers, set_up
from stepcore.experiment.cost import heaviness
from stepcore.experiment.failure import far_off, runaway
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.reference import Reference, ReferenceRuns
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import HORIZON, STARTS, Schedule, scheduled, time_steps
from stepcore.experiment.sizes import scene_size
from stepcore.measure.ablation.result import Ablation, FeatureEffect
from stepcore.measure.ablation.selection import Selection
from stepcore.measure.ablation.variants import (
    Baseline,
    VariantOutcome,
    outcome_of,
    times_of,
    usage_of,
)
from stepcore.report import units
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import metres, seconds

__all__ = ["Ablation", "FeatureEffect", "ablate"]

# The smallest model is confirmed on sets of so many other starts, until one of the sets needs
# nothing restored. Of 32 starts without a failure, at least 91 % of all such starts have none
# (95 % confidence); fewer, where each costs much.
SETS, CONFIRMED_ON = 4, 32
# What all runs of the sets may cost, in steps × (dofs + 2).
SETS_BUDGET = 6e6
# Where all features alone, from all starts, cost more than this, each first runs from a few starts,
# and only what keeps to the tolerance there from the others.
FEATURES_BUDGET, SCREENED = 1.2e7, 2
# What the reference may cost, in steps × (dofs + 2).
BUDGET = 3e6


@takes_motion()
def ablate(
    model: Source,
    motion: Motion | None = None,
    *,
    error: float | str = 1e-3,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
    **fields: Unpack[MotionFields],
) -> Ablation:
    """Removes one modelled feature at a time, and measures the work saved and the error added.

    Then it removes as many features together as possible within `error`: this smallest model is
    chosen on some starts and confirmed on up to 32 others; what those reach and need is restored,
    and the rest confirmed on further ones.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Everything runs under
        its own settings.
    error: the RMS position error, over samples and bodies, that the smallest model may add to the
        whole model's motion in the worst start: metres, "1mm", or "0.1%" of the scene's size.
    motion: a `Motion`, or its fields as arguments. By default 1 s, and 8 starts to choose on.
    threads: the number of runs at the same time (default: one per core).
    executor: any `concurrent.futures` executor, used in place of threads.
    progress: False for no bar, or a function of (label, done, total).

    Raises ValueError for an argument outside its limits, or if the whole model fails.

    >>> from stepcore import loads
    >>> result = ablate(loads('''<mujoco><worldbody><body><joint axis="0 1 0" range="-90 90"/>
    ...   <geom type="capsule" size=".02" fromto="0 0 0 .3 0 -.1"/></body></worldbody></mujoco>'''),
    ...   horizon=0.2, starts=2)
    >>> [row.outcome.worst for row in result.rows if row.removal.kind == "limits"]
    [0.0]
    >>> result.smallest.joints[0].range is None
    True
    """
    # A wrong error is refused before minutes of work; the scene's size is known later.
    units.length("ablate", "error", error, 1.0)
    setup = set_up(
        ablate,
        model,
        motion,
        fields,
        missing="no motion to keep",
        threads=threads,
        executor=executor,
        progress=progress,
    )
    model, motion, workers = setup
    starts, dt = motion.starts or STARTS, model.settings.dt
    _, period = time_steps(dt, None, motion.period(dt), motion.horizon or HORIZON)
    # Starts to choose on, and sets to confirm on what is left each time.
    one = Runner(model, scheduled(motion, model, period, starts=1))
    one.check_repeatable()
    weight = heaviness(one, model.settings)
    more = _more(model, motion.horizon or HORIZON, starts, weight)
    schedule = scheduled(motion, model, period, starts=starts + SETS * more)
    runner = Runner(model, schedule.part(0, starts))
    runs = ReferenceRuns(runner, model.settings, dt, BUDGET, workers, weight)
    reference, notes = _reference(runs)
    baseline = _baseline(runner, reference, workers)
    tolerance = units.length("ablate", "error", error, scene_size(model.scene, baseline.paths))
    usage = usage_of(runner, model.settings, workers)
    selection = Selection(baseline, RemovableFeatures(model), tolerance, workers)
    removals = selection.features.removals(usage, model.settings)
    dear = (1 + len(removals)) * starts * _work(model, schedule.horizon, weight) > FEATURES_BUDGET
    few = SCREENED if dear and starts > SCREENED else starts
    whole, alone, cut = _alone(baseline, removals, few, tolerance, workers)
    selection.known = dict(zip(removals, alone, strict=True))
    with workers.bar("smallest", len(removals)) as bar:
        selection.choose(removals, whole, bar)
    selection.confirm(_others(model, schedule, starts, more, workers))
    removed = selection.removed
    removals += [removal for removal in removed if removal not in removals]
    times = times_of(baseline, [(), *((removal,) for removal in removals), removed])
    rows = [
        FeatureEffect(removal, selection.alone(removal), cost)
        for removal, cost in zip(removals, times[1:-1], strict=True)
    ]
    return Ablation(
        name=setup.name,
        settings=model.settings,
        motion=dataclasses.replace(motion, horizon=schedule.horizon, starts=starts),
        horizon=schedule.horizon,
        starts=starts,
        error=tolerance,
        whole=FeatureEffect(Removal("whole model", "", ()), whole, times[0]),
        rows=rows,
        removed=removed,
        best=FeatureEffect(Removal("smallest model", "", ()), selection.chosen_on, times[-1]),
        confirmed=selection.confirmed_on,
        restored=selection.restored,
        restored_on=selection.restored_on,
        smallest=without(model.scene.with_settings(model.settings), removed),
        reference=reference.error if reference else None,
        notes=[
            *notes,
            *_notes(reference, baseline, tolerance),
            *_screened(cut, few, starts),
        ],
        batches=workers.speedup.sentences,
        ran=motion_in_words(model, motion, schedule.part(0, starts)),
    )


def _more(model: Model, horizon: float, starts: int, weight: float) -> int:
    """How many starts a set to confirm on has; weight: of a step (`heaviness`)."""
    cost = _work(model, horizon, weight)
    return max(starts, min(CONFIRMED_ON, int(SETS_BUDGET / (2 * SETS * cost))))


def _work(model: Model, horizon: float, weight: float) -> float:
    """What one run costs, in steps × (dofs + 2)."""
    return horizon / model.settings.dt * (model.nv + 2) * weight


def _alone(
    baseline: Baseline, removals: list[Removal], few: int, error: float, workers: Workers
) -> tuple[VariantOutcome, list[VariantOutcome], int]:
    """The whole model, every feature removed alone, and how many of these ran from few starts only.

    few: the starts that all run from; what adds more than `error` [m] there is not run from more.
    """
    points = [(), *((removal,) for removal in removals)]
    job = partial(outcome_of, baseline.first(few), workers=workers.inside)
    outcomes = workers.each(job, points, "features")
    if few == len(baseline.paths):
        return outcomes[0], outcomes[1:], 0
    again = [i for i, outcome in enumerate(outcomes) if outcome.worst <= error]
    job = partial(outcome_of, baseline, workers=workers.inside)
    full = workers.each(job, [points[i] for i in again], "features from all starts")
    for i, outcome in zip(again, full, strict=True):
        outcomes[i] = outcome
    return outcomes[0], outcomes[1:], len(points) - len(again)


def _screened(cut: int, few: int, starts: int) -> list[str]:
    """A note on features that ran from few starts."""
    if not cut:
        return []
    one = cut == 1
    return [
        f"{cut} feature{' exceeds' if one else 's exceed'} the tolerance in the first {few} of "
        f"{starts} starts, and {'was' if one else 'were'} not run from the others: "
        f"{'its error is that' if one else 'their errors are those'} of {few} starts"
    ]


def _others(
    model: Model, schedule: Schedule, starts: int, more: int, workers: Workers
) -> Iterator[tuple[Runner, Baseline]]:
    """The sets of starts on which nothing was chosen."""
    for first in range(starts, starts + SETS * more, more):
        runner = Runner(model, schedule.part(first, first + more))
        yield runner, _baseline(runner, None, workers)


def _reference(runs: ReferenceRuns) -> tuple[Reference | None, list[str]]:
    """The converged motion, or a note on why there is none."""
    try:
        with runs.workers.bar("reference", runs.least) as bar:
            return runs.reference(bar), []
    except ValueError as error:
        return None, [f"no converged motion to compare with: {checks.one_line(error)}"]


def _baseline(runner: Runner, reference: Reference | None, workers: Workers) -> Baseline:
    """The whole model's own motion at its settings; ValueError if it fails."""
    starts = range(len(runner.schedule.starts))
    job = partial(runner.run, runner.model.settings)
    paths = workers.each(job, starts, Progress("", len(starts), False))
    for start, path in enumerate(paths):
        if path.failure:
            raise ValueError(f"the whole model fails from start {start}: {path.failure}")
    explodes = runaway(runner.model, runner.schedule, paths)
    if explodes:
        raise ValueError(explodes)
    if reference is None:
        scored = np.ones((len(paths), len(runner.schedule.times)), bool)
        return Baseline(runner.model, runner.schedule, tuple(paths), None, scored)
    truth = tuple(reference.runs)
    wrong = far_off(paths, truth, scene_size(runner.model.scene, truth))
    if wrong:
        dt = seconds(runner.model.settings.dt)
        raise ValueError(f"the whole model fails at its dt of {dt}: {wrong}; see stepcore diagnose")
    return Baseline(runner.model, runner.schedule, tuple(paths), truth, reference.scored)


def _notes(reference: Reference | None, baseline: Baseline, tolerance: float) -> list[str]:
    notes: list[str] = []
    if reference is not None and reference.error > tolerance:
        notes.append(
            f"the reference has an error of {metres(reference.error)}, more than the tolerance: "
            "the column error is uncertain by that much, the column added is not"
        )
    short = int((~baseline.scored).any(axis=1).sum())
    if short:
        count = f"{short} of {len(baseline.paths)} starts"
        notes.append(f"{count} count only as long as they can be predicted")
    if baseline.schedule.undriven:
        names = ", ".join(baseline.schedule.undriven)
        notes.append(f"actuators without a control range are not driven: {names}")
    return notes
