"""`TradeRow`: one setting of a trade. `Frontier`: all rows, with the best ones marked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.experiment.converged import ORDERS
from stepcore.experiment.errors import Errors, moved, pareto
from stepcore.experiment.reference import FINER, Reference
from stepcore.measure.trade.statistics import QUANTITIES, Statistics
from stepcore.report.units import rounded

# Recommended settings must stay within this share of the requested error, because further starts
# may be harder.
MARGIN = 0.9
# The number of digits of an error that replaces one that the reference cannot verify.
DIGITS = 2
# Cost ratios above this are within the uncertainty of timing.
NOTABLE = 0.9
# An error above this share of the bodies' displacement no longer falls as a power of dt.
SATURATED = 0.1
# Relative tolerance of a line's slope as an order; the slope between two neighbours has twice this.
CLOSE = 0.15

FIELDS = (
    *("dt", "integrator", "solver", "sweeps", "precision", "tolerance", "warm_start"),
    "cost_tolerance",
    *("acceleration", "cone", "accuracy"),
)
# Fields of `Errors`, with their units.
ERRORS = {
    "position": "m",
    "position_max": "m",
    "relative": "1",
    "relative_max": "1",
    "numerical": "m",
    "modelling": "m",
    "angle": "rad",
    "angle_max": "rad",
    "gained": "J",
    "lost": "J",
    "momentum": "kg m/s",
    "angular_momentum": "kg m^2/s",
    "overlap": "m",
    "joint": "m",
    "limit": "rad or m",
    "creep": "m/s",
    "anisotropy": "rad",
    "residual": "m/s",
}
# Units of the fields of `TradeRow.record`.
UNITS = {
    **ERRORS,
    "dt": "s",
    "accuracy": "m per simulated second",
    "position_high": "m",
    "cost": "us per simulated second",
    "row_updates": "per simulated second",
    "flops": "per simulated second",
    **{f"{name}_difference": unit for name, unit in QUANTITIES.items()},
    **{f"{name}_interval": unit for name, unit in QUANTITIES.items()},
}


@dataclass(frozen=True)
class Further:
    """The results of a setting on starts that the search has not used.

    starts: the number of these starts.
    held: the number of these starts on which the error was within the requested error.
    high: the RMS position error of the worst start [m].
    failure: the reason why the first failing start failed.
    """

    starts: int
    held: int
    high: float
    failure: str | None = None


@dataclass(frozen=True)
class TradeRow:
    """One setting of a trade.

    settings: the setting.
    errors: the errors of the setting; None if a run failed.
    cost: computing time [µs per simulated second].
    flops, row_updates: floating-point operations and row updates [per simulated second].
    nbytes: memory of the state and the working space [bytes].
    further: the results on further starts, if the setting ran there.
    after: differences of means after the motion becomes unpredictable, if they were measured.
    shipped: whether these are the shipped settings.
    clamped: whether refsafe softens rows at this dt.
    below, below_max: whether the error and the largest error are below the reference's own.
    best: whether no other setting is cheaper and at least as accurate on the same starts.
    failure: the reason why a run failed.
    """

    settings: Settings
    errors: Errors | None
    cost: float
    row_updates: float
    failure: str | None = None
    shipped: bool = False
    clamped: bool = False
    below: bool = False
    below_max: bool = False
    best: bool = False
    flops: float = math.nan
    nbytes: int = 0
    further: Further | None = None
    after: Statistics | None = None

    def misses(self, error: float) -> tuple[int, int]:
        """Return on how many starts the row exceeds an error [m], and from how many it ran."""
        each = () if self.errors is None else self.errors.each
        held, count = sum(wrong <= error for wrong in each), len(each)
        if self.further is not None:
            held, count = held + self.further.held, count + self.further.starts
        return count - held, count

    def record(self) -> dict[str, Any]:
        """Return the row as plain data.

        `below` and `below_max` mark an error and a largest error below the reference's own.
        """
        e = self.errors
        record: dict[str, Any] = {name: getattr(self.settings, name) for name in FIELDS}
        for name in ERRORS:
            value = None if e is None else getattr(e, name)
            record[name] = None if value is None or math.isnan(value) else value
        record["position_high"] = None if e is None else e.high
        record["worst_start"] = None if e is None else e.worst
        return record | {
            "cost": _known(self.cost),
            "row_updates": _known(self.row_updates),
            "flops": _known(self.flops),
            "bytes": self.nbytes or None,
            "pareto": self.best,
            "shipped": self.shipped,
            "clamped": self.clamped,
            "below": self.below,
            "below_max": self.below_max,
            **{
                f"further_{name}": None if self.further is None else getattr(self.further, name)
                for name in ("starts", "held", "high")
            },
            "failure": self.failure,
            **({} if self.after is None else self.after.record()),
        }


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


@dataclass(frozen=True)
class Frontier:
    """The rows of a trade, coarsest step first.

    by: the cost metric, "time" or "flops".
    known, known_max: the reference's own error and largest error [m]; no row can claim less.
    """

    rows: tuple[TradeRow, ...]
    known: float
    known_max: float
    by: str

    @property
    def shipped(self) -> TradeRow:
        """The row of the scene's own settings."""
        return next(row for row in self.rows if row.shipped)

    @classmethod
    def of(cls, rows: Iterable[TradeRow], known: float, known_max: float, by: str) -> Frontier:
        """Return the frontier of some rows, with the best rows marked."""
        plain = cls(tuple(sorted(rows, key=lambda row: -row.settings.dt)), known, known_max, by)
        best = pareto(
            [plain.price(row) for row in plain.rows], [plain.searched(row) for row in plain.rows]
        )
        marked = []
        for row, mark in zip(plain.rows, best, strict=True):
            below = below_max = False
            if (e := row.errors) is not None:
                below, below_max = e.high < known, e.position_max < known_max
            marked.append(dataclasses.replace(row, best=mark, below=below, below_max=below_max))
        return dataclasses.replace(plain, rows=tuple(marked))

    def updated(self, row: TradeRow) -> Frontier:
        """Return the frontier with a row added; the row replaces that of the same settings."""
        others = [other for other in self.rows if other.settings != row.settings]
        if len(others) == len(self.rows):
            return self.of([*self.rows, row], self.known, self.known_max, self.by)
        rows = [row if other.settings == row.settings else other for other in self.rows]
        return self.of(rows, self.known, self.known_max, self.by)

    def has(self, settings: Settings) -> bool:
        return any(row.settings == settings for row in self.rows)

    def error(self, row: TradeRow) -> float:
        """Return the error that a row can claim in all starts it ran from [m]; inf if it failed."""
        if row.errors is None:
            return math.inf
        further = 0.0 if row.further is None else row.further.high
        return max(row.errors.high, self.known, further)

    def searched(self, row: TradeRow) -> float:
        """Return the error of a row on the starts of the search, from which every row ran [m].

        Tables and plots have this error, so that their rows can be compared.
        """
        return math.inf if row.errors is None else max(row.errors.high, self.known)

    def largest(self, row: TradeRow) -> float:
        """Return the largest error of any body and sample on the starts of the search [m]."""
        return math.inf if row.errors is None else max(row.errors.position_max, self.known_max)

    def tied(self, row: TradeRow) -> bool:
        """Return whether the error is below the reference's, which cannot rank such rows."""
        return row.below and self.error(row) <= self.known

    def halving(self, row: TradeRow) -> TradeRow | None:
        """Return the cheapest row with at most half the error of a row, or None.

        None means that no row is as accurate, or that the error is already 0. Both errors are those
        on the starts of the search: further starts, from which few rows ran, may be harder.
        """
        half = self.searched(row) / 2
        good = [r for r in self.rows if self.searched(r) <= half and not math.isnan(self.price(r))]
        return self._cheapest_of(good) if good and half > 0 else None

    def least(self) -> float:
        """Return a round error above the smallest of any row, by the margin [m]; inf without one.

        It is asked for in place of an error that the reference cannot verify.
        """
        least = min(map(self.error, self.rows), default=math.inf) / MARGIN
        return rounded(least, DIGITS, up=True) if math.isfinite(least) else least

    def price(self, row: TradeRow) -> float:
        """Return the cost of a row per simulated second: µs, or operations with `by="flops"`."""
        return row.flops if self.by == "flops" else row.cost

    def cheapest(self, error: float) -> TradeRow:
        """Return the row with the lowest price whose error is at most `error` [m].

        A row in single precision must save more than the uncertainty of timing. Of rows of equal
        cost within that uncertainty, one with at most half the error is preferred, or the shipped
        settings if they have at most twice the error.

        Raises ValueError, naming the smallest error reached, if no row is accurate enough.
        """
        good = [r for r in self.rows if self.error(r) <= error and not math.isnan(self.price(r))]
        if not good:
            least = min((self.error(row) for row in self.rows), default=math.inf)
            raise ValueError(f"error = {error:g} m: the smallest in this trade is {least:.3g} m")
        return self._cheapest_of(good)

    def _cheapest_of(self, rows: list[TradeRow]) -> TradeRow:
        least = min(rows, key=lambda row: (self.price(row), self.error(row)))
        if self.by == "time":
            # Of equal cost, within the uncertainty of timing, with half the error or less.
            half, most = self.error(least) / 2, self.price(least) / NOTABLE
            alike = [row for row in rows if self.price(row) <= most and self.error(row) <= half]
            least = min([least, *alike], key=self.error)
            # Nothing is changed for a gain that timing cannot tell.
            for row in rows:
                same = NOTABLE * self.price(row) <= self.price(least)
                if row.shipped and same and self.error(row) <= 2 * self.error(least):
                    return row
        double = least.settings.replace(precision="f64")
        twin = next((row for row in rows if row.settings == double), least)
        return twin if NOTABLE * self.price(twin) <= self.price(least) else least

    def most_accurate(self, budget: float) -> TradeRow:
        """Return the row with the smallest error whose price is at most `budget`.

        Raises ValueError, naming the lowest price, if no row is cheap enough.
        """
        checks.real(above=0)("most_accurate", "budget", budget)
        done = [row for row in self.rows if not row.failure]
        good = [row for row in done if self.price(row) <= budget]
        if not good:
            least = min((self.price(row) for row in done), default=math.inf)
            raise ValueError(f"budget = {budget:g}: the lowest price in this trade is {least:.3g}")
        return min(good, key=lambda row: (self.error(row), self.price(row)))


