"""Frequency, damping and largest stable dt of each element on its own.

An element on its own is its stiffness on the mass that it moves, with its own damping and with all
damping that the integrator treats implicitly along its direction (under `explicit` all damping):
damping that helps it. Where an element's own damping limits dt, the row of that damper shows it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.element import INERTIAL, ROWS, Element
from stepcore.engine.linear_maps import INTEGRATORS, STIFFNESS_IMPLICIT
from stepcore.measure.diagnosis.control import KIND, control_dt
from stepcore.measure.diagnosis.dt_limits import LONGEST, SHORTEST
from stepcore.measure.diagnosis.linear_motion import LinearMotion
from stepcore.measure.diagnosis.oscillator import (
    nutation_dt,
    oscillator_dt,
    row_dt_under_midpoint,
)
from stepcore.measure.diagnosis.spectrum import eigenvalues

# Of the largest eigenvalue: a smaller one is the rounding of a difference.
NOTHING = 1e-6


@dataclass(frozen=True)
class ElementLimits:
    """One element on its own, at the state at which it is stiffest.

    element: which one it is.
    omega: natural frequency [rad/s], 0 without stiffness.
    ratio: damping ratio with all damping along its direction, nan without stiffness.
    rate: its own damping over the mass that it moves [1/s].
    limits: its largest stable dt by integrator [s], inf beyond `LONGEST`, 0 below `SHORTEST`.
    softened: the dt from which `refsafe` softens it [s], inf if it never does.
    state: the index of the state.
    """

    element: Element
    omega: float
    ratio: float
    rate: float
    limits: dict[str, float]
    softened: float
    state: int

    @property
    def name(self) -> str:
        """The element's name."""
        return self.element.name

    @property
    def stiffness(self) -> float:
        """By what elements are compared: the larger of frequency and damping rate [1/s]."""
        return max(self.omega, self.rate)

    @property
    def acts(self) -> bool:
        """Whether it pulls at all; a spin: whether it limits any integrator."""
        if self.element.kind == "spin":
            return any(math.isfinite(limit) for limit in self.limits.values())
        return self.stiffness > 0


class IsolatedElements:
    """The elements of a linearised motion, each on its own on the mass matrix.

    horizon [s]: see `growth`. state: the index of the state.
    """

    def __init__(self, motion: LinearMotion, horizon: float, state: int) -> None:
        self.motion, self.horizon, self.state = motion, horizon, state
        self.root = np.linalg.inv(np.linalg.cholesky(motion.mass))
        none, elements = np.zeros_like(motion.mass), motion.elements
        self.damping = sum((e.damping for k, e in elements.items() if k != INERTIAL), none)
        self.implicit = {
            name: sum((elements[element].damping for element in treated), none)
            for name, treated in motion.implicit.items()
        }

    def limits(self, element: Element, softened: float) -> ElementLimits:
        """One element; softened: the dt [s] from which `refsafe` softens it."""
        matrices = self.motion.elements[element]
        if element.kind == "spin":
            return self._spin(element, self._per_mass(matrices.damping), softened)
        square, mode = self._stiffest(matrices.stiffness)
        rate, direction = self._stiffest(matrices.damping)
        omega = math.sqrt(square)
        limits = {}
        for name in INTEGRATORS:
            dt = self._limit(name, element, omega, mode) if omega > 0 else math.inf
            if rate > 0:
                dt = min(dt, self._limit(name, element, 0.0, direction))
            # Softened with dt from there on, it limits nothing that it did not limit before.
            limits[name] = _as_tried(dt) if dt <= softened else math.inf
        ratio = float(mode @ self.damping @ mode) / (2 * omega) if omega > 0 else math.nan
        return ElementLimits(element, omega, ratio, rate, limits, softened, self.state)

    def _spin(self, element: Element, turning: Floats, softened: float) -> ElementLimits:
        values = eigenvalues(turning)
        omega = 0.0 if values is None else float(np.abs(values.imag).max(initial=0.0))
        limits = {}
        for name in INTEGRATORS:
            implicit = element in self.motion.implicit.get(name, ())
            dt = nutation_dt(omega, name, implicit, self.horizon)
            limits[name] = _as_tried(dt)
        return ElementLimits(element, omega, 0.0, 0.0, limits, softened, self.state)

    def _limit(self, name: str, element: Element, omega: float, direction: Floats) -> float:
        """The largest stable dt [s] of an oscillation along a direction of unit mass."""

        def along(damping: Floats) -> float:
            return max(float(direction @ damping @ direction), 0.0)

        own = along(self.motion.elements[element].damping)
        if element.kind == KIND:
            hidden = along(self.implicit[name]) if name in self.implicit else 0.0
            return control_dt(omega, own, hidden, name, self.horizon, LONGEST)
        if name == "midpoint" and element.kind in ROWS:
            return row_dt_under_midpoint(omega, own)
        if name == "explicit" and omega > 0:
            # Damping only helps an oscillation here, whichever element it comes from.
            return oscillator_dt(omega, along(self.damping), 0.0, name, self.horizon)
        implicit = along(self.implicit[name]) if name in self.implicit else 0.0
        explicit = 0.0 if element in self.motion.implicit.get(name, ()) else own
        if name in STIFFNESS_IMPLICIT and element in self.motion.held and explicit == 0.0:
            return math.inf
        return oscillator_dt(omega, explicit, implicit, name, self.horizon)

    def _per_mass(self, matrix: Floats) -> Floats:
        """L⁻¹ X L⁻ᵀ, M = L Lᵀ."""
        return self.root @ matrix @ self.root.T

    def _stiffest(self, matrix: Floats) -> tuple[float, Floats]:
        """The largest eigenvalue of M⁻¹X, X made symmetric, and its direction of unit mass."""
        value, vector = _largest(self._per_mass(matrix))
        return value, self.root.T @ vector


def _as_tried(dt: float) -> float:
    """A limit [s] among the steps that are tried: inf beyond the longest, 0 below the shortest."""
    return math.inf if dt > LONGEST else dt if dt >= SHORTEST else 0.0


def _largest(matrix: Floats) -> tuple[float, Floats]:
    """The largest eigenvalue of the symmetric part, and its vector."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    if len(values) == 0:
        return 0.0, np.zeros(0)
    size = float(np.abs(values).max())
    value = float(values[-1])
    return (value if value > NOTHING * size and value > 0 else 0.0), vectors[:, -1]
