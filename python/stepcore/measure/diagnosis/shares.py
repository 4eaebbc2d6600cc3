"""Which elements limit dt: their shares in the mode that sets the limit, and what softening does.

The share of an element is the derivative of log |μ| by its gain, as a part of the sum over all
elements that push the eigenvalue μ outwards. A share tells what a small change would do. An element
with the largest share may be held in the mode by another one, and be good for a longer step alone;
softened by a lot, it changes little. Equal elements in a row hold each other: none of them limits
dt by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.element import INERTIAL, Element
from stepcore.measure.diagnosis.control import folded, steps_held
from stepcore.measure.diagnosis.growth import bisected, eigenvalues, step_growth
from stepcore.measure.diagnosis.limits import Limit, StepStability
from stepcore.measure.diagnosis.linear_motion import LinearMotion
from stepcore.measure.diagnosis.linear_step import State, step_map

# Past the limit an eigenvalue has left its partner: there it shows what drives it.
BEYOND = 1.05
# Relative change of an element's gain for the derivative of an eigenvalue.
NUDGE = 1e-4
# Eigenvalues that are equal, as part of their distance from 1; points of the contour around them.
EQUAL, CONTOUR = 1e-2, 16
# The most steps of a control period that is made of the elements.
HOLD = 64

# A step that multiplies by more has left the range in which derivatives mean anything.
FARTHEST = 1e12

Shares = dict[Element, float]


def limiting_shares(here: StepStability, limit: Limit) -> Shares:
    """Each element's share in the eigenvalue that sets a limit, or else in the fastest rate.

    Nothing where the numbers of the step leave their range.
    """
    try:
        with np.errstate(all="ignore"):
            return _limiting_shares(here, limit)
    except (np.linalg.LinAlgError, ArithmeticError):
        return {}


def _limiting_shares(here: StepStability, limit: Limit) -> Shares:
    if math.isinf(limit.dt):
        every = range(len(here.rates))
        return _fastest(here, max(every, key=lambda k: abs(here.rates[k]).max(initial=0.0)))
    dt = (limit.dt or limit.shortest) * BEYOND
    state, worst = here.growth_where_seen(limit.integrator, dt, limit.state)
    motion = here.motion(state, dt)
    if motion is None:
        return _fastest(here, limit.state)
    held = _held_shares(here, limit, state, motion, dt)
    if held is not None:
        return held
    # The step made of the elements, where it grows too: what it leaves out belongs to no element.
    made = motion.step(limit.integrator, dt)
    if not np.abs(made).max() < FARTHEST:
        # So long a step leaves the range in which shares have a meaning.
        return _fastest(here, limit.state) if limit.dt > 0 else {}
    growth = step_growth(made, dt, eigenvalues(motion.rates), here.horizon)
    if not growth.stable:
        return step_shares(motion, limit.integrator, dt, made, growth.value)
    if math.isinf(worst.rate):
        # A step that does not stay finite, or an iteration that does not converge.
        return _fastest(here, limit.state)
    matrix = step_map(here.model_at(state), state, limit.integrator, dt)
    if matrix is None:
        return _fastest(here, limit.state)
    return step_shares(motion, limit.integrator, dt, matrix, worst.value)


def _held_shares(
    here: StepStability, limit: Limit, state: State, motion: LinearMotion, dt: float
) -> Shares | None:
    """The shares over a control period of several steps; None where that does not grow."""
    count, step = steps_held(state, dt)
    if count == 1 or motion.feedback is None:
        return None
    # Shares need no more steps than this.
    hold, step = (count, step) if count <= HOLD else (HOLD, count * step / HOLD)
    span = hold * step
    with np.errstate(over="ignore", invalid="ignore"):
        made = motion.step(limit.integrator, step, hold=hold)
    if not np.isfinite(made).all():
        return None
    rates = eigenvalues(motion.rates)
    if rates is None:
        return None
    growth = step_growth(made, span, folded(rates, span), here.horizon)
    if growth.stable:
        return None

    return _shares(
        motion, made, growth.value, lambda m, of: m.step(limit.integrator, step, of, hold)
    )


def step_shares(
    motion: LinearMotion, integrator: str, dt: float, matrix: Floats, value: complex
) -> Shares:
    """Each element's share in the growth of an eigenvalue `value` of a step's `matrix`.

    Nothing where the numbers of the step leave their range.
    """
    try:
        with np.errstate(all="ignore"):
            return _shares(motion, matrix, value, lambda m, of: m.step(integrator, dt, of))
    except (np.linalg.LinAlgError, ArithmeticError):
        return {}


def growing_shares(motion: LinearMotion) -> Shares:
    """Each element's share in the fastest growth of the motion itself; nothing where none grows."""
    values = eigenvalues(motion.rates)
    if values is None or not values.real.max(initial=0.0) > 0:
        return {}
    try:
        with np.errstate(all="ignore"):
            value = values[values.real.argmax()]
            return _shares(motion, motion.rates, value, lambda m, of: m.rates @ of)
    except (np.linalg.LinAlgError, ArithmeticError):
        return {}


