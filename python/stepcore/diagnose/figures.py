"""The figures of one element: frequency, damping ratio, and what dt it allows on its own.

An element alone is its stiffness on the mass that it moves, with its own damping and with all
damping that the integrator treats implicitly along its direction (under `explicit` all damping):
the damping that helps it. What limits dt by its own damping stands in the row of the damper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stepcore.arrays import Floats
from stepcore.diagnose.alone import INTEGRATORS, gyration, oscillator, row_after_midpoint
from stepcore.diagnose.forces import Key
from stepcore.diagnose.limits import LONGEST
from stepcore.diagnose.parts import Parts

ROWS = ("contact", "limit", "connect", "friction loss")
# Of the largest of its kind: less is the rounding of a difference.
NOTHING = 1e-6


@dataclass(frozen=True)
class Figures:
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


def figures(key: Key, all_parts: Parts, softened: float, horizon: float, state: int) -> Figures:
    """The figures of an element; see the module."""
    root = np.linalg.cholesky(all_parts.mass)

    def scaled(matrix: Floats) -> Floats:
        """L⁻¹ X L⁻ᵀ, M = L Lᵀ: per mass."""
        half = np.linalg.solve(root, matrix)
        return np.linalg.solve(root, half.T).T

    part = all_parts.elements[key]
    if key.kind == "spin":
        turning = scaled(part.damping)
        omega = float(np.abs(np.linalg.eigvals(turning).imag).max(initial=0.0))
        limits = {
            name: gyration(omega, name, key in all_parts.implicit.get(name, ()), horizon)
            for name in INTEGRATORS
        }
        limits = {name: dt if dt <= LONGEST else math.inf for name, dt in limits.items()}
        return Figures(key, omega, 0.0, 0.0, limits, softened, state)
    square, mode = _largest(scaled(part.stiffness))
    own_most, own_mode = _largest(scaled(part.damping))
    omega = math.sqrt(max(square, 0.0))

    def along(direction: Floats, keys: set[Key]) -> float:
        dampings = (scaled(all_parts.elements[k].damping) for k in keys if k.kind != "inertial")
        return float(sum(direction @ damping @ direction for damping in dampings))

    def alone(name: str, omega: float, direction: Floats) -> float:
        if name == "midpoint" and key.kind in ROWS:
            return row_after_midpoint(omega, along(direction, {key}))
        implicit = set(all_parts.implicit.get(name, ()))
        # Under `explicit` damping only helps an oscillation, whoever gives it.
        helps = set(all_parts.elements) if name == "explicit" and omega > 0 else implicit | {key}
        hidden = along(direction, implicit)
        shown = along(direction, helps) - hidden
        return oscillator(omega, max(shown, 0.0), max(hidden, 0.0), name, horizon)

    limits = {}
    for name in INTEGRATORS:
        found = math.inf
        if omega > 0:
            found = alone(name, omega, mode)
        if own_most > 0:
            found = min(found, alone(name, 0.0, own_mode))
        # Softened with dt from there on, it limits nothing that it did not limit before.
        limits[name] = found if found <= min(softened, LONGEST) else math.inf
    ratio = along(mode, set(all_parts.elements)) / (2 * omega) if omega > 0 else math.nan
    return Figures(key, omega, ratio, max(own_most, 0.0), limits, softened, state)


def _largest(matrix: Floats) -> tuple[float, Floats]:
    """The largest eigenvalue of the symmetric part, and its vector."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    if len(values) == 0:
        return 0.0, np.zeros(0)
    size = float(np.abs(values).max())
    value = float(values[-1])
    return (value if value > NOTHING * size and value > 0 else 0.0), vectors[:, -1]
