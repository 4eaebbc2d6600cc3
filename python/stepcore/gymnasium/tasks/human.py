"""The common observation and first state of Humanoid and HumanoidStandup."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.mujoco_task import NoisyTask, observed

# Dofs of the free joint, on which no actuator acts.
FREE = 6


@dataclass(frozen=True, kw_only=True)
class Human(NoisyTask):
    """Observes inertias, velocities and forces of all bodies beside qpos and qvel."""

    late: ClassVar[tuple[str, ...]] = (  # type: ignore[misc]
        *("subtree_com", "cinert", "cvel", "actuator_force", "cfrc_ext"),
        *("ten_length", "ten_velocity"),
    )

    ctrl_cost_weight: float = 0.1
    reset_noise_scale: float = 1e-2
    exclude_current_positions_from_observation: bool = True
    include_cinert_in_observation: bool = True
    include_cvel_in_observation: bool = True
    include_qfrc_actuator_in_observation: bool = True
    include_cfrc_ext_in_observation: bool = True

    def observe(self, now: Moment) -> Floats:
        parts = [observed(now, 2 * self.exclude_current_positions_from_observation, now.qvel)]
        if self.include_cinert_in_observation:
            parts.append(_of_bodies(now, now.cinert))
        if self.include_cvel_in_observation:
            parts.append(_of_bodies(now, now.cvel))
        if self.include_qfrc_actuator_in_observation:
            parts.append(_actuator_forces(now)[..., FREE:])
        if self.include_cfrc_ext_in_observation:
            parts.append(_of_bodies(now, now.cfrc_ext))
        return np.concatenate(parts, axis=-1)

    def controls(self, now: Moment) -> Floats:
        """Return the controls in double precision, as MuJoCo keeps them, shape (nu,)."""
        return now.action.astype(np.float64)

    def contact_forces(self, now: Moment) -> Floats:
        """Return the forces on all bodies, shape (6 (nbody - 1),)."""
        return _of_bodies(now, now.cfrc_ext)

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            "x_position": now.qpos[..., 0],
            "y_position": now.qpos[..., 1],
            "tendon_length": now.ten_length,
            "tendon_velocity": now.ten_velocity,
        }


def _of_bodies(now: Moment, values: Floats) -> Floats:
    """Return the rows of all bodies but the world as one vector."""
    return values[..., 1:, :].reshape(*now.shape, -1)


def _actuator_forces(now: Moment) -> Floats:
    """Return actuator forces by dof, shape (nv,); each actuator drives a joint of one dof."""
    model = now.model
    dofs = model.jnt_dofadr[model.actuator_joint]
    forces = np.zeros((*now.shape, model.nv))
    for actuator, dof in enumerate(dofs.tolist()):
        forces[..., dof] += model.actuator_gear[actuator, 0] * now.actuator_force[..., actuator]
    return forces
