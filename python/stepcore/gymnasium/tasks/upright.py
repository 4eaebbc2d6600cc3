"""The common part of Hopper and Walker2d: move forward in a plane without falling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.mujoco_task import MujocoTask, observed, squares, uniform, velocity

# Observed velocities are clipped to this on either side [m/s or rad/s].
FASTEST = 10.0


@dataclass(frozen=True, kw_only=True)
class Upright(MujocoTask):
    """A walker whose qpos begins with x, height z and the angle of the torso."""

    frame_skip: int = 4
    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float = 1e-3
    healthy_reward: float = 1.0
    terminate_when_unhealthy: bool = True
    healthy_z_range: tuple[float, float] = (0.0, np.inf)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)
    reset_noise_scale: float = 5e-3
    exclude_current_positions_from_observation: bool = True

    def observe(self, now: Moment) -> Floats:
        excluded = int(self.exclude_current_positions_from_observation)
        return observed(now, excluded, np.clip(now.qvel, -FASTEST, FASTEST))

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        """Return whether the walker stands, shape ()."""
        height = within(now.qpos[..., 1], self.healthy_z_range)
        return height & within(now.qpos[..., 2], self.healthy_angle_range)

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {
            "reward_forward": self.forward_reward_weight * velocity(now, "qpos", (..., 0)),
            "reward_ctrl": -self.ctrl_cost_weight * squares(now.action),
            "reward_survive": self.healthy(now) * self.healthy_reward,
        }

    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        return ~self.healthy(now) & self.terminate_when_unhealthy

    def info(self, now: Moment) -> dict[str, Floats]:
        return {**self.reset_info(now), "x_velocity": velocity(now, "qpos", (..., 0))}

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            "x_position": now.qpos[..., 0],
            "z_distance_from_origin": now.qpos[..., 1] - now.model.qpos0[1],
        }

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        return uniform(model, rng, self.reset_noise_scale)


def within(value: Floats, interval: tuple[float, float]) -> NDArray[np.bool_]:
    """Return whether values are within an open interval."""
    low, high = interval
    return (low < value) & (value < high)
