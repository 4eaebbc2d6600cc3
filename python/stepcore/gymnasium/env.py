"""`Env` and `VectorEnv`: one world, or many, as an environment of gymnasium."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, Unpack

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.sim import Sim
from stepcore.gymnasium.env_core import MODES, EnvCore, Picture
from stepcore.gymnasium.moment import owned
from stepcore.gymnasium.task import Source, Task, TaskFields, takes_task, task_of

Mask = NDArray[np.bool_]
Step = tuple[Floats, Floats, Mask, Mask, dict[str, Any]]


class Env(gymnasium.Env[Floats, NDArray[Any]]):
    """One world of a model as an environment of gymnasium.

    model: a `Model`, a `Scene`, the path of an MJCF file, or a `Task`, which already has these
        functions.
    observe: a function of a `Moment` that returns the observation, shape (k,); by default qpos and
        qvel.
    reward: a function of a `Moment` that returns a number; by default 0.
    terminated: a function of a `Moment` that returns whether the episode is over; by default never.
    info: a function of a `Moment` that returns a dict of further information after an action.
    reset: a function of the model and a `numpy.random.Generator` that returns the first qpos and
        qvel; by default the model's initial pose at rest. For three arguments see `Task.start`.
    frame_skip: steps of the engine for each action.
    action_space, observation_space: a `gymnasium.spaces.Box`; by default the actuators' control
        ranges, in float32, and any numbers in float64. Actions beyond the space are not clipped:
        the actuators clamp their controls.
    settings: a `Settings`, or a dict of some of its fields, which replaces the model's settings.
    dtype: number type of the observations, such as ``numpy.float32``; by default the type of the
        observation space.
    render_mode: "rgb_array" to let `render` draw the world, with the needs of `stepcore.picture`.
    width, height: size of a picture, in pixels.

    The same functions make a `VectorEnv`, if they allow a leading axis of worlds:
    ``now.qpos[..., 0]``, not ``now.qpos[0]``.

    An action after which the motion is not finite ends the episode: the world is in its last finite
    state, `terminated` is True, and ``info["failure"]`` is the post-mortem.

    Raises ValueError for a model that cannot be compiled and functions that return another shape.

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
        self._task = task_of(Env, model, task)
        core = EnvCore("Env", self._task, settings, dtype, render_mode, width, height)
        self._env_core, self.render_mode = core, render_mode
        self.action_space = core.action_space
        self.observation_space = core.observation_space  # type: ignore[assignment]
        self._begun = False
        self.metadata = core.metadata  # type: ignore[misc]

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
        _no_options(options)
        first = self._env_core.begin(np.arange(1), [self.np_random])
        self._begun = True
        info = self._task.reset_info(first)
        observation = owned(self._task.observe(first)[0], self.observation_space.dtype)
        return observation, {name: owned(value[0]) for name, value in info.items()}

    def step(self, action: NDArray[Any]) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Take an action, shape (nu,); see `gymnasium.Env.step`. The episode is never truncated."""
        if not self._begun:
            raise gymnasium.error.ResetNeeded("Env.step: call reset first")
        now, errors = self._env_core.act(action)
        reward, terminated, info = self._task.outcome(now)
        info = {name: owned(value) for name, value in info.items()}
        if errors:
            terminated, info["failure"] = np.array(True), str(errors[0])
        observation = owned(self._task.observe(now), self.observation_space.dtype)
        self._env_core.keep(now)
        return observation, float(reward), bool(terminated), False, info

    def render(self) -> Picture | None:
        """Draw the world, shape (height, width, 3); return None without a `render_mode`."""
        return self._env_core.draw()

    def close(self) -> None:
        """Free the renderer."""
        self._env_core.close()


class VectorEnv(gymnasium.vector.VectorEnv[Floats, NDArray[Any], NDArray[Any]]):
    """Many worlds of a model as one vector environment, which steps them in one `Batch`.

    model, observe, reward, terminated, info, reset, frame_skip, action_space, observation_space,
    settings, dtype: as for `Env`; the spaces are for one world.
    num_envs: the number of worlds.
    max_episode_steps: the number of actions after which an episode is truncated; None for never.
    autoreset_mode: the treatment of a world whose episode is over, as gymnasium's `AutoresetMode`
        or its value. "NextStep": the next call of `step` resets it, whatever its action.
        "SameStep": it is reset at once, and ``infos["final_obs"]`` and ``infos["final_info"]``
        describe its end. "Disabled": call `reset` with ``options={"reset_mask": …}`` for it.
    copy: False returns the same array of observations from each call, which every call overwrites,
        so that a view of it (``torch.from_numpy``, DLPack) is made once.
    threads, lanes: as for a `Batch`.
    render_mode, width, height: as for `Env`; `render` draws every world.

    A world is bit-identical to an `Env` with the same seed; `reset(seed=s)` seeds world i with
    s + i. A world whose motion is not finite ends only its episode, as in `Env`;
    ``infos["failure"]`` has its post-mortem.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": MODES}  # type: ignore[misc]

    @takes_task
    def __init__(
        self,
        model: Source | Task,
        num_envs: int,
        *,
        settings: Settings | Mapping[str, Any] | None = None,
        dtype: Any = None,
        copy: bool = True,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        lanes: bool | Literal["auto"] = "auto",
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
        **task: Unpack[TaskFields],
    ) -> None:
        self.render_mode = render_mode
        self.num_envs = checks.count("num_envs", num_envs)
        if max_episode_steps is not None:
            checks.count("max_episode_steps", max_episode_steps)
        self._most = np.inf if max_episode_steps is None else max_episode_steps
        self._task = task_of(VectorEnv, model, task)
        drawn, how = (render_mode, width, height), {"threads": threads, "lanes": lanes}
        core = EnvCore("VectorEnv", self._task, settings, dtype, *drawn, n=self.num_envs, how=how)
        self._env_core = core
        self._copy: bool = checks.flag("VectorEnv", "copy", copy)
        self.single_action_space = core.action_space
        self.single_observation_space = core.observation_space
        self.action_space = batch_space(core.action_space, self.num_envs)
        self.observation_space = batch_space(core.observation_space, self.num_envs)
        modes = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode) and autoreset_mode not in modes:
            limit = "one of " + ", ".join(modes)
            raise ValueError(f"autoreset_mode = {checks.shown(autoreset_mode)}: must be {limit}")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        metadata = {**core.metadata, "autoreset_mode": self.autoreset_mode}
        self.metadata = metadata  # type: ignore[misc]
        self._rngs: list[np.random.Generator] = []
        self._seeds: list[int] = []
        self._observations = np.zeros((0, 0))
        self._elapsed = np.zeros(self.num_envs, dtype=np.int64)
        self._over = np.zeros(self.num_envs, dtype=bool)

    @property
    def batch(self) -> Batch:
        """The `Batch` of this environment."""
        world = self._env_core.world
        assert isinstance(world, Batch)
        return world

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        return self._env_core.dt

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator of each world."""
        self._seed([None] * self.num_envs)
        return tuple(self._rngs)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each world's generator."""
        self._seed([None] * self.num_envs)
        return tuple(self._seeds)

    # Resets.

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode in every world, or in the worlds of options["reset_mask"].

        seed: world i is seeded with seed + i, or with seed[i]; None continues with its generator.
        options: only "reset_mask": which worlds to reset, shape (n,). The observations of the
            others do not change.

        Raises ValueError for a mask or seeds of another length.
        """
        options = dict(options or {})
        reset_mask = options.pop("reset_mask", None)
        mask: Mask = (
            np.ones(self.num_envs, dtype=bool) if reset_mask is None else np.asarray(reset_mask)
        )
        if mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            limit = f"{self.num_envs} truth values, one of them True"
            raise ValueError(f"reset_mask = {checks.shown(reset_mask)}: must be {limit}")
        _no_options(options)
        seeds: Sequence[int | None]
        if seed is None or isinstance(seed, (int, np.integer)):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries: must be {self.num_envs}")
        self._seed([seed if chosen else None for seed, chosen in zip(seeds, mask, strict=True)])
        if not len(self._observations):
            if not mask.all():
                raise ValueError("reset_mask: must be True everywhere in the first reset")
            space = self.observation_space
            self._observations = np.zeros(space.shape or (), dtype=space.dtype)
        infos = self._begin(mask, {})
        return self._shown(), infos

    def _seed(self, seeds: Sequence[int | None]) -> None:
        """Create generators for worlds with a seed, and for worlds without a generator."""
        if not self._rngs:
            generators = [seeding.np_random(seed) for seed in seeds]
            self._rngs, self._seeds = [rng for rng, _ in generators], [own for _, own in generators]
            return
        for world, seed in enumerate(seeds):
            if seed is not None:
                self._rngs[world], self._seeds[world] = seeding.np_random(seed)

    def _begin(self, mask: Mask, infos: dict[str, Any]) -> dict[str, Any]:
        """Begin and observe episodes in worlds; return `infos` with their information added."""
        worlds = np.flatnonzero(mask)
        first = self._env_core.begin(worlds, [self._rngs[world] for world in worlds])
        self._observations[worlds] = self._task.observe(first)
        self._elapsed[worlds], self._over[worlds] = 0, False
        return _masked(infos, self._task.reset_info(first), mask)

    def _shown(self) -> Floats:
        return self._observations.copy() if self._copy else self._observations

    # Actions.

    def step(self, actions: NDArray[Any]) -> Step:
        """Take an action in every world, shape (n, nu); see `gymnasium.vector.VectorEnv.step`."""
        if not len(self._observations):
            raise gymnasium.error.ResetNeeded("VectorEnv.step: call reset first")
        over = self._over.copy()
        if self.autoreset_mode is AutoresetMode.DISABLED and over.any():
            listed = checks.shown(np.flatnonzero(over).tolist())
            raise gymnasium.error.ResetNeeded(
                f'worlds {listed} are over: reset them with options={{"reset_mask": …}}'
            )
        drawn = self._env_core.streams.counts()
        now, errors = self._env_core.act(actions)
        rewards, terminated, info = self._task.outcome(now)
        rewards = np.array(rewards, dtype=np.float64)
        terminated = np.array(terminated, dtype=bool)
        if errors:
            terminated[list(errors)] = True
            texts = {world: str(error) for world, error in errors.items()}
            info = {**info, "failure": _objects(self.num_envs, texts)}
        self._observations[...] = self._task.observe(now)
        self._env_core.keep(now)
        self._elapsed += 1
        truncated = self._elapsed >= self._most
        if over.any():
            # Their episodes had ended: discard this step and the numbers drawn in it.
            self._env_core.streams.rewind(over, drawn)
            rewards[over], terminated[over], truncated[over] = 0.0, False, False
            infos = self._begin(over, _masked({}, info, ~over))
        elif self.autoreset_mode is AutoresetMode.SAME_STEP and (terminated | truncated).any():
            ended = terminated | truncated
            last = {k: self._observations[k].copy() for k in np.flatnonzero(ended).tolist()}
            finals = {
                "final_obs": _objects(self.num_envs, last),
                "_final_obs": ended.copy(),
                "final_info": _masked({}, info, ended),
                "_final_info": ended.copy(),
            }
            infos = self._begin(ended, _masked(finals, info, ~ended))
        else:
            infos = _masked({}, info, np.ones(self.num_envs, dtype=bool))
        if self.autoreset_mode is not AutoresetMode.SAME_STEP:
            self._over = terminated | truncated
        return self._shown(), rewards, terminated, truncated, infos

    # Attributes of the worlds, as in gymnasium's `SyncVectorEnv`.

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Read an attribute of each world, or call the task's method of this name.

        name: an array of `Moment.state`, an attribute of the task, or an attribute of an `Env`,
            such as "dt" or "np_random". One task serves all worlds: its method is called once.

        Returns an entry for each world. Raises AttributeError for an unknown name.
        """
        state = self._env_core.state
        if name in state:
            return tuple(np.array(row)[()] for row in state[name])
        if name in ("np_random", "np_random_seed", "render"):
            each = getattr(self, name)
            return tuple((each() if callable(each) else each) or [None] * self.num_envs)
        if name in ("action_space", "observation_space"):
            return (getattr(self, f"single_{name}"),) * self.num_envs
        owner: Any = self._task if hasattr(self._task, name) else self
        if name.startswith("_") or not hasattr(owner, name):
            near = checks.nearest(name, [*state, *dir(self._task), "dt", "np_random"])
            raise AttributeError(f"a world has no {checks.quoted(name)}{near}")
        value = getattr(owner, name)
        return (value(*args, **kwargs) if callable(value) else value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Read an attribute of each world; see `call`."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an array of `Moment.state`, or an attribute of the task, which all worlds share.

        values: a list or tuple with an entry for each world, or one value for all.

        Raises ValueError for another number of values, or different ones for an attribute of the
        task.
        """
        each = list(values) if isinstance(values, (list, tuple)) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(f"values has {len(each)} entries: must be {self.num_envs}")
        if name in self._env_core.state:
            self._env_core.state[name][...] = np.array(each)
            return
        if any(value is not each[0] and value != each[0] for value in each):
            limit = "the same in all worlds, which share the task"
            raise ValueError(f"values of {checks.quoted(name)}: must be {limit}")
        if name.startswith("_") or not hasattr(self._task, name):
            near = checks.nearest(name, [*self._env_core.state, *dir(self._task)])
            raise AttributeError(f"a world has no {checks.quoted(name)} that can be set{near}")
        setattr(self._task, name, each[0])

    def render(self) -> tuple[Picture, ...] | None:
        """Draw every world, (height, width, 3) each; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        return tuple(self._env_core.draw(world) for world in range(self.num_envs))  # type: ignore[misc]

    def close_extras(self, **options: Any) -> None:
        """Free the renderer."""
        self._env_core.close()


def _no_options(options: Mapping[str, Any] | None) -> None:
    if options:
        raise ValueError(f"options = {checks.shown(options)}: must be empty, a reset has none")


# Information of many worlds, in the form of gymnasium's vector environments: each name has an array
# with the worlds first, and a mask "_name" of the worlds with an entry; the others have 0 or None.


def _masked(infos: dict[str, Any], info: dict[str, Any], mask: Mask) -> dict[str, Any]:
    """Add the entries of the worlds of a mask to `infos`."""
    for name, value in info.items():
        rows, worlds = np.asarray(value), np.flatnonzero(mask)
        if len(rows) == len(mask):
            rows = rows[worlds]
        if rows.dtype == object:
            present = np.array([row is not None for row in rows], dtype=bool)
            rows, worlds = rows[present], worlds[present]
        if len(worlds):
            empty = np.full((len(mask), *rows.shape[1:]), None if rows.dtype == object else 0)
            infos.setdefault(name, empty.astype(rows.dtype))[worlds] = rows
            infos.setdefault(f"_{name}", np.zeros(len(mask), dtype=bool))[worlds] = True
    return infos


def _objects(n: int, entries: Mapping[int, Any]) -> NDArray[Any]:
    """Return an array of n objects: the entries of some worlds, None for the others."""
    objects = np.full(n, None, dtype=object)
    for world, entry in entries.items():
        objects[world] = entry
    return objects
