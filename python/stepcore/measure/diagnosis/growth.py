"""Growth that the integrator makes, told from growth of the motion itself; the largest stable dt.

An eigenvalue μ of the linearised step grows at the rate Re log(μ)/dt. It belongs to the physical
rate s (an eigenvalue of J, see `linear`) that is nearest to log(μ)/dt, and is stable while it
grows no faster than that rate allows:

- a motion that grows itself (Re s > 0: an inverted pendulum): half as fast again;
- one that decays (damping ratio above `DAMPED`): not at all, |μ| ≤ 1;
- one that neither grows nor decays: e-fold in the horizon, and at most `PER_RADIAN` of its
  frequency. Explicit rules make every such motion grow at every dt, a little.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats

DAMPED = 1e-3
PER_RADIAN = 0.05
FASTER = 1.5
# |log μ| that may be rounding: two equal eigenvalues of 1 part by the root of an error.
UNRESOLVED = 1e-4
# |μ| - 1 of any other that may be rounding.
ROUNDING = 1e-9

# Angle of an eigenvalue [rad] below which it may be any slow motion.
SLOW_TURN = 0.5

# The search for a limit: how the steps tried grow, and how finely the limit is told.
FACTOR, FINE = 1.5, 1e-3


@dataclass(frozen=True)
class Growth:
    """The worst eigenvalue of a step: μ, its growth rate and the excess over what is allowed [1/s].

    own: the rate of the motion itself that it belongs to.
    """

    value: complex
    rate: float
    excess: float
    own: complex = 0j

    @property
    def stable(self) -> bool:
        """Nothing grows that the motion itself does not make grow."""
        return self.excess <= 0


def allowed(rates: Any, horizon: float) -> Floats:
    """How fast [1/s] a numerical motion may grow where the physical one has these rates."""
    size = np.abs(rates)
    neutral = _neutral(size, horizon)
    decaying = rates.real < -DAMPED * size
    growing = FASTER * np.maximum(rates.real, 0)
    return np.where(decaying, 0.0, np.maximum(growing, neutral))


def _neutral(size: Any, horizon: float) -> Any:
    """How fast [1/s] what neither grows nor decays may grow, of rates of this size."""
    return np.minimum(1 / horizon, PER_RADIAN * np.maximum(size, 1 / horizon))


def growth(matrix: Floats | None, dt: float, rates: Any, horizon: float) -> Growth:
    """The eigenvalue that grows most beyond what is physical."""
    if matrix is None:
        return Growth(math.inf, math.inf, math.inf)
    return worst_of(np.linalg.eigvals(matrix), dt, rates, horizon)


def worst_of(values: Any, dt: float, rates: Any, horizon: float) -> Growth:
    """The one of a step's eigenvalues that grows most beyond what is physical."""
    # An eigenvalue of zero decays at once.
    values = np.where(values == 0, 1e-300, values).astype(complex)
    found = np.log(values) / dt
    apart = np.abs(found[:, None] - rates[None, :])
    nearest = apart.argmin(axis=1)
    limit = allowed(rates, horizon)[nearest]
    excess = found.real - np.maximum(limit, ROUNDING / dt)
    excess[np.abs(found) * dt < UNRESOLVED] = -np.inf
    worst = int(excess.argmax())
    own = complex(rates[nearest[worst]])
    return Growth(complex(values[worst]), float(found[worst].real), float(excess[worst]), own)


def beyond(found: Growth, shorter: Floats, dt: float, horizon: float) -> Growth:
    """The growth beyond what the same motion does over dt in shorter steps, `shorter`.

    Growth of a rule falls with its step, growth of the motion does not. A decay that the shorter
    steps do not show either (the state moves, and its rates with it) is no measure of a growth.
    """
    values = np.linalg.eigvals(shorter).astype(complex)
    rates = np.log(np.where(values == 0, 1e-300, values)) / dt
    here = cmath.log(found.value) / dt
    same = complex(rates[np.abs(rates - here).argmin()])
    own = FASTER * max(same.real, 0.0)
    if abs(cmath.phase(found.value)) < SLOW_TURN:
        own = max(own, FASTER * float(rates.real.max()))
        if same.real > 0.5 * found.own.real:
            own = max(own, float(_neutral(abs(found.own), horizon)))
    return replace(found, excess=min(found.excess, found.rate - own))


def largest_stable(
    stable: Callable[[float], bool], low: float, high: float, fine: float = FINE
) -> float:
    """The largest dt below which all steps are stable: 0 where none is, inf where all are [s].

    stable: whether a step is; asked of steps from `low` to `high`, then between two of them.
    """
    count = max(2, math.ceil(math.log(high / low) / math.log(FACTOR)) + 1)
    below = 0.0
    for dt in np.geomspace(low, high, count):
        if not stable(float(dt)):
            return between(stable, below, float(dt), fine) if below else 0.0
        below = float(dt)
    return math.inf


def between(stable: Callable[[float], bool], low: float, high: float, fine: float = FINE) -> float:
    """The limit between a stable and an unstable step, by bisection to a relative `fine`."""
    while high / low > 1 + fine:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
