"""The stiffness and damping of every element at a state.

An element e has a stiffness K_e and a damping D_e: minus the derivatives of its force by position
and velocity, by central differences of the forces that the engine solved.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates
from stepcore.measure.diagnosis.element_id import ROWS, ElementId, row_elements
from stepcore.measure.diagnosis.linear_step import State
from stepcore.measure.diagnosis.spins import spinning_bodies, spins
from stepcore.scene.layout import DOFS

# Change of a position or velocity for the differences: the forces are exact to rounding.
SMALL = 1e-6

Forces = dict[tuple[str, int], Floats]
# Evaluates something of a Sim with positions (column 0) or velocities (1) changed, then changed
# by the opposite.
Sides = Callable[[int, Floats, Callable[[Sim], Any]], tuple[Any, Any]]


@dataclass(frozen=True)
class ElementMatrices:
    """One element's stiffness K_e and damping D_e, shape (nv, nv) each."""

    stiffness: Floats
    damping: Floats

    def by(self, column: int) -> Floats:
        """The derivative by position (0) or velocity (1)."""
        return self.damping if column else self.stiffness

    def force(self, x: Floats) -> Floats:
        """−K_e dq − D_e dv for a block of x = [dq, dv], shape (nv, …)."""
        n = len(self.stiffness)
        return -(self.stiffness @ x[:n] + self.damping @ x[n:])


def element_matrices(model: Model, sim: Sim, state: State) -> dict[ElementId, ElementMatrices]:
    """Stiffness and damping of every element that acts at a state, where `sim` is."""
    coordinates = Coordinates(model)

    def sides(column: int, change: Floats, read: Callable[[Sim], Any]) -> tuple[Any, Any]:
        def read_with(qpos: Floats, qvel: Floats) -> Any:
            sim.qpos[:], sim.qvel[:] = qpos, qvel
            return read(sim)

        if column == 0:
            after, before = (coordinates.moved(state.qpos, c) for c in (change, -change))
            return read_with(after, state.qvel), read_with(before, state.qvel)
        after, before = state.qvel + change, state.qvel - change
        return read_with(state.qpos, after), read_with(state.qpos, before)

    matrices: dict[ElementId, ElementMatrices] = dict(_joint_matrices(model, sides))
    matrices |= _tendon_matrices(model, sides)
    matrices |= _linked_matrices(model, sides)
    matrices |= _row_matrices(model, sim, sides)
    sim.qpos[:], sim.qvel[:] = state.qpos, state.qvel
    if np.any(state.qvel):
        matrices |= _spin_matrices(model, sim, sides)
        sim.qpos[:], sim.qvel[:] = state.qpos, state.qvel
    return matrices


def _joint_matrices(model: Model, sides: Sides) -> dict[ElementId, ElementMatrices]:
    """Those of springs, dampers and actuators.

    One dof of every joint at once: an element depends on its own joint alone.
    """
    starts, counts = model.jnt_dofadr, np.array([DOFS[kind] for kind in model.jnt_type])
    matrices = _no_matrices(model.nv)
    none = np.zeros(model.nv)
    for nth, column in product(range(max(counts)), (0, 1)):
        change = np.zeros(model.nv)
        change[starts[counts > nth] + nth] = SMALL
        after, before = sides(column, change, _forces("spring", "damper", "actuator"))
        for kind, index in dict.fromkeys([*after, *before]):
            joint = model.actuator_joint[index] if kind == "actuator" else index
            if joint < 0 or counts[joint] <= nth:
                continue
            at = slice(starts[joint], starts[joint] + counts[joint])
            slope = before.get((kind, index), none) - after.get((kind, index), none)
            derivative = matrices[ElementId.of(model, kind, index)].by(column)
            derivative[at, at.start + nth] = slope[at] / (2 * SMALL)
    return matrices


