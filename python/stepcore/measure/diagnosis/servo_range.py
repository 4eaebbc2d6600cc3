"""Compute the speed at which a servo reaches its force range, and the step that crosses the range.

With gain kv, gear g, force range ±F and inverse inertia w of its dof, the force is clamped above
the speed F/(kv |g|). A step changes the speed by F |g| w dt there, and jumps from one end of the
range to the other for dt ≥ 2/(kv g² w).

With gain kp the servo oscillates with ω = sqrt(kp g² w), and reaches the range above the speed
F |g| w/ω. If friction stops the joint, or the force is clamped, no linearised step has this
oscillation. The force goes from end to end above the dt at which the oscillator alone is unstable.
"""

from __future__ import annotations

import math

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.linear_maps import STIFFNESS_IMPLICIT, implicit_kinds
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.measure.diagnosis.isolated import joint_dofs, joint_gains, oscillator_dt


def largest_force(model: Model, actuator: int) -> float:
    """Return the nearer end of an actuator's force range [N or N·m]; inf without a range."""
    return float(np.abs(model.actuator_forcerange[actuator]).min())


def reaching_speed(model: Model, actuator: int) -> float:
    """Return the joint speed at which an actuator's damping alone reaches its force range."""
    damping = _damping(model, actuator)
    return _end(model, actuator) / damping if damping > 0 else math.inf


def crossing_dt(model: Model, qpos: Floats, actuator: int) -> float:
    """Return the step [s] above which an actuator's force may jump across its range.

    The result is inf without damping, and for an actuator that drives no single joint.
    """
    damping = _damping(model, actuator)
    if model.actuator_joint[actuator] < 0 or not damping > 0:
        return math.inf
    return 2 / (damping * _inverse_inertia(model, qpos, driven_dof(model, actuator)))


def swinging_dt(model: Model, qpos: Floats, actuator: int, integrator: str) -> tuple[float, float]:
    """Return the largest stable dt [s] of a servo's own oscillation, and the speed of its range.

    The oscillator is the servo's stiffness on its joint, with the dampers and servos of that joint.
    The speed [rad/s or m/s] is that of the joint at which the oscillation reaches the force range.
    Both are inf without stiffness, and for an actuator that drives no hinge or slide.
    """
    gains = list(joint_gains(model))
    gain = next((g for g in gains if (g.kind, g.index) == ("actuator", actuator)), None)
    if gain is None or not gain.stiffness > 0:
        return math.inf, math.inf
    w = _inverse_inertia(model, qpos, driven_dof(model, actuator))
    omega = math.sqrt(gain.stiffness * w)
    late = implicit_kinds(integrator, model.scene.features.eulerdamp)
    beside = [other for other in gains if other.joint == gain.joint]
    implicit = sum(other.damping * w for other in beside if other.kind in late)
    explicit = sum(other.damping * w for other in beside if other.kind not in late)
    held = integrator in STIFFNESS_IMPLICIT
    limit = math.inf if held else oscillator_dt(omega, explicit, implicit, integrator)
    return limit, _end(model, actuator) * w / omega


def driven_dof(model: Model, actuator: int) -> int:
    """Return the first dof of an actuator's joint."""
    return joint_dofs(model, int(model.actuator_joint[actuator])).start


def _damping(model: Model, actuator: int) -> float:
    """Return an actuator's damping of its joint within its force range (ball, free: first dof)."""
    return -float(model.actuator_bias[actuator, 2] * model.actuator_gear[actuator, 0] ** 2)


def _end(model: Model, actuator: int) -> float:
    """Return the nearer end of an actuator's force range, at its joint."""
    return largest_force(model, actuator) * abs(float(model.actuator_gear[actuator, 0]))


def _inverse_inertia(model: Model, qpos: Floats, dof: int) -> float:
    """Return a dof's acceleration per unit of force, the others free [1/kg or 1/(kg·m²)]."""
    sim = unwatched(Sim(model))
    sim.qpos[:] = qpos
    return float(np.linalg.inv(np.array(sim.mass_matrix()))[dof, dof])
