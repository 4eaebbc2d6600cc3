"""`ablate`: the cost of each modelled feature, and the error added when the feature is removed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Unpack

import numpy as np

from stepcore import checks
from stepcore.engine.features import RemovableFeatures, Removal, without
from stepcore.engine.model import Model
from stepcore.experiment.arguments import MeasurementFields, Source, Workers, measurement, set_up
from stepcore.experiment.cost import TimedRun, heaviness
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.failure import runaway
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.reference import Reference
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import HORIZON, STARTS, scheduled, time_steps
from stepcore.experiment.sizes import scene_size
from stepcore.measure.ablation.result import Ablation, FeatureEffect
from stepcore.measure.ablation.selection import Selection
from stepcore.measure.ablation.variants import (
    Baseline,
    VariantOutcome,
    outcome_of,
    time_saved,
    timed_runs,
    usage_of,
)
from stepcore.report import units
from stepcore.report.units import metres, seconds

__all__ = ["Ablation", "FeatureEffect", "ablate"]

# Largest number of sets of other starts on which the smallest model is confirmed, and starts in a
# set. Confirmation ends with a set that needs nothing restored. If 32 starts show no failure, at
# least 91 % of all such starts have none (95 % confidence). Sets are smaller if each start is
# expensive.
SETS, CONFIRMED_ON = 4, 32
# Limit on the cost of all runs of the sets, in steps × (dofs + 2).
SETS_BUDGET = 6e6
# Above this cost of all single removals, each feature first runs from SCREENED starts. Only
# features within the tolerance there run from the others.
FEATURES_BUDGET, SCREENED = 1.2e7, 2
# Limit on the cost of the reference, in steps × (dofs + 2).
BUDGET = 3e6
# The shares of the time (`seconds`) at which the converged motion, the features alone, the choice
# and the tests on other starts end.
CONVERGED, ALONE, CHOSEN, CONFIRMED = 0.4, 0.7, 0.8, 0.95


@measurement()
def ablate(
    model: Source,
    motion: Motion | str | None = None,
    *,
    added: float | str = 1e-3,
    **fields: Unpack[MeasurementFields],
) -> Ablation:
    """Remove one modelled feature at a time, and measure the work saved and the error added.

    Then `ablate` removes as many features together as possible within `added`. This smallest model
    is chosen on some starts and confirmed on up to 32 others. Features that the other starts need
    are restored, and the new smallest model is confirmed on further starts.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Every run uses the
        model's own settings.
    motion: a `Motion`, or its fields as arguments. By default 1 s, and 8 starts for the choice.
    added: the largest RMS position error, over samples and bodies, that the smallest model may add
        to the whole model's motion in the worst start: metres, "1mm", or "0.1%" of the scene's
        size.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

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
    # Check the tolerance before minutes of work; the scene's size is known later.
    units.length("ablate", "added", added, 1.0)
    setup = set_up(ablate, model, motion, fields, missing="no motion to keep")
    model, (_, motion, workers) = setup.model, setup
    starts, dt = motion.starts or STARTS, model.settings.dt
    _, period = time_steps(dt, None, motion.period(dt), motion.horizon or HORIZON)
    first = Runner(model, scheduled(motion, model, period, starts=1))
    first.check_repeatable()
    work = _work(model, motion.horizon or HORIZON, heaviness(first, model.settings))
    # The number of starts in a set to confirm on.
    more = max(starts, min(CONFIRMED_ON, int(SETS_BUDGET / (2 * SETS * work))))
    schedule = scheduled(motion, model, period, starts=starts + SETS * more)
    experiment = Experiment(model, schedule.part(0, starts), workers)
    time = workers.deadline
    reference, notes = None, list[str]()
    with time.stage("the converged motion, and errors against it", CONVERGED):
        reference, notes = _reference(experiment)
    baseline = _baseline(experiment, reference)
    tolerance = units.length("ablate", "added", added, baseline.size)
    if reference:
        notes += [*_poor(reference, tolerance), *reference.notes]
    features = RemovableFeatures(model)
    selection = Selection(baseline, features, tolerance, workers)
    removals = features.removals(usage_of(experiment.runner, workers), model.settings)
    dear = (1 + len(removals)) * starts * work > FEATURES_BUDGET
    few = SCREENED if dear and starts > SCREENED else starts
    whole, alone, cut = _alone(baseline, removals, few, tolerance, workers)
    removals = list(alone)
    time.so_far(_so_far(whole, alone, tolerance))
    selection.known = alone
    complete = False
    with (
        time.stage("the whole search for the smallest model", CHOSEN),
        workers.bar("smallest", len(removals)) as bar,
    ):
        selection.choose(removals, whole, bar)
        complete = True
    sets = (schedule.part(k, k + more) for k in range(starts, starts + SETS * more, more))
    with time.stage("all tests of the smallest model on other starts", CONFIRMED):
        selection.confirm(_baseline(Experiment(model, part, workers)) for part in sets)
    removed = selection.removed
    removals += [removal for removal in removed if removal not in removals]
    with time.closing():
        runs = timed_runs(baseline, [(), *((removal,) for removal in removals), removed])

    def effect(removal: Removal, outcome: VariantOutcome, run: TimedRun) -> FeatureEffect:
        return FeatureEffect(removal, outcome, run.cost, time_saved(runs[0], run))

    return Ablation(
        name=setup.name,
        settings=model.settings,
        motion=dataclasses.replace(motion, horizon=schedule.horizon, starts=starts),
        horizon=schedule.horizon,
        starts=starts,
        tolerance=tolerance,
        whole=FeatureEffect(Removal("whole model", "", ()), whole, runs[0].cost),
        rows=[
            effect(removal, selection.alone(removal), run)
            for removal, run in zip(removals, runs[1:-1], strict=True)
        ],
        removed=removed,
        best=effect(Removal("smallest model", "", ()), selection.chosen_on, runs[-1]),
        confirmed=selection.confirmed_on,
        restored=selection.restored,
        restored_on=selection.restored_on,
        smallest=without(model.scene.with_settings(model.settings), removed),
        reference=reference.high if reference else None,
        notes=[*notes, *schedule.notes, *_screened(cut, few, starts)],
        batches=workers.speedup.sentences,
        ran=motion_in_words(model, motion, experiment.schedule),
        complete=complete,
    )


