"""Variants of a model without some features: their motion, what it costs, what it uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.features import MotionUsage, Removal, without
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.arguments import Workers
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.cost import TimedRun, costs
from stepcore.experiment.errors import errors
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule
from stepcore.report.progress import Progress

# Steps of the first start whose operations are counted, spread over the motion.
COUNTED = 40
# Contacts and limits of a start are read this often, at most.
READINGS = 500
# Runs that are themselves made at the same time as others.
ALONE = Workers()


@dataclass(frozen=True)
class VariantOutcome:
    """The motion of one variant of a model, and what it costs.

    added [m]: RMS distance from the whole model's motion at the same settings, in every start.
    added_max [m]: the largest such distance of any body, sample and start.
    error [m]: RMS distance from the converged motion of the whole model, in every start.
    flops: floating-point operations per simulated second of the first start; None if they cannot
        be counted. row_updates: updates of rows, likewise.
    failure: why the run failed.
    """

    added: tuple[float, ...] = ()
    added_max: float = np.nan
    error: tuple[float, ...] = ()
    flops: float | None = None
    row_updates: float = np.nan
    failure: str | None = None

    @property
    def worst(self) -> float:
        """Error added in the worst start [m]."""
        return max(self.added, default=np.inf) if self.failure is None else np.inf

    @property
    def median(self) -> float:
        """Error added in the median start [m]."""
        return float(np.median(self.added)) if self.failure is None else np.inf


@dataclass(frozen=True)
class Baseline:
    """The whole model's motion at its own settings, which every variant is compared with.

    truth: its converged motion, None where there is none; scored: which samples count.
    """

    model: Model
    schedule: Schedule
    paths: tuple[Run, ...]
    truth: tuple[Run, ...] | None
    scored: np.ndarray

    @property
    def settings(self) -> Settings:
        """The model's own."""
        return self.model.settings

    def first(self, starts: int) -> Baseline:
        """The same from the first so many starts alone."""
        return Baseline(
            self.model,
            self.schedule.part(0, starts),
            self.paths[:starts],
            None if self.truth is None else self.truth[:starts],
            self.scored[:starts],
        )


def variant(baseline: Baseline, removals: Sequence[Removal]) -> Runner:
    """The motion's runner for the model without some features."""
    scene = without(baseline.model.scene.with_settings(baseline.settings), removals)
    model = scene.compile()
    return Runner(model, baseline.schedule)


def outcome_of(
    baseline: Baseline, removals: Sequence[Removal], workers: Workers = ALONE
) -> VariantOutcome:
    """The motion without some features. workers: its starts run there."""
    try:
        runner = variant(baseline, removals)
    except ValueError as error:
        return VariantOutcome(failure=one_line(error))
    settings = runner.model.settings
    paths = positions(runner, settings, workers)
    failure = next(
        (f"start {i}: {path.failure}" for i, path in enumerate(paths) if path.failure), None
    )
    if failure is not None:
        return VariantOutcome(failure=failure)
    added = errors(paths, baseline.paths, baseline.scored)
    truth = baseline.truth
    off = () if truth is None else errors(paths, truth, baseline.scored).each
    flops, rows = work_per_second(runner, settings)
    return VariantOutcome(added.each, added.position_max, off, flops, rows)


def positions(runner: Runner, settings: Settings, workers: Workers) -> list[Run]:
    """The positions of the runs from all starts, until one fails."""
    starts = range(len(runner.schedule.starts))
    bar = Progress("", len(starts), False)
    return screened(runner, settings, starts, workers, bar, until_fails=True)


class WorkCount(Probe):
    """Floating-point operations of single steps, spread evenly over a motion."""

    def __init__(self, periods: int) -> None:
        self.every = max(1, periods // COUNTED)
        self.total = self.steps = 0

    def period(self, sim: Sim, period: int) -> None:
        if period % self.every == 0:
            self.total += sim.count_flops(1)
            self.steps += 1


def work_per_second(runner: Runner, settings: Settings) -> tuple[float | None, float]:
    """Floating-point operations and updates of rows per simulated second of the first start's
    motion; None and NaN where it fails.

    Operations are counted exactly in about `COUNTED` steps spread evenly over it.
    """
    count, sim = WorkCount(runner.schedule.periods), runner.sim(settings)
    try:
        runner.follow(sim, 0, [count])
    except SimulationError:
        return None, np.nan
    flops = count.total / count.steps / settings.dt
    return flops, sim.row_updates / runner.schedule.horizon


class UsageProbe(Probe):
    """Which pairs of bodies touch, and which joints reach a limit."""

    def __init__(self, runner: Runner) -> None:
        self.periods = runner.schedule.periods
        self.owner = runner.model.geom_body.tolist()
        self.touched: set[tuple[int, int]] = set()
        self.limited: set[int] = set()

    def stride(self, steps: int) -> int:
        return max(1, steps * self.periods // READINGS)

    def step(self, sim: Sim) -> None:
        contacts = sim.contacts
        pairs = zip(contacts["geom1"].tolist(), contacts["geom2"].tolist(), strict=True)
        for bodies in ((self.owner[a], self.owner[b]) for a, b in pairs):
            self.touched.add((min(bodies), max(bodies)))
        rows = sim.rows
        self.limited.update(rows["index"][rows["kind"] == "limit"].tolist())


def usage_of(runner: Runner, settings: Settings, workers: Workers = ALONE) -> MotionUsage:
    """Which pairs of bodies touch and which joints reach a limit in any start."""
    starts = range(len(runner.schedule.starts))
    job = partial(_usage_from, runner, settings)
    parts = workers.each(job, starts, Progress("", len(starts), False))
    touched = frozenset(pair for part in parts for pair in part.touched)
    return MotionUsage(touched, frozenset(joint for part in parts for joint in part.limited))


def _usage_from(runner: Runner, settings: Settings, start: int) -> MotionUsage:
    """The same of one start."""
    usage = UsageProbe(runner)
    runner.follow(runner.sim(settings), start, [usage])
    return MotionUsage(frozenset(usage.touched), frozenset(usage.limited))


def times_of(baseline: Baseline, variants: Sequence[Sequence[Removal]]) -> list[float]:
    """Computing time of variants [µs per simulated second], as `costs` measures it."""
    runs = []
    for removals in variants:
        try:
            runner = variant(baseline, removals)
        except ValueError:
            whole = Runner(baseline.model, baseline.schedule)
            runs.append(TimedRun(whole, baseline.settings, failed=True))
        else:
            runs.append(TimedRun(runner, runner.model.settings))
    return costs(runs, Progress("", len(runs), False))
