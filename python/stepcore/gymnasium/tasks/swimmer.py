"""Swimmer: swim forward in a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.mujoco_task import (
    MujocoTask,
    distance,
    observed,
    squares,
    uniform,
    velocity,
)


@dataclass(frozen=True, kw_only=True)
class Swimmer(MujocoTask):
    """The options are those of gymnasium's Swimmer-v5."""

    xml_file: str = "swimmer.xml"
    frame_skip: int = 4
    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float = 1e-4
    reset_noise_scale: float = 0.1
    exclude_current_positions_from_observation: bool = True

    def observe(self, now: Moment) -> Floats:
        return observed(now, 2 * self.exclude_current_positions_from_observation, now.qvel)

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {
            "reward_forward": self.forward_reward_weight * velocity(now, "qpos", (..., 0)),
            "reward_ctrl": -self.ctrl_cost_weight * squares(now.action),
        }

    def info(self, now: Moment) -> dict[str, Floats]:
        return {
            **self.reset_info(now),
            "x_velocity": velocity(now, "qpos", (..., 0)),
            "y_velocity": velocity(now, "qpos", (..., 1)),
        }

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {
            "x_position": now.qpos[..., 0],
            "y_position": now.qpos[..., 1],
            "distance_from_origin": distance(now.qpos[..., :2]),
        }

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        return uniform(model, rng, self.reset_noise_scale)
