"""`converge`: whether a scene's rows are solved, and whether sweeps or smaller steps buy more."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.executors import check_executor, each
from stepcore.experiment.coordinates import Dofs, movable
from stepcore.experiment.errors import extent
from stepcore.experiment.motion import Control, motion
from stepcore.experiment.runner import Course, Path
from stepcore.loading import find_model
from stepcore.measure.convergence.closing import Closing, Moment, closing
from stepcore.measure.convergence.result import Convergence, Rest
from stepcore.measure.convergence.runs import (
    Job,
    Plan,
    Truth,
    converging,
    error,
    moments,
    plan,
    ride,
    run_of,
    truth,
)
from stepcore.report.progress import Choice, Progress
from stepcore.scene.scene import Scene

if TYPE_CHECKING:
    from concurrent.futures import Executor

__all__ = ["Closing", "Convergence", "converge"]

# Sweeps read at the settings' own time step, and at the others.
MOST, FEWER = 4096, 256


def converge(
    model: Model | Scene | str | os.PathLike[str],
    *,
    horizon: float | None = None,
    key: str | int | None = None,
    control: Control | None = None,
    control_dt: float | None = None,
    ctrl: ArrayLike | None = None,
    starts: int = 3,
    seed: int = 0,
    states: int = 8,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> Convergence:
    """Measures whether a scene's rows are solved along its motion, and what would solve them.

    At states along the motion: the residual by the number of sweeps, cold and warm, what a sweep
    leaves of the error beside what theory says, and the rows that are furthest from their law.
    Over the motion: how wrong it is at other time steps, with converged forces, and at equal row
    updates split into many sweeps or many steps, all against one converged reference.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Its settings are
        judged. horizon, key, control, control_dt, ctrl, starts, seed: the motion, as in `trade`.
    states: at how many states sweeps are measured.
    threads: how many runs at once (default: one a core); executor: any `concurrent.futures`
        executor in their place. progress: False, or a function of (label, done, total).

    Raises ValueError for an argument outside its limits, or where the reference itself fails.

    >>> from stepcore import lesson
    >>> heavy = lesson.stack(5, "rigid", (1.0, 1000.0), warm_start=False)
    >>> found = converge(heavy, horizon=0.1, starts=1, progress=False)
    >>> found.verdict
    'under-solved'
    >>> print(f"{found.contraction:.4f} {found.theory.closed:.4f}")
    0.9990 0.9990
    """
    model = find_model(model)
    checks.told("converge", progress)
    check_executor("converge", executor)
    starts, seed = checks.count("starts", starts), checks.count("seed", seed, least=0)
    states, workers = checks.count("states", states), checks.threads(threads)
    dofs = movable(model.scene, "nothing to solve")
    if horizon is not None:
        checks.seconds("horizon", horizon)
    if control_dt is not None:
        _check_divides(model.settings.dt, checks.seconds("control_dt", control_dt))
    own = model.settings
    todo = plan(own, control_dt, 1.0 if horizon is None else horizon)
    motive = motion(
        model,
        dofs,
        horizon=horizon,
        period=todo.period,
        key=key,
        ctrl=ctrl,
        control=control,
        count=starts,
        seed=seed,
    )
    course = Course(model, dofs, motive)
    done: dict[Settings, list[Path]] = {}
    for label in ("runs", "converged runs"):
        tried = [s for s in (todo.truth or todo.tried) if s not in done]
        jobs = [Job(settings, start) for settings in tried for start in range(starts)]
        with Progress(label, len(jobs), progress) as bar:
            paths = each(partial(ride, course), jobs, bar=bar, threads=workers, executor=executor)
        done |= {s: paths[i * starts : (i + 1) * starts] for i, s in enumerate(tried)}
        rows = max(path.rows for some in done.values() for path in some)
        todo = converging(todo, own, course, rows)
    true = _truth(todo, done, model)
    curves = _curves(course, todo, states, workers, executor, progress)
    runs = {s: run_of(s, paths, true, motive.horizon) for s, paths in done.items()}
    return Convergence(
        name=model.scene.name or "scene",
        settings=own,
        horizon=motive.horizon,
        starts=starts,
        plan=todo,
        runs=runs,
        curves=curves,
        reference=todo.references[0],
        reference_error=true.error,
        size=true.size,
        rest=None
        if runs[own].failure or runs[todo.solved].failure
        else _rest(model, done[own], done[todo.solved], true, motive.times),
        notes=[*true.notes, *model.scene.notes],
    )


def _check_divides(dt: float, period: float) -> None:
    count = period / dt
    if round(count) < 1 or abs(count - round(count)) > 1e-6 * count:
        raise ValueError(f"control_dt = {period:g}: must be a whole number of steps of {dt:g} s")


def _truth(todo: Plan, paths: dict[Settings, list[Path]], model: Model) -> Truth:
    fine, coarse = (paths[settings] for settings in todo.references)
    for path in (*fine, *coarse):
        if path.failure:
            raise ValueError(f"the reference fails: {path.failure}")
    return truth(fine, coarse, extent(fine, model.scene))


def _curves(
    course: Course,
    todo: Plan,
    states: int,
    workers: int,
    executor: Executor | None,
    progress: Choice,
) -> list[Closing]:
    """Sweeps at states along the settings' own motion, at each time step."""
    own = course.model.settings
    starts = range(len(course.motion.starts))
    found = [
        moment
        for some in each(
            partial(moments, course, own),
            starts,
            bar=Progress("", len(starts), False),
            threads=workers,
            executor=executor,
        )
        for moment in some
    ]
    chosen = _chosen(found, states)
    jobs = [(s, MOST if s == own else FEWER, m) for s in todo.dts for m in chosen]
    with Progress("sweeps", len(jobs), progress) as bar:
        work = partial(_close, course.model)
        return each(work, jobs, bar=bar, threads=workers, executor=executor)


def _chosen(found: list[Moment], states: int) -> list[Moment]:
    """Spread over all starts, and the one with the worst residual."""
    if len(found) <= states:
        return found
    even = np.linspace(0, len(found) - 1, states - 1).round().astype(int)
    worst = int(np.argmax([moment.residual for moment in found]))
    return [found[i] for i in np.unique([*even, worst])]


def _close(model: Model, job: tuple[Settings, int, Moment]) -> Closing:
    settings, most, moment = job
    return closing(model, settings, most, moment)


def _rest(
    model: Model, own: Sequence[Path], solved: Sequence[Path], true: Truth, times: np.ndarray
) -> Rest:
    """Where the motion ends, beside where it ends with converged forces."""
    bodies = Dofs(model.scene).moving
    found: list[Rest] = []
    for start, (one, other) in enumerate(zip(own, solved, strict=True)):
        gap = np.linalg.norm(one.com[-1] - other.com[-1], axis=-1)
        at = int(gap.argmax())
        last = max(1, len(times) // 10)
        if len(times) > last:
            span = float(times[-1] - times[-1 - last])
            moved = [
                float(np.linalg.norm(p.com[-1, at] - p.com[-1 - last, at])) / span
                for p in (one, other)
            ]
        else:
            moved = [np.nan, np.nan]
        name = model.body_names[bodies[at]] or f"body {bodies[at]}"
        over = error(own, solved, true.scored)
        found.append(Rest(start, name, float(gap[at]), moved[0], moved[1], over))
    return max(found, key=lambda rest: rest.apart)
