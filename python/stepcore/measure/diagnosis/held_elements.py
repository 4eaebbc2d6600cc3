"""Say why an element that would limit dt on its own does not in the scene: what holds it there."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from stepcore.engine.element import INERTIAL, Element
from stepcore.measure.diagnosis.growth import eigenvalues, step_growth
from stepcore.measure.diagnosis.isolated import ElementLimits
from stepcore.measure.diagnosis.limits import Limit, StepStability
from stepcore.measure.diagnosis.linear_motion import LinearMotion
from stepcore.report.units import seconds

# The least ratio of both limits that is told; a tried step over the limit that it must lie below;
# and the most elements that are told of, and that are tried as what holds one.
NOTABLE, BELOW, MOST, TRIED = 1.1, 0.97, 3, 12


def held(here: StepStability, rows: Sequence[ElementLimits], limit: Limit) -> Iterator[str]:
    """Yield a note for elements whose limit on their own is below the limit of all together.

    rows: the elements on their own.
    limit: the limit of all elements.
    """
    own = limit.integrator
    least = min(limit.dt, limit.longest)
    lower = [row for row in rows if 0 < NOTABLE * row.limits[own] < least]
    for row in sorted(lower, key=lambda row: row.limits[own])[:MOST]:
        alone = f"{row.name} alone would limit dt to {seconds(row.limits[own])}"
        yield f"{alone}; {_why(here, row, least, own)}"


def _why(here: StepStability, row: ElementLimits, least: float, integrator: str) -> str:
    alone, softened = row.limits[integrator], row.softened
    if softened < NOTABLE * alone:
        return "above, refsafe softens it"
    dt = BELOW * min(least, softened)
    motion = here.motion(here.states[row.state], dt)
    if motion is None or row.element not in motion.elements:
        return "in the scene, other elements hold it"
    held_by = _holder(motion, row.element, integrator, dt, here.horizon)
    if held_by is None:
        return "in the scene, the other elements together hold it"
    return f"in the scene, {held_by.name} {'hold' if held_by == INERTIAL else 'holds'} it"


def _holder(
    motion: LinearMotion, element: Element, integrator: str, dt: float, horizon: float
) -> Element | None:
    """Return the element that alone makes a step stable beside another one, or None."""
    others = [other for other in motion.elements if other != element]

    def stable(beside: Collection[Element]) -> bool:
        with np.errstate(all="ignore"):
            left = motion.scaled([other for other in others if other not in beside], 0.0)
            made = left.step(integrator, dt)
            if not np.isfinite(made).all():
                return False
            return step_growth(made, dt, eigenvalues(left.rates), horizon).stable

    def size(other: Element) -> float:
        slopes = motion.elements[other]
        return float(np.linalg.norm(slopes.damping) + dt * np.linalg.norm(slopes.stiffness))

    strongest = sorted(others, key=size, reverse=True)[:TRIED]
    return next((other for other in strongest if stable([other])), None)
