"""`ablate`: the cost of each modelled feature, and the error that removing it adds."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Executor
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.features import RemovableFeatures, Removal, without
from stepcore.engine.model import Model
from stepcore.executors import check_executor, each
from stepcore.experiment.coordinates import Dofs, movable
from stepcore.experiment.errors import extent, far_off
from stepcore.experiment.motion import Control, Motion, motion, time_steps
from stepcore.experiment.reference import Reference, Search
from stepcore.experiment.runner import Course
from stepcore.loading import find_model
from stepcore.measure.ablation.result import Ablation, FeatureEffect
from stepcore.measure.ablation.selection import Selection
from stepcore.measure.ablation.variants import Baseline, outcome_of, times_of, usage_of
from stepcore.report import units
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import metres, seconds
from stepcore.scene.scene import Scene

__all__ = ["Ablation", "FeatureEffect", "ablate"]

SETS = 3
# What the reference may cost, in steps × (dofs + 2).
BUDGET = 3e6


def ablate(
    model: Model | Scene | str | os.PathLike[str],
    *,
    error: float | str = 1e-3,
    horizon: float | None = None,
    key: str | int | None = None,
    control: Control | None = None,
    control_dt: float | None = None,
    ctrl: ArrayLike | None = None,
    starts: int = 8,
    seed: int = 0,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> Ablation:
    """Removes one modelled feature at a time, and measures the work saved and the error added.

    Then it removes as many together as leave the motion within `error`: the smallest model, chosen
    on some starts and confirmed on as many others.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Everything runs
        under its own settings.
    error: the RMS position error, over samples and bodies, that the smallest model may add to the
        whole model's motion in the worst start: metres, "1mm", or "0.1%" of the scene's size.
    horizon, key, control, control_dt, ctrl, starts, seed: the motion, as in `stepcore.trade`.
    threads: how many runs at once (default: one a core). executor: any `concurrent.futures`
        executor in place of threads. progress: False, or a function of (label, done, total).

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
    model = find_model(model)
    checks.told("ablate", progress)
    check_executor("ablate", executor)
    # A wrong error is refused before minutes of work; the scene's size is known later.
    units.length("ablate", "error", error, 1.0)
    starts, seed = checks.count("starts", starts), checks.count("seed", seed, least=0)
    workers = checks.threads(threads)
    dofs = movable(model.scene, "no motion to keep")
    dt = model.settings.dt
    _, period = time_steps(dt, None, control_dt, 1.0 if horizon is None else horizon)
    # Three sets of starts: to choose on, to confirm on, and to confirm what is left then.
    motions = motion(
        model,
        dofs,
        horizon=horizon,
        period=period,
        key=key,
        ctrl=ctrl,
        control=control,
        count=SETS * starts,
        seed=seed,
    )
    tuned = _part(motions, 0, starts)
    course = Course(model, dofs, tuned)
    notes: list[str] = []
    search = Search(course, model.settings, dt, BUDGET, workers, executor)
    with Progress("reference", search.runs, progress) as bar:
        reference = _reference(search, bar, notes)
    baseline = _baseline(course, reference)
    tolerance = units.length("ablate", "error", error, extent(baseline.paths, model.scene))
    usage = usage_of(course, model.settings)
    selection = Selection(baseline, RemovableFeatures(model), tolerance)
    removals = selection.features.removals(usage, model.settings)
    with Progress("features", len(removals) + 1, progress) as bar:
        points = [(), *((removal,) for removal in removals)]
        job = partial(outcome_of, baseline)
        whole, *alone = each(job, points, bar=bar, threads=workers, executor=executor)
    selection.known = dict(zip(removals, alone, strict=True))
    with Progress("smallest", len(removals), progress) as bar:
        selection.choose(removals, whole, bar)
    selection.confirm(_others(model, dofs, motions, starts))
    removed = selection.removed
    removals += [removal for removal in removed if removal not in removals]
    times = times_of(baseline, [(), *((removal,) for removal in removals), removed])
    rows = [
        FeatureEffect(removal, selection.alone(removal), cost)
        for removal, cost in zip(removals, times[1:-1], strict=True)
    ]
    return Ablation(
        name=model.scene.name or "scene",
        settings=model.settings,
        horizon=tuned.horizon,
        starts=starts,
        error=tolerance,
        whole=FeatureEffect(Removal("whole model", "", ()), whole, times[0]),
        rows=rows,
        removed=removed,
        best=FeatureEffect(Removal("smallest model", "", ()), selection.chosen_on, times[-1]),
        confirmed=selection.confirmed_on,
        restored=selection.restored,
        smallest=without(model.scene.with_settings(model.settings), removed),
        reference=reference.error if reference else None,
        notes=[*notes, *_notes(reference, baseline, tolerance)],
    )


def _others(
    model: Model, dofs: Dofs, motions: Motion, starts: int
) -> Iterator[tuple[Course, Baseline]]:
    """The sets of starts on which nothing was chosen."""
    for part in range(1, SETS):
        course = Course(model, dofs, _part(motions, part * starts, (part + 1) * starts))
        yield course, _baseline(course, None)


def _part(motions: Motion, first: int, last: int) -> Motion:
    """Some of the starts of a motion."""
    values = dict(motions.__dict__)
    values["starts"] = motions.starts[first:last]
    values["ctrl"] = None if motions.ctrl is None else motions.ctrl[first:last]
    return Motion(**values)


def _reference(search: Search, bar: Progress, notes: list[str]) -> Reference | None:
    try:
        return search.first(bar)
    except ValueError as error:
        notes.append(f"no converged motion to compare with: {checks.one_line(error)}")
        return None


def _baseline(course: Course, reference: Reference | None) -> Baseline:
    """The whole model's own motion at its settings; ValueError if it fails."""
    paths = []
    for start in range(len(course.motion.starts)):
        path = course.run(course.model.settings, start)
        if path.failure:
            raise ValueError(f"the whole model fails from start {start}: {path.failure}")
        paths.append(path)
    if reference is None:
        scored = np.ones((len(paths), len(course.motion.times)), bool)
        return Baseline(course.model, course.motion, tuple(paths), None, scored)
    truth = tuple(reference.paths)
    wrong = far_off(paths, truth, extent(truth, course.model.scene))
    if wrong:
        dt = seconds(course.model.settings.dt)
        raise ValueError(f"the whole model fails at its dt of {dt}: {wrong}; see stepcore diagnose")
    return Baseline(course.model, course.motion, tuple(paths), truth, reference.scored)


def _notes(reference: Reference | None, baseline: Baseline, tolerance: float) -> list[str]:
    notes = ["torsional and rolling friction are not built yet: there is nothing to remove"]
    if reference is not None and reference.error > tolerance:
        notes.append(
            f"the converged motion is known to {metres(reference.error)} only, which limits the "
            "column error; the column added does not depend on it"
        )
    short = int((~baseline.scored).any(axis=1).sum())
    if short:
        count = f"{short} of {len(baseline.paths)} starts"
        notes.append(f"{count} count only as long as they can be predicted")
    if baseline.motion.undriven:
        names = ", ".join(baseline.motion.undriven)
        notes.append(f"actuators without a control range are not driven: {names}")
    return notes
