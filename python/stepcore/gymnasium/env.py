"""`Env`: one world as an environment of gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Unpack

import gymnasium
import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim
from stepcore.gymnasium.camera import MODES, Picture, camera_for, metadata_of
from stepcore.gymnasium.env_core import EnvCore
from stepcore.gymnasium.snapshot import owned
from stepcore.gymnasium.spaces import spaces_of
from stepcore.gymnasium.task import Source, Task, TaskFields, takes_task, task_of


class Env(gymnasium.Env[Floats, NDArray[Any]]):
    """One world of a model as an environment of gymnasium.

    model: a `Model`, a `Scene`, the path of an MJCF file, or a `Task`, which has functions of its
        own.
    observe: a function of a `Moment` that returns the observation, shape (k,); by default qpos and
        qvel.
    reward: of a `Moment`, a number; by default 0.
    terminated: of a `Moment`, whether the episode is over; by default never.
    info: of a `Moment`, a dict of further information after an action.
    reset: a function of the model and a `numpy.random.Generator` that returns the first qpos and
        qvel; by default the model's initial pose at rest. Or of three arguments: see `Task.start`.
    frame_skip: steps of the engine for each action.
    action_space, observation_space: a `gymnasium.spaces.Box`; by default the actuators' control
        ranges, in float32, and any numbers in float64. Actions beyond the space are not clipped:
        the actuators clamp their controls.
    settings: a `Settings`, or a dict of some of its fields, instead of the model's own.
    dtype: number type of the observations, such as ``numpy.float32``; by default that of the
        observation space.
    render_mode: "rgb_array" to let `render` draw the world; needs what `stepcore.picture` needs.
    width, height: of what is drawn, in points.

    The same functions make a `VectorEnv`, if they are written so that the worlds may come first:
    ``now.qpos[..., 0]``, not ``now.qpos[0]``.

    An action after which the motion is not finite ends the episode: the world stands in its last
    finite state, `terminated` is True, and ``info["failure"]`` is the post-mortem.

    Raises ValueError for what cannot be compiled and for functions that return another shape.

    >>> import numpy as np
    >>> import stepcore as sc
    >>> import stepcore.gymnasium
    >>> def height(now):
    ...     return now.qpos[..., 0]
    >>> env = sc.gymnasium.Env(sc.lesson.drop(), reward=height, frame_skip=5)
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape, env.action_space.shape
    ((2,), (0,))
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": MODES}  # type: ignore[misc]

    @takes_task
    def __init__(
        self,
        model: Source | Task,
        *,
        settings: Settings | Mapping[str, Any] | None = None,
        dtype: Any = None,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
        **task: Unpack[TaskFields],
    ) -> None:
        self._camera = camera_for("Env", render_mode, width, height)
        self.render_mode = render_mode
        self._task = task_of(Env, model, task)
        self._env_core = EnvCore(self._task, settings)
        self.action_space, self.observation_space = spaces_of(  # type: ignore[assignment]
            self._task, self._env_core, dtype
        )
        self._begun = False
        self.metadata = metadata_of(self.dt)  # type: ignore[misc]

    @property
    def sim(self) -> Sim:
        """The `Sim` of this environment."""
        world = self._env_core.world
        assert isinstance(world, Sim)
        return world

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        return self._env_core.dt

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode; see `gymnasium.Env.reset`. There are no options."""
        super().reset(seed=seed)
        no_options(options)
        first = self._env_core.begin(np.arange(1), [self.np_random])
        self._env_core.keep_only(first)
        self._begun = True
        info = self._task.reset_info(first)
        observation = owned(self._task.observe(first)[0], self.observation_space.dtype)
        return observation, {name: owned(value[0]) for name, value in info.items()}

    def step(self, action: NDArray[Any]) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Take an action, shape (nu,); see `gymnasium.Env.step`. The episode is never truncated."""
        if not self._begun:
            raise gymnasium.error.ResetNeeded("Env.step: call reset first")
        now, errors = self._env_core.act(checked(action, self.action_space.shape))
        reward, terminated, info = self._task.outcome(now)
        info = {name: owned(value) for name, value in info.items()}
        if errors:
            terminated, info["failure"] = np.array(True), str(errors[0])
        observation = owned(self._task.observe(now), self.observation_space.dtype)
        self._env_core.keep(now)
        return observation, float(reward), bool(terminated), False, info

    def render(self) -> Picture | None:
        """Draw the world, shape (height, width, 3); return None without a `render_mode`."""
        return None if self._camera is None else self._camera.draw(self.sim)

    def close(self) -> None:
        """Free the renderer."""
        if self._camera is not None:
            self._camera.close()


def checked(action: Any, shape: tuple[int, ...] | None) -> NDArray[Any]:
    """Return the action as an array of the shape of its space."""
    array = np.asarray(action)
    if array.shape != shape:
        raise ValueError(f"action has shape {array.shape}: must be {shape}")
    return array


def no_options(options: dict[str, Any] | None) -> None:
    """Refuse any option of a reset."""
    if options:
        raise ValueError(f"options = {checks.shown(options)}: must be empty, a reset has none")
