"""`Trade`: the table, what it means in sentences, and the cheapest setting for an error."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, field
from typing import Any

from stepcore import checks
from stepcore._core import Settings
from stepcore.results import Result
from stepcore.table import Table, jsonable
from stepcore.trade import report
from stepcore.trade.errors import Errors, pareto
from stepcore.trade.reference import Reference


@dataclass
class Row:
    """One setting. cost [µs per simulated second], row_updates [per simulated second]."""

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

    def record(self) -> dict[str, Any]:
        """The row as plain data.

        `below` and `below_max` mark a median and a largest error below the reference's own.
        """
        s, e = self.settings, self.errors
        record = {
            "dt": s.dt,
            "integrator": s.integrator,
            "solver": s.solver,
            "sweeps": s.sweeps,
            "precision": s.precision,
        }
        for name in ERRORS:
            value = None if e is None else getattr(e, name)
            record[name] = None if value is None or math.isnan(value) else value
        record["worst_start"] = None if e is None else e.worst
        return record | {
            "cost": None if math.isnan(self.cost) else self.cost,
            "row_updates": None if math.isnan(self.row_updates) else self.row_updates,
            "pareto": self.best,
            "shipped": self.shipped,
            "clamped": self.clamped,
            "below": self.below,
            "below_max": self.below_max,
            "failure": self.failure,
        }


@dataclass
class Trade(Result):
    """What speed costs in accuracy for one scene; made by `stepcore.trade`.

    rows: every setting tried, failures among them. reference: the converged motion and its
    error. horizon: simulated time [s]. notes: what to bear in mind.
    """

    name: str
    horizon: float
    rows: list[Row]
    reference: Reference
    starts: int
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        for row in self.rows:
            if row.errors is not None:
                row.below = row.errors.position < self.reference.error
                row.below_max = row.errors.position_max < self.reference.largest
        marks = pareto([row.cost for row in self.rows], [self.error(row) for row in self.rows])
        for row, mark in zip(self.rows, marks, strict=True):
            row.best = mark

    def error(self, row: Row) -> float:
        """The error that a row can claim [m]: not below the reference's own; inf if it failed."""
        if row.errors is None:
            return math.inf
        return max(row.errors.position, self.reference.error)

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: what speed costs in accuracy"

    @property
    def shipped(self) -> Row:
        """The settings that came with the scene."""
        return next(row for row in self.rows if row.shipped)

    @property
    def predictable(self) -> float:
        """When the first of the starts can no longer be predicted [s]; inf beyond the horizon.

        Trajectory errors are those before it; see `stepcore.predictability`.
        """
        return self.reference.growth.overall

    @property
    def table(self) -> Table:
        """All rows, coarsest step first; units as in `Errors` and `Row`."""
        return Table(row.record() for row in self.rows)

    def best(self, error: float = 1e-3) -> Settings:
        """The cheapest Settings whose position error is at most `error` [m].

        Raises ValueError, naming the smallest error there is, if none is that good.
        """
        return self.cheapest(error).settings

    def cheapest(self, error: float) -> Row:
        """The row of `best`."""
        checks.real(low=0)("best", "error", error)
        good = [r for r in self.rows if self.error(r) <= error and not math.isnan(r.cost)]
        if not good:
            least = min((self.error(row) for row in self.rows), default=math.inf)
            raise ValueError(f"error = {error:g} m: the smallest in this trade is {least:.3g} m")
        return min(good, key=lambda row: (row.cost, self.error(row)))

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """The picture, cost against error; written to `path` if given. Needs matplotlib.

        Returns the matplotlib Figure.
        """
        from stepcore.plot.frontier import plot_trade

        return plot_trade(self, path)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        ref = self.reference
        own = {
            "settings": ref.settings.as_dict(),
            "error": ref.error,
            "error_max": ref.largest,
            "angle_error": ref.angle,
            "agreement": ref.agreement,
            "other_integrator": ref.other,
            "halvings": [{"dt": level.dt, "distance": level.distance} for level in ref.levels],
            "basis": ref.basis,
            "order": ref.order,
            "orders": ref.orders,
            "closed_form": None if ref.exact is None else ref.exact.check,
            "stiffens": ref.stiffens,
            "modelling": {name: asdict(gap) for name, gap in ref.gaps.items()},
            "predictable": self.predictable,
            "predictable_starts": ref.growth.ends,
        }
        truth = ref.paths
        own["overlap"] = max(path.overlap for path in truth)
        own["gained"] = max(float(path.balance.max()) for path in truth)
        own["lost"] = max(-float(path.balance.min()) for path in truth)
        plain: dict[str, Any] = jsonable(
            {
                "model": self.name,
                "horizon": self.horizon,
                "starts": self.starts,
                "shipped": self.shipped.settings.as_dict(),
                "reference": own,
                "units": UNITS,
                "rows": [row.record() for row in self.rows],
                "notes": self.notes + report.cautions(self),
                "summary": report.sentences(self),
            }
        )
        return plain

    def to_pandas(self) -> Any:
        """The table as a pandas DataFrame."""
        return self.table.to_pandas()

    def text(self, width: int | None = None, full: bool = False) -> str:
        """The printed trade, at most `width` characters wide; `full`: every row."""
        return report.text(self, width, full)

    def __repr__(self) -> str:
        failed = sum(row.failure is not None for row in self.rows)
        return f"<Trade of {self.name}: {len(self.rows)} settings, {failed} failed>"


ERRORS = (
    *("position", "position_max", "relative", "relative_max", "numerical", "modelling"),
    *("angle", "angle_max", "gained", "lost", "momentum", "angular_momentum"),
    *("overlap", "joint", "limit", "creep", "anisotropy", "residual"),
)
UNITS = {
    "dt": "s",
    "position": "m",
    "position_max": "m",
    "angle": "rad",
    "angle_max": "rad",
    "gained": "J",
    "lost": "J",
    "overlap": "m",
    "residual": "m/s",
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
}
