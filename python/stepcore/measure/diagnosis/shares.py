"""Find the elements that limit dt, from their shares in the limiting mode and by softening each.

The share of an element is the derivative of log |μ| by its gain, as a fraction of the sum over all
elements that push the eigenvalue μ outwards. A share shows the effect of a small change. An element
with the largest share may be held in the mode by another element and permit a longer step alone; a
large change then has little effect. Equal elements in a chain hold each other, so that no single
one limits dt.
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

# Beyond the limit an eigenvalue has separated from its partner and shows its own causes.
BEYOND = 1.05
# Relative change of an element's gain for the derivative of an eigenvalue.
NUDGE = 1e-4
# The distance of eigenvalues that count as equal, over their distance from 1; and the number of
# points on the contour around them.
EQUAL, CONTOUR = 1e-2, 16
# The most steps of a control period that is composed of the elements.
HOLD = 64

# Entries beyond this size make derivatives meaningless.
FARTHEST = 1e12

Shares = dict[Element, float]


def limiting_shares(here: StepStability, limit: Limit) -> Shares:
    """Return each element's share in the eigenvalue that sets a limit, or else in the fastest rate.

    The result is {} if the numbers of the step overflow.
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
    # The step composed of the elements, if it grows too. The remainder belongs to no element.
    made = motion.step(limit.integrator, dt)
    if not np.abs(made).max() < FARTHEST:
        # Shares have no meaning at such a long step.
        return _fastest(here, limit.state) if limit.dt > 0 else {}
    growth = step_growth(made, dt, eigenvalues(motion.rates), here.horizon)
    if not growth.stable:
        return step_shares(motion, limit.integrator, dt, made, growth.value)
    if math.isinf(worst.rate):
        # The step does not stay finite, or its iteration does not converge.
        return _fastest(here, limit.state)
    matrix = step_map(here.model_at(state), state, limit.integrator, dt)
    if matrix is None:
        return _fastest(here, limit.state)
    return step_shares(motion, limit.integrator, dt, matrix, worst.value)


def _held_shares(
    here: StepStability, limit: Limit, state: State, motion: LinearMotion, dt: float
) -> Shares | None:
    """Return the shares over a control period of several steps, or None without growth."""
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
    """Return each element's share in the growth of one eigenvalue of a step.

    The result is {} if the numbers of the step overflow.

    motion: the linearised motion.
    integrator, dt: the integrator and its step [s].
    matrix: the matrix of the step.
    value: the eigenvalue.
    """
    try:
        with np.errstate(all="ignore"):
            return _shares(motion, matrix, value, lambda m, of: m.step(integrator, dt, of))
    except (np.linalg.LinAlgError, ArithmeticError):
        return {}


