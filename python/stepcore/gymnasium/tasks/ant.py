"""Ant: walk forward on four legs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment, state_vector
from stepcore.gymnasium.tasks.mujoco_task import StandingTask, squares, velocity


@dataclass(frozen=True, kw_only=True)
class Ant(StandingTask):
    """The options are those of gymnasium's Ant-v5."""

    axes: ClassVar[str] = "xy"
    normal: ClassVar[bool] = True
    late: ClassVar[tuple[str, ...]] = ("xpos", "cfrc_ext")  # type: ignore[misc]

    xml_file: str = "ant.xml"
    ctrl_cost_weight: float = 0.5
    contact_cost_weight: float = 5e-4
    main_body: int | str = 1
    healthy_z_range: tuple[float, float] = (0.2, 1.0)
    contact_force_range: tuple[float, float] = (-1.0, 1.0)
    include_cfrc_ext_in_observation: bool = True

    def contact_forces(self, now: Moment) -> Floats:
        """Return the clipped forces on all bodies but the world, shape (6 (nbody - 1),)."""
        forces = np.clip(now.cfrc_ext[..., 1:, :], *self.contact_force_range)
        return forces.reshape(*now.shape, -1)

    def observe(self, now: Moment) -> Floats:
        state = super().observe(now)
        if not self.include_cfrc_ext_in_observation:
            return state
        return np.concatenate([state, self.contact_forces(now)], axis=-1)

    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        low, high = self.healthy_z_range
        height = now.qpos[..., 2]
        finite = np.all(np.isfinite(state_vector(now)), axis=-1)
        return finite & (low <= height) & (height <= high)

    def main_velocity(self, now: Moment, axis: int) -> Floats:
        return velocity(now, "xpos", (..., now.model.index("body", self.main_body), axis))

    def parts(self, now: Moment) -> dict[str, Floats]:
        parts = super().parts(now)
        # gymnasium adds them in this order.
        survive = parts.pop("reward_survive")
        contact = -self.contact_cost_weight * squares(self.contact_forces(now))
        return {**parts, "reward_contact": contact, "reward_survive": survive}
