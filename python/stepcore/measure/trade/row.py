"""`TradeRow`: one setting of a trade, with its errors, its costs and its further starts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from stepcore._core import Settings
from stepcore.experiment.errors import Errors
from stepcore.measure.trade.statistics import QUANTITIES, Statistics

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
# Of all that `TradeRow.record` has.
UNITS = {
    **ERRORS,
    "dt": "s",
    "position_high": "m",
    "cost": "us per simulated second",
    "row_updates": "per simulated second",
    "flops": "per simulated second",
    **{f"{name}_difference": unit for name, unit in QUANTITIES.items()},
    **{f"{name}_interval": unit for name, unit in QUANTITIES.items()},
}


@dataclass(frozen=True)
class Further:
    """Results of a recommendation on starts that the search had not used.

    starts: the number of starts.
    held: the number of them on which the error stayed within the one asked for.
    high: the RMS position error of the worst start [m].
    failure: why the first failing start failed.
    """

    starts: int
    held: int
    high: float
    failure: str | None = None


@dataclass(frozen=True)
class TradeRow:
    """One setting of a trade.

    settings: the setting.
    errors: its errors; None if it failed.
    cost: computing time [µs per simulated second].
    flops, row_updates: floating-point operations and row updates [per simulated second].
    nbytes: memory of the state and the working space.
    further: its results on further starts, if it was tried there.
    after: differences of means once the motion can no longer be predicted, if they were measured.
    shipped: whether these are the shipped settings.
    clamped: whether refsafe softens rows at this dt.
    below, below_max: whether the error and the largest error are below the reference's own.
    best: whether no other setting is cheaper and at least as accurate.
    failure: why it failed.
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
