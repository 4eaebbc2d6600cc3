"""Hopper: hop forward on one leg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stepcore.gymnasium.snapshot import Moment, state_vector
from stepcore.gymnasium.tasks.upright import Upright, within


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
