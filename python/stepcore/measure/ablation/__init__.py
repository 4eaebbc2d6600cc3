"""`ablate`: what each modelled feature costs, and what error leaving it out adds."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Executor
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.executors import check_executor, each
from stepcore.experiment.coordinates import Dofs, movable
from stepcore.experiment.errors import extent, far_off
from stepcore.experiment.motion import Control, Motion, motion, time_steps
from stepcore.experiment.reference import Reference, Search
from stepcore.experiment.runner import Course
from stepcore.loading import find_model
from stepcore.measure.ablation.changes import Change, Features, made
from stepcore.measure.ablation.result import Ablation, Row
from stepcore.measure.ablation.run import Motive, measured, timed, watched
from stepcore.measure.ablation.selection import Selection
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import metres, seconds
from stepcore.scene.scene import Scene

__all__ = ["Ablation", "Row", "ablate"]

SETS = 3
# What the reference may cost, in steps × (dofs + 2).
BUDGET = 3e6


def ablate(
    model: Model | Scene | str | os.PathLike[str],
    *,
    error: float = 1e-3,
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
    """Switches off one modelled feature at a time: the work this saves, the error it adds.

    Then as many of them together as leave the motion within `error`: the smallest model, chosen
    on some starts and confirmed on as many others.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Everything runs
        under its own settings.
    error: what the smallest model may add in the worst start [m]: the root mean square, over
        samples and bodies, of the distance from the whole model's motion.
    horizon, key, control, control_dt, ctrl, starts, seed: the motion, as in `stepcore.trade`.
    threads: how many runs at once (default: one a core). executor: any `concurrent.futures`
        executor in place of threads. progress: False, or a function of (label, done, total).

    Raises ValueError for an argument outside its limits, or if the whole model fails.

    >>> from stepcore import loads
    >>> result = ablate(loads('''<mujoco><worldbody><body><joint axis="0 1 0" range="-90 90"/>
    ...   <geom type="capsule" size=".02" fromto="0 0 0 .3 0 -.1"/></body></worldbody></mujoco>'''),
    ...   horizon=0.2, starts=2)
    >>> [row.measured.worst for row in result.rows if row.change.kind == "limits"]
    [0.0]
    >>> result.smallest.joints[0].range is None
    True
    """
    model = find_model(model)
    checks.told("ablate", progress)
    check_executor("ablate", executor)
    checks.real(above=0)("ablate", "error", error)
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
    motive = _motive(course, reference)
    seen = watched(course, model.settings)
    selection = Selection(motive, Features(model), error)
    changes = selection.features.changes(seen, model.settings)
    with Progress("features", len(changes) + 1, progress) as bar:
        points = [(), *((change,) for change in changes)]
        job = partial(measured, motive)
        whole, *alone = each(job, points, bar=bar, threads=workers, executor=executor)
    selection.known = dict(zip(changes, alone, strict=True))
    with Progress("smallest", len(changes), progress) as bar:
        selection.choose(changes, whole, bar)
    selection.confirm(_others(model, dofs, motions, starts))
    kept = selection.kept
    changes += [change for change in kept if change not in changes]
    times = timed(motive, [(), *((change,) for change in changes), kept])
    rows = [Row(c, selection.alone(c), t) for c, t in zip(changes, times[1:-1], strict=True)]
    return Ablation(
        name=model.scene.name or "scene",
        settings=model.settings,
        horizon=tuned.horizon,
        starts=starts,
        error=error,
        whole=Row(Change("whole model", "", ()), whole, times[0]),
        rows=rows,
        chosen=kept,
        best=Row(Change("smallest model", "", ()), selection.best, times[-1]),
        held=selection.held,
        back=selection.back,
        smallest=made(model.scene.with_settings(model.settings), kept),
        reference=reference.error if reference else None,
        notes=[*notes, *_notes(reference, motive, error)],
    )


def _others(
    model: Model, dofs: Dofs, motions: Motion, starts: int
) -> Iterator[tuple[Course, Motive]]:
    """The sets of starts that nothing was chosen on."""
    for part in range(1, SETS):
        course = Course(model, dofs, _part(motions, part * starts, (part + 1) * starts))
        yield course, _motive(course, None)


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


def _motive(course: Course, reference: Reference | None) -> Motive:
    """The whole model's own motion at its settings; ValueError if it fails."""
    paths = []
    for start in range(len(course.motion.starts)):
        path = course.run(course.model.settings, start)
        if path.failure:
            raise ValueError(f"the whole model fails from start {start}: {path.failure}")
        paths.append(path)
    if reference is None:
        scored = np.ones((len(paths), len(course.motion.times)), bool)
        return Motive(course.model, course.motion, tuple(paths), None, scored)
    truth = tuple(reference.paths)
    wrong = far_off(paths, truth, extent(truth, course.model.scene))
    if wrong:
        dt = seconds(course.model.settings.dt)
        raise ValueError(f"the whole model fails at its dt of {dt}: {wrong}; see stepcore diagnose")
    return Motive(course.model, course.motion, tuple(paths), truth, reference.scored)


def _notes(reference: Reference | None, motive: Motive, tolerance: float) -> list[str]:
    notes = ["torsional and rolling friction are not built yet: there is nothing to switch off"]
    if reference is not None and reference.error > tolerance:
        notes.append(
            f"the converged motion is known to {metres(reference.error)} only: the column error "
            "says no more than that, the column added does not need it"
        )
    short = int((~motive.scored).any(axis=1).sum())
    if short:
        count = f"{short} of {len(motive.paths)} starts"
        notes.append(f"{count} are scored only as long as they can be predicted")
    if motive.motion.undriven:
        names = ", ".join(motive.motion.undriven)
        notes.append(f"motors without a control range are not driven: {names}")
    return notes
