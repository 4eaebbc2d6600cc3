"""What each element adds to the linearised motion, and to each integrator's step.

Every element e feels like a stiffness K_e and a damping D_e: minus the derivatives of its force by
position and velocity, by central differences of the forces that the engine solved. With the mass
matrix M, J = [[J_qq, J_qv], [-M⁻¹ΣK_e, -M⁻¹ΣD_e]]; what no element accounts for (gravity, Coriolis
and centrifugal forces) is the element "inertial forces", so that the sum is exact.

Each integrator's step is then a function of M, J and the damping that it treats implicitly
(`step`), and what an element does to an eigenvalue of the step is its first derivative.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore.arrays import Floats
from stepcore.course.dofs import Dofs
from stepcore.diagnose.forces import INERTIAL, Elements, Key
from stepcore.diagnose.linear import ON_GUESS, TINY_STEP, State, placed, rates_matrix, without_rows
from stepcore.layout import Layout
from stepcore.model import Model
from stepcore.sim import Sim

# Change of a position or velocity for the differences: forces are exact to rounding.
SMALL = 1e-6
# Change of an element's gain for the derivative of an eigenvalue.
NUDGE = 1e-4
# Eigenvalues as near as this part of their distance from 1 are equal; points around them.
EQUAL, AROUND = 1e-2, 16

Shares = dict[Key, float]


@dataclass(frozen=True)
class Part:
    """Stiffness and damping of one element, shape (nv, nv) each."""

    stiffness: Floats
    damping: Floats


@dataclass(frozen=True)
class Parts:
    """The linearised motion at a state, by elements. implicit: damping by integrator."""

    mass: Floats
    rates: Floats
    elements: dict[Key, Part]
    implicit: dict[str, frozenset[Key]]

    def step(self, integrator: str, dt: float, scaled: Key | None = None, by: float = 0.0) -> Any:
        """A of a step, shape (2 nv, 2 nv); one element's stiffness and damping times 1 + by."""
        n = len(self.mass)
        rates = self.rates if scaled is None else self.rescaled(scaled, by)
        one = np.eye(2 * n)
        if integrator == "explicit":
            return one + dt * rates
        if integrator == "midpoint":
            return np.linalg.solve(one - dt / 2 * rates, one + dt / 2 * rates)
        if integrator == "rk4":
            z = dt * rates
            return one + z @ (one + z / 2 @ (one + z / 3 @ (one + z / 4)))
        damping = np.zeros((n, n))
        for key in self.implicit.get(integrator, ()):
            damping += self.elements[key].damping * (1 + by if key == scaled else 1.0)
        new = np.eye(n, 2 * n, n) + dt * np.linalg.solve(
            self.mass + dt * damping, self.mass @ rates[n:]
        )
        move = (
            np.hstack([np.eye(n) + dt * rates[:n, :n], np.zeros((n, n))]) + dt * rates[:n, n:] @ new
        )
        return np.vstack([move, new])

    def rescaled(self, key: Key, by: float) -> Floats:
        """J with one element's stiffness and damping times 1 + by."""
        n = len(self.mass)
        part = self.elements[key]
        rates = self.rates.copy()
        rates[n:] -= by * np.linalg.solve(self.mass, np.hstack([part.stiffness, part.damping]))
        return rates

    def shares(self, integrator: str, dt: float, matrix: Floats, value: complex) -> Shares:
        """What part of the growth of an eigenvalue of a step's `matrix` each element has."""
        return self._shares(matrix, value, lambda key, by: self.step(integrator, dt, key, by))

    def fastest(self) -> Shares:
        """What part of the motion's fastest rate each element has."""
        values = np.linalg.eigvals(self.rates)
        return self._shares(self.rates, values[np.abs(values).argmax()], self.rescaled)

    def _shares(
        self, matrix: Floats, value: complex, changed: Callable[[Key, float], Floats]
    ) -> Shares:
        """The derivatives of log |value| by each element's gain, as parts of their sum.

        Of several equal eigenvalues the mean's. Elements that hold it back count 0.
        """
        values = np.linalg.eigvals(matrix).astype(complex)
        if not np.any(values):
            return dict.fromkeys(self.elements, 0.0)
        mean, onto = _cluster(matrix, values, value)
        found: dict[Key, float] = {}
        for key in self.elements:
            slope = np.sum(onto.T * (changed(key, NUDGE) - changed(key, -NUDGE))) / mean
            found[key] = max(0.0, float(slope.real))
        whole = sum(found.values())
        return {key: share / whole if whole > 0 else 0.0 for key, share in found.items()}


