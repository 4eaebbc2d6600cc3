"""`Trade`: the table, what it means in sentences, and the cheapest setting for an error."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, field
from typing import Any

from stepcore import checks
from stepcore._core import Settings
from stepcore.experiment.errors import Errors, moved, pareto
from stepcore.experiment.order import orders
from stepcore.experiment.reference import FINER, Reference
from stepcore.experiment.statistics import QUANTITIES, Statistics
from stepcore.measure.trade import report
from stepcore.measure.trade.mujoco import Point
from stepcore.report.result import Result
from stepcore.report.table import Table, jsonable

FIELDS = (
    "dt",
    "integrator",
    "solver",
    "sweeps",
    "precision",
    "tolerance",
    "warm_start",
    "acceleration",
    "cone",
)
ERRORS = (
    *("position", "position_max", "relative", "relative_max", "numerical", "modelling"),
    *("angle", "angle_max", "gained", "lost", "momentum", "angular_momentum"),
    *("overlap", "joint", "limit", "creep", "anisotropy", "residual"),
)
# An error above this share of how far matter moves no longer falls as a power of dt.
SATURATED = 0.1


@dataclass
class Further:
    """How a recommendation did on starts that the search had not seen.

    starts: how many; held: how many of them kept to the error asked for; high: the root mean
    square of the worst [m]; failure: of the first that failed.
    """

    starts: int
    held: int
    high: float
    failure: str | None = None


@dataclass
class Row:
    """One setting. cost [µs per simulated second]; row_updates, flops [per simulated second];
    nbytes: memory of state and working space; further: tried on further starts. after:
    differences of means once the motion cannot be predicted, where they were measured.
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

    def record(self) -> dict[str, Any]:
        """The row as plain data.

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
            "further_starts": None if self.further is None else self.further.starts,
            "further_held": None if self.further is None else self.further.held,
            "further_high": None if self.further is None else self.further.high,
            "failure": self.failure,
            **({} if self.after is None else self.after.record()),
        }


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


@dataclass(eq=False, repr=False)
class Trade(Result):
    """What speed costs in accuracy for one scene; made by `stepcore.trade`.

    rows: every setting that ran from all starts, and those that failed. reference: the
    converged motion and its error. horizon: simulated time [s]. notes: what to bear in mind.
    target [m], budget: what was asked for. by: what cheap means, "time" [µs] or "flops", per
    simulated second. size: of the scene [m]. mujoco: MuJoCo's points, where asked for.
    screened: how many settings were tried at all; runs: how many runs that took. chosen: the row
    for `target` that further starts confirmed.
    """

    name: str
    horizon: float
    rows: list[Row]
    reference: Reference
    starts: int
    notes: list[str] = field(default_factory=list)
    target: float | None = None
    budget: float | None = None
    by: str = "time"
    size: float = math.nan
    mujoco: list[Point] = field(default_factory=list)
    screened: int = 0
    runs: int = 0
    chosen: Row | None = None

    def __post_init__(self) -> None:
        self.mark()

    def mark(self) -> None:
        """Marks the rows that no other beats, and errors below the reference's own."""
        for row in self.rows:
            if row.errors is not None:
                row.below = row.errors.high < self.reference.high
                row.below_max = row.errors.position_max < self.reference.largest
        prices = [self.price(row) for row in self.rows]
        marks = pareto(prices, [self.error(row) for row in self.rows])
        for row, mark in zip(self.rows, marks, strict=True):
            row.best = mark
        marks = pareto([p.cost for p in self.mujoco], [p.error for p in self.mujoco])
        for point, mark in zip(self.mujoco, marks, strict=True):
            point.best = mark

    def error(self, row: Row) -> float:
        """The error that a row can claim [m]: inf if it failed.

        The root mean square of positions in the worst start, further ones among them; not
        below the reference's own.
        """
        if row.errors is None:
            return math.inf
        further = 0.0 if row.further is None else row.further.high
        return max(row.errors.high, self.reference.high, further)

    def price(self, row: Row) -> float:
        """What a row costs per simulated second: µs, or operations if that is what counts."""
        return row.flops if self.by == "flops" else row.cost

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: what speed costs in accuracy"

    @property
    def shipped(self) -> Row:
        """The settings that came with the scene."""
        return next(row for row in self.rows if row.shipped)

    @property
    def orders(self) -> dict[str, float]:
        """The order of accuracy that each integrator shows in the table (worst start).

        From errors below a tenth of how far matter moves; see `stepcore.experiment.order.orders`.
        """
        ref = self.reference
        return orders(self.rows, FINER * ref.high, SATURATED * moved(ref.paths))

    @property
    def predictable(self) -> float:
        """When the first of the starts can no longer be predicted [s]; inf beyond the horizon.

        Trajectory errors are those before it; see `stepcore.predictability`.
        """
        return self.reference.growth.overall

    @property
    def failures(self) -> list[Row]:
        """The rows that failed; `Row.failure` says why."""
        return [row for row in self.rows if row.failure]

    @property
    def table(self) -> Table:
        """All rows, coarsest step first; units as in `Errors` and `Row`."""
        return Table(row.record() for row in self.rows)

    @property
    def recommended(self) -> Row | None:
        """The row for the error or budget that was asked for; None where no row is, or no ask."""
        if self.chosen is not None:
            return self.chosen
        try:
            if self.target is not None:
                return self.cheapest(self.target)
            return None if self.budget is None else self.most_accurate(self.budget)
        except ValueError:
            return None

    def best(self, error: float | None = None) -> Settings:
        """The cheapest Settings whose error is at most `error` [m] in every start.

        error: by default what the trade was made for (an error or a budget), else 1e-3.

        Raises ValueError, naming the smallest error there is, if none is that good.
        """
        if error is None and self.target is None and self.budget is not None:
            return self.most_accurate(self.budget).settings
        asked = self._asked(error)
        if self.chosen is not None and asked == self.target:
            return self.chosen.settings
        return self.cheapest(asked).settings

    def next_better(self, error: float | None = None) -> Row | None:
        """The cheapest row with at most half of that error; None if there is none.

        error [m]: by default that of the recommended row.
        """
        if error is None and self.recommended is not None:
            error = self.error(self.recommended)
        try:
            return self.cheapest(self._asked(error) / 2)
        except ValueError:
            return None

    def _asked(self, error: float | None) -> float:
        asked = error if error is not None else self.target
        return 1e-3 if asked is None else asked

    def cheapest(self, error: float) -> Row:
        """The row of `best`."""
        checks.real(low=0)("best", "error", error)
        good = [r for r in self.rows if self.error(r) <= error and not math.isnan(self.price(r))]
        if not good:
            least = min((self.error(row) for row in self.rows), default=math.inf)
            raise ValueError(f"error = {error:g} m: the smallest in this trade is {least:.3g} m")
        # Single precision does the same operations: of two alike the double one.
        single = {row.settings: row.settings.precision == "f32" for row in good}
        return min(good, key=lambda r: (self.price(r), single[r.settings], self.error(r)))

    def most_accurate(self, budget: float) -> Row:
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

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """The picture, cost against error; written to `path` if given. Needs matplotlib.

        Returns the matplotlib Figure.
        """
        from stepcore.report.plot.frontier import plot_trade

        return plot_trade(self, path)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        chosen = self.recommended
        plain: dict[str, Any] = jsonable(
            {
                "model": self.name,
                "horizon": self.horizon,
                "starts": self.starts,
                "size": self.size,
                "shipped": self.shipped.settings.as_dict(),
                "reference": self._reference(),
                "orders": self.orders,
                "predictable": self.predictable,
                "asked": {"error": self.target, "budget": self.budget, "by": self.by},
                "recommended": None if chosen is None else chosen.settings.as_dict(),
                "units": UNITS,
                "rows": [row.record() for row in self.rows],
                "mujoco": [point.record() for point in self.mujoco],
                "screened": self.screened,
                "runs": self.runs,
                "notes": self.notes + report.cautions(self),
                "summary": report.sentences(self),
            }
        )
        return plain

    def _reference(self) -> dict[str, Any]:
        ref = self.reference
        truth = ref.paths
        return {
            "settings": ref.settings.as_dict(),
            "error": ref.error,
            "error_high": ref.high,
            "error_max": ref.largest,
            "angle_error": ref.angle,
            "agreement": ref.agreement,
            "other_integrator": ref.other,
            "halvings": [{"dt": level.dt, "distance": level.distance} for level in ref.levels],
            "basis": ref.basis,
            "order": ref.order,
            "known": None if ref.exact else {"orders": ref.known.orders, "bases": ref.known.bases},
            "orders": ref.orders,
            "closed_form": None if ref.exact is None else ref.exact.check,
            "stiffens": ref.stiffens,
            "modelling": {name: asdict(gap) for name, gap in ref.gaps.items()},
            "predictable": self.predictable,
            "predictable_starts": ref.growth.ends,
            "overlap": max(path.overlap for path in truth),
            "gained": max(float(path.balance.max()) for path in truth),
            "lost": max(-float(path.balance.min()) for path in truth),
        }

    def to_pandas(self) -> Any:
        """The table as a pandas DataFrame."""
        return self.table.to_pandas()

    def text(self, width: int | None = None, full: bool = False) -> str:
        """The printed trade, at most `width` characters wide; `full`: every row."""
        return report.text(self, width, full)

    def __repr__(self) -> str:
        failed = len(self.failures)
        return f"<Trade of {self.name}: {len(self.rows)} settings, {failed} failed>"


UNITS = {
    "dt": "s",
    "position": "m",
    "position_high": "m",
    "position_max": "m",
    "angle": "rad",
    "angle_max": "rad",
    "gained": "J",
    "lost": "J",
    "overlap": "m",
    "residual": "m/s",
    **{
        f"{name}_{part}": unit
        for name, unit in QUANTITIES.items()
        for part in ("difference", "interval")
    },
    "numerical": "m",
    "modelling": "m",
    "momentum": "kg m/s",
    "angular_momentum": "kg m^2/s",
    "joint": "m",
    "limit": "rad or m",
    "creep": "m/s",
    "anisotropy": "rad",
    "cost": "us per simulated second",
    "row_updates": "per simulated second",
    "flops": "per simulated second",
}
