"""Makes rows of settings that ran from all starts: their errors, costs and failures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.cost import TimedRun, costs
from stepcore.experiment.other_models import ErrorSplit
from stepcore.measure.trade.row import TradeRow
from stepcore.measure.trade.trials import Trials


class Finisher:
    """Makes rows out of trials.

    tau: the time constant that refsafe guards [s], or None. by: "flops" times nothing.
    """

    def __init__(
        self, trials: Trials, split: ErrorSplit, shipped: Settings, tau: float | None, by: str
    ) -> None:
        self.trials, self.split = trials, split
        self.shipped, self.tau, self.by = shipped, tau, by

    def rows(self, settings: Sequence[Settings], others: Sequence[TimedRun] = ()) -> list[TradeRow]:
        """Rows of settings that have been run, timed in turn with one another and with others."""
        failed = {setting for setting in settings if self.trials.failure(setting)}
        for setting in settings:
            if setting not in failed:
                self.split.keep(setting, self.trials.paths[setting])
        times = [math.nan] * len(settings)
        if self.by == "time":
            runner = self.trials.runner
            own = [TimedRun(runner, setting, setting in failed) for setting in settings]
            runs = [*own, *others]
            with self.trials.workers.bar("costs", len(runs)) as bar:
                times = costs(runs, bar)[: len(settings)]
        return [self._row(setting, cost) for setting, cost in zip(settings, times, strict=True)]

    def row(self, settings: Settings) -> TradeRow:
        """The row of one setting more, run from all starts."""
        self.trials.run([settings])
        return self.rows([settings])[0]

    def _row(self, settings: Settings, cost: float) -> TradeRow:
        trials = self.trials
        paths, work = trials.paths[settings], trials.work[settings]
        failure = trials.failure(settings)
        if failure is None and self.by == "time" and math.isnan(cost):
            failure = "failed while it was timed"
        updates = float(np.mean([path.row_updates for path in paths]))
        ran = failure is None
        return TradeRow(
            settings=settings,
            errors=self.split.errors(settings, paths) if ran else None,
            cost=cost if ran else math.nan,
            row_updates=updates / trials.runner.schedule.horizon if ran else math.nan,
            failure=failure,
            shipped=settings == self.shipped,
            clamped=self.tau is not None and 2 * settings.dt > self.tau * (1 + 1e-12),
            flops=work.flops if ran else math.nan,
            nbytes=work.nbytes if ran else 0,
        )
