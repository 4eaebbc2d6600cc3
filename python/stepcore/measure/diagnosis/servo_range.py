"""A servo's force range in numbers: the speed at which it is reached, and the step that crosses it.

With gain kv, gear g, force range ±F and inverse inertia w of its dof, the force is clamped beyond
the speed F/(kv |g|); a step changes the speed by F |g| w dt there, and jumps from one end of the
range to the other from dt = 2/(kv g² w) on.
"""

from __future__ import annotations

import math

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.joint_gains import joint_dofs


def largest_force(model: Model, actuator: int) -> float:
    """The nearer end of an actuator's force range [N or N·m]; inf without one."""
    return float(np.abs(model.actuator_forcerange[actuator]).min())


def reaching_speed(model: Model, actuator: int) -> float:
    """The speed of its joint at which an actuator's damping alone reaches its force range."""
    damping = -float(model.actuator_bias[actuator, 2])
    damping *= abs(float(model.actuator_gear[actuator, 0]))
    return largest_force(model, actuator) / damping if damping > 0 else math.inf


def crossing_dt(model: Model, qpos: Floats, actuator: int) -> float:
    """The step [s] from which an actuator may jump across its range.

    inf without damping, and for one that pulls along no single joint.
    """
    if model.actuator_joint[actuator] < 0:
        return math.inf
    damping = -float(model.actuator_bias[actuator, 2])
    damping *= float(model.actuator_gear[actuator, 0]) ** 2
    if not damping > 0:
        return math.inf
    sim = unwatched(Sim(model))
    sim.qpos[:] = qpos
    dof = driven_dof(model, actuator)
    return 2 / (damping * float(np.linalg.inv(np.array(sim.mass_matrix()))[dof, dof]))


def driven_dof(model: Model, actuator: int) -> int:
    """The first dof of an actuator's joint."""
    return joint_dofs(model, int(model.actuator_joint[actuator])).start
