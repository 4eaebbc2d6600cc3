"""The runs and the work of every setting tried so far, and the rows made from them.

The search records positions only. Settings that the search chooses are run again and fully
recorded.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from stepcore._core import Settings
from stepcore.deadline import OutOfTime
from stepcore.experiment.arguments import Workers
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.cost import UNKNOWN, TimedRun, Work, costs, priced
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.other_models import ErrorSplit
from stepcore.experiment.reference import Reference
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner
from stepcore.measure.trade.rows import TradeRow

# The runs of a setting, and the work of the first run.
Ran = tuple[list[Run], Work]
# A setting, its first start, and the start after the last.
Job = tuple[Settings, int, int]


class PricedError(NamedTuple):
    """The price and the error of a setting; both are infinite for a failure.

    price: floating-point operations per simulated second.
    error: RMS position error of the worst start [m].
    """

    price: float
    error: float


class RunCache:
    """The runs made so far, stored so that no run is repeated.

    screened: runs from the first starts, with positions recorded.
    full: fully recorded runs from all starts.
    work: the work of each setting.
    tried: the settings that were to be run, also those that the deadline left out.
    count: the number of runs made.
    """

    def __init__(self, experiment: Experiment, reference: Reference) -> None:
        self.experiment, self.reference = experiment, reference
        self.screened: dict[Settings, list[Run]] = {}
        self.full: dict[Settings, list[Run]] = {}
        self.work: dict[Settings, Work] = {}
        self.tried: set[Settings] = set()
        self._scores: dict[tuple[Settings, int, Reference], PricedError] = {}
        self.count = 0

    def screen(self, settings: Sequence[Settings], starts: int, label: str) -> None:
        """Run settings from the first starts; a setting stops at its first failure."""
        jobs = []
        for setting in dict.fromkeys(settings):
            done = self.screened.get(setting, [])
            if len(done) < starts and not (done and done[-1].failure):
                jobs.append((setting, len(done), starts))
        self.tried.update(setting for setting, *_ in jobs)
        ran: list[Ran | None] = []
        try:
            self._screened(jobs, label, ran)
        finally:
            # What the deadline lets finish is kept.
            for (setting, first, _), made in zip(jobs, ran, strict=False):
                if made is not None:
                    self._keep(setting, first, *made)

    def _keep(self, setting: Settings, first: int, runs: list[Run], work: Work) -> None:
        self.count += len(runs)
        self.screened.setdefault(setting, []).extend(runs)
        if first == 0:
            self.work[setting] = work

    def _screened(self, jobs: Sequence[Job], label: str, ran: list[Ran | None]) -> None:
        """Run jobs in parallel; with fewer jobs than threads, the starts run in parallel too.

        ran: is filled with the runs.
        """
        runner, workers = self.experiment.runner, self.experiment.workers
        job = partial(screen_starts, runner, workers.inside)
        if workers.executor is not None or len(jobs) >= workers.threads:
            workers.each(job, jobs, label, ran)
            return
        for setting, first, last in jobs:
            starts = [(setting, start, start + 1) for start in range(first, last)]
            parts = workers.until(lambda part: part[0][-1].failure, job, starts, label)
            ran.append(([run for runs, _ in parts for run in runs], parts[0][1]))

    def run(self, settings: Sequence[Settings], label: str = "errors") -> None:
        """Run settings from every start, fully recorded.

        Settings that have run, and settings that failed in the search, are not run again.
        """
        for setting in settings:
            done = self.screened.get(setting)
            if done and setting not in self.full and self.why_failed(done):
                self.full[setting] = done
        missing = [setting for setting in dict.fromkeys(settings) if setting not in self.full]
        workers = self.experiment.workers
        if math.isinf(workers.deadline.left):
            # Start with the most expensive settings, so that all threads finish together.
            missing.sort(key=lambda setting: setting.dt)
        job, ran = partial(all_starts, self.experiment.runner), list[Ran | None]()
        try:
            workers.each(job, missing, label, ran)
        finally:
            for setting, made in zip(missing, ran, strict=False):
                if made is not None:
                    self.full[setting], self.work[setting] = made
                    self.count += len(made[0])

    def score(self, settings: Settings, starts: int) -> PricedError:
        """Return the price and the error of a setting, from the positions of the first starts."""
        runs = self.screened[settings][:starts]
        key = settings, len(runs), self.reference
        if key not in self._scores:
            price, error = math.inf, math.inf
            if not self.why_failed(runs):
                price = self.work[settings].flops
                error = self.experiment.errors(runs, self.reference).high
            self._scores[key] = PricedError(price, error)
        return self._scores[key]

    def failure(self, settings: Settings) -> str | None:
        """Return why a setting failed that was run from all starts, or None."""
        return self.why_failed(self.full[settings])

    def why_failed(self, runs: Sequence[Run]) -> str | None:
        """Return why runs from the first starts failed, or None."""
        return self.experiment.failure(runs, self.reference)

    @property
    def can_refine(self) -> bool:
        """Whether halving the reference's step again is affordable and would reduce its error."""
        made = self.experiment.reference_runs
        return made is not None and made.can_refine(self.reference)

    def refine(self) -> bool:
        """Halve the reference's step once more; return False if that would not help."""
        made = self.experiment.reference_runs
        if made is None or not made.can_refine(self.reference):
            return False
        with self.experiment.workers.bar("finer reference", made.starts) as bar:
            better = made.refined(self.reference, bar)
        if better is not None:
            self.reference = better
        return better is not None


