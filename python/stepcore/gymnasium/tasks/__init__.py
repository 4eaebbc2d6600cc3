"""The table of gymnasium's MuJoCo tasks."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from stepcore.gymnasium.env import Env
from stepcore.gymnasium.task import Task
from stepcore.gymnasium.vector_env import VectorEnv


class Entry(NamedTuple):
    """module: of the class with this name. The other fields are gymnasium's registered limits."""

    module: str
    max_episode_steps: int
    reward_threshold: float | None


TASKS = {
    "Ant": Entry("walkers", 1000, 6000.0),
    "HalfCheetah": Entry("walkers", 1000, 4800.0),
    "Hopper": Entry("walkers", 1000, 3800.0),
    "Humanoid": Entry("walkers", 1000, None),
    "HumanoidStandup": Entry("walkers", 1000, None),
    "InvertedDoublePendulum": Entry("pendulums", 1000, 9100.0),
    "InvertedPendulum": Entry("pendulums", 1000, 950.0),
    "Pusher": Entry("arms", 100, 0.0),
    "Reacher": Entry("arms", 50, -3.75),
    "Swimmer": Entry("walkers", 1000, 360.0),
    "Walker2d": Entry("walkers", 1000, None),
}


def named(name: str, **options: Any) -> Task:
    """Return the task with this name and these options."""
    module = import_module(f"stepcore.gymnasium.tasks.{TASKS[name].module}")
    task: Task = getattr(module, name)(**options)
    return task


# What `make` hands to `Env`, and `make_vec` to `VectorEnv`; other options are the task's.
OF_ENV = ("settings", "dtype", "render_mode", "width", "height")
OF_VECTOR_ENV = (*OF_ENV, "max_episode_steps", "autoreset_mode", "copy", "threads", "lanes")


def make(task: str, **options: Any) -> Env:
    """Make one world of a task; `gymnasium.make` calls this.

    options: of the task, and those of `Env` in `OF_ENV`.
    """
    given = {name: options.pop(name) for name in OF_ENV if name in options}
    return Env(named(task, **options), **given)


# Here gymnasium looks for the modes, to which it adds lists of pictures.
make.metadata = Env.metadata  # type: ignore[attr-defined]


def make_vec(task: str, num_envs: int, **options: Any) -> VectorEnv:
    """Make many worlds of a task; `gymnasium.make_vec` calls this.

    options: of the task, and those of `VectorEnv` in `OF_VECTOR_ENV`.
    """
    given = {name: options.pop(name) for name in OF_VECTOR_ENV if name in options}
    return VectorEnv(named(task, **options), num_envs, **given)
