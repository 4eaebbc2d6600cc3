"""`Task`: the observation, reward, beginning and end of an episode."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypedDict

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.world import compiled
from stepcore.gymnasium.moment import Draws, Moment, state_vector
from stepcore.loading import load
from stepcore.scene.scene import Scene
from stepcore.signatures import F, annotation, keyword, refuse_unknown, spell_out

Source = Model | Scene | str | os.PathLike[str]
Values = Mapping[str, ArrayLike]
Outcome = tuple[Floats, NDArray[np.bool_], dict[str, Any]]


class Task(ABC):
    """The functions of an environment. Subclass it to define a task.

    Each function takes a `Moment` and serves one world and many: with many worlds, the arrays and
    the results have the worlds as their first axis. Shapes below are for one world.

    An episode begins with `randomize` (values of the model), `start` (positions and velocities) and
    `begin` (the task's arrays). At an action, `control` converts it to controls, `before_step` acts
    before each step of the engine, `after_action` follows the steps, and then come `reward`,
    `terminated`, `info` and `observe`. The task's arrays of each world are in ``now.state``, and
    random numbers are in ``now.rng``.

    A slider moves to a different position in each world, by a motor that is one action late:

    >>> import numpy as np
    >>> import stepcore as sc
    >>> from stepcore.gymnasium import Task, VectorEnv
    >>> class Reach(Task):
    ...     frame_skip = 10
    ...
    ...     def model(self):
    ...         scene = sc.Scene(gravity=(0, 0, 0))
    ...         body = scene.add_body("slider")
    ...         scene.add_joint(body, "slide", axis=(1, 0, 0), name="x", damping=1.0)
    ...         scene.add_geom(body, "sphere", 0.1, mass=1.0)
    ...         scene.add_actuator("x", "motor", ctrlrange=(-5, 5))
    ...         return scene.compile()
    ...
    ...     def begin(self, now):
    ...         now.state.goal = now.rng.uniform(-1, 1)
    ...         now.state.late = np.zeros((*now.shape, 1))
    ...
    ...     def control(self, now):
    ...         late, now.state.late = now.state.late.copy(), now.action
    ...         return 5 * late
    ...
    ...     def observe(self, now):
    ...         missing = now.state.goal - now.qpos[..., 0]
    ...         return np.stack([missing, now.qvel[..., 0]], axis=-1)
    ...
    ...     def reward(self, now):
    ...         return -np.abs(now.state.goal - now.qpos[..., 0])
    >>> envs = VectorEnv(Reach(), 3, dtype=np.float32)
    >>> observations, _ = envs.reset(seed=0)
    >>> observations.dtype, observations.shape
    (dtype('float32'), (3, 2))
    """

    # Steps of the engine for each action.
    frame_skip: int = 1
    # Arrays that are read as MuJoCo has them after mj_step: at the state of the step's last force
    # evaluation, not at its end.
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
        """Draw qpos and qvel of one world's first state with the generator of the world.

        With a third argument, ``start(self, model, rng, worlds)``, it serves all k worlds that
        begin together, and is much faster: rng is a `Draws`, worlds has their indices, shape (k,),
        and the result has shapes (k, nq) and (k, nv), or shapes that broadcast to these. With the
        indices each world can begin at a different origin on a shared terrain.
        """
        return model.qpos0, np.zeros(model.nv)

    def randomize(self, model: Model, rng: Draws, worlds: NDArray[np.intp]) -> Values:
        """Draw model values of k worlds that begin: arrays of shape (k,) or (k, m) by path.

        The paths are as in `Batch.param`, such as "geom/floor/friction". By default no value
        differs. A world keeps its values until its next episode begins.
        """
        return {}

    def begin(self, now: Moment) -> None:  # noqa: B027
        """Set the task's arrays of worlds that begin: ``now.state.command = …``."""

    def control(self, now: Moment) -> ArrayLike:
        """Return the controls for ``now.action``, shape (nu,); by default the action itself.

        It is called once for each action, and can scale, filter or delay it. `now` is the state
        before the action and has no `before`. The action may have a different size than the
        controls: see `action_space`.
        """
        return now.action

    def before_step(self, now: Moment, step: int) -> None:  # noqa: B027
        """Apply pushes or delays before each step of the engine; by default do nothing.

        step: from 0 to frame_skip - 1. ``now.world`` is the `Sim` or `Batch`, whose `ctrl`,
        `xfrc_applied`, `qvel` and others can be written. They keep their values; an episode begins
        without forces.
        """

    def after_action(self, now: Moment) -> None:  # noqa: B027
        """Change the task's arrays after an action, before its reward, such as new commands."""

    def action_space(self, model: Model) -> Box:
        """The action space: controls within the ranges of the actuators."""
        low, high = model.actuator_ctrlrange.astype(np.float32).T
        return Box(low, high, dtype=np.float32)

    def observation_space(self, size: int) -> Box:
        """The observation space: unbounded, of the size that `observe` returns."""
        return Box(-np.inf, np.inf, (size,), dtype=np.float64)

    def has(self, hook: str) -> bool:
        """Return whether the task overrides `control`, `before_step` or `randomize`."""
        return getattr(type(self), hook) is not getattr(Task, hook)


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


# The arguments of `Env` that are spaces, not functions.
SPACES = ("action_space", "observation_space")


class FunctionTask(Task):
    """A task of a model, with functions and spaces that replace the defaults of `Task`."""

    def __init__(self, source: Source, frame_skip: int, given: Mapping[str, Any]) -> None:
        self.source, self.frame_skip = source, frame_skip
        for name, value in given.items():
            # An attribute of the instance, so that the function gets no self.
            space = partial(_space, value) if name in SPACES else value
            setattr(self, "start" if name == "reset" else name, space)

    def model(self) -> Model:
        source = self.source
        return compiled(load(source) if isinstance(source, (str, os.PathLike)) else source)


def _space(space: Box, *_: object) -> Box:
    return space


def task_of(owner: Callable[..., Any], model: Source | Task, fields: Mapping[str, Any]) -> Task:
    """Return a `Task` unchanged, or make the task of a model with these functions.

    owner: the class that is called, for errors. fields: its `TaskFields`.

    Raises ValueError for functions in addition to a `Task`, and for a function that cannot be
    called.
    """
    refuse_unknown(owner, fields)
    fields_given = {name: value for name, value in fields.items() if value is not None}
    frame_skip = fields_given.pop("frame_skip", 1)
    if isinstance(model, Task):
        if fields_given or frame_skip != 1:
            name = next(iter(fields_given), "frame_skip")
            raise ValueError(f"{name}: must be the task's own, not given beside a Task")
        return model
    for name, value in fields_given.items():
        if not (isinstance(value, Box) if name in SPACES else callable(value)):
            limit = "a gymnasium.spaces.Box" if name in SPACES else "a function"
            raise ValueError(f"{name} = {checks.shown(value)}: must be {limit}")
    return FunctionTask(model, checks.count("frame_skip", frame_skip), fields_given)
