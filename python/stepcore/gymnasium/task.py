"""`Task`: observation, reward, and how an episode begins and ends."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, TypedDict

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.world import compiled
from stepcore.gymnasium.snapshot import Moment, state_vector
from stepcore.reading import load
from stepcore.scene.scene import Scene
from stepcore.signatures import F, annotation, keyword, refuse_unknown, spell_out

Source = Model | Scene | str | os.PathLike[str]
Outcome = tuple[Floats, NDArray[np.bool_], dict[str, Any]]


class Task(ABC):
    """The functions of an environment. Subclass it for a task of your own.

    Each function takes a `Moment` and serves one world and many: its arrays have the worlds, if
    there are many, as their first axis, and what it returns has them too.
    """

    # Steps of the engine for each action.
    frame_skip: int = 1
    # Arrays that are read as MuJoCo has them after mj_step: of where the step last evaluated forces
    # and not of where it arrived.
    late: tuple[str, ...] = ()

    @abstractmethod
    def model(self) -> Model:
        """The compiled model."""

    def observe(self, now: Moment) -> Floats:
        """Return the observation, shape (k,); by default qpos and qvel."""
        return state_vector(now)

    def reward(self, now: Moment) -> Floats:
        """Return the reward, shape ()."""
        return np.zeros(now.shape)

    def terminated(self, now: Moment) -> NDArray[np.bool_]:
        """Return whether the episode is over, shape ()."""
        return np.zeros(now.shape, dtype=bool)

    def info(self, now: Moment) -> dict[str, Any]:
        """Return further information after an action, by name."""
        return {}

    def reset_info(self, now: Moment) -> dict[str, Any]:
        """Return further information after a reset, by name."""
        return {}

    def outcome(self, now: Moment) -> Outcome:
        """Return reward, termination and information after an action."""
        return self.reward(now), self.terminated(now), self.info(now)

    def start(self, model: Model, rng: np.random.Generator) -> tuple[ArrayLike, ArrayLike]:
        """Draw qpos and qvel of one world's first state with its own generator."""
        return model.qpos0, np.zeros(model.nv)

    def action_space(self, model: Model) -> Box:
        """The action space: controls within the ranges of the actuators."""
        low, high = model.actuator_ctrlrange.astype(np.float32).T
        return Box(low, high, dtype=np.float32)

    def observation_space(self, size: int) -> Box:
        """The observation space: unbounded, of the size that `observe` returns."""
        return Box(-np.inf, np.inf, (size,), dtype=np.float64)


Function = Callable[[Moment], Any]


class TaskFields(TypedDict, total=False):
    """The arguments of `Env` and `VectorEnv` that make the task of a model."""

    observe: Function | None
    reward: Function | None
    terminated: Function | None
    info: Function | None
    reset: Any
    frame_skip: int
    action_space: Box | None
    observation_space: Box | None


def takes_task(function: F) -> F:
    """Decorate a function: its signature lists each field of `TaskFields` as a keyword."""
    hints = TaskFields.__annotations__.items()
    defaults = {"frame_skip": 1}
    return spell_out(function, [keyword(k, defaults.get(k), annotation(v)) for k, v in hints])


# The arguments of `Env` that are spaces, and no functions.
SPACES = ("action_space", "observation_space")


class FunctionTask(Task):
    """A task of a model and functions, which replace those of `Task`."""

    def __init__(self, source: Source, frame_skip: int, given: Mapping[str, Any]) -> None:
        self.source, self.frame_skip = source, frame_skip
        self.spaces = {name: given[name] for name in SPACES if name in given}
        for name in given.keys() - self.spaces:
            # As a method of this task; it is no function of a class, so it gets no self.
            setattr(self, "start" if name == "reset" else name, given[name])

    def model(self) -> Model:
        source = self.source
        return compiled(load(source) if isinstance(source, (str, os.PathLike)) else source)

    def action_space(self, model: Model) -> Box:
        return self.spaces.get("action_space") or super().action_space(model)

    def observation_space(self, size: int) -> Box:
        return self.spaces.get("observation_space") or super().observation_space(size)


def task_of(owner: Callable[..., Any], model: Source | Task, fields: Mapping[str, Any]) -> Task:
    """Return a `Task` unchanged, or make the task of a model with these functions.

    owner: the class that is called, for errors. fields: its `TaskFields`.

    Raises ValueError for functions beside a `Task`, which has its own, and for a function that
    cannot be called.
    """
    refuse_unknown(owner, fields)
    given = {name: value for name, value in fields.items() if value is not None}
    frame_skip = given.pop("frame_skip", 1)
    if isinstance(model, Task):
        if given or frame_skip != 1:
            name = next(iter(given), "frame_skip")
            raise ValueError(f"{name}: must be the task's own, not given beside a Task")
        return model
    for name, value in given.items():
        if not (isinstance(value, Box) if name in SPACES else callable(value)):
            limit = "a gymnasium.spaces.Box" if name in SPACES else "a function"
            raise ValueError(f"{name} = {checks.shown(value)}: must be {limit}")
    return FunctionTask(model, checks.count("frame_skip", frame_skip), given)
