"""Humanoid: walk forward on two legs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.human import Human
from stepcore.gymnasium.tasks.mujoco_task import StandingTask, distance, squares, velocity
from stepcore.gymnasium.tasks.upright import within

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
