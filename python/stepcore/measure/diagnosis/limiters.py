"""Which elements limit dt: those that share the mode and whose softening raises the limit most.

A share is a derivative: it tells what a small change would do. An element with the largest share
may be held in the mode by another one, and be good for a longer step alone; softened by a lot, it
changes little. Equal elements in a row hold each other: none of them limits dt by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.element import INERTIAL, Element
from stepcore.measure.diagnosis.control import steps_held
from stepcore.measure.diagnosis.dt_limits import Limit
from stepcore.measure.diagnosis.growth import step_growth
from stepcore.measure.diagnosis.linear_motion import LinearMotion
from stepcore.measure.diagnosis.shares import BEYOND, Shares
from stepcore.measure.diagnosis.spectrum import eigenvalues
from stepcore.measure.diagnosis.step_stability import StepStability

# The least share of an element that is softened by itself, the most of them, and the least share
# of one that is named with others.
PARTAKES, MOST, HELD = 0.02, 12, 1e-6
# What is left of the stiffness and damping of a softened element.
SOFTENED = 0.1
# By how much the limit is looked at, as a factor, and its relative resolution.
FARTHEST, FINE = 4.0, 1.05
# One element limits dt if the limit rises by this factor without it; if it does not, equal
# elements do together, whose gains differ by no more than the second factor.
ALONE, EQUAL = 1.4, 1.25


def limiters(here: StepStability, limit: Limit, shares: Shares) -> tuple[Element, ...]:
    """The elements that limit dt, several where none does by itself; () where none has a share."""
    by_share = sorted(shares, key=lambda element: -shares[element])
    partaking = [element for element in by_share if shares[element] >= PARTAKES][:MOST]
    if not partaking:
        return ()
    first = (partaking[0],)
    if limit.state < 0 or limit.outcome or not limit.dt < limit.longest:
        # Nothing limits dt, or the motion itself does: no linearised step shows it.
        return first
    dt = (limit.dt or limit.shortest) * BEYOND
    # Where the shares were found: rows that begin to act within the step are looked at there.
    state, _ = here.growth_where_seen(limit.integrator, dt, limit.state)
    motion = here.motion(state, dt)
    if motion is None or not set(partaking) <= motion.elements.keys():
        return first
    if motion.feedback is not None and steps_held(state, dt)[0] > 1:
        # Held over several steps, a control is told from the others by its share alone.
        return first
    by_share = [element for element in by_share if element in motion.elements]
    rise = _Rise(motion, limit.integrator, dt, here.horizon)
    try:
        # Unless the composed step does not show what the real one does.
        return first if rise.stable((), dt) else _effective(rise, partaking, by_share, shares)
    except np.linalg.LinAlgError:
        return first


def _effective(
    rise: _Rise, partaking: list[Element], by_share: list[Element], shares: Shares
) -> tuple[Element, ...]:
    """The element that raises the limit most, or with its equals if it does not by itself."""
    rises = {element: rise.without((element,)) for element in partaking}
    best = max(partaking, key=lambda element: (rises[element], shares[element]))
    if rises[best] >= ALONE:
        return (best,)
    group = sorted(e for e in by_share if shares[e] > HELD and _equal(rise.motion, e, best))
    together = len(group) > 1 and rise.without(group) > EQUAL * rises[best]
    return tuple(group) if together else (best,)


class _Rise:
    """By how much the limit of a motion's step rises when elements are softened.

    dt [s]: a step just beyond the limit. horizon [s]: see `growth`.
    """

    def __init__(self, motion: LinearMotion, integrator: str, dt: float, horizon: float) -> None:
        self.motion, self.integrator, self.dt, self.horizon = motion, integrator, dt, horizon

    def stable(self, elements: Sequence[Element], dt: float) -> bool:
        """Whether a step of dt [s] is stable with some elements softened."""
        return self._softened(elements)(dt)

    def without(self, elements: Sequence[Element]) -> float:
        """The limit with some elements softened, over the limit with them; at most `FARTHEST`."""
        stable = self._softened(elements)
        low, high = 1.0, FARTHEST
        if stable(high * self.dt):
            return high
        while high / low > FINE:
            middle = (low * high) ** 0.5
            low, high = (middle, high) if stable(middle * self.dt) else (low, middle)
        return low

    def _softened(self, elements: Sequence[Element]) -> Callable[[float], bool]:
        """The test of a step with some elements softened, whose own rates are found once."""
        motion = self.motion.softened(elements, SOFTENED)
        with np.errstate(all="ignore"):
            rates = eigenvalues(motion.rates)

        def stable(dt: float) -> bool:
            with np.errstate(all="ignore"):
                made = motion.step(self.integrator, dt)
                if not np.all(np.isfinite(made)):
                    return False
                return step_growth(made, dt, rates, self.horizon).stable

        return stable


def _equal(motion: LinearMotion, element: Element, other: Element) -> bool:
    """Whether two elements are of a kind, and of nearly the same gains."""
    if element.kind != other.kind or INERTIAL in (element, other):
        return False
    pairs = zip(_gains(motion, element), _gains(motion, other), strict=True)
    return all(max(a, b) <= EQUAL * min(a, b) for a, b in pairs)


def _gains(motion: LinearMotion, element: Element) -> tuple[float, float]:
    """The size of an element's stiffness and damping, whatever mass it acts on."""
    matrices = motion.elements[element]
    return _size(matrices.stiffness), _size(matrices.damping)


def _size(matrix: Floats) -> float:
    return float(np.linalg.norm(matrix))
