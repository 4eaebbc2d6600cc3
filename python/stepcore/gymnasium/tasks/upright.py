"""The common part of Hopper and Walker2d: move forward in a plane without falling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.mujoco_task import StandingTask, observed

# Observed velocities are clipped to this on either side [m/s or rad/s].
FASTEST = 10.0


@dataclass(frozen=True, kw_only=True)
class Upright(StandingTask):
    """A walker whose qpos begins with x, height z and the angle of the torso."""

    frame_skip: int = 4
    ctrl_cost_weight: float = 1e-3
    healthy_z_range: tuple[float, float] = (0.0, np.inf)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)
    reset_noise_scale: float = 5e-3

    def observe(self, now: Moment) -> Floats:
        excluded = int(self.exclude_current_positions_from_observation)
        return observed(now, excluded, np.clip(now.qvel, -FASTEST, FASTEST))

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        height = within(now.qpos[..., 1], self.healthy_z_range)
        return height & within(now.qpos[..., 2], self.healthy_angle_range)

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        height = now.qpos[..., 1] - now.model.qpos0[1]
        return {**super().reset_info(now), "z_distance_from_origin": height}


def within(value: Floats, interval: tuple[float, float]) -> NDArray[np.bool_]:
    """Return whether values are within an open interval."""
    low, high = interval
    return (low < value) & (value < high)
