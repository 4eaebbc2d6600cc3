"""Pusher: push a cylinder to a goal with an arm; Reacher: reach a target with its tip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.tasks.mujoco_task import MujocoTask, distance, squares

# The cylinder begins at least so far from its goal [m].
NEAREST = 0.17
# Joints of the arm.
ARM = 7


@dataclass(frozen=True, kw_only=True)
class Pusher(MujocoTask):
    """The options are those of gymnasium's Pusher-v5."""

    late: ClassVar[tuple[str, ...]] = ("xpos",)  # type: ignore[misc]

    xml_file: str = "pusher_v5.xml"
    reward_near_weight: float = 0.5
    reward_dist_weight: float = 1.0
    reward_control_weight: float = 0.1

    def observe(self, now: Moment) -> Floats:
        bodies = [_body(now, name) for name in ("tips_arm", "object", "goal")]
        return np.concatenate([now.qpos[..., :ARM], now.qvel[..., :ARM], *bodies], axis=-1)

    def parts(self, now: Moment) -> dict[str, Floats]:
        thing = _body(now, "object")
        far, near = (thing - _body(now, name) for name in ("goal", "tips_arm"))
        return {
            "reward_dist": -distance(far) * self.reward_dist_weight,
            "reward_ctrl": -squares(now.action) * self.reward_control_weight,
            "reward_near": -distance(near) * self.reward_near_weight,
        }

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        place = _place(rng)
        while not np.linalg.norm(place) > NEAREST:
            place = _place(rng)
        qpos = np.array(model.qpos0)
        qpos[-4:-2], qpos[-2:] = place, 0
        qvel = rng.uniform(low=-0.005, high=0.005, size=model.nv)
        qvel[-4:] = 0
        return qpos, qvel


def _place(rng: np.random.Generator) -> Floats:
    """Draw a first place of the cylinder relative to its goal [m], shape (2,)."""
    x = rng.uniform(low=-0.3, high=0, size=1)
    return np.concatenate([x, rng.uniform(low=-0.2, high=0.2, size=1)])


def _body(now: Moment, name: str) -> Floats:
    """Return the position of a body [m], shape (3,)."""
    return now.xpos[..., now.model.index("body", name), :]


# The place is within a disc of this radius [m].
FARTHEST = 0.2


@dataclass(frozen=True, kw_only=True)
class Reacher(MujocoTask):
    """The options are those of gymnasium's Reacher-v5."""

    late: ClassVar[tuple[str, ...]] = ("xpos",)  # type: ignore[misc]

    xml_file: str = "reacher.xml"
    frame_skip: int = 2
    reward_dist_weight: float = 1.0
    reward_control_weight: float = 1.0

    def observe(self, now: Moment) -> Floats:
        angles, rest = now.qpos[..., :2], now.qpos[..., 2:]
        parts = [np.cos(angles), np.sin(angles), rest, now.qvel[..., :2], _way(now)[..., :2]]
        return np.concatenate(parts, axis=-1)

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {
            "reward_dist": -distance(_way(now)) * self.reward_dist_weight,
            "reward_ctrl": -squares(now.action) * self.reward_control_weight,
        }

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        qpos = rng.uniform(low=-0.1, high=0.1, size=model.nq) + model.qpos0
        goal = rng.uniform(low=-FARTHEST, high=FARTHEST, size=2)
        while not np.linalg.norm(goal) < FARTHEST:
            goal = rng.uniform(low=-FARTHEST, high=FARTHEST, size=2)
        qpos[-2:] = goal
        qvel = rng.uniform(low=-0.005, high=0.005, size=model.nv)
        qvel[-2:] = 0
        return qpos, qvel


def _way(now: Moment) -> Floats:
    """Return the vector from the target to the fingertip [m], shape (3,)."""
    tip, target = (now.model.index("body", name) for name in ("fingertip", "target"))
    return now.xpos[..., tip, :] - now.xpos[..., target, :]
