"""The figures of one element: frequency, damping ratio, and what dt it allows on its own.

An element alone is its stiffness on the mass that it moves, with its own damping and with all
damping that the integrator treats implicitly along its direction (under `explicit` all damping):
the damping that helps it. What limits dt by its own damping stands in the row of the damper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.measure.diagnosis.dt_limits import LONGEST
from stepcore.measure.diagnosis.element_forces import INERTIAL, ROWS, Key
from stepcore.measure.diagnosis.linear_motion import LinearMotion
from stepcore.measure.diagnosis.oscillator import gyration, oscillator, row_after_midpoint

# Of the largest of its kind: less is the rounding of a difference.
NOTHING = 1e-6


@dataclass(frozen=True)
class ElementLimits:
    """One element at one state.

    omega: natural frequency [rad/s], 0 without stiffness. ratio: damping ratio with all damping
    along its direction, nan without stiffness. rate: own damping over the mass it moves [1/s].
    limits: the largest stable dt alone, by integrator [s], inf beyond `LONGEST`. softened: the dt
    from which `refsafe` softens it [s].
    """

    key: Key
    omega: float
    ratio: float
    rate: float
    limits: dict[str, float]
    softened: float
    state: int

    @property
    def acts(self) -> bool:
        """Whether it pulls at all; a spin: whether it limits any integrator."""
        if self.key.kind == "spin":
            return any(math.isfinite(limit) for limit in self.limits.values())
        return max(self.omega, self.rate) > 0


class IsolatedElements:
    """The figures of a state's elements, each alone on the mass matrix.

    horizon [s]: see `growth`. state: which of the states this is.
    """

    def __init__(self, motion: LinearMotion, horizon: float, state: int) -> None:
        self.parts, self.horizon, self.state = motion, horizon, state
        self.root = np.linalg.inv(np.linalg.cholesky(motion.mass))
        none = np.zeros_like(motion.mass)
        elements = motion.elements
        self.damping = sum((p.damping for k, p in elements.items() if k != INERTIAL), none)
        self.implicit = {
            name: sum((elements[key].damping for key in keys), none)
            for name, keys in motion.implicit.items()
        }

    def figures(self, key: Key, softened: float) -> ElementLimits:
        """Those of one element; `softened`: the dt [s] from which `refsafe` softens it."""
        part = self.parts.elements[key]
        if key.kind == "spin":
            return self._spin(key, self._per_mass(part.damping), softened)
        square, mode = self._stiffest(part.stiffness)
        most, direction = self._stiffest(part.damping)
        omega = math.sqrt(square)
        limits = {}
        for name in INTEGRATORS:
            found = self._limit(name, key, omega, mode) if omega > 0 else math.inf
            if most > 0:
                found = min(found, self._limit(name, key, 0.0, direction))
            # Softened with dt from there on, it limits nothing that it did not limit before.
            limits[name] = found if found <= min(softened, LONGEST) else math.inf
        ratio = float(mode @ self.damping @ mode) / (2 * omega) if omega > 0 else math.nan
        return ElementLimits(key, omega, ratio, most, limits, softened, self.state)

    def _spin(self, key: Key, turning: Floats, softened: float) -> ElementLimits:
        omega = float(np.abs(np.linalg.eigvals(turning).imag).max(initial=0.0))
        limits = {}
        for name in INTEGRATORS:
            hidden = key in self.parts.implicit.get(name, ())
            dt = gyration(omega, name, hidden, self.horizon)
            limits[name] = dt if dt <= LONGEST else math.inf
        return ElementLimits(key, omega, 0.0, 0.0, limits, softened, self.state)

    def _limit(self, name: str, key: Key, omega: float, direction: Floats) -> float:
        """The largest stable dt of an oscillation along a direction of unit mass."""

        def along(damping: Floats) -> float:
            return max(float(direction @ damping @ direction), 0.0)

        own = along(self.parts.elements[key].damping)
        if name == "midpoint" and key.kind in ROWS:
            return row_after_midpoint(omega, own)
        if name == "explicit" and omega > 0:
            # Damping only helps an oscillation here, whoever gives it.
            return oscillator(omega, along(self.damping), 0.0, name, self.horizon)
        hidden = along(self.implicit[name]) if name in self.implicit else 0.0
        shown = 0.0 if key in self.parts.implicit.get(name, ()) else own
        return oscillator(omega, shown, hidden, name, self.horizon)

    def _per_mass(self, matrix: Floats) -> Floats:
        """L⁻¹ X L⁻ᵀ, M = L Lᵀ."""
        return self.root @ matrix @ self.root.T

    def _stiffest(self, matrix: Floats) -> tuple[float, Floats]:
        """The largest eigenvalue of M⁻¹X, X made symmetric, and its direction of unit mass."""
        value, vector = _largest(self._per_mass(matrix))
        return value, self.root.T @ vector


def _largest(matrix: Floats) -> tuple[float, Floats]:
    """The largest eigenvalue of the symmetric part, and its vector."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    if len(values) == 0:
        return 0.0, np.zeros(0)
    size = float(np.abs(values).max())
    value = float(values[-1])
    return (value if value > NOTHING * size and value > 0 else 0.0), vectors[:, -1]
