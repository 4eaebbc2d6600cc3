"""The largest stable dt of one element alone: an oscillator x'' = -ω² x - c x' under each rule.

With h the step, s the roots of s² + c s + ω², and c = c_explicit + c_implicit:

    explicit         |1 + h s| ≤ 1
    semi-implicit    ω² h² + 2 c h < 4
    damping implicit ω² h² + 2 (c_explicit - c_implicit) h < 4
    rk4              |1 + z + z²/2 + z³/6 + z⁴/24| ≤ 1, z = h s
    midpoint         always; a row of `solref`, which acts after it: h < 2/c and h < 2c/ω²

The third with c_explicit = 0 and c = 2ζω is h < (2ζ + 2√(ζ² + 1))/ω. The conditions are those of
Jury (1964) for the characteristic polynomial of the step.
"""

from __future__ import annotations

import cmath
import math

from stepcore.engine.linear_maps import amplification
from stepcore.measure.diagnosis.growth import DAMPED, PER_RADIAN, largest_stable


def oscillator(
    omega: float, explicit: float, implicit: float, integrator: str, horizon: float = 1.0
) -> float:
    """The largest stable dt [s]; `explicit` and `implicit`: damping rates c as treated [1/s].

    horizon: what growth counts where nothing damps, as in `gyration` [s].
    """
    explicit, implicit = max(explicit, 0.0), max(implicit, 0.0)
    damping = explicit + implicit
    if integrator == "midpoint" or (omega <= 0 and damping <= 0):
        return math.inf
    if integrator == "explicit":
        if damping <= 2 * DAMPED * omega:
            return gyration(omega, integrator, False, horizon)
        return min(-2 * s.real / abs(s) ** 2 for s in roots(omega, damping) if s != 0)
    if integrator == "rk4":
        return min(_rk4(s) for s in roots(omega, damping) if s != 0)
    if integrator == "semi-implicit":
        explicit, implicit = damping, 0.0
    return _jury(omega, explicit - implicit)


def row_after_midpoint(omega: float, damping: float) -> float:
    """The largest stable dt [s] of a `solref` row under midpoint: v⁺ = v + Δ, q⁺ = q + h(v + Δ/2)
    with Δ = -h(c v + ω² q)."""
    limit = 2 / damping if damping > 0 else math.inf
    return min(limit, 2 * damping / omega**2) if omega > 0 else limit


def gyration(omega: float, integrator: str, implicit: bool, horizon: float) -> float:
    """The largest dt [s] of a first-order motion v' = iωv: a nutation that nothing damps.

    Explicit rules make it grow by ω² dt/2 at every dt: the limit is where that is e-fold in the
    horizon [s], or `growth.PER_RADIAN` of ω.
    """
    if omega <= 0 or integrator == "midpoint" or implicit:
        return math.inf
    if integrator == "rk4":
        return 2 * math.sqrt(2) / omega
    return 2 * min(1 / horizon, PER_RADIAN * max(omega, 1 / horizon)) / omega**2


def roots(omega: float, damping: float) -> tuple[complex, complex]:
    """Those of s² + c s + ω²."""
    root = cmath.sqrt(damping**2 / 4 - omega**2)
    large = -damping / 2 - root
    # The product of both is ω²: no digits are lost to a difference.
    small = omega**2 / large if large != 0 else 0j
    return large, small


def _jury(omega: float, damping: float) -> float:
    """The positive root of ω² h² + 2 c h = 4."""
    if omega <= 0:
        return 2 / damping if damping > 0 else math.inf
    # In the form that loses no digits, for either sign of c.
    root = math.sqrt(damping**2 + 4 * omega**2)
    return 4 / (damping + root) if damping > 0 else (root - damping) / omega**2


def _rk4(s: complex) -> float:
    def stable(h: float) -> bool:
        return bool(abs(amplification("rk4", h * s)) <= 1 + 1e-9)

    return largest_stable(stable, 1e-2 / abs(s), 4 / abs(s))
