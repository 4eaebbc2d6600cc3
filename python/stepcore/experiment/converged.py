"""Converged settings, and how well a converged motion is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.errors import Errors

# The orders that methods have, and how close to one of them an observed order must be.
ORDERS, CLOSE = (1, 2, 4), 0.2
# Newton converges in some ten iterations, or not at all.
NEWTON = 200


def converged_settings(
    settings: Settings,
    *,
    sweeps: int = 20_000,
    tolerance: float = 1e-13,
    refsafe: bool | None = None,
    **changes: Any,
) -> Settings:
    """The same settings in double precision with converged rows: by Newton where the law is convex.

    sweeps: the most sweeps of PGS under other laws. With 20,000 of them a stack with mass ratios of
        a thousand converges; fewer may be asked for where many steps are made.
    tolerance: on the residual [m/s]; 0 runs all sweeps. The default is rounding in a scene whose
        speeds are about 1 m/s.
    refsafe: whether solref may be softened at a large dt, where the law is solref; None leaves it
        as it is.
    changes: further fields of Settings (dt, integrator, …).
    """
    convex = settings.law == "solref"
    if convex and refsafe is not None:
        changes["refsafe"] = refsafe
    return settings.replace(
        solver="newton" if convex else "pgs",
        sweeps=NEWTON if convex else sweeps,
        tolerance=tolerance,
        acceleration="none",
        precision="f64",
        **changes,
    )


def reference_settings(shipped: Settings, integrator: str, dt: float) -> Settings:
    """The settings of a reference run: converged rows, contacts as soft as the scene says."""
    return converged_settings(shipped, dt=dt, integrator=integrator, warm_start=True, refsafe=False)


def observed(distances: Sequence[float]) -> list[float]:
    """The order of each two halvings: log2 of how much less the second moved the motion."""
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
    """The error of a converged motion, in four measures of `Errors`.

    error, high, largest [m]: of the median start, of the worst start, and of any body, sample and
        start. angle [rad]: of orientations.
    orders: the order that Richardson used for each (1, 2 or 4), None where no order is shown.
    bases: how each is known, in words.
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

    If the error falls as dt^p, the distance d between runs at dt and dt/2 puts the error of the
    finer at d/(2^p - 1). That holds where three halvings show a p that a method can have. Elsewhere
    the error is twice the distance to the rival, and not less than the last halving moved.

    halvings: how far each moved the motion, coarsest first. rival: distance to the finest run of
    another integrator, named `other`. count: samples × bodies, of which none is further off than
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
