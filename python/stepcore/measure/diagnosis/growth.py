"""Separate the growth that an integrator causes from the growth of the motion itself.

An eigenvalue μ of the linearised step grows at the rate Re log(μ)/dt. It belongs to the physical
rate s (an eigenvalue of J, see `linear_step`) that is nearest to log(μ)/dt. The step is stable if
its growth does not exceed the growth that s allows:

- a motion that grows by itself (Re s > 0, such as an inverted pendulum): 1.5 times its own growth;
- a motion that decays (damping ratio above `DAMPED`): none, |μ| ≤ 1;
- a motion that does neither: e-fold in the horizon, and at most `PER_RADIAN` of its frequency.
  Explicit integrators make every such motion grow a little at every dt.
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
# Rounding may cause |log μ| of this size: an error ε moves a double eigenvalue of 1 by √ε.
UNRESOLVED = 1e-4
# Rounding may cause |μ| − 1 of this size for any other eigenvalue.
ROUNDING = 1e-9

# An eigenvalue at a smaller angle [rad] may belong to any slow motion.
SLOW_TURN = 0.5

# The search for a limit: ratio of successive trial steps, and relative resolution.
FACTOR, FINE = 1.5, 1e-3


@dataclass(frozen=True)
class StepGrowth:
    """The worst eigenvalue of a step.

    value: μ.
    rate: the growth of μ [1/s].
    excess: the growth above the allowed growth [1/s]; the step is stable if it is <= 0.
    own: the rate s of the motion itself that μ belongs to [1/s].
    """

    value: complex
    rate: float
    excess: float
    own: complex = 0j

    @property
    def stable(self) -> bool:
        """Whether no eigenvalue grows faster than the motion itself allows."""
        return self.excess <= 0


def allowed_growth(rates: Any, horizon: float) -> Floats:
    """Return the growth [1/s] allowed for a step of a motion with these rates [1/s]."""
    size = np.abs(rates)
    decaying = rates.real < -DAMPED * size
    growing = FASTER * np.maximum(rates.real, 0)
    return np.where(decaying, 0.0, np.maximum(growing, neutral_growth(size, horizon)))


def neutral_growth(omega: Any, horizon: float) -> Any:
    """Return the growth [1/s] allowed at a frequency ω [rad/s] without physical growth or decay."""
    return np.minimum(1 / horizon, PER_RADIAN * np.maximum(omega, 1 / horizon))


def step_growth(matrix: Floats | None, dt: float, rates: Any, horizon: float) -> StepGrowth:
    """Return the worst growth of a step's matrix.

    matrix: the matrix of the step; None for a step that does not stay finite, whose growth is
        infinite.
    dt: the step [s].
    rates: the rates of the motion itself [1/s]; None if they are unknown.
    horizon: the time in which neutral growth counts [s].
    """
    values = eigenvalues(matrix)
    if values is None or rates is None:
        return StepGrowth(math.inf, math.inf, math.inf)
    return worst_growth(values, dt, rates, horizon)


def worst_growth(values: Any, dt: float, rates: Any, horizon: float) -> StepGrowth:
    """Return the growth of the eigenvalue that exceeds the allowed growth most.

    values: the eigenvalues of the step.
    dt: the step [s].
    rates: the rates of the motion itself [1/s].
    horizon: the time in which neutral growth counts [s].
    """
    with np.errstate(all="ignore"):
        log = _log(values) / dt
    if not np.isfinite(log).all():
        return StepGrowth(math.inf, math.inf, math.inf)
    nearest = np.abs(log[:, None] - rates[None, :]).argmin(axis=1)
    limit = allowed_growth(rates, horizon)[nearest]
    excess = log.real - np.maximum(limit, ROUNDING / dt)
    excess[np.abs(log) * dt < UNRESOLVED] = -np.inf
    worst = int(excess.argmax())
    own = complex(rates[nearest[worst]])
    return StepGrowth(complex(values[worst]), float(log[worst].real), float(excess[worst]), own)


def growth_beyond_motion(
    growth: StepGrowth, shorter: Floats, dt: float, horizon: float
) -> StepGrowth:
    """Return the growth, compared with the motion over dt in shorter steps.

    Growth that an integrator causes falls with its step; growth of the motion does not. A physical
    decay that the shorter steps do not show is no measure of growth: there the state moves, and its
    rates with it.

    growth: the growth in one step of dt.
    shorter: the matrix of the shorter steps over dt.
    dt: the step [s].
    horizon: the time in which neutral growth counts [s].
    """
    values = eigenvalues(shorter)
    if values is None:
        return growth
    rates = _log(values) / dt
    here = cmath.log(growth.value) / dt
    same = complex(rates[np.abs(rates - here).argmin()])
    own = FASTER * max(same.real, 0.0)
    if abs(cmath.phase(growth.value)) < SLOW_TURN:
        own = max(own, FASTER * float(rates.real.max()))
        if same.real > 0.5 * growth.own.real:
            own = max(own, float(neutral_growth(abs(growth.own), horizon)))
    return replace(growth, excess=min(growth.excess, growth.rate - own))


def _log(values: Any) -> Any:
    """Return the logarithm of eigenvalues; an eigenvalue of zero decays at once."""
    values = values.astype(complex)
    return np.log(np.where(values == 0, 1e-300, values))


def largest_stable(
    stable: Callable[[float], bool], low: float, high: float, fine: float = FINE
) -> float:
    """Return the dt [s] below which all steps are stable; 0 if none is, inf if all are.

    stable: whether a step is stable.
    low, high: the shortest and the longest step to try [s], in a geometric series.
    fine: the relative resolution of the bisection that follows.
    """
    count = max(2, math.ceil(math.log(high / low) / math.log(FACTOR)) + 1)
    below = 0.0
    for dt in np.geomspace(low, high, count):
        if not stable(float(dt)):
            return bisected(stable, below, float(dt), fine) if below else 0.0
        below = float(dt)
    return math.inf


def bisected(stable: Callable[[float], bool], good: float, bad: float, fine: float = FINE) -> float:
    """Return the stable number nearest to `bad`, by bisection.

    stable: whether a number is stable.
    good, bad: a stable and an unstable number.
    fine: the relative resolution.
    """
    while max(good / bad, bad / good) > 1 + fine:
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if stable(middle) else (good, middle)
    return good


def eigenvalues(matrix: Any) -> Any:
    """Return the eigenvalues of a matrix, shape (n,), complex, or None if they are not computable.

    They are not if an entry is not finite, if the iteration overflows, or if it does not converge.
    """
    if matrix is None or not np.isfinite(matrix).all():
        return None
    try:
        with np.errstate(all="ignore"):
            values = np.linalg.eigvals(matrix).astype(complex)
    except np.linalg.LinAlgError:
        return None
    return values if np.isfinite(values).all() else None
