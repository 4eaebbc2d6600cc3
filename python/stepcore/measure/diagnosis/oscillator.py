"""The largest stable dt of one oscillator, x'' = −ω² x − c x', under each integrator.

With h = dt, s the roots of s² + c s + ω², and c = c_explicit + c_implicit as the integrator treats
the damping, a step is stable where

    explicit                |1 + h s| ≤ 1
    semi-implicit           ω² h² + 2 c h < 4
    euler, implicitfast,
    implicit, discrete      ω² h² + 2 (c_explicit − c_implicit) h < 4, ω² of a stiffness that is not
                            implicit: with ω² and c implicit `discrete` is stable at any h
    rk4                     |1 + z + z²/2 + z³/6 + z⁴/24| ≤ 1, z = h s
    midpoint                always; a row of `solref`, which acts after it: h < 2/c and h < 2c/ω²

The third with c_explicit = 0 and c = 2ζω is h < (2ζ + 2√(ζ² + 1))/ω. The conditions are those of
Jury (1964) for the characteristic polynomial of the maps in `engine.linear_maps`.
"""

from __future__ import annotations

import cmath
import math
from functools import lru_cache

from stepcore.engine.linear_maps import amplification
from stepcore.measure.diagnosis.growth import DAMPED, largest_stable, neutral_growth

# Rates [1/s] beyond this are taken as this, and those below its inverse as none, so that no square
# leaves the range of numbers: limits there are far from any step that could be asked for.
FASTEST = 1e120


def oscillator_dt(
    omega: float, explicit: float, implicit: float, integrator: str, horizon: float = 1.0
) -> float:
    """The largest stable dt [s] of an oscillator; inf where every dt is stable.

    omega: natural frequency ω [rad/s]. explicit, implicit: the damping rates c that the integrator
    treats explicitly and implicitly [1/s]. horizon: see `nutation_dt` [s].
    """
    omega, explicit, implicit = _in_range(omega), _in_range(explicit), _in_range(implicit)
    damping = explicit + implicit
    if integrator == "midpoint" or (omega <= 0 and damping <= 0):
        return math.inf
    if integrator == "explicit":
        if damping <= 2 * DAMPED * omega:
            return nutation_dt(omega, integrator, False, horizon)
        return min(-2 * (s.real / abs(s)) / abs(s) for s in _roots(omega, damping))
    if integrator == "rk4":
        return min(_rk4(s) for s in _roots(omega, damping))
    if integrator == "semi-implicit":
        explicit, implicit = damping, 0.0
    return _jury(omega, explicit - implicit)


def row_dt_under_midpoint(omega: float, damping: float) -> float:
    """The largest stable dt [s] of a `solref` row under midpoint.

    The row acts after the implicit step: v⁺ = v + Δ, q⁺ = q + h (v + Δ/2), Δ = −h (c v + ω² q).
    """
    omega, damping = _in_range(omega), _in_range(damping)
    limit = 2 / damping if damping > 0 else math.inf
    return min(limit, 2 * damping / omega**2) if omega > 0 else limit


def nutation_dt(omega: float, integrator: str, implicit: bool, horizon: float) -> float:
    """The largest dt [s] of an undamped first-order motion v' = iωv, such as a nutation.

    Explicit integrators make it grow by ω² dt/2 at every dt. The limit is the dt at which this
    reaches the growth that `growth.neutral_growth` allows in the horizon [s].
    """
    omega = _in_range(omega)
    if omega <= 0 or integrator == "midpoint" or implicit:
        return math.inf
    if integrator == "rk4":
        return 2 * math.sqrt(2) / omega
    return 2 * float(neutral_growth(omega, horizon)) / omega**2


def _roots(omega: float, damping: float) -> tuple[complex, ...]:
    """The roots of s² + c s + ω² that are not zero."""
    root = cmath.sqrt(damping**2 / 4 - omega**2)
    large = -damping / 2 - root
    # The product of both is ω²: no digits are lost in a difference.
    small = omega * (omega / large) if large != 0 else 0j
    return tuple(s for s in (large, small) if abs(s) > 1 / FASTEST)


def _jury(omega: float, damping: float) -> float:
    """The positive root of ω² h² + 2 c h = 4."""
    if omega <= 0:
        return 2 / damping if damping > 0 else math.inf
    # The form that loses no digits, for either sign of c.
    root = math.sqrt(damping**2 + 4 * omega**2)
    return 4 / (damping + root) if damping > 0 else (root - damping) / omega**2


def _rk4(s: complex) -> float:
    size = abs(s)
    return _rk4_along(s / size) / size


@lru_cache(maxsize=256)
def _rk4_along(way: complex) -> float:
    """The limit of a rate of length 1; joints of one kind, and all without ω, share theirs."""

    def stable(h: float) -> bool:
        return bool(abs(amplification("rk4", h * way)) <= 1 + 1e-9)

    return largest_stable(stable, 1e-2, 4.0)


def _in_range(rate: float) -> float:
    """A rate [1/s] whose square is a number; 0 for one below 0, and for nan."""
    return min(rate, FASTEST) if rate > 1 / FASTEST else 0.0