def growing_shares(motion: LinearMotion) -> Shares:
    """Return each element's share in the fastest growth of the motion itself; {} without growth."""
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
    """Return each element's share in the fastest rate of the motion at a state."""
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
    """Return the derivatives of log |value| by each element's gain, as fractions of their sum.

    Equal eigenvalues count by their mean. Elements that reduce |value| have share 0.

    motion: the linearised motion.
    matrix: the matrix with the eigenvalue.
    value: the eigenvalue.
    times: a function that multiplies the matrix of a motion by a block.
    """
    values = eigenvalues(matrix)
    if values is None or not np.any(values):
        return dict.fromkeys(motion.elements, 0.0)
    mean, projector = _cluster(matrix, values, value)
    # P has low rank: trace(P dA) = trace(left dA right) with P = right left.
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
    """Return the sum of the eigenvalues equal to `value`, and the projector P.

    P projects onto their eigenvectors. A change dA moves their mean by trace(P dA) / trace P, even
    if eigenvectors do not separate the values (the nutation of a thin plate is as fast as its
    spin). P is the mean of (z − A)⁻¹ (z − c) around a circle that encloses these values and no
    other.
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


# The least share of an element that is softened alone, the most of these elements, and the least
# share of an element that is named in a group.
PARTAKES, MOST, HELD = 0.02, 12, 1e-6
# The remaining fraction of the stiffness and damping of a softened element. A limit in proportion
# to damping over stiffness does not move so (explicit integrators with little damping, controls
# with a delay): there the element is left out.
SOFTENED = 0.1
# The largest rise of the limit that is tested, as a factor, and its relative resolution.
MOST_RISE, RISE_FINE = 4.0, 0.05
# An element limits dt alone if softening it raises the limit by the first factor. If not, a group
# of equal elements does, whose gains differ by no more than the second factor.
ALONE, ALIKE = 1.4, 1.25
# The least rise of the limit by which softening moves it at all; the search resolves half of this.
MOVES = 1.1


def limiters(here: StepStability, limit: Limit, shares: Shares) -> tuple[Element, ...]:
    """Return the elements that limit dt: several if no single one does, () if none moves it."""
    by_share = sorted(shares, key=lambda element: -shares[element])
    partaking = [element for element in by_share if shares[element] >= PARTAKES][:MOST]
    if not partaking:
        return ()
    first = (partaking[0],)
    if limit.state < 0 or limit.outcome or not limit.dt < limit.longest:
        # Nothing limits dt, or the motion itself does, and no linearised step shows that.
        return first
    dt = (limit.dt or limit.shortest) * BEYOND
    # The state at which the shares were found: rows that begin to act within the step act there.
    state, _ = here.growth_where_seen(limit.integrator, dt, limit.state)
    motion = here.motion(state, dt)
    if motion is None or not set(partaking) <= motion.elements.keys():
        return first
    if motion.feedback is not None and steps_held(state, dt)[0] > 1:
        # Over several held steps, shares alone separate a control from the other elements.
        return first
    by_share = [element for element in by_share if element in motion.elements]
    try:
        # Where softening moves nothing, leaving an element out may.
        for part in (SOFTENED, 0.0):
            rise = _Rise(motion, limit.integrator, dt, here.horizon, part)
            if rise.stable((), dt):
                # The composed step does not show the growth of the real one.
                return first
            found = _effective(rise, partaking, by_share, shares)
            found = found or _first_of_modes(rise, partaking[0])
            if found:
                return found
        return ()
    except np.linalg.LinAlgError:
        return first


def _effective(
    rise: _Rise, partaking: list[Element], by_share: list[Element], shares: Shares
) -> tuple[Element, ...]:
    """Return the element that raises the limit most, in a group with its equals if necessary."""
    rises = {element: rise.without((element,)) for element in partaking}
    best = max(partaking, key=lambda element: (rises[element], shares[element]))
    if rises[best] >= ALONE:
        return (best,)
    group = sorted(e for e in by_share if shares[e] > HELD and _equal(rise.motion, e, best))
    together = len(group) > 1 and rise.without(group) > ALIKE * rises[best]
    if together:
        return tuple(group)
    if rises[best] >= MOVES:
        return (best,)
    # No single element moves the limit: the fewest with the largest shares that do so together.
    for count in range(2, len(partaking) + 1):
        if rise.without(partaking[:count]) >= MOVES:
            return tuple(partaking[:count])
    return ()


def _first_of_modes(rise: _Rise, first: Element) -> tuple[Element, ...]:
    """Return the first element of a group that moves the limit, if several modes set it.

    Each element leads the mode that limits dt once those before it are softened. The element that
    is named is the first without which the others do not move the limit: what has a share, and
    changes nothing, is passed over.

    first: the element with the largest share in the limiting mode.
    """
    group = [first]
    while rise.without(group) < MOVES:
        shares = {e: share for e, share in rise.shares(group).items() if e not in group}
        following = max(shares, key=lambda element: shares[element], default=None)
        if following is None or shares[following] < PARTAKES or len(group) == MOST:
            return ()
        group.append(following)
    for element in group:
        others = [other for other in group if other != element]
        if rise.without(others) < MOVES:
            return (element,)
        group = others
    return ()


class _Rise:
    """The rise of the limit of a motion's step when elements are softened.

    motion: the linearised motion.
    integrator: the integrator.
    dt: a step just beyond the limit [s].
    horizon: see `growth` [s].
    part: the remaining fraction of the stiffness and damping of a softened element.
    """

    def __init__(
        self, motion: LinearMotion, integrator: str, dt: float, horizon: float, part: float
    ) -> None:
        self.motion, self.integrator, self.dt, self.horizon = motion, integrator, dt, horizon
        self.part = part

    def stable(self, elements: Sequence[Element], dt: float) -> bool:
        """Return whether a step of dt [s] is stable with some elements softened."""
        return self._softened(elements)(dt)

    def without(self, elements: Sequence[Element]) -> float:
        """Return the factor by which softening elements raises the limit, at most `MOST_RISE`."""
        stable = self._softened(elements)
        if stable(MOST_RISE * self.dt):
            return MOST_RISE
        return bisected(lambda rise: stable(rise * self.dt), 1.0, MOST_RISE, RISE_FINE)

    def shares(self, elements: Sequence[Element]) -> Shares:
        """Return the shares in what grows a little further beyond dt with some softened."""
        motion, dt = self.motion.scaled(elements, self.part), MOVES * self.dt
        with np.errstate(all="ignore"):
            made = motion.step(self.integrator, dt)
            if not np.abs(made).max() < FARTHEST:
                return {}
            growth = step_growth(made, dt, eigenvalues(motion.rates), self.horizon)
        return step_shares(motion, self.integrator, dt, made, growth.value)

    def _softened(self, elements: Sequence[Element]) -> Callable[[float], bool]:
        """Return the stability test of a step with some elements softened."""
        motion = self.motion.scaled(elements, self.part)
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
    """Return whether two elements are of one kind and have nearly equal gains."""
    if element.kind != other.kind or INERTIAL in (element, other):
        return False
    pairs = zip(_gains(motion, element), _gains(motion, other), strict=True)
    return all(max(a, b) <= ALIKE * min(a, b) for a, b in pairs)


def _gains(motion: LinearMotion, element: Element) -> tuple[float, float]:
    """Return the norms of an element's stiffness and damping, independent of the mass."""
    matrices = motion.elements[element]
    return _size(matrices.stiffness), _size(matrices.damping)


def _size(matrix: Floats) -> float:
    return float(np.linalg.norm(matrix))
