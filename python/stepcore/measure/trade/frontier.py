"""`Frontier`: the rows of a trade, marked where no other beats them, and the best of them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass

from stepcore import checks
from stepcore._core import Settings
from stepcore.experiment.errors import pareto
from stepcore.measure.trade.row import TradeRow

# Everything tried is held to this share of the error asked for, because further starts differ.
MARGIN = 0.9
# A saving below this is within what timing can tell.
NOTABLE = 0.9


@dataclass(frozen=True)
class Frontier:
    """Rows, coarsest step first. by: the cost metric, "time" or "flops".

    known, known_max: the reference's own error and largest error [m]; no row can claim less.
    """

    rows: tuple[TradeRow, ...]
    known: float
    known_max: float
    by: str

    @classmethod
    def of(cls, rows: Iterable[TradeRow], known: float, known_max: float, by: str) -> Frontier:
        """The rows with their marks."""
        plain = cls(tuple(sorted(rows, key=lambda row: -row.settings.dt)), known, known_max, by)
        best = pareto(
            [plain.price(row) for row in plain.rows], [plain.error(row) for row in plain.rows]
        )
        marked = []
        for row, mark in zip(plain.rows, best, strict=True):
            e = row.errors
            below, below_max = (
                (False, False) if e is None else (e.high < known, e.position_max < known_max)
            )
            marked.append(dataclasses.replace(row, best=mark, below=below, below_max=below_max))
        return dataclasses.replace(plain, rows=tuple(marked))

    def updated(self, row: TradeRow) -> Frontier:
        """The frontier with this row in place of that of the same settings, or added."""
        others = [other for other in self.rows if other.settings != row.settings]
        if len(others) == len(self.rows):
            return self.of([*self.rows, row], self.known, self.known_max, self.by)
        rows = [row if other.settings == row.settings else other for other in self.rows]
        return self.of(rows, self.known, self.known_max, self.by)

    def has(self, settings: Settings) -> bool:
        return any(row.settings == settings for row in self.rows)

    def error(self, row: TradeRow) -> float:
        """The error that a row can claim [m]: inf if it failed."""
        if row.errors is None:
            return math.inf
        further = 0.0 if row.further is None else row.further.high
        return max(row.errors.high, self.known, further)

    def searched(self, row: TradeRow) -> float:
        """The error of a row in the starts of the search, from which every row ran [m]."""
        return math.inf if row.errors is None else max(row.errors.high, self.known)

    def halving(self, row: TradeRow) -> TradeRow | None:
        """The cheapest row with at most half the error of this one; None if there is none.

        Both in the starts of the search: further ones, from which few rows ran, may be harder.
        """
        half = self.searched(row) / 2
        good = [r for r in self.rows if self.searched(r) <= half and not math.isnan(self.price(r))]
        return self._cheapest_of(good) if good else None

    def price(self, row: TradeRow) -> float:
        """What a row costs per simulated second: µs, or operations if that is the metric."""
        return row.flops if self.by == "flops" else row.cost

    def cheapest(self, error: float) -> TradeRow:
        """The row of the lowest price whose error is at most `error` [m].

        In double precision where single saves no more than timing can tell.

        Raises ValueError, naming the smallest error there is, if none is that good.
        """
        good = [r for r in self.rows if self.error(r) <= error and not math.isnan(self.price(r))]
        if not good:
            least = min((self.error(row) for row in self.rows), default=math.inf)
            raise ValueError(f"error = {error:g} m: the smallest in this trade is {least:.3g} m")
        return self._cheapest_of(good)

    def _cheapest_of(self, rows: list[TradeRow]) -> TradeRow:
        least = min(rows, key=lambda row: (self.price(row), self.error(row)))
        double = least.settings.replace(precision="f64")
        twin = next((row for row in rows if row.settings == double), least)
        return twin if NOTABLE * self.price(twin) <= self.price(least) else least

    def most_accurate(self, budget: float) -> TradeRow:
        """The row with the smallest error whose price is at most `budget`.

        Raises ValueError, naming the lowest price there is, if none is that cheap.
        """
        checks.real(above=0)("most_accurate", "budget", budget)
        done = [row for row in self.rows if not row.failure]
        good = [row for row in done if self.price(row) <= budget]
        if not good:
            least = min((self.price(row) for row in done), default=math.inf)
            raise ValueError(f"budget = {budget:g}: the lowest price in this trade is {least:.3g}")
        return min(good, key=lambda row: (self.error(row), self.price(row)))