def screen_starts(runner: Runner, workers: Workers, job: Job) -> Ran:
    """Run one setting from start `first` to before `last`, until a run fails; record positions."""
    settings, first, last = job
    if first == 0:
        return priced(runner, settings, range(last), workers)
    return screened(runner, settings, range(first, last), workers, None, until_fails=True), UNKNOWN


def all_starts(runner: Runner, settings: Settings) -> Ran:
    """Run one setting from every start, until a run fails; return the runs and the work."""
    runs = runner.runs(settings)
    return runs, UNKNOWN if runs[-1].failure else priced(runner, settings, [0], Workers())[1]


class RowMaker:
    """Makes rows of settings that ran from all starts: their errors, costs and failures.

    tau: the time constant that refsafe guards [s], or None.
    by: the cost metric; with "flops" nothing is timed.
    """

    def __init__(self, cache: RunCache, split: ErrorSplit, tau: float | None, by: str) -> None:
        self.cache, self.split, self.tau, self.by = cache, split, tau, by

    def row(self, settings: Settings) -> TradeRow:
        """Run a setting from all starts, and return its row."""
        self.cache.run([settings])
        for row in self.rows([settings]):
            return row
        raise OutOfTime("the settings have not been timed")

    def rows(self, settings: Sequence[Settings], others: Sequence[TimedRun] = ()) -> list[TradeRow]:
        """Return the rows of settings that have run; settings and `others` are timed in turn.

        Settings that the deadline leaves without a time have no row.
        """
        failed = {setting for setting in settings if self.cache.failure(setting)}
        for setting in settings:
            if setting not in failed:
                self.split.keep(setting, self.cache.full[setting])
        times, experiment = [math.nan] * len(settings), self.cache.experiment
        if self.by == "time":
            runs = [TimedRun(experiment.runner, setting, setting in failed) for setting in settings]
            with experiment.workers.bar("costs", len(runs) + len(others)) as bar:
                times = costs([*runs, *others], bar)[: len(settings)]
            done = [bool(run.times or run.failed) for run in runs]
            settings = list(itertools.compress(settings, done))
            times = list(itertools.compress(times, done))
        return [self._row(setting, cost) for setting, cost in zip(settings, times, strict=True)]

    def _clamped(self, settings: Settings) -> bool:
        fixed = settings.accuracy is None
        return fixed and self.tau is not None and 2 * settings.dt > self.tau * (1 + 1e-12)

    def _row(self, settings: Settings, cost: float) -> TradeRow:
        cache, experiment = self.cache, self.cache.experiment
        runs, work, failure = cache.full[settings], cache.work[settings], cache.failure(settings)
        if failure is None and self.by == "time" and math.isnan(cost):
            failure = "failed while it was timed"
        row = TradeRow(
            settings,
            errors=None,
            cost=math.nan,
            row_updates=math.nan,
            failure=failure,
            shipped=settings == experiment.model.settings,
            clamped=self._clamped(settings),
        )
        if failure is not None:
            return row
        return dataclasses.replace(
            row,
            errors=self.split.errors(settings, runs),
            cost=cost,
            row_updates=float(np.mean([run.row_updates for run in runs]))
            / experiment.schedule.horizon,
            flops=work.flops,
            nbytes=work.nbytes,
        )
