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
from itertools import product
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.linear_maps import stepped
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates
from stepcore.measure.diagnosis.element_forces import INERTIAL, ROWS, ElementForces, Key, SpinForces
from stepcore.measure.diagnosis.linear_step import (
    ON_GUESS,
    TINY_STEP,
    State,
    placed,
    rates_matrix,
    without_rows,
)
from stepcore.scene.layout import Layout

# Change of a position or velocity for the differences: forces are exact to rounding.
SMALL = 1e-6
# Change of an element's gain for the derivative of an eigenvalue.
NUDGE = 1e-4
# Eigenvalues as near as this part of their distance from 1 are equal; points around them.
EQUAL, AROUND = 1e-2, 16

Shares = dict[Key, float]
Forces = dict[Key, Floats]


@dataclass(frozen=True)
class Part:
    """Stiffness and damping of one element, shape (nv, nv) each."""

    stiffness: Floats
    damping: Floats

    def by(self, column: int) -> Floats:
        """What the position (0) or the velocity (1) gives."""
        return self.damping if column else self.stiffness


@dataclass(frozen=True)
class LinearMotion:
    """The linearised motion at a state, by elements.

    implicit: whose damping each integrator treats implicitly; after: what acts after the midpoint.
    """

    mass: Floats
    rates: Floats
    elements: dict[Key, Part]
    implicit: dict[str, frozenset[Key]]
    after: frozenset[Key] = frozenset()

    def step(
        self,
        integrator: str,
        dt: float,
        scaled: Key | None = None,
        by: float = 0.0,
        of: Any = None,
    ) -> Any:
        """A of a step, shape (2 nv, 2 nv); one element's stiffness and damping times 1 + by.

        of: A times this, which is less work.
        """
        n = len(self.mass)
        implicit = np.zeros((n, n))
        for key in self.implicit.get(integrator, ()):
            implicit += self.elements[key].damping * (1 + by if key == scaled else 1.0)

        def after(y: Any) -> Any:
            force = np.zeros_like(y[:n])
            for key in self.after:
                part, gain = self.elements[key], 1 + by if key == scaled else 1.0
                force = force - gain * (part.stiffness @ y[:n] + part.damping @ y[n:])
            return np.linalg.solve(self.mass, force)

        return stepped(
            integrator,
            dt,
            lambda y: self.moving(scaled, by, y),
            np.eye(2 * n) if of is None else of,
            self.mass,
            implicit,
            after if self.after else None,
        )

    def moving(self, scaled: Key | None, by: float, x: Any) -> Any:
        """J x, with one element's stiffness and damping times 1 + by."""
        found = self.rates @ x
        if scaled is not None:
            n = len(self.mass)
            part = self.elements[scaled]
            force = part.stiffness @ x[:n] + part.damping @ x[n:]
            found[n:] -= by * np.linalg.solve(self.mass, force)
        return found

    def shares(self, integrator: str, dt: float, matrix: Floats, value: complex) -> Shares:
        """What part of the growth of an eigenvalue of a step's `matrix` each element has."""
        return self._shares(matrix, value, lambda *at: self.step(integrator, dt, *at))

    def fastest(self) -> Shares:
        """What part of the motion's fastest rate each element has."""
        values = np.linalg.eigvals(self.rates)
        return self._shares(self.rates, values[np.abs(values).argmax()], self.moving)

    def _shares(
        self, matrix: Floats, value: complex, changed: Callable[[Key, float, Any], Any]
    ) -> Shares:
        """The derivatives of log |value| by each element's gain, as parts of their sum.

        changed: the matrix times a block, of an element's gain times 1 + the number given. Of
        several equal eigenvalues the mean's. ElementForces that hold it back count 0.
        """
        values = np.linalg.eigvals(matrix).astype(complex)
        if not np.any(values):
            return dict.fromkeys(self.elements, 0.0)
        mean, onto = _cluster(matrix, values, value)
        # Of little rank: the trace of P dA is that of its left factor times dA times its right.
        right, sizes, left = np.linalg.svd(onto)
        rank = int(np.sum(sizes > 1e-9 * sizes[0]))
        right, left = right[:, :rank] * sizes[:rank], left[:rank]
        found: dict[Key, float] = {}
        for key in self.elements:
            slope = np.sum(left.T * (changed(key, NUDGE, right) - changed(key, -NUDGE, right)))
            found[key] = max(0.0, float((slope / mean).real))
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


