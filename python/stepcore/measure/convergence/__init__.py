"""`converge`: tests whether the forces of rows are converged, and what would converge them."""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Sequence
from functools import partial
from typing import Unpack

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.deadline import OutOfTime
from stepcore.experiment.arguments import MeasurementFields, Source, Workers, measurement, set_up
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.horizon import affordable, horizon_of
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import divides, scheduled
from stepcore.measure.convergence.result import Convergence
from stepcore.measure.convergence.runs import (
    CandidateRun,
    Candidates,
    candidates,
    ending,
    row_states,
    run_of,
)
from stepcore.measure.convergence.sweeps import (
    MotionState,
    ResidualHistory,
    RowForce,
    SweepTheory,
    residual_history,
)
from stepcore.measure.monitors import Finding, monitored
from stepcore.report.units import metres

__all__ = [
    "CandidateRun",
    "Convergence",
    "ResidualHistory",
    "RowForce",
    "SweepTheory",
    "converge",
]

# Limit on the cost of the reference, in steps × (dofs + 2).
BUDGET = 4e6
# Largest number of sweeps measured at the shipped time step, and at the others.
MOST, FEWER = 4096, 256
# Default number of starts.
STARTS = 3
# The shares of the time (`seconds`) at which the runs and the measurement of sweeps end.
RUN, MEASURED = 0.7, 0.95


@measurement()
def converge(
    model: Source,
    motion: Motion | str | None = None,
    *,
    states: int = 8,
    **fields: Unpack[MeasurementFields],
) -> Convergence:
    """Test whether a scene's contact forces and other rows are converged along its motion.

    At states of the motion, `converge` measures the residual by the number of sweeps, cold and
    warm; the share of the error that each sweep leaves, with the theoretical value for comparison;
    and which rows are furthest from their converged force. Over the whole motion, `converge`
    measures the error at other time steps, with converged forces, and at equal row updates split
    into many sweeps or many steps. All runs are compared with one converged reference. Errors are
    RMS distances from the reference in the worst start [m], as in `stepcore.trade`.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). The model's own
        settings are judged.
    motion: a `Motion`, or its fields as arguments. By default 3 starts and 1 s, or longer
        if it is not at rest by then; see `stepcore.experiment.horizon`.
    states: the number of states at which sweeps are measured.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, or if the reference itself fails.

    >>> from stepcore import lesson
    >>> heavy = lesson.stack(5, "rigid", (1.0, 1000.0), warm_start=False)
    >>> result = converge(heavy, horizon=0.1, starts=1, progress=False)
    >>> result.verdict
    'under-solved'
    >>> print(f"{result.contraction:.4f} {result.theory.closed:.4f}")
    0.9990 0.9990
    """
    setup = set_up(converge, model, motion, fields, missing="nothing to solve")
    model, (_, motion, workers) = setup.model, setup
    states = checks.count("states", states)
    shipped = model.settings
    if motion.control_dt is not None and not divides(shipped.dt, motion.control_dt):
        limit = f"must be a whole number of steps of {shipped.dt:g} s"
        raise ValueError(f"control_dt = {motion.control_dt:g}: {limit}")
    starts = motion.starts or STARTS
    far = horizon_of(model, motion, cost=affordable(BUDGET, starts))
    if far.words:
        motion = dataclasses.replace(motion, horizon=far.length)
    some = candidates(shipped, motion.period(shipped.dt), far.length)
    schedule = scheduled(motion, model, some.period, starts)
    experiment = Experiment(model, schedule, workers)
    runner = experiment.runner
    runner.check_repeatable()
    reference = experiment.reference(min(s.dt for s in some.all), BUDGET)
    # The answer needs two of the settings, which come first.
    made = _runs(runner, some.all[:2], workers)
    if len(made) < len({shipped, some.solved}):
        raise OutOfTime("the shipped settings have not been run with converged forces")
    first = [run_of(experiment, s, made[s], reference).error for s in (shipped, some.solved)]
    said = f"as shipped the error is {metres(first[0])}, with converged forces {metres(first[1])}"
    workers.deadline.so_far(f"{said}, ± {metres(reference.high)}; other settings are run now")
    made |= _runs(runner, some.all[2:], workers, RUN)
    some = some.only(made)
    runs = {s: run_of(experiment, s, those, reference) for s, those in made.items()}
    end = None
    if not (runs[shipped].failure or runs[some.solved].failure):
        end = ending(experiment, made[shipped], made[some.solved], reference.scored)
    histories: list[ResidualHistory] = []
    with workers.deadline.stage("the residual by sweeps", MEASURED):
        histories = _histories(runner, some, states, workers)
    findings: list[Finding] = []
    with workers.deadline.stage("the findings on the shipped settings"):
        findings = monitored(model, schedule)[0]
    return Convergence(
        name=setup.name,
        settings=shipped,
        motion=dataclasses.replace(motion, horizon=schedule.horizon, starts=starts),
        horizon=schedule.horizon,
        starts=starts,
        candidates=some,
        runs=runs,
        histories=histories,
        reference=reference,
        size=experiment.size,
        ending=end,
        notes=[*model.scene.notes, *schedule.notes],
        findings=findings,
        ran=far.after(motion_in_words(model, motion, schedule)),
    )


def _runs(
    runner: Runner, some: Sequence[Settings], workers: Workers, share: float = 1.0
) -> dict[Settings, list[Run]]:
    """Run every start under each of the settings, as far as a share of the time allows."""
    count = len(runner.starts)
    jobs = [partial(runner.run, settings, start) for settings in some for start in runner.starts]
    runs: list[Run | None] = []

    def made() -> dict[Settings, list[Run]]:
        each = {s: runs[i * count : (i + 1) * count] for i, s in enumerate(some)}
        return {s: [run for run in some if run] for s, some in each.items() if all(some)}

    def left_out() -> str:
        return f"{len(some) - len(made())} of {len(some)} settings"

    with workers.deadline.stage(left_out, share):
        workers.each(operator.call, jobs, "runs", runs)
    return made()


def _histories(
    runner: Runner, some: Candidates, states: int, workers: Workers
) -> list[ResidualHistory]:
    """Measure sweeps at states of the shipped motion, under each time step."""
    by_start = workers.each(partial(row_states, runner, some.shipped), runner.starts, None)
    chosen = _chosen([state for states_of in by_start for state in states_of], states)
    jobs = [
        partial(residual_history, runner.model, s, MOST if s == some.shipped else FEWER, state)
        for s in some.dts
        for state in chosen
    ]
    return workers.each(operator.call, jobs, "sweeps")


def _chosen(some: list[MotionState], count: int) -> list[MotionState]:
    """Return states spread over all starts, including the one with the worst residual."""
    if len(some) <= count:
        return some
    even = np.linspace(0, len(some) - 1, count - 1).round().astype(int)
    worst = int(np.argmax([state.residual for state in some]))
    return [some[i] for i in np.unique([*even, worst])]
