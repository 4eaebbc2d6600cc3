"""InvertedPendulum: balance a pole on a cart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.gymnasium.snapshot import Moment, state_vector
from stepcore.gymnasium.tasks.mujoco_task import NoisyTask

# An episode is over when the pole leans more than this [rad].
LEANING = 0.2


@dataclass(frozen=True, kw_only=True)
class InvertedPendulum(NoisyTask):
    """The options are those of gymnasium's InvertedPendulum-v5."""

    xml_file: str = "inverted_pendulum.xml"
    frame_skip: int = 2
    reset_noise_scale: float = 0.01

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {"reward_survive": (~self.terminated(now)).astype(np.int64)}

    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        finite = np.all(np.isfinite(state_vector(now)), axis=-1)
        return ~finite | (np.abs(now.qpos[..., 1]) > LEANING)