def parts(model: Model, state: State, dt: float | None) -> LinearMotion | None:
    """The elements at a state; None where its accelerations are not finite.

    dt: rows as soft as `refsafe` makes them at this step; None: as soft as the scene asks.
    """
    rates = rates_matrix(model, state, dt)
    if rates is None:
        return None
    if dt is None and model.settings.law in ON_GUESS:
        model = without_rows(model)
    elements = ElementForces(model)
    own: dict[str, Any] = {"dt": TINY_STEP, "refsafe": False} if dt is None else {"dt": dt}
    sim = placed(model, state, integrator="explicit", **own)
    found = _differences(elements, Coordinates(model), sim, state)
    sim.qpos[:], sim.qvel[:] = state.qpos, state.qvel
    mass = np.array(sim.mass_matrix())
    n = model.nv
    known = sum((np.hstack([p.stiffness, p.damping]) for p in found.values()), np.zeros((n, 2 * n)))
    rest = -mass @ rates[n:] - known
    found[INERTIAL] = Part(rest[:, :n], rest[:, n:])
    penalty = model.settings.law == "penalty"
    rows = {key for key in found if key.kind in ROWS and (key.kind != "contact" or not penalty)}
    return LinearMotion(mass, rates, found, _implicit(model, found), frozenset(rows))


def _differences(
    elements: ElementForces, dofs: Coordinates, sim: Sim, state: State
) -> dict[Key, Part]:
    """Minus the derivatives of every element's force.

    Where a row opens or closes on one side of the state (a contact, one point of it, a limit), all
    is differenced on the other: the engine's rows begin to push with a jump.
    """

    def sides(column: int, change: Floats, forces: Callable[[Sim], Any]) -> list[Any]:
        """The forces with positions (column 0) or velocities (1) changed, and changed back."""
        found = []
        for sign in (1, -1):
            sim.qpos[:], sim.qvel[:] = state.qpos, state.qvel
            if column == 0:
                sim.qpos[:] = dofs.moved(state.qpos, sign * change)
            else:
                sim.qvel[:] = state.qvel + sign * change
            found.append(forces(sim))
        return found

    def same(sim: Sim) -> Forces:
        """The forces across where the rows are those of the state."""
        forces = elements.across(sim)
        return forces if _acting(sim) == acting else {}

    n = elements.model.nv
    local, across, acting = elements.of_joints(sim), elements.across(sim), _acting(sim)
    found = {key: Part(np.zeros((n, n)), np.zeros((n, n))) for key in local | across}
    # All joints at once, one dof of each: nothing of another joint comes in.
    for nth, column in product(range(max(_count(at) for at in elements.dofs)), (0, 1)):
        change = np.zeros(n)
        change[[at.start + nth for at in elements.dofs if _count(at) > nth]] = SMALL
        after, before = sides(column, change, elements.of_joints)
        for key, force in local.items():
            at = elements.joint_dofs(key)
            if _count(at) > nth:
                slope = _slope(key, force, after, before)
                found[key].by(column)[at, at.start + nth] = slope[at]
    for dof, column in product(range(n if across else 0), (0, 1)):
        after, before = sides(column, SMALL * np.eye(1, n, dof)[0], same)
        for key, force in across.items():
            found[key].by(column)[:, dof] = _slope(key, force, after, before)
    if np.any(state.qvel):
        sim.qpos[:], sim.qvel[:] = state.qpos, state.qvel
        found |= _spins(elements, elements.spinning(sim), lambda *at: sides(0, *at))
    return found


def _spins(
    elements: ElementForces, spins: SpinForces, sides: Callable[..., list[Any]]
) -> dict[Key, Part]:
    """Those of spinning bodies. sides: forces with positions changed, and changed back."""
    n = elements.model.nv
    stiffness = np.zeros((len(spins.spin), n, n))
    for dof in range(n):
        change = SMALL * np.eye(1, n, dof)[0]
        after, before = sides(change, lambda sim: elements.spinning(sim).force)
        stiffness[:, :, dof] = (before - after) / (2 * SMALL)
    turns = zip(elements.spin_keys, spins.spin, stiffness, spins.damping, strict=True)
    return {key: Part(k, d) for key, spin, k, d in turns if np.any(spin)}


def _acting(sim: Sim) -> list[str]:
    """The element of every row at hand, in order."""
    names: list[str] = sim.rows["name"].tolist()
    return names


def _count(at: slice) -> int:
    return int(at.stop - at.start)


def _slope(key: Key, here: Floats, after: Forces, before: Forces) -> Floats:
    """Minus the derivative of a force: 0 where it acts on neither side."""
    count = (key in after) + (key in before)
    return (before.get(key, here) - after.get(key, here)) / (SMALL * count or 1.0)


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
