"""Humanoid: walk forward on two legs; HumanoidStandup: stand up from the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.mujoco_task import (
    NoisyTask,
    StandingTask,
    distance,
    observed,
    squares,
    velocity,
)
from stepcore.gymnasium.tasks.planar import within

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


# The tree of the world is all there is: its centre of mass is that of the robot.
CENTRE = (..., 0)


@dataclass(frozen=True, kw_only=True)
class Humanoid(Human, StandingTask):
    """The options are those of gymnasium's Humanoid-v5."""

    axes: ClassVar[str] = "xy"

    xml_file: str = "humanoid.xml"
    forward_reward_weight: float = 1.25
    contact_cost_weight: float = 5e-7
    contact_cost_range: tuple[float, float] = (-np.inf, 10.0)
    healthy_reward: float = 5.0
    healthy_z_range: tuple[float, float] = (1.0, 2.0)

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        return within(now.qpos[..., 2], self.healthy_z_range)

    def main_velocity(self, now: Moment, axis: int) -> Floats:
        return velocity(now, "subtree_com", (*CENTRE, axis))

    def parts(self, now: Moment) -> dict[str, Floats]:
        contact = self.contact_cost_weight * squares(self.contact_forces(now))
        return {
            "reward_survive": self.healthy(now) * self.healthy_reward,
            "reward_forward": self.forward_reward_weight * self.main_velocity(now, 0),
            "reward_ctrl": -self.ctrl_cost_weight * squares(self.controls(now)),
            "reward_contact": -np.clip(contact, *self.contact_cost_range),
        }

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            **super().reset_info(now),
            "distance_from_origin": distance(now.qpos[..., :2]),
        }


@dataclass(frozen=True, kw_only=True)
class HumanoidStandup(Human):
    """The options are those of gymnasium's HumanoidStandup-v5."""

    xml_file: str = "humanoidstandup.xml"
    uph_cost_weight: float = 1.0
    impact_cost_weight: float = 5e-7
    impact_cost_range: tuple[float, float] = (-np.inf, 10.0)

    def parts(self, now: Moment) -> dict[str, Floats]:
        impact = self.impact_cost_weight * squares(self.contact_forces(now))
        return {
            # Over the engine's step, and without uph_cost_weight, as gymnasium has it.
            "reward_linup": now.qpos[..., 2] / now.model.settings.dt,
            "reward_quadctrl": -self.ctrl_cost_weight * squares(self.controls(now)),
            "reward_impact": -np.clip(impact, *self.impact_cost_range),
        }

    def total(self, parts: dict[str, Floats]) -> Floats:
        return super().total(parts) + 1.0

    def info(self, now: Moment) -> dict[str, Floats]:
        return self.reset_info(now)

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            **super().reset_info(now),
            "z_distance_from_origin": now.qpos[..., 2] - now.model.qpos0[2],
        }
