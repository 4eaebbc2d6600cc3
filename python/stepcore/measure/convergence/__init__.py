"""`converge`: whether a scene's rows are solved, and whether sweeps or smaller steps buy more."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Unpack

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.errors import extent
from stepcore.experiment.motion import Motion, MotionFields
from stepcore.experiment.path import Path
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import scheduled
from stepcore.experiment.setup import Source, set_up
from stepcore.experiment.workers import Workers
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

if TYPE_CHECKING:
    from concurrent.futures import Executor

__all__ = ["Closing", "Convergence", "converge"]

# Sweeps read at the settings' own time step, and at the others.
MOST, FEWER = 4096, 256
STARTS = 3


def converge(
    model: Source,
    motion: Motion | None = None,
    *,
    states: int = 8,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
    **fields: Unpack[MotionFields],
) -> Convergence:
    """Measures whether a scene's rows are solved along its motion, and what would solve them.

    At states along the motion: the residual by the number of sweeps, cold and warm, what a sweep
    leaves of the error beside what theory says, and the rows that are furthest from their law.
    Over the motion: how wrong it is at other time steps, with converged forces, and at equal row
    updates split into many sweeps or many steps, all against one converged reference.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Its settings are
        judged.
    motion: the `Motion` that is run; or write its fields as arguments. The horizon is about 1 s
        by default; there are 3 starts.
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
    states = checks.count("states", states)
    setup = set_up(
        converge,
        model,
        motion,
        fields,
        missing="nothing to solve",
        threads=threads,
        executor=executor,
        progress=progress,
    )
    model, motion, workers = setup
    own, starts = model.settings, motion.starts or STARTS
    if motion.control_dt is not None:
        _check_divides(own.dt, motion.control_dt)
    todo = plan(own, motion.control_dt, 1.0 if motion.horizon is None else motion.horizon)
    runner = Runner(model, scheduled(motion, model, todo.period, starts=starts))
    done: dict[Settings, list[Path]] = {}
    for label in ("runs", "converged runs"):
        tried = [s for s in (todo.truth or todo.tried) if s not in done]
        jobs = [Job(settings, start) for settings in tried for start in range(starts)]
        paths = workers.each(partial(ride, runner), jobs, label)
        done |= {s: paths[i * starts : (i + 1) * starts] for i, s in enumerate(tried)}
        rows = max(path.rows for some in done.values() for path in some)
        todo = converging(todo, own, runner, rows)
    true = _truth(todo, done, model)
    curves = _curves(runner, todo, states, workers)
    runs = {s: run_of(s, paths, true, runner.schedule.horizon) for s, paths in done.items()}
    return Convergence(
        name=setup.name,
        settings=own,
        horizon=runner.schedule.horizon,
        starts=starts,
        plan=todo,
        runs=runs,
        curves=curves,
        reference=todo.references[0],
        reference_error=true.error,
        size=true.size,
        rest=None
        if runs[own].failure or runs[todo.solved].failure
        else _rest(runner, done[own], done[todo.solved], true, runner.schedule.times),
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


def _curves(runner: Runner, todo: Plan, states: int, workers: Workers) -> list[Closing]:
    """Sweeps at states along the settings' own motion, at each time step."""
    own = runner.model.settings
    starts = range(len(runner.schedule.starts))
    hidden = Progress("", len(starts), False)
    found = [
        moment
        for some in workers.each(partial(moments, runner, own), starts, hidden)
        for moment in some
    ]
    chosen = _chosen(found, states)
    jobs = [(s, MOST if s == own else FEWER, m) for s in todo.dts for m in chosen]
    return workers.each(partial(_close, runner.model), jobs, "sweeps")


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
    runner: Runner, own: Sequence[Path], solved: Sequence[Path], true: Truth, times: np.ndarray
) -> Rest:
    """Where the motion ends, beside where it ends with converged forces."""
    bodies = runner.coordinates.moving
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
        name = runner.model.body_names[bodies[at]] or f"body {bodies[at]}"
        over = error(own, solved, true.scored)
        found.append(Rest(start, name, float(gap[at]), moved[0], moved[1], over))
    return max(found, key=lambda rest: rest.apart)
