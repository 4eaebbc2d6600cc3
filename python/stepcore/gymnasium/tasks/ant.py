"""Ant: walk forward on four legs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.gymnasium.snapshot import Moment, state_vector
from stepcore.gymnasium.tasks.mujoco_task import (
    MujocoTask,
    distance,
    observed,
    squares,
    uniform,
    velocity,
)


@dataclass(frozen=True, kw_only=True)
class Ant(MujocoTask):
    """The options are those of gymnasium's Ant-v5."""

    late: ClassVar[tuple[str, ...]] = ("xpos", "cfrc_ext")  # type: ignore[misc]

    xml_file: str = "ant.xml"
    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float = 0.5
    contact_cost_weight: float = 5e-4
    healthy_reward: float = 1.0
    main_body: int | str = 1
    terminate_when_unhealthy: bool = True
    healthy_z_range: tuple[float, float] = (0.2, 1.0)
    contact_force_range: tuple[float, float] = (-1.0, 1.0)
    reset_noise_scale: float = 0.1
    exclude_current_positions_from_observation: bool = True
    include_cfrc_ext_in_observation: bool = True

    def contact_forces(self, now: Moment) -> Floats:
        """Return the clipped forces on all bodies but the world, shape (6 (nbody - 1),)."""
        forces = np.clip(now.cfrc_ext[..., 1:, :], *self.contact_force_range)
        return forces.reshape(*now.shape, -1)

    def observe(self, now: Moment) -> Floats:
        state = observed(now, 2 * self.exclude_current_positions_from_observation, now.qvel)
        if not self.include_cfrc_ext_in_observation:
            return state
        return np.concatenate([state, self.contact_forces(now)], axis=-1)

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        """Return whether the ant stands, shape ()."""
        low, high = self.healthy_z_range
        height = now.qpos[..., 2]
        finite = np.all(np.isfinite(state_vector(now)), axis=-1)
        return finite & (low <= height) & (height <= high)

    def main_velocity(self, now: Moment, axis: int) -> Floats:
        """Return the velocity of the main body along an axis, shape ()."""
        return velocity(now, "xpos", (..., now.model.index("body", self.main_body), axis))

    def parts(self, now: Moment) -> dict[str, Floats]:
        forces = self.contact_forces(now)
        return {
            "reward_forward": self.main_velocity(now, 0) * self.forward_reward_weight,
            "reward_ctrl": -self.ctrl_cost_weight * squares(now.action),
            "reward_contact": -self.contact_cost_weight * squares(forces),
            "reward_survive": self.healthy(now) * self.healthy_reward,
        }

    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        return ~self.healthy(now) & self.terminate_when_unhealthy

    def info(self, now: Moment) -> dict[str, Floats]:
        return {
            **self.reset_info(now),
            "x_velocity": self.main_velocity(now, 0),
            "y_velocity": self.main_velocity(now, 1),
        }

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            "x_position": now.qpos[..., 0],
            "y_position": now.qpos[..., 1],
            "distance_from_origin": distance(now.qpos[..., :2]),
        }

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        return uniform(model, rng, self.reset_noise_scale, qvel=False)