def _fastest(here: StepStability, state: int) -> Shares:
    """Each element's share in the fastest rate of the motion at a state."""
    motion = here.motion(here.states[state])
    if motion is None:
        return {}
    values = eigenvalues(motion.rates)
    if values is None:
        return {}
    value = values[np.abs(values).argmax()]
    return _shares(motion, motion.rates, value, lambda m, of: m.rates @ of)


def _shares(
    motion: LinearMotion,
    matrix: Floats,
    value: complex,
    times: Callable[[LinearMotion, Any], Any],
) -> Shares:
    """The derivatives of log |value| by each element's gain, as parts of their sum.

    times: the matrix of a motion times a block.
    Several equal eigenvalues count by their mean. Elements that hold the value back have share 0.
    """
    values = eigenvalues(matrix)
    if values is None or not np.any(values):
        return dict.fromkeys(motion.elements, 0.0)
    mean, projector = _cluster(matrix, values, value)
    # Of low rank: trace(P dA) = trace(left dA right) with P = right left.
    right, sizes, left = np.linalg.svd(projector)
    rank = int(np.sum(sizes > 1e-9 * sizes[0]))
    right, left = right[:, :rank] * sizes[:rank], left[:rank]
    slopes: Shares = {}
    for element in motion.elements:
        more, less = (motion.scaled((element,), 1 + by) for by in (NUDGE, -NUDGE))
        change = times(more, right) - times(less, right)
        slopes[element] = max(0.0, float((np.sum(left.T * change) / mean).real))
    whole = sum(slopes.values())
    return {element: slope / whole if whole > 0 else 0.0 for element, slope in slopes.items()}


def _cluster(matrix: Floats, values: Any, value: complex) -> tuple[complex, Any]:
    """The sum of the eigenvalues equal to `value`, and the projector P onto their eigenvectors.

    A change dA moves their mean by trace(P dA) / trace P, also where eigenvectors do not tell the
    values apart (the nutation of a thin plate is as fast as its spin). P is the mean of
    (z − A)⁻¹ (z − c) around a circle that holds these values and no other.
    """
    centre = values[np.abs(values - value).argmin()]
    apart = np.sort(np.abs(values - centre))
    near = max(EQUAL * min(1.0, abs(centre - 1)), 1e-12)
    count = int(np.sum(apart <= near))
    centre = values[np.abs(values - centre) <= near].mean()
    others = apart[count] if count < len(apart) else 1.0
    radius = math.sqrt(max(apart[count - 1], others / 100) * others)
    around = radius * np.exp(2j * np.pi * (np.arange(CONTOUR) + 0.5) / CONTOUR)
    one = np.eye(len(matrix))
    projector = sum(z * np.linalg.inv((centre + z) * one - matrix) for z in around) / CONTOUR
    return complex(centre or 1.0) * count, projector


# The least share of an element that is softened by itself, the most of them, and the least share
# of one that is named with others.
PARTAKES, MOST, HELD = 0.02, 12, 1e-6
# What is left of the stiffness and damping of a softened element.
SOFTENED = 0.1
# By how much the limit is looked at, as a factor, and its relative resolution.
MOST_RISE, RISE_FINE = 4.0, 0.05
# One element limits dt if the limit rises by this factor without it; if it does not, equal
# elements do together, whose gains differ by no more than the second factor.
ALONE, ALIKE = 1.4, 1.25


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
    together = len(group) > 1 and rise.without(group) > ALIKE * rises[best]
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
        """The limit with some elements softened, over the limit with them; at most `MOST_RISE`."""
        stable = self._softened(elements)
        if stable(MOST_RISE * self.dt):
            return MOST_RISE
        return bisected(lambda rise: stable(rise * self.dt), 1.0, MOST_RISE, RISE_FINE)

    def _softened(self, elements: Sequence[Element]) -> Callable[[float], bool]:
        """The test of a step with some elements softened, whose own rates are found once."""
        motion = self.motion.scaled(elements, SOFTENED)
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
    return all(max(a, b) <= ALIKE * min(a, b) for a, b in pairs)


def _gains(motion: LinearMotion, element: Element) -> tuple[float, float]:
    """The size of an element's stiffness and damping, whatever mass it acts on."""
    matrices = motion.elements[element]
    return _size(matrices.stiffness), _size(matrices.damping)


def _size(matrix: Floats) -> float:
    return float(np.linalg.norm(matrix))
