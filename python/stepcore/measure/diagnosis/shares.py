"""The elements' shares in the mode that sets a limit: which element it is, and by how much.

The share of an element is the derivative of log |μ| by its gain, as a part of the sum over all
elements that push the eigenvalue μ outwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.element import Element
from stepcore.measure.diagnosis.control import folded, steps_held
from stepcore.measure.diagnosis.dt_limits import Limit
from stepcore.measure.diagnosis.growth import step_growth
from stepcore.measure.diagnosis.linear_motion import LinearMotion
from stepcore.measure.diagnosis.linear_step import State, step_map
from stepcore.measure.diagnosis.spectrum import eigenvalues
from stepcore.measure.diagnosis.step_stability import StepStability

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

    def changed(element: Element, by: float, block: Any) -> Any:
        return motion.step(limit.integrator, step, element, by, block, hold)

    return _shares(motion, made, growth.value, changed)


def step_shares(
    motion: LinearMotion, integrator: str, dt: float, matrix: Floats, value: complex
) -> Shares:
    """Each element's share in the growth of an eigenvalue `value` of a step's `matrix`.

    Nothing where the numbers of the step leave their range.
    """
    try:
        with np.errstate(all="ignore"):
            return _shares(motion, matrix, value, lambda *at: motion.step(integrator, dt, *at))
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
            return _shares(motion, motion.rates, value, motion.rates_times)
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
    return _shares(motion, motion.rates, values[np.abs(values).argmax()], motion.rates_times)


def _shares(
    motion: LinearMotion,
    matrix: Floats,
    value: complex,
    changed: Callable[[Element, float, Any], Any],
) -> Shares:
    """The derivatives of log |value| by each element's gain, as parts of their sum.

    changed: the matrix times a block, with an element's gain multiplied by 1 + the number given.
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
        change = changed(element, NUDGE, right) - changed(element, -NUDGE, right)
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
