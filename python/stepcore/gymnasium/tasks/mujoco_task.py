"""`MujocoTask`: the common part of gymnasium's MuJoCo tasks, version 5."""

from __future__ import annotations

import os
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.gymnasium.snapshot import Moment
from stepcore.gymnasium.task import Outcome, Task
from stepcore.loading import find_asset, find_scene

# Each file of gymnasium stands in the folder of this one.
KNOWN_FILE = "mujoco/assets/half_cheetah"


@dataclass(frozen=True, kw_only=True)
class MujocoTask(Task):
    """One of gymnasium's MuJoCo tasks. `gymnasium.make` takes its fields.

    xml_file: a file among gymnasium's own models, or a path that begins with ".", "~" or "/".
    """

    xml_file: str = ""
    frame_skip: int = 5

    def model(self) -> Model:
        return find_scene(model_path(self.xml_file)).compile()

    @abstractmethod
    def parts(self, now: Moment) -> dict[str, Floats]:
        """Return the terms of the reward by name, for `info`."""

    def total(self, parts: dict[str, Floats]) -> Floats:
        """Return the reward."""
        return np.sum(list(parts.values()), axis=0)

    def outcome(self, now: Moment) -> Outcome:
        parts = self.parts(now)
        return self.total(parts), self.terminated(now), {**self.info(now), **parts}


@dataclass(frozen=True, kw_only=True)
class NoisyTask(MujocoTask):
    """A task that begins near the initial state of its model.

    The draws are gymnasium's, in their order.
    """

    # Whether the noise of the first velocities is normal; else it is uniform.
    normal: ClassVar[bool] = False

    reset_noise_scale: float = 0.1

    def start(self, model: Model, rng: np.random.Generator) -> tuple[Floats, Floats]:
        scale = self.reset_noise_scale
        qpos = model.qpos0 + rng.uniform(low=-scale, high=scale, size=model.nq)
        if self.normal:
            return qpos, scale * rng.standard_normal(model.nv)
        return qpos, rng.uniform(low=-scale, high=scale, size=model.nv)


@dataclass(frozen=True, kw_only=True)
class ForwardTask(NoisyTask):
    """Move forward along x."""

    # The coordinates of the place, with which qpos begins.
    axes: ClassVar[str] = "x"

    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float = 0.1
    exclude_current_positions_from_observation: bool = True

    def observe(self, now: Moment) -> Floats:
        excluded = len(self.axes) * self.exclude_current_positions_from_observation
        return observed(now, excluded, now.qvel)

    def main_velocity(self, now: Moment, axis: int) -> Floats:
        """Return the velocity along an axis, shape ()."""
        return velocity(now, "qpos", (..., axis))

    def parts(self, now: Moment) -> dict[str, Floats]:
        return {
            "reward_forward": self.forward_reward_weight * self.main_velocity(now, 0),
            "reward_ctrl": -self.ctrl_cost_weight * squares(now.action),
        }

    def info(self, now: Moment) -> dict[str, Floats]:
        speeds = {f"{x}_velocity": self.main_velocity(now, k) for k, x in enumerate(self.axes)}
        return {**self.reset_info(now), **speeds}

    def reset_info(self, now: Moment) -> dict[str, Floats]:
        place = {f"{x}_position": now.qpos[..., k] for k, x in enumerate(self.axes)}
        if len(self.axes) > 1:
            place["distance_from_origin"] = distance(now.qpos[..., : len(self.axes)])
        return place


@dataclass(frozen=True, kw_only=True)
class StandingTask(ForwardTask):
    """Move forward without falling."""

    healthy_reward: float = 1.0
    terminate_when_unhealthy: bool = True

    @abstractmethod
    def healthy(self, now: Moment) -> NDArray[np.bool_]:
        """Return whether the robot stands, shape ()."""

    def parts(self, now: Moment) -> dict[str, Floats]:
        survive: Any = self.healthy(now) * self.healthy_reward
        return {**super().parts(now), "reward_survive": survive}

    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        return ~self.healthy(now) & self.terminate_when_unhealthy


def model_path(xml_file: str) -> str:
    """Return the path of a model by gymnasium's rule."""
    if not isinstance(xml_file, str):
        raise ValueError(f"xml_file = {checks.shown(xml_file)}: must be a text")
    path = Path(os.path.expanduser(xml_file))
    if not xml_file.startswith((".", "~", "/")):
        path = find_asset("gymnasium", KNOWN_FILE).parent / xml_file
    if not path.exists():
        known = sorted(file.name for file in path.parent.glob("*.xml"))
        near = checks.nearest(path.name, known)
        raise ValueError(f"xml_file = {checks.shown(xml_file)}: there is no such file{near}")
    return str(path)


def squares(values: NDArray[Any]) -> Any:
    """Return the sum of squares over the last axis."""
    return np.sum(np.square(values), axis=-1)


def distance(x: Floats) -> Floats:
    """Return the length of vectors, shape (…, k)."""
    return np.sqrt(squares(x))


def velocity(now: Moment, name: str, index: Any) -> Floats:
    """Return the mean rate of entries of an array since the last action."""
    after, before = getattr(now, name)[index], getattr(now.before, name)[index]
    return (after - before) / now.dt


def observed(now: Moment, excluded: int, qvel: Floats) -> Floats:
    """Return qpos without its first entries, and the velocities."""
    return np.concatenate([now.qpos[..., excluded:], qvel], axis=-1)
