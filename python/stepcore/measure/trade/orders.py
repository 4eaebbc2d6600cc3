"""The order of accuracy that each integrator shows in a trade's table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.errors import moved
from stepcore.experiment.reference import FINER, Reference
from stepcore.measure.trade.row import TradeRow

# An error above this share of how far bodies move no longer falls as a power of dt.
SATURATED = 0.1


def observed_orders(rows: Sequence[TradeRow], reference: Reference) -> dict[str, float]:
    """The orders from errors ten times the reference's and below a tenth of how far bodies move."""
    return orders(rows, FINER * reference.high, SATURATED * moved(reference.paths))


def orders(rows: Sequence[TradeRow], least: float, most: float = np.inf) -> dict[str, float]:
    """The order that each integrator shows in a table: log of errors over log of steps.

    The slope of a line through runs that differ in dt alone, by a factor of two or more, in double
    precision, whose worst start is further from the truth than `least` [m] and nearer than `most`
    (beyond it errors no longer grow with dt), and whose model is the shipped one, not made softer
    by refsafe; the median, where an integrator has several such lines.
    """
    slopes: dict[str, list[float]] = {}
    kinds: dict[Settings, list[tuple[float, float]]] = {}
    for row in rows:
        e, s = row.errors, row.settings
        own = s.precision == "f64" and not row.clamped and e is not None and e.modelling == 0
        if e is not None and own and least < e.high < most:
            kinds.setdefault(s.replace(dt=1.0), []).append((s.dt, e.high))
    for kind, points in kinds.items():
        dts, errors = np.log(np.array(points)).T
        if np.ptp(dts) >= np.log(2) * (1 - 1e-9):
            slopes.setdefault(kind.integrator, []).append(float(np.polyfit(dts, errors, 1)[0]))
    return {name: float(np.median(some)) for name, some in slopes.items()}
