"""How well a converged motion is known: by the order that halvings show, or a second integrator.

Richardson: if the error falls as dt^p, the distance d between runs at dt and dt/2 puts the error of
the finer at d/(2^p - 1). That holds only where p is seen, in three halvings, to be what the
method's order can be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stepcore.experiment.errors import Errors

ORDERS = (1, 2, 4)
# An order counts that is within this share of one of them.
CLOSE = 0.2


def observed(distances: Sequence[float]) -> list[float]:
    """The order between each two halvings: log2 of how much less the next moved the motion."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return [float(np.log2(np.divide(a, b))) for a, b in pairwise(distances)]


def shown(distances: Sequence[float], floor: float) -> int | None:
    """The order that three halvings show and the finer ones keep, or None.

    distances: between a run and the next finer, coarsest first. floor: below it they are rounding.

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
    """What a converged motion may be wrong by, in four measures of `Errors`.

    error, largest, high [m], angle [rad]: see `Reference`. orders: what
    Richardson used for each (1, 2 or 4), None where no order is shown; bases: the same in words.
    """

    error: float
    largest: float
    high: float
    angle: float
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
    """The error of the finest run, each measure by its own order or else by the rival.

    halvings: how far each moved the motion, coarsest first. rival: distance to the finest run of
    another integrator, named `other`. Without an order the error is twice that distance, and not
    less than the last halving moved. count: samples × bodies, of which none is further off than
    √count times their root mean square.
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
    # No start is worse than the worst, so neither is their median.
    if sure["high"] < sure["error"]:
        sure["error"], orders["error"], bases["error"] = sure["high"], orders["high"], bases["high"]
    bound = np.sqrt(count) * sure["high"]
    if bound < sure["largest"]:
        sure["largest"], orders["largest"] = float(bound), orders["high"]
        bases["largest"] = f"{bases['high']}; √(samples × bodies) times the worst start's"
    return Known(**sure, orders=orders, bases=bases)
