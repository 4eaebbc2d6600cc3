"""The table of gymnasium's MuJoCo tasks, one file each."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Literal, NamedTuple

from stepcore.gymnasium.env import Env
from stepcore.gymnasium.task import Task
from stepcore.gymnasium.vector_env import VectorEnv


class Entry(NamedTuple):
    """module: of the class with this name. The other fields are gymnasium's registered limits."""

    module: str
    max_episode_steps: int
    reward_threshold: float | None


TASKS = {
    "Ant": Entry("ant", 1000, 6000.0),
    "HalfCheetah": Entry("half_cheetah", 1000, 4800.0),
    "Hopper": Entry("hopper", 1000, 3800.0),
    "Humanoid": Entry("humanoid", 1000, None),
    "HumanoidStandup": Entry("humanoid_standup", 1000, None),
    "InvertedDoublePendulum": Entry("inverted_double_pendulum", 1000, 9100.0),
    "InvertedPendulum": Entry("inverted_pendulum", 1000, 950.0),
    "Pusher": Entry("pusher", 100, 0.0),
    "Reacher": Entry("reacher", 50, -3.75),
    "Swimmer": Entry("swimmer", 1000, 360.0),
    "Walker2d": Entry("walker2d", 1000, None),
}


def named(name: str, **options: Any) -> Task:
    """Return the task with this name and these options."""
    module = import_module(f"stepcore.gymnasium.tasks.{TASKS[name].module}")
    task: Task = getattr(module, name)(**options)
    return task


def make(
    task: str,
    settings: Any = None,
    render_mode: str | None = None,
    width: int = 480,
    height: int = 480,
    **options: Any,
) -> Env:
    """Make one world of a task; `gymnasium.make` calls this.

    settings, render_mode, width, height: as for `Env`. options: those of the task.
    """
    picture = {"render_mode": render_mode, "width": width, "height": height}
    return Env(named(task, **options), settings=settings, **picture)  # type: ignore[arg-type]


# Here gymnasium looks for the modes, to which it adds lists of pictures.
make.metadata = Env.metadata  # type: ignore[attr-defined]


def make_vec(
    task: str,
    num_envs: int,
    settings: Any = None,
    render_mode: str | None = None,
    width: int = 480,
    height: int = 480,
    max_episode_steps: int | None = None,
    autoreset_mode: Any = "NextStep",
    threads: int | None = None,
    lanes: bool | Literal["auto"] = "auto",
    **options: Any,
) -> VectorEnv:
    """Make many worlds of a task; `gymnasium.make_vec` calls this.

    All but `task` and the options of the task are as for `VectorEnv`.
    """
    return VectorEnv(
        named(task, **options),
        num_envs,
        settings=settings,
        render_mode=render_mode,
        width=width,
        height=height,
        max_episode_steps=max_episode_steps,
        autoreset_mode=autoreset_mode,
        threads=threads,
        lanes=lanes,
    )