def _tendon_matrices(model: Model, sides: Sides) -> dict[ElementId, ElementMatrices]:
    """Those of springs and dampers of tendons, which couple dofs."""
    matrices = _no_matrices(model.nv)
    none = np.zeros(model.nv)
    pull = any(tendon.sprung or tendon.damped for tendon in model.scene.tendons)
    for dof, column in product(range(model.nv if pull else 0), (0, 1)):
        change = SMALL * np.eye(1, model.nv, dof)[0]
        after, before = sides(column, change, _forces("tendon spring", "tendon damper"))
        for element in dict.fromkeys([*after, *before]):
            slope = before.get(element, none) - after.get(element, none)
            matrices[ElementId.of(model, *element)].by(column)[:, dof] = slope / (2 * SMALL)
    return matrices


def _linked_matrices(model: Model, sides: Sides) -> dict[ElementId, ElementMatrices]:
    """Those of actuators along tendons, sites and slider-cranks: one dof after the other."""
    linked = {int(k) for k in np.flatnonzero(model.actuator_joint < 0)}
    matrices = _no_matrices(model.nv)
    for dof, column in product(range(model.nv if linked else 0), (0, 1)):
        change = SMALL * np.eye(1, model.nv, dof)[0]
        after, before = sides(column, change, _forces("actuator"))
        for kind, index in dict.fromkeys([*after, *before]):
            if index in linked:
                none = np.zeros(model.nv)
                slope = before.get((kind, index), none) - after.get((kind, index), none)
                derivative = matrices[ElementId.of(model, kind, index)].by(column)
                derivative[:, dof] = slope / (2 * SMALL)
    return matrices


def _row_matrices(model: Model, sim: Sim, sides: Sides) -> dict[ElementId, ElementMatrices]:
    """Those of rows and contacts.

    Where a row opens or closes on one side of the state (a contact, one point of it, a limit), all
    are differenced on the other side alone: the engine's rows begin to push with a jump.
    """
    of_rows = _forces(*ROWS)
    here, rows = of_rows(sim), list(row_elements(sim))

    def where_same(sim: Sim) -> Forces:
        forces = of_rows(sim)
        return forces if list(row_elements(sim)) == rows else {}

    matrices = _no_matrices(model.nv)
    none = np.zeros(model.nv)
    for dof, column in product(range(model.nv if rows or here else 0), (0, 1)):
        after, before = sides(column, SMALL * np.eye(1, model.nv, dof)[0], where_same)
        for kind, index in dict.fromkeys([*after, *before]):
            element, force = (kind, index), here.get((kind, index), none)
            count = (element in after) + (element in before)
            slope = before.get(element, force) - after.get(element, force)
            derivative = matrices[ElementId.of(model, kind, index)].by(column)
            derivative[:, dof] = slope / (SMALL * count)
    return matrices


def _no_matrices(nv: int) -> defaultdict[ElementId, ElementMatrices]:
    """Matrices of zeros for every element that is asked for."""
    return defaultdict(lambda: ElementMatrices(np.zeros((nv, nv)), np.zeros((nv, nv))))


def _forces(*kinds: str) -> Callable[[Sim], Forces]:
    """The forces of elements of some kinds at the present state of a Sim."""

    def forces(sim: Sim) -> Forces:
        sim.forward()
        return {element: f for element, f in sim.element_forces().items() if element[0] in kinds}

    return forces


def _spin_matrices(model: Model, sim: Sim, sides: Sides) -> dict[ElementId, ElementMatrices]:
    """Those of spinning bodies."""
    bodies = spinning_bodies(model)
    here = spins(sim, bodies)
    stiffness = np.zeros((len(bodies), model.nv, model.nv))
    for dof in range(model.nv):
        change = SMALL * np.eye(1, model.nv, dof)[0]
        after, before = sides(0, change, lambda sim: spins(sim, bodies).force)
        stiffness[:, :, dof] = (before - after) / (2 * SMALL)
    turns = zip(bodies, here.spin, stiffness, here.damping, strict=True)
    return {
        ElementId.of(model, "spin", body): ElementMatrices(k, d)
        for body, spin, k, d in turns
        if np.any(spin)
    }
