"""Ways to change a solref so that a larger dt is stable.

A solref of the standard form, (tc, ζ), has the stiffness 1/(tc ζ)² and the damping 2/tc of the
direct form (−k, −b), both per inertia and for an impedance of 1. Sources: MuJoCo's documentation,
"Solver parameters", and docs/method.md.
"""

from __future__ import annotations

import math

from stepcore.measure.diagnosis.new_value import ratio, rounded
from stepcore.scene.frames import Vec

# What a change is called: a slower or faster response, more or less damping, and the standard form
# in place of the direct one.
SOLREF, ROW_DAMPING, STANDARD = "solref", "damping of solref", "standard form of solref"


def new_solref(what: str, old: Vec, x: float, softest: float) -> Vec | None:
    """The solref after a change by x; None where there is no such change.

    softest: the time constant [s] below which `refsafe` would soften a row without a word, at the
    step that is to be stable; 0 without it.
    """
    direct, up = old[0] <= 0, x > 1
    if what == SOLREF:
        if not direct:
            return rounded(old[0] / x, up=not up), old[1]
        return -rounded(-old[0] * x * x, up=up), -rounded(-old[1] * x, up=up)
    if what == ROW_DAMPING:
        if old[1] == 0:
            return None
        changed = math.copysign(rounded(abs(old[1]) * x, up=up), old[1])
        return old[0], changed
    if not direct or x > 1 or old[0] == 0:
        return None
    # Critically damped, at x = 1 of the same stiffness, or of the same damping if that is faster.
    fastest = min(1 / math.sqrt(-old[0]), 2 / -old[1] if old[1] < 0 else math.inf)
    constant = max(fastest / x, softest)
    return rounded(constant, up=True), 1.0


def size_of(old: Vec, new: Vec) -> float:
    """|log| of the factor by which stiffness or damping changes, the larger of both."""
    (k, b), (stiffness, damping) = _direct(old), _direct(new)
    return max(ratio(k, stiffness), ratio(b, damping))


def _direct(solref: Vec) -> tuple[float, float]:
    """Stiffness [1/s²] and damping [1/s] per inertia."""
    first, second = solref[0], solref[1]
    if first <= 0:
        return -first, -second
    # Divided in turn: no square leaves its range.
    return 1 / first / first / second / second, 2 / first