def _work(model: Model, horizon: float, weight: float) -> float:
    """Return the cost of one run, in steps × (dofs + 2); weight: of a step (`heaviness`)."""
    return horizon / model.settings.dt * (model.nv + 2) * weight


def _alone(
    baseline: Baseline, removals: list[Removal], few: int, tolerance: float, workers: Workers
) -> tuple[VariantOutcome, dict[Removal, VariantOutcome], int]:
    """Run the whole model and every feature removed alone.

    Return both outcomes, and the number of features that ran from few starts only. If the time is
    over, some features have no outcome.

    few: the number of starts that all features run from. A feature that adds more than `tolerance`
        [m] there does not run from the other starts.
    """
    points = [(), *((removal,) for removal in removals)]
    job = partial(outcome_of, baseline.first(few), workers=workers.inside)
    outcomes: list[VariantOutcome | None] = []
    with workers.deadline.stage(lambda: _not_run(outcomes, "feature"), ALONE):
        workers.each(job, points, "features", outcomes)
    whole, cut = outcomes[0] if outcomes else None, 0
    if whole is None:
        # The answer needs the whole model, whose runs may therefore take all the time.
        whole = job(points[0])
        outcomes[:1] = [whole]
    if few < len(baseline.runs):
        again = [i for i, one in enumerate(outcomes) if one is not None and one.worst <= tolerance]
        job = partial(outcome_of, baseline, workers=workers.inside)
        full: list[VariantOutcome | None] = []
        with workers.deadline.stage(lambda: _not_run(full, "feature") + " from all starts", ALONE):
            workers.each(job, [points[i] for i in again], "features from all starts", full)
        for i, outcome in zip(again, full, strict=True):
            outcomes[i] = outcome or outcomes[i]
        cut = len(points) - len(again)
        whole = outcomes[0] or whole
    known = zip(removals, outcomes[1:], strict=True)
    return whole, {removal: one for removal, one in known if one is not None}, cut


def _so_far(whole: VariantOutcome, alone: dict[Removal, VariantOutcome], tolerance: float) -> str:
    """Return what features save that are removed alone, in words."""
    within = {one: outcome for one, outcome in alone.items() if outcome.worst <= tolerance}
    said = f"{len(within)} of {units.counted(len(alone), 'feature')} add at most "
    said += f"{metres(tolerance)} when removed alone"
    if within:
        best = max(within, key=lambda one: within[one].saved(whole))
        share = units.percent(within[best].saved(whole))
        said += f"; most is saved without {best.label}: {share} of the work"
    return f"{said}; the search for the smallest model goes on"


def _not_run(outcomes: Sequence[VariantOutcome | None], what: str) -> str:
    """Return how many features, of how many, the deadline left out."""
    left = sum(outcome is None for outcome in outcomes)
    return f"{left} of {units.counted(len(outcomes), what)}"


def _reference(experiment: Experiment) -> tuple[Reference | None, list[str]]:
    """Return the converged motion, or None and a note with the reason."""
    try:
        return experiment.reference(experiment.model.settings.dt, BUDGET), []
    except ValueError as error:
        return None, [f"no converged motion to compare with: {checks.one_line(error)}"]


def _baseline(experiment: Experiment, reference: Reference | None = None) -> Baseline:
    """Run the whole model at its own settings; raise ValueError if a run fails."""
    model, schedule = experiment.model, experiment.schedule
    starts = len(schedule.starts)
    runs = experiment.run(model.settings)
    if runs[-1].failure:
        raise ValueError(f"the whole model fails from start {len(runs) - 1}: {runs[-1].failure}")
    explodes = runaway(model, schedule, runs)
    if explodes:
        raise ValueError(explodes)
    if reference is None:
        scored = np.ones((starts, len(schedule.times)), bool)
        return Baseline(model, schedule, tuple(runs), None, scored, scene_size(model.scene, runs))
    wrong = experiment.failure(runs, reference)
    if wrong:
        dt = seconds(model.settings.dt)
        raise ValueError(f"the whole model fails at its dt of {dt}: {wrong}; see stepcore diagnose")
    truth, scored = tuple(reference.runs), reference.scored
    return Baseline(model, schedule, tuple(runs), truth, scored, experiment.size)


def _poor(reference: Reference, tolerance: float) -> Iterator[str]:
    """Yield a note if the reference is less accurate than the tolerance."""
    if reference.high > tolerance:
        yield (
            f'column "error" is uncertain by {metres(reference.high)}, the uncertainty of the '
            'reference, which is more than the tolerance; column "added" is not affected'
        )


def _screened(cut: int, few: int, starts: int) -> list[str]:
    """Return a note on features that ran from few starts."""
    if not cut:
        return []
    exceeds, were = ("exceeds", "was") if cut == 1 else ("exceed", "were")
    return [
        f"{units.counted(cut, 'feature')} {exceeds} the tolerance in the first {few} of {starts} "
        f"starts and {were} not run from the others: errors there are of {few} starts"
    ]
