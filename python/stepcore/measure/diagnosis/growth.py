"""Growth that the integrator causes, told apart from growth of the motion itself.

An eigenvalue μ of the linearised step grows at the rate Re log(μ)/dt. It belongs to the physical
rate s (an eigenvalue of J, see `linear_step`) that is nearest to log(μ)/dt. The step is stable if
its growth does not exceed what that rate allows:

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
# |log μ| that may be rounding: an error ε moves a double eigenvalue of 1 by √ε.
UNRESOLVED = 1e-4
# |μ| − 1 of any other eigenvalue that may be rounding.
ROUNDING = 1e-9

# An eigenvalue at a smaller angle [rad] may belong to any slow motion.
SLOW_TURN = 0.5

# The search for a limit: ratio of successive trial steps, and relative resolution of the result.
FACTOR, FINE = 1.5, 1e-3


@dataclass(frozen=True)
class StepGrowth:
    """The worst eigenvalue of a step.

    value: μ. rate: its growth [1/s]. excess: the growth above what is allowed [1/s], stable if
    <= 0. own: the rate s of the motion itself that it belongs to [1/s].
    """

    value: complex
    rate: float
    excess: float
    own: complex = 0j

    @property
    def stable(self) -> bool:
        """Whether nothing grows faster than the motion itself allows."""
        return self.excess <= 0


def allowed_growth(rates: Any, horizon: float) -> Floats:
    """The growth [1/s] that a step may show where the motion itself has these rates [1/s]."""
    size = np.abs(rates)
    decaying = rates.real < -DAMPED * size
    growing = FASTER * np.maximum(rates.real, 0)
    return np.where(decaying, 0.0, np.maximum(growing, neutral_growth(size, horizon)))


def neutral_growth(omega: Any, horizon: float) -> Any:
    """The growth [1/s] allowed for a motion of frequency ω [rad/s] that does neither by itself."""
    return np.minimum(1 / horizon, PER_RADIAN * np.maximum(omega, 1 / horizon))


def step_growth(matrix: Floats | None, dt: float, rates: Any, horizon: float) -> StepGrowth:
    """The worst growth of a step's matrix; infinite for None, a step that does not stay finite.

    rates: those of the motion itself [1/s]; None where they are not known.
    """
    values = eigenvalues(matrix)
    if values is None or rates is None:
        return StepGrowth(math.inf, math.inf, math.inf)
    return worst_growth(values, dt, rates, horizon)


def worst_growth(values: Any, dt: float, rates: Any, horizon: float) -> StepGrowth:
    """The eigenvalue of a step that exceeds the allowed growth most.

    values: the eigenvalues of the step of dt [s]; rates: those of the motion itself [1/s].
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
    """The same growth, compared with what the motion does over dt in shorter steps.

    shorter: the matrix of these shorter steps over dt [s]. Growth that an integrator causes falls
    with its step; growth of the motion does not. A physical decay that the shorter steps do not
    show either (the state moves, and its rates with it) is no measure of growth.
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
    """The logarithm of eigenvalues; one of zero decays at once."""
    values = values.astype(complex)
    return np.log(np.where(values == 0, 1e-300, values))


def largest_stable(
    stable: Callable[[float], bool], low: float, high: float, fine: float = FINE
) -> float:
    """The dt [s] below which all steps are stable; 0 where none is, inf where all are.

    stable: whether a step is; asked of steps from `low` to `high`, then by bisection.
    """
    count = max(2, math.ceil(math.log(high / low) / math.log(FACTOR)) + 1)
    below = 0.0
    for dt in np.geomspace(low, high, count):
        if not stable(float(dt)):
            return bisected(stable, below, float(dt), fine) if below else 0.0
        below = float(dt)
    return math.inf


def bisected(stable: Callable[[float], bool], good: float, bad: float, fine: float = FINE) -> float:
    """The number nearest to `bad` that is stable, between one that is and one that is not.

    fine: to this relative resolution.
    """
    while max(good / bad, bad / good) > 1 + fine:
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if stable(middle) else (good, middle)
    return good


def eigenvalues(matrix: Any) -> Any:
    """The eigenvalues of a matrix, shape (n,), complex; None where they cannot be computed.

    That is where an entry is not finite, or the iteration leaves the range of numbers or does not
    converge.
    """
    if matrix is None or not np.isfinite(matrix).all():
        return None
    try:
        with np.errstate(all="ignore"):
            values = np.linalg.eigvals(matrix).astype(complex)
    except np.linalg.LinAlgError:
        return None
    return values if np.isfinite(values).all() else None
