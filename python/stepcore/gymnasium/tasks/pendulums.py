"""InvertedPendulum and InvertedDoublePendulum: balance one pole or two on a cart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

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


# Observed velocities and forces are clipped to this on either side.
LARGEST = 10.0


@dataclass(frozen=True, kw_only=True)
class InvertedDoublePendulum(NoisyTask):
    """The options are those of gymnasium's InvertedDoublePendulum-v5."""

    normal: ClassVar[bool] = True
    late: ClassVar[tuple[str, ...]] = ("site_xpos", "constraint_force")  # type: ignore[misc]

    xml_file: str = "inverted_double_pendulum.xml"
    healthy_reward: float = 10.0

    def observe(self, now: Moment) -> Floats:
        angles = now.qpos[..., 1:]
        parts = [now.qpos[..., :1], np.sin(angles), np.cos(angles)]
        forces = (now.qvel, now.constraint_force[..., :1])
        parts += [np.clip(values, -LARGEST, LARGEST) for values in forces]
        return np.concatenate(parts, axis=-1)

    def parts(self, now: Moment) -> dict[str, Floats]:
        x, z = now.site_xpos[..., 0, 0], now.site_xpos[..., 0, 2]
        first, second = now.qvel[..., 1], now.qvel[..., 2]
        return {
            "reward_survive": ~self.terminated(now) * self.healthy_reward,
            "distance_penalty": -(0.01 * np.square(x) + np.square(z - 2)),
            "velocity_penalty": -(1e-3 * np.square(first) + 5e-3 * np.square(second)),
        }

    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        return now.site_xpos[..., 0, 2] <= 1
