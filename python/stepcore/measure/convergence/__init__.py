"""`converge`: whether a scene's rows are solved, and what gains more: sweeps or smaller steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Unpack

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.path import Path
from stepcore.experiment.runaway import runaway
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import HORIZON, scheduled
from stepcore.experiment.setup import Source, set_up
from stepcore.experiment.workers import Workers
from stepcore.measure.convergence.candidates import (
    Candidates,
    candidates,
    divides,
    with_converged,
)
from stepcore.measure.convergence.findings import Ending
from stepcore.measure.convergence.residuals import (
    MotionState,
    ResidualHistory,
    RowForce,
    residual_history,
)
from stepcore.measure.convergence.result import Convergence
from stepcore.measure.convergence.runs import (
    CandidateRun,
    HalvedReference,
    halved_reference,
    median_error,
    row_states,
    run_of,
)
from stepcore.measure.convergence.theory import SweepTheory
from stepcore.measure.findings import watched
from stepcore.report.progress import Choice

__all__ = [
    "CandidateRun",
    "Convergence",
    "ResidualHistory",
    "RowForce",
    "SweepTheory",
    "converge",
]

# The most sweeps at the settings' own time step, and at the others.
MOST, FEWER = 4096, 256
# The number of starts where none is given.
STARTS = 3


@takes_motion()
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

    At states along the motion it measures the residual by the number of sweeps, cold and warm; the
    share of the error that a sweep leaves, beside the theoretical value; and which rows are
    furthest from their converged force. Over the whole motion it measures the error at other time
    steps, with converged forces, and at equal row updates split into many sweeps or many steps. All
    runs are compared with one converged reference.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). Its settings are
        judged.
    motion: a `Motion`, or its fields as arguments. By default 3 starts and 1 s.
    states: the number of states at which sweeps are measured.
    threads: the number of runs at the same time (default: one per core).
    executor: any `concurrent.futures` executor, used in place of threads.
    progress: False for no bar, or a function of (label, done, total).

    Raises ValueError for an argument outside its limits, or if the reference itself fails.

    >>> from stepcore import lesson
    >>> heavy = lesson.stack(5, "rigid", (1.0, 1000.0), warm_start=False)
    >>> result = converge(heavy, horizon=0.1, starts=1, progress=False)
    >>> result.verdict
    'under-solved'
    >>> print(f"{result.contraction:.4f} {result.theory.closed:.4f}")
    0.9990 0.9990
    """
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
    states = checks.count("states", states)
    own = model.settings
    if motion.control_dt is not None and not divides(own.dt, motion.control_dt):
        limit = f"must be a whole number of steps of {own.dt:g} s"
        raise ValueError(f"control_dt = {motion.control_dt:g}: {limit}")
    starts = motion.starts or STARTS
    some = candidates(own, motion.period(own.dt), motion.horizon or HORIZON)
    schedule = scheduled(motion, model, some.period, starts)
    runner = Runner(model, schedule)
    runner.check_repeatable()
    paths = _runs(runner, some.tried, "runs", workers)
    rows = max(path.rows for paths_of in paths.values() for path in paths_of)
    some = with_converged(some, runner, rows)
    missing = [settings for settings in some.converged if settings not in paths]
    paths |= _runs(runner, missing, "converged runs", workers)
    fine, coarse = (paths[s] for s in some.references)
    explodes = runaway(runner, fine)
    if explodes:
        raise ValueError(explodes)
    reference = halved_reference(fine, coarse, model.scene)
    histories = _histories(runner, some, states, workers)
    weight = float(np.sum(model.body_mass) * np.linalg.norm(runner.bodies.gravity))
    runs = {
        s: run_of(s, paths_of, reference, schedule.horizon, weight) for s, paths_of in paths.items()
    }
    ending = None
    if not (runs[own].failure or runs[some.solved].failure):
        ending = _ending(model, paths[own], paths[some.solved], reference, schedule.times)
    return Convergence(
        name=setup.name,
        settings=own,
        motion=dataclasses.replace(motion, horizon=schedule.horizon, starts=starts),
        horizon=schedule.horizon,
        starts=starts,
        candidates=some,
        runs=runs,
        histories=histories,
        reference=reference,
        ending=ending,
        notes=list(model.scene.notes),
        # What the rows leave unsolved is the whole answer.
        findings=[one for one in watched(runner, own) if one.kind != "residual"],
        ran=motion_in_words(model, motion, schedule),
    )


def _runs(
    runner: Runner, some: Sequence[Settings], label: str, workers: Workers
) -> dict[Settings, list[Path]]:
    """Every start under each of the settings."""
    starts = range(len(runner.schedule.starts))
    jobs = [(settings, start) for settings in some for start in starts]
    paths = workers.each(partial(_run, runner), jobs, label)
    return {s: paths[i * len(starts) : (i + 1) * len(starts)] for i, s in enumerate(some)}


def _run(runner: Runner, job: tuple[Settings, int]) -> Path:
    return runner.run(*job)


def _histories(
    runner: Runner, some: Candidates, states: int, workers: Workers
) -> list[ResidualHistory]:
    """Sweeps at states along the settings' own motion, at each time step."""
    starts = range(len(runner.schedule.starts))
    quiet = dataclasses.replace(workers, progress=False)
    by_start = quiet.each(partial(row_states, runner, some.own), starts, "")
    chosen = _chosen([state for states_of in by_start for state in states_of], states)
    jobs = [(s, MOST if s == some.own else FEWER, state) for s in some.dts for state in chosen]
    return workers.each(partial(_history, runner.model), jobs, "sweeps")


def _chosen(some: list[MotionState], count: int) -> list[MotionState]:
    """States spread over all starts, and the one with the worst residual."""
    if len(some) <= count:
        return some
    even = np.linspace(0, len(some) - 1, count - 1).round().astype(int)
    worst = int(np.argmax([state.residual for state in some]))
    return [some[i] for i in np.unique([*even, worst])]


def _history(model: Model, job: tuple[Settings, int, MotionState]) -> ResidualHistory:
    return residual_history(model, *job)


def _ending(
    model: Model,
    own: Sequence[Path],
    solved: Sequence[Path],
    reference: HalvedReference,
    times: np.ndarray,
) -> Ending:
    """Where the motion ends, beside where it ends with converged forces; the worst start."""
    bodies = Coordinates(model).moving
    over = median_error(own, solved, reference.scored)
    last = max(1, len(times) // 10)
    span = float(times[-1] - times[-1 - last]) if len(times) > last else np.nan
    endings: list[Ending] = []
    for start, paths in enumerate(zip(own, solved, strict=True)):
        gap = np.linalg.norm(paths[0].com[-1] - paths[1].com[-1], axis=-1)
        at = int(gap.argmax())
        speed = solved_speed = np.nan
        if len(times) > last:
            moved = [path.com[-1, at] - path.com[-1 - last, at] for path in paths]
            speed, solved_speed = (float(np.linalg.norm(way)) / span for way in moved)
        body = model.element_name("body", bodies[at])
        endings.append(Ending(start, body, float(gap[at]), speed, solved_speed, over))
    return max(endings, key=lambda ending: ending.apart)