def observed_orders(rows: Sequence[TradeRow], reference: Reference) -> dict[str, float]:
    """Return each integrator's order from errors well above the reference's and not saturated."""
    return orders(rows, FINER * reference.high, SATURATED * moved(reference.runs))


def orders(rows: Sequence[TradeRow], least: float, most: float = np.inf) -> dict[str, float]:
    """Return the observed order of each integrator: the slope of log(error) over log(dt).

    The slope is fitted to a line of three or more runs in double precision that differ in dt alone,
    by a factor of four or more. The error of each run's worst start must be above `least` and below
    `most` [m]; beyond `most`, errors no longer grow with dt. Runs that refsafe softens are left
    out. If an integrator has several such lines, the order is the median of their slopes.

    A slope counts as an order only if the slope of the line and the slopes between neighbours are
    all near one whole number that is a possible order. Otherwise contacts that begin and end
    dominate the error, and the integrator has no order.
    """
    slopes: dict[str, list[float]] = {}
    kinds: dict[Settings, list[tuple[float, float]]] = {}
    for row in rows:
        e, s = row.errors, row.settings
        fixed = s.accuracy is None and not row.clamped
        plain = s.precision == "f64" and fixed and e is not None and e.modelling == 0
        if e is not None and plain and least < e.high < most:
            kinds.setdefault(s.replace(dt=1.0), []).append((s.dt, e.high))
    for kind, points in kinds.items():
        dts, errors = np.log(np.array(sorted(points))).T
        if len(points) >= 3 and np.ptp(dts) >= np.log(4) * (1 - 1e-9):
            slope = float(np.polyfit(dts, errors, 1)[0])
            if _is_order(slope, dts, errors):
                slopes.setdefault(kind.integrator, []).append(slope)
    return {name: float(np.median(some)) for name, some in slopes.items()}


def _is_order(slope: float, dts: np.ndarray, errors: np.ndarray) -> bool:
    """Return whether the whole line, and each part that spans some 40 % of dt, show one order."""
    order = min(ORDERS, key=lambda p: abs(np.log(max(slope, 1e-9) / p)))
    wide = np.diff(dts) > np.log(1.4)
    local = np.diff(errors)[wide] / np.diff(dts)[wide]
    near = np.abs(local - order) <= 2 * CLOSE * order
    return abs(slope - order) <= CLOSE * order and bool(near.all())
