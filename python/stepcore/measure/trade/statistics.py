"""Means over many starts, which can be compared after the motion becomes unpredictable.

From the time when the first start becomes unpredictable (`stepcore.experiment.growth`) to the
horizon, each run has a mean height of its centre of mass, a mean kinetic energy and a mean number
of contacts. At least 32 seeded starts run, each under the setting and under the reference's. The
differences have a mean and a 95 % confidence interval: Student's t on the paired differences, which
is valid whether or not the two runs of a pair still resemble each other. An interval that contains
0 shows no significant difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.intervals import Difference, difference
from stepcore.experiment.reference import Reference, ReferenceRuns
from stepcore.experiment.runner import means
from stepcore.experiment.schedule import Schedule
from stepcore.report.progress import Progress

LEAST = 32
# Number of best rows measured along the front (all if fewer), within half the reference's budget.
MOST = 10
# Fields of `Statistics` and of `Run`, with their units.
QUANTITIES = {"height": "m", "kinetic": "J", "touching": "1"}


@dataclass(frozen=True)
class Statistics:
    """Differences of means over `starts` starts, from `since` [s] to the horizon.

    height: of the centre of mass [m].
    kinetic: kinetic energy [J].
    touching: number of contacts.
    """

    starts: int
    since: float
    height: Difference
    kinetic: Difference
    touching: Difference

    def record(self) -> dict[str, float]:
        """Return the differences and intervals as flat data for a table."""
        flat = {}
        for name in QUANTITIES:
            apart: Difference = getattr(self, name)
            flat[f"{name}_difference"], flat[f"{name}_interval"] = apart.mean, apart.interval
        return flat


class AfterPrediction:
    """A measurement of settings after the motion becomes unpredictable; many: 32 starts or more."""

    def __init__(self, made: ReferenceRuns, reference: Reference, many: Schedule) -> None:
        self.made, self.spent, self.since = made, 0.0, reference.growth.overall
        self.experiment = Experiment(made.runner.model, many, made.workers)
        self.window = many.times > self.since
        # The finest useful step of the reference that takes at most half the budget.
        dts = [reference.level.dt, *(level.dt for level in reference.levels[::-1])]
        name, useful = reference.level.integrator, [max(dt, made.finest / 2) for dt in dts]
        cheap = [dt for dt in useful if 2 * self.cost(name, dt) <= made.budget]
        self.settings = made.settings(name, cheap[0] if cheap else useful[-1])
        self.truth: np.ndarray | None = None

    def cost(self, integrator: str, dt: float) -> float:
        """Return the cost of a setting's runs, in the unit of the reference's budget."""
        starts = len(self.experiment.schedule.starts)
        return self.made.cost(integrator, dt) * starts / self.made.starts

    def affords(self, settings: Settings) -> bool:
        """Reserve a setting's runs in the budget; return False if the budget is too small."""
        more = self.cost(settings.integrator, settings.dt)
        if self.spent + more > self.made.budget / 2:
            return False
        self.spent += more
        return True

    def measure(self, settings: Settings, bar: Progress) -> Statistics | None:
        """Return the differences of one setting; None if the setting or the reference fails."""
        if self.truth is None:
            self.truth = self._means(self.settings, bar)
        measured = self._means(settings, bar)
        if measured is None or self.truth is None:
            return None
        apart = [
            difference(mine, true) for mine, true in zip(measured.T, self.truth.T, strict=True)
        ]
        return Statistics(len(measured), self.since, *apart)

    def _means(self, settings: Settings, bar: Progress) -> np.ndarray | None:
        """Return the means over the window, shape (starts, 3); None if a run fails."""
        runs = self.experiment.run(settings, probes=means, bar=bar)
        if any(run.failure for run in runs):
            return None
        each = [[np.mean(getattr(run, name)[self.window]) for name in QUANTITIES] for run in runs]
        return np.array(each, float)
