"""What a trade found: the settings with their errors and costs, and the cheapest for an error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from stepcore._core import Settings
from stepcore.experiment.motion import Motion, picklable
from stepcore.experiment.reference import Reference
from stepcore.experiment.runner import Runner
from stepcore.measure.monitors import Finding
from stepcore.measure.trade.frontier import MARGIN, NOTABLE, Frontier
from stepcore.measure.trade.in_batch import BatchPoint
from stepcore.measure.trade.mujoco import Point
from stepcore.measure.trade.orders import observed_orders
from stepcore.measure.trade.row import TradeRow
from stepcore.report.units import length

# What `TradeFindings.best` looks for where nobody says it [m].
ERROR = 1e-3
# A cheaper row that misses the error on at most this share of the starts is worth naming.
FEW = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class TradeFindings:
    """The fields of a `Trade`, which says what each is, and the questions they answer."""

    name: str
    motion: Motion
    frontier: Frontier
    reference: Reference
    horizon: float
    notes: list[str] = field(default_factory=list)
    target: float | None = None
    budget: float | None = None
    size: float = math.nan
    mujoco: Sequence[Point] = ()
    in_batch: Sequence[BatchPoint] = ()
    screened: int = 0
    runs: int = 0
    chosen: TradeRow | None = None
    ran: str = ""
    batches: Sequence[str] = ()
    findings: Sequence[Finding] = ()
    # The runs of the trade, which can be made again to be seen.
    runner: Runner | None = None

    def __getstate__(self) -> dict[str, Any]:
        state = dict(self.__dict__)
        if (runner := self.runner) is not None and (control := runner.schedule.control) is not None:
            schedule = replace(runner.schedule, control=picklable(control))
            state["runner"] = Runner(runner.model, schedule)
        return state

    @property
    def rows(self) -> list[TradeRow]:
        """Every setting that ran from all starts, and those that failed; coarsest step first."""
        return list(self.frontier.rows)

    @property
    def starts(self) -> int:
        """From how many starts every setting ran."""
        return len(self.reference.runs)

    @property
    def by(self) -> str:
        """The cost metric: "time" [µs] or "flops", per simulated second."""
        return self.frontier.by

    def error(self, row: TradeRow) -> float:
        """The error that a row can claim [m]: inf if it failed.

        The RMS position error of the worst start, further ones among them; not below the
        reference's own.
        """
        return self.frontier.error(row)

    def price(self, row: TradeRow) -> float:
        """What a row costs per simulated second: µs, or operations if that is the metric."""
        return self.frontier.price(row)

    @property
    def shipped(self) -> TradeRow:
        """The settings that came with the scene."""
        return next(row for row in self.rows if row.shipped)

    @property
    def settings(self) -> Settings:
        """The settings that came with the scene."""
        return self.shipped.settings

    @property
    def orders(self) -> dict[str, float]:
        """The order of accuracy that each integrator shows in the worst start; see `orders`."""
        return observed_orders(self.rows, self.reference)

    @property
    def predictable(self) -> float:
        """When the first of the starts can no longer be predicted [s]; inf beyond the horizon.

        Trajectory errors are those before it; see `stepcore.predict`.
        """
        return self.reference.growth.overall

    @property
    def failures(self) -> list[TradeRow]:
        """The rows that failed; `TradeRow.failure` says why."""
        return [row for row in self.rows if row.failure]

    @property
    def recommended(self) -> TradeRow | None:
        """The row for the error or budget that was asked for; None where no row is, or no ask."""
        if self.chosen is not None:
            return self.chosen
        try:
            if self.target is not None:
                return self.cheapest(self.target)
            return None if self.budget is None else self.most_accurate(self.budget)
        except ValueError:
            return None

    @property
    def passed_over(self) -> TradeRow | None:
        """A row that costs notably less than the recommended one and all but meets the error.

        It meets the error asked for, but not the share of it that a recommendation keeps to; or it
        misses it on few of the starts (one of ten at most). Of several the one that misses least.
        """
        chosen, target = self.recommended, self.target
        if chosen is None or target is None:
            return None
        near = []
        for row in self.rows:
            e, tried = row.errors, row.further
            if e is None or tried is None or tried.starts == 0:
                continue
            missed, count = self.misses(row)
            few = missed <= FEW * count
            if (
                few
                and self.error(row) < math.inf
                and self.price(row) < NOTABLE * self.price(chosen)
            ):
                near.append((missed, self.price(row), row.settings.dt, row))
        return min(near, key=lambda entry: entry[:3])[-1] if near else None

    @property
    def offered(self) -> list[TradeRow]:
        """The rows that the answer compares with: half the error, and the same one for less."""
        if (chosen := self.recommended) is not None:
            rows = [self.passed_over, self.frontier.halving(chosen)]
        elif self.shipped.errors is not None and not math.isnan(self.price(self.shipped)):
            error = self.error(self.shipped)
            rows = [self.next_better(error), self.frontier.cheapest(error)]
        else:
            rows = []
        return [row for row in rows if row is not None]

    @property
    def kept(self) -> float:
        """The error that a recommendation keeps to on every start that ran [m]; NaN without one."""
        return math.nan if self.target is None else MARGIN * self.target

    def misses(self, row: TradeRow) -> tuple[int, int]:
        """On how many starts a row exceeds the error asked for, and of how many that it ran."""
        each = () if row.errors is None else row.errors.each
        held = sum(wrong <= (self.target or math.inf) for wrong in each)
        count = len(each)
        if row.further is not None:
            held, count = held + row.further.held, count + row.further.starts
        return count - held, count

    def best(self, error: float | str | None = None) -> Settings:
        """The cheapest Settings that keep to an error in every start.

        error: metres, "1mm", or "0.1%" of the scene's size; by default what the trade was made
            for (an error or a budget), else 1 mm.

        Raises ValueError, naming the smallest error there is, if none is that good.
        """
        if error is None and self.target is None and self.budget is not None:
            return self.most_accurate(self.budget).settings
        if self.chosen is not None and error in (None, self.target):
            return self.chosen.settings
        return self.cheapest(error).settings

    def next_better(self, error: float | str | None = None) -> TradeRow | None:
        """The cheapest row with at most half of that error; None if there is none.

        error: as in `best`; by default that of the recommended row, which is compared in the starts
        of the search, because no other row need have run from the further ones.
        """
        if error is None and self.recommended is not None:
            return self.frontier.halving(self.recommended)
        try:
            return self.frontier.cheapest(self._length(error) / 2)
        except ValueError:
            return None

    def cheapest(self, error: float | str | None = None) -> TradeRow:
        """The row of the lowest price whose error is at most `error`, as in `best`."""
        return self.frontier.cheapest(self._length(error))

    def _length(self, error: float | str | None) -> float:
        if error is None:
            return ERROR if self.target is None else self.target
        return length("best", "error", error, self.size)

    def most_accurate(self, budget: float) -> TradeRow:
        """The row with the smallest error whose price is at most `budget`.

        Raises ValueError, naming the lowest price there is, if none is that cheap.
        """
        return self.frontier.most_accurate(budget)
