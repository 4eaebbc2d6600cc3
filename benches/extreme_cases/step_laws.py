"""Laws that every step of every scene keeps, whatever its settings: momentum and rows."""

from __future__ import annotations

import numpy as np

from extreme_cases.cells import EPS, Outcome, within
from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim
from stepcore.scene.layout import DOFS


def balance(sim: Sim) -> float:
    """The error of M (v⁺ - v) = dt (forces) + impulses at the present state, over its terms.

    Every term is read on its own: mass matrix, acceleration, bias, springs and dampers, actuators,
    and the force of the rows.
    """
    sim.forward()
    dt, m = sim.settings.dt, sim.mass_matrix()
    parts = [m @ sim.qacc, sim.bias, -sim.passive, -actuation(sim), -sim.constraint_force]
    missing = np.abs(np.sum(parts, axis=0)) * dt
    # The momentum of the velocities, whose last digit is rounding, and every force.
    size = np.abs(m) @ np.abs(sim.qvel) + dt * np.sum(np.abs(parts), axis=0)
    # The largest of all: a light part's term is a difference of its heavy neighbours' terms.
    return float(np.max(missing / np.maximum(size.max(), 1e-300)))


def actuation(sim: Sim) -> Floats:
    """The force of the actuators on each dof [N or N·m], shape (nv,)."""
    force = np.zeros(sim.model.nv)
    for i, joint in enumerate(sim.model.actuator_joint):
        first = sim.model.jnt_dofadr[joint]
        count = DOFS[sim.model.jnt_type[joint]]
        force[first : first + count] += sim.model.actuator_gear[i, :count] * sim.actuator_force[i]
    return force


def step_is_balanced(sim: Sim, precision: str) -> Outcome:
    """Newton's law for the step about to be made, and no impulse outside its bounds."""
    miss = within(balance(sim), 1e3 * EPS[precision], "balance of momentum")
    rows = sim.rows
    inside = (rows["impulse"] >= rows["lo"]) & (rows["impulse"] <= rows["hi"])
    if not inside.all():
        name = rows["name"][np.argmin(inside)]
        return Outcome(False, f"pulls: {name}", "impulses push")
    return miss