def _cluster(matrix: Floats, values: Any, value: complex) -> tuple[complex, Any]:
    """The mean of the eigenvalues equal to `value`, and the projector onto their vectors.

    A change dA moves the mean by trace(P dA) / trace P, also where no eigenvectors tell the values
    apart (the nutation of a thin plate is as fast as its spin). P is the mean of (z - A)⁻¹ (z - c)
    around a circle that holds these values and no other.
    """
    centre = values[np.abs(values - value).argmin()]
    apart = np.sort(np.abs(values - centre))
    near = max(EQUAL * min(1.0, abs(centre - 1)), 1e-12)
    count = int(np.sum(apart <= near))
    centre = values[np.abs(values - centre) <= near].mean()
    others = apart[count] if count < len(apart) else 1.0
    radius = math.sqrt(max(apart[count - 1], others / 100) * others)
    around = radius * np.exp(2j * np.pi * (np.arange(AROUND) + 0.5) / AROUND)
    one = np.eye(len(matrix))
    onto = sum(z * np.linalg.inv((centre + z) * one - matrix) for z in around) / AROUND
    return complex(centre or 1.0) * count, onto


def parts(model: Model, state: State, dt: float | None) -> Parts | None:
    """The elements at a state; None where its accelerations are not finite.

    dt: rows as soft as `refsafe` makes them at this step; None: as soft as the scene asks.
    """
    rates = rates_matrix(model, state, dt)
    if rates is None:
        return None
    if dt is None and model.settings.law in ON_GUESS:
        model = without_rows(model)
    elements = Elements(model)
    own: dict[str, Any] = {"dt": TINY_STEP, "refsafe": False} if dt is None else {"dt": dt}
    sim = placed(model, state, integrator="explicit", **own)
    found = _differences(elements, Dofs(model.scene), sim, state)
    sim.qpos[:], sim.qvel[:] = state.qpos, state.qvel
    mass = np.array(sim.mass_matrix())
    n = model.nv
    known = sum((np.hstack([p.stiffness, p.damping]) for p in found.values()), np.zeros((n, 2 * n)))
    rest = -mass @ rates[n:] - known
    found[INERTIAL] = Part(rest[:, :n], rest[:, n:])
    return Parts(mass, rates, found, _implicit(model, found))


def _differences(elements: Elements, dofs: Dofs, sim: Sim, state: State) -> dict[Key, Part]:
    """Minus the derivatives of every element's force.

    Where a row opens or closes on one side of the state (a contact, one point of it, a limit), all
    is differenced on the other: the engine's rows begin to push with a jump.
    """
    n = elements.model.nv
    base, acting = elements.forces(sim), _acting(sim)
    found = {key: Part(np.zeros((n, n)), np.zeros((n, n))) for key in base}
    for column in range(2 * n):
        change = np.zeros(n)
        change[column % n] = SMALL
        sides, same = [], []
        for sign in (1, -1):
            if column < n:
                sim.qpos[:], sim.qvel[:] = dofs.moved(state.qpos, sign * change), state.qvel
            else:
                sim.qpos[:], sim.qvel[:] = state.qpos, state.qvel + sign * change
            sides.append(elements.forces(sim))
            same.append(_acting(sim) == acting)
        sides = [side if one else {} for side, one in zip(sides, same, strict=True)]
        for key, part in found.items():
            ends = [side.get(key, base[key]) for side in sides]
            apart = SMALL * sum(key in side for side in sides)
            into = part.stiffness if column < n else part.damping
            if apart:
                into[:, column % n] = (ends[1] - ends[0]) / apart
    return found


def _acting(sim: Sim) -> list[str]:
    """The element of every row at hand, in order."""
    names: list[str] = sim.rows["name"].tolist()
    return names


def _implicit(model: Model, found: dict[Key, Part]) -> dict[str, frozenset[Key]]:
    """Which elements' damping each integrator treats implicitly."""
    dampers = {key for key in found if key.kind == "damper"}
    servos = {key for key in found if key.kind == "servo"}
    layout = Layout(model.scene)
    alone = {id(joint.body) for joint in layout.joints if joint.type == "free"}
    alone -= {id(body.parent) for body in layout.bodies[1:]}
    spins = {
        key for key in found if key.kind == "spin" and id(layout.bodies[key.index[0]]) in alone
    }
    euler = dampers if model.scene.features.eulerdamp else set()
    return {"euler": frozenset(euler), "implicitfast": frozenset(dampers | servos | spins)}
