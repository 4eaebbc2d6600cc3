"""`Trade`: the table, what it means in sentences, and the cheapest setting for an error."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, field
from typing import Any

from stepcore import checks
from stepcore._core import Settings
from stepcore.experiment.errors import moved
from stepcore.experiment.reference import FINER, Reference
from stepcore.measure.trade import report
from stepcore.measure.trade.frontier import Frontier
from stepcore.measure.trade.mujoco import Point
from stepcore.measure.trade.orders import orders
from stepcore.measure.trade.row import Row
from stepcore.measure.trade.statistics import QUANTITIES
from stepcore.report.result import Result
from stepcore.report.table import Table, jsonable

# An error above this share of how far matter moves no longer falls as a power of dt.
SATURATED = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class Trade(Result):
    """What speed costs in accuracy for one scene; made by `stepcore.trade`.

    frontier: every setting that ran from all starts, and those that failed. reference: the
    converged motion and its error. horizon: simulated time [s]. notes: what to bear in mind.
    target [m], budget: what was asked for. size: of the scene [m]. mujoco: MuJoCo's points, where
    asked for. screened: how many settings were tried at all; runs: how many runs that took.
    chosen: the row for `target` that further starts confirmed.
    """

    name: str
    horizon: float
    frontier: Frontier
    reference: Reference
    starts: int
    notes: list[str] = field(default_factory=list)
    target: float | None = None
    budget: float | None = None
    size: float = math.nan
    mujoco: list[Point] = field(default_factory=list)
    screened: int = 0
    runs: int = 0
    chosen: Row | None = None

    @property
    def rows(self) -> list[Row]:
        """Every setting that ran from all starts, and those that failed; coarsest step first."""
        return list(self.frontier.rows)

    @property
    def by(self) -> str:
        """The cost metric: "time" [µs] or "flops", per simulated second."""
        return self.frontier.by

    def error(self, row: Row) -> float:
        """The error that a row can claim [m]: inf if it failed.

        The RMS position error of the worst start, further ones among them; not below the
        reference's own.
        """
        return self.frontier.error(row)

    def price(self, row: Row) -> float:
        """What a row costs per simulated second: µs, or operations if that is the metric."""
        return self.frontier.price(row)

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

        From errors below a tenth of how far matter moves; see `trade.orders`.
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
        return self.frontier.cheapest(error)

    def most_accurate(self, budget: float) -> Row:
        """The row with the smallest error whose price is at most `budget`.

        Raises ValueError, naming the lowest price there is, if none is that cheap.
        """
        return self.frontier.most_accurate(budget)

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
