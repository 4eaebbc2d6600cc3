"""HalfCheetah and Swimmer; Hopper and Walker2d, which must not fall: move forward in a plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment, state_vector
from stepcore.gymnasium.tasks.mujoco_task import ForwardTask, StandingTask, observed


@dataclass(frozen=True, kw_only=True)
class HalfCheetah(ForwardTask):
    """The options are those of gymnasium's HalfCheetah-v5."""

    normal: ClassVar[bool] = True

    xml_file: str = "half_cheetah.xml"


@dataclass(frozen=True, kw_only=True)
class Swimmer(ForwardTask):
    """The options are those of gymnasium's Swimmer-v5."""

    axes: ClassVar[str] = "xy"

    xml_file: str = "swimmer.xml"
    frame_skip: int = 4
    ctrl_cost_weight: float = 1e-4


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


@dataclass(frozen=True, kw_only=True)
class Hopper(Upright):
    """The options are those of gymnasium's Hopper-v5."""

    xml_file: str = "hopper.xml"
    healthy_state_range: tuple[float, float] = (-100.0, 100.0)
    healthy_z_range: tuple[float, float] = (0.7, np.inf)
    healthy_angle_range: tuple[float, float] = (-0.2, 0.2)

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        state = within(state_vector(now)[..., 2:], self.healthy_state_range)
        return super().healthy(now) & np.all(state, axis=-1)


@dataclass(frozen=True, kw_only=True)
class Walker2d(Upright):
    """The options are those of gymnasium's Walker2d-v5."""

    xml_file: str = "walker2d_v5.xml"
    healthy_z_range: tuple[float, float] = (0.8, 2.0)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)
