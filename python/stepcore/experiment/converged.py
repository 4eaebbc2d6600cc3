"""Settings of the reference, and error estimates of a converged motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stepcore._core import Settings
from stepcore.engine.run_settings import converged_settings
from stepcore.experiment.errors import Errors

# Possible orders of convergence, and the largest relative deviation of an observed order.
ORDERS, CLOSE = (1, 2, 4), 0.2


def reference_settings(shipped: Settings, integrator: str, dt: float) -> Settings:
    """Return the settings of a reference run: converged rows, with the scene's contact softness."""
    return converged_settings(shipped, dt=dt, integrator=integrator, warm_start=True, refsafe=False)


def observed(distances: Sequence[float]) -> list[float]:
    """Return the observed order of convergence of each pair of consecutive halvings.

    The order is log2 of the ratio of the two distances.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return [float(np.log2(np.divide(a, b))) for a, b in pairwise(distances)]


def shown(distances: Sequence[float], floor: float) -> int | None:
    """Return the order that three halvings show and that finer halvings confirm, or None.

    distances: between each run and the next finer one, coarsest first [m].
    floor: distances below this are rounding [m].

    >>> shown([4e-3, 1e-3, 2.5e-4], floor=0.0), shown([4e-3, 1e-3, 1.5e-4], floor=0.0)
    (2, None)
    """
    seen: int | None = None
    orders = observed(distances)
    for k, order in enumerate(orders):
        kept = seen is not None and order >= (1 - CLOSE) * seen
        if not (kept or distances[k + 1] <= floor):
            seen = None
        for nominal in ORDERS:
            close = [p for p in orders[k : k + 2] if abs(p - nominal) <= CLOSE * nominal]
            if len(close) == 2 and distances[k + 2] > floor:
                seen = nominal
    return seen


@dataclass(frozen=True)
class Known:
    """The error of a converged motion, in four measures of `Errors`.

    error: the error of the median start [m].
    largest: the largest error of any body, sample and start [m].
    high: the error of the worst start [m].
    angle: the error of orientations [rad].
    each: the error of every start [m]; the largest is `high`.
    orders: the order of the Richardson extrapolation of each measure (1, 2 or 4); None without one.
    bases: the method of each estimate, in words.
    """

    error: float
    largest: float
    high: float
    angle: float
    each: tuple[float, ...]
    orders: dict[str, int | None]
    bases: dict[str, str]


MEASURES = {"error": "median", "largest": "position_max", "high": "high", "angle": "angle"}


def known(
    halvings: Sequence[Errors],
    floor: float,
    rival: Errors | None,
    other: str,
    count: float = np.inf,
) -> Known:
    """Estimate the error of the finest run, for each measure separately.

    If the error falls as dt^p, and runs at dt and dt/2 differ by d, the error of the finer run is
    d/(2^p - 1). This estimate is used if three halvings show a possible order p. Otherwise the
    error is twice the distance to the rival, and at least the change of the last halving.

    halvings: the change of the motion in each halving, coarsest first.
    floor: distances below this are rounding [m].
    rival: the distance to the finest run of another integrator; other: that integrator's name.
    count: the number of samples × bodies. It bounds the largest error: by √count times the RMS.
    """
    sure: dict[str, float] = {}
    orders: dict[str, int | None] = {}
    bases: dict[str, str] = {}
    for name, measure in MEASURES.items():
        distances = [float(getattr(halving, measure)) for halving in halvings]
        order, last = shown(distances, floor), distances[-1]
        orders[name] = order
        if order is not None:
            sure[name] = last if last <= floor else last / (2**order - 1)
            bases[name] = f"Richardson, order {order}"
        elif rival is not None:
            sure[name] = max(2 * float(getattr(rival, measure)), last)
            bases[name] = f"twice the distance to {other}"
        else:
            sure[name] = 2 * last
            bases[name] = "twice the change in its last halving, because no other integrator runs"
    # The median error cannot exceed that of the worst start, nor an RMS the largest of its parts.
    if sure["high"] < sure["error"]:
        sure["error"], orders["error"], bases["error"] = sure["high"], orders["high"], bases["high"]
    if sure["largest"] < sure["high"]:
        sure["largest"], orders["largest"] = sure["high"], orders["high"]
        bases["largest"] = bases["high"]
    bound = np.sqrt(count) * sure["high"]
    if bound < sure["largest"]:
        sure["largest"], orders["largest"] = float(bound), orders["high"]
        bases["largest"] = f"{bases['high']}; √(samples × bodies) times the worst start's"
    each = _each(halvings[-1], floor, orders["high"], rival)
    return Known(**sure, each=each, orders=orders, bases=bases)


def _each(last: Errors, floor: float, order: int | None, rival: Errors | None) -> tuple[float, ...]:
    """Estimate the error of every start as that of the worst start is estimated."""
    if order is not None:
        return tuple(moved if moved <= floor else moved / (2**order - 1) for moved in last.each)
    if rival is None:
        return tuple(2 * moved for moved in last.each)
    return tuple(max(2 * far, moved) for far, moved in zip(rival.each, last.each, strict=True))
