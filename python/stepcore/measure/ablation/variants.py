"""Variants of a model that leave out some features: their motion, cost and used features."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stepcore.checks import one_line
from stepcore.engine.features import MotionUsage, Removal, without
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.arguments import Workers
from stepcore.experiment.cost import TimedRun, costs, priced
from stepcore.experiment.errors import errors
from stepcore.experiment.failure import failure
from stepcore.experiment.intervals import Difference, difference
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule

# Largest number of readings of contacts and limits in a start.
READINGS = 500


@dataclass(frozen=True)
class VariantOutcome:
    """The motion of one variant of a model, and its cost.

    added: RMS distance from the whole model's motion at equal settings, in every start [m].
    added_max: the largest such distance of any body, sample and start [m].
    error: RMS distance from the converged motion of the whole model, in every start [m].
    flops: floating-point operations per simulated second of the first start; None if they cannot be
        counted.
    row_updates: row updates per simulated second of the first start.
    failure: the reason why a run failed.
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

    @property
    def work(self) -> float:
        """The counted cost: operations, or row updates if operations cannot be counted."""
        return self.row_updates if self.flops is None else self.flops

    def saved(self, whole: VariantOutcome) -> float:
        """Return the share of the whole model's work that is saved.

        The share is negative if this variant costs more, and nan if the variant fails.
        """
        before = whole.work
        return (before - self.work) / before if before > 0 and not self.failure else math.nan


@dataclass(frozen=True)
class Baseline:
    """The whole model's motion at its own settings, with which every variant is compared.

    truth: the converged runs; None without a converged motion.
    scored: the samples that count, shape (starts, n).
    size: the size of the scene [m].
    """

    model: Model
    schedule: Schedule
    runs: tuple[Run, ...]
    truth: tuple[Run, ...] | None
    scored: np.ndarray
    size: float

    def first(self, starts: int) -> Baseline:
        """Return the baseline of the first starts alone."""
        return replace(
            self,
            schedule=self.schedule.part(0, starts),
            runs=self.runs[:starts],
            truth=None if self.truth is None else self.truth[:starts],
            scored=self.scored[:starts],
        )

    def without(self, removals: Sequence[Removal]) -> Model:
        """Return the model without some features; raise ValueError for an invalid model."""
        return without(self.model.scene.with_settings(self.model.settings), removals).compile()


def outcome_of(
    baseline: Baseline, removals: Sequence[Removal], workers: Workers | None = None
) -> VariantOutcome:
    """Return the outcome of the motion without some features.

    workers: where the starts run; by default a new `Workers()`.
    """
    try:
        model = baseline.without(removals)
    except ValueError as error:
        return VariantOutcome(failure=one_line(error))
    runner = Runner(model, baseline.schedule)
    runs, work = priced(runner, model.settings, runner.starts, workers or Workers())
    failed = failure(runs, baseline.runs[: len(runs)], baseline.size)
    if failed is not None:
        return VariantOutcome(failure=failed)
    added = errors(runs, baseline.runs, baseline.scored)
    truth = baseline.truth
    off = () if truth is None else errors(runs, truth, baseline.scored).each
    return VariantOutcome(added.each, added.position_max, off, work.flops, work.row_updates)


class UsageProbe(Probe):
    """A probe that records which pairs of bodies touch, and which joints reach a limit."""

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


def usage_of(runner: Runner, workers: Workers) -> MotionUsage:
    """Return which pairs of bodies touch and which joints reach a limit in any start."""
    parts = workers.each(partial(_usage_from, runner), runner.starts, None)
    touched = frozenset(pair for part in parts for pair in part.touched)
    return MotionUsage(touched, frozenset(joint for part in parts for joint in part.limited))


def _usage_from(runner: Runner, start: int) -> MotionUsage:
    usage = UsageProbe(runner)
    runner.follow(runner.sim(runner.model.settings), start, [usage])
    return MotionUsage(frozenset(usage.touched), frozenset(usage.limited))


def timed_runs(baseline: Baseline, variants: Sequence[Sequence[Removal]]) -> list[TimedRun]:
    """Time variants in turn, as in `costs`; return their timed runs, in each of which round k is
    beside round k of the others.

    Of equal variants one is timed. The first and the last are timed in twice as many rounds.
    """

    def timed(removals: Sequence[Removal]) -> TimedRun:
        try:
            model, failed = baseline.without(removals), False
        except ValueError:
            model, failed = baseline.model, True
        return TimedRun(Runner(model, baseline.schedule), model.settings, failed)

    kinds = {frozenset(removals): timed(removals) for removals in variants}
    made = [kinds[frozenset(removals)] for removals in variants]
    costs(list(kinds.values()))
    if made[-1] is not made[0]:
        costs([made[0], made[-1]])
    return made


def time_saved(whole: TimedRun, without: TimedRun) -> Difference | None:
    """Return the computing time saved [µs per simulated second], with its interval, or None.

    The rounds of both runs are compared in pairs, so that other load on the machine cancels.
    """
    pairs = np.array([*zip(whole.times, without.times, strict=False)])
    if len(pairs) < 2:
        return None
    scale = 1e6 / whole.runner.schedule.horizon
    saved: Difference = difference(scale * pairs[:, 0], scale * pairs[:, 1])
    return saved
