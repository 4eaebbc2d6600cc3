"""HalfCheetah: run forward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.mujoco_task import MujocoTask, observed, squares, uniform, velocity


@dataclass(frozen=True, kw_only=True)
class HalfCheetah(MujocoTask):
    """The options are those of gymnasium's HalfCheetah-v5."""

    xml_file: str = "half_cheetah.xml"
    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float = 0.1
    reset_noise_scale: float = 0.1
    exclude_current_positions_from_observation: bool = True

    def observe(self, now: Moment) -> Floats:
        return observed(now, int(self.exclude_current_positions_from_observation), now.qvel)

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {
            "reward_forward": self.forward_reward_weight * velocity(now, "qpos", (..., 0)),
            "reward_ctrl": -self.ctrl_cost_weight * squares(now.action),
        }

    def info(self, now: Moment) -> dict[str, Floats]:
        return {**self.reset_info(now), "x_velocity": velocity(now, "qpos", (..., 0))}

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        return {"x_position": now.qpos[..., 0]}

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        return uniform(model, rng, self.reset_noise_scale, qvel=False)
