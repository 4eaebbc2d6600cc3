"""The order of accuracy that each integrator shows in a trade's table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.converged import ORDERS
from stepcore.experiment.errors import moved
from stepcore.experiment.reference import FINER, Reference
from stepcore.measure.trade.row import TradeRow

# An error above this share of how far bodies move no longer falls as a power of dt.
SATURATED = 0.1
# The slope of a line is an order within this share of it; that of two neighbours within twice it.
CLOSE = 0.15


def observed_orders(rows: Sequence[TradeRow], reference: Reference) -> dict[str, float]:
    """The orders from errors ten times the reference's and below a tenth of how far bodies move."""
    return orders(rows, FINER * reference.high, SATURATED * moved(reference.runs))


def orders(rows: Sequence[TradeRow], least: float, most: float = np.inf) -> dict[str, float]:
    """The order that each integrator shows in a table: log of errors over log of steps.

    The slope of a line through three or more runs that differ in dt alone, by a factor of four or
    more, in double precision, whose worst start is further from the truth than `least` [m] and
    nearer than `most` (beyond it errors no longer grow with dt), and whose model is the shipped
    one, not made softer by refsafe; the median, where an integrator has several such lines.

    A slope is an order only where it is one: the line's, and that between each two neighbours, are
    near the same whole order that a method can have. Elsewhere contacts that begin and end, not
    the method, make the error, and an integrator has none.
    """
    slopes: dict[str, list[float]] = {}
    kinds: dict[Settings, list[tuple[float, float]]] = {}
    for row in rows:
        e, s = row.errors, row.settings
        own = s.precision == "f64" and not row.clamped and e is not None and e.modelling == 0
        if e is not None and own and least < e.high < most:
            kinds.setdefault(s.replace(dt=1.0), []).append((s.dt, e.high))
    for kind, points in kinds.items():
        dts, errors = np.log(np.array(sorted(points))).T
        if len(points) >= 3 and np.ptp(dts) >= np.log(4) * (1 - 1e-9):
            slope = float(np.polyfit(dts, errors, 1)[0])
            if _is_order(slope, dts, errors):
                slopes.setdefault(kind.integrator, []).append(slope)
    return {name: float(np.median(some)) for name, some in slopes.items()}


def _is_order(slope: float, dts: np.ndarray, errors: np.ndarray) -> bool:
    """Whether the whole line and each part of it that spans some 40 % of dt show one order."""
    order = min(ORDERS, key=lambda p: abs(np.log(max(slope, 1e-9) / p)))
    wide = np.diff(dts) > np.log(1.4)
    local = np.diff(errors)[wide] / np.diff(dts)[wide]
    near = np.abs(local - order) <= 2 * CLOSE * order
    return abs(slope - order) <= CLOSE * order and bool(near.all())
