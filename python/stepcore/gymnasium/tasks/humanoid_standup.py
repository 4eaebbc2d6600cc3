"""HumanoidStandup: stand up from the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.human import Human
from stepcore.gymnasium.tasks.mujoco_task import squares


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
