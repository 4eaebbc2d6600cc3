"""Finished rows: settings that ran from all starts, with their errors and costs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.cost import Timed, costs
from stepcore.experiment.other_models import Models
from stepcore.measure.trade.mujoco import Player
from stepcore.measure.trade.result import Row
from stepcore.measure.trade.trials import Trials
from stepcore.report.progress import Progress


class Finisher:
    """Makes rows out of trials.

    tau: the time constant that refsafe guards [s], or None. by: "flops" times nothing.
    """

    def __init__(
        self, trials: Trials, models: Models, shipped: Settings, tau: float | None, by: str
    ) -> None:
        self.models = models
        self.trials, self.shipped, self.tau, self.by = trials, shipped, tau, by

    def rows(self, settings: Sequence[Settings], rivals: Sequence[Player] = ()) -> list[Row]:
        """Rows of settings that have been run, timed in turn with one another and with rivals."""
        for one in settings:
            self.models.keep(one, self.trials.paths[one])
        course, times = self.trials.course, [math.nan] * len(settings)
        if self.by == "time":
            players: list[Settings | Timed] = [*settings, *rivals]
            with Progress("costs", len(players), self.trials.progress) as bar:
                found = costs(course, players, bar)
            times = found[: len(settings)]
            for rival, cost in zip(rivals, found[len(settings) :], strict=True):
                rival.point.cost = cost
        return [self._row(one, cost) for one, cost in zip(settings, times, strict=True)]

    def row(self, settings: Settings) -> Row:
        """The row of one setting more, run from all starts."""
        self.trials.run([settings])
        return self.rows([settings])[0]

    def _row(self, settings: Settings, cost: float) -> Row:
        trials = self.trials
        paths = trials.paths[settings]
        failure = trials.failure(settings)
        if failure is None and self.by == "time" and math.isnan(cost):
            failure = "failed while it was timed"
        horizon = trials.course.motion.horizon
        row = Row(
            settings=settings,
            errors=None,
            cost=math.nan,
            row_updates=math.nan,
            failure=failure,
            shipped=settings == self.shipped,
            clamped=self.tau is not None and 2 * settings.dt > self.tau * (1 + 1e-12),
        )
        if failure is None:
            row.errors = self.models.errors(settings, paths)
            row.cost, (row.flops, row.nbytes) = cost, trials.work[settings]
            row.row_updates = float(np.mean([path.row_updates for path in paths])) / horizon
        return row
