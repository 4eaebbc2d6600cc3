"""Vector environments in the form that libraries of reinforcement learning take.

Both functions take a `VectorEnv`, made directly or by `gymnasium.make_vec`. A world whose episode
ends must be reset in the same step (``autoreset_mode="SameStep"``), as both libraries expect.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.gymnasium.env import VectorEnv

__all__ = ["rsl_rl", "stable_baselines3"]


def stable_baselines3(envs: Any) -> Any:
    """Return a vector environment as a `VecEnv` of stable-baselines3.

    Observations are in float32. Only worlds whose episodes end have information of the step, with
    "terminal_observation" and "TimeLimit.truncated". The wrappers of stable-baselines3 do the rest:
    `VecMonitor` keeps the returns of episodes, `VecNormalize` scales observations and rewards.

    envs: the vector environment; gymnasium's are accepted too.

    Raises ValueError unless worlds are reset in the same step, and ImportError without
    stable-baselines3.

    >>> import gymnasium, stepcore.gymnasium
    >>> envs = gymnasium.make_vec("stepcore/Hopper-v0", 4, autoreset_mode="SameStep")
    >>> adapted = stable_baselines3(envs)  # doctest: +SKIP
    >>> PPO("MlpPolicy", adapted).learn(100_000)  # doctest: +SKIP
    """
    library = _library("stable_baselines3.common.vec_env", "stable-baselines3")
    envs = _with_same_step(envs)
    count = envs.num_envs

    class Adapted(library.VecEnv):  # type: ignore[name-defined, misc]
        def __init__(self) -> None:
            self.render_mode = envs.render_mode
            super().__init__(count, envs.single_observation_space, envs.single_action_space)

        def reset(self) -> np.ndarray:
            seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
            self._reset_seeds()
            return np.asarray(envs.reset(seed=seeds)[0], np.float32)

        def step_async(self, actions: np.ndarray) -> None:
            self.actions = actions

        def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
            observed, rewards, terminated, truncated, infos = envs.step(self.actions)
            done = terminated | truncated
            last: list[dict[str, Any]] = [{} for _ in range(count)]
            for world in np.flatnonzero(done).tolist():
                last[world] = {
                    **_of_world(infos["final_info"], world),
                    "terminal_observation": np.asarray(infos["final_obs"][world], np.float32),
                    "TimeLimit.truncated": bool(truncated[world] and not terminated[world]),
                }
            return np.asarray(observed, np.float32), np.asarray(rewards, np.float32), done, last

        def close(self) -> None:
            envs.close()

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            if attr_name == "render_mode":
                return [envs.render_mode] * count
            return [envs.get_attr(attr_name)[k] for k in self._get_indices(indices)]

        def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
            values = list(envs.get_attr(attr_name))
            for k in self._get_indices(indices):
                values[k] = value
            envs.set_attr(attr_name, values)

        def env_method(self, method_name: str, *args: Any, indices: Any = None, **more: Any) -> Any:
            results = envs.call(method_name, *args, **more)
            return [results[k] for k in self._get_indices(indices)]

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
            return [False for _ in self._get_indices(indices)]

        def get_images(self) -> Any:
            return envs.render()

    return Adapted()


def rsl_rl(
    envs: Any, groups: Mapping[str, slice | list[int]] | None = None, device: str = "cpu"
) -> Any:
    """Return a vector environment as a `VecEnv` of rsl_rl (5 or later).

    Each number in the information of a step that has a value per world is logged by its name, as a
    mean over the worlds: terms of the reward, misses of a command.

    envs: the vector environment; an episode needs a time limit (`max_episode_steps`).
    groups: the columns of the observation by the name of their group, for ``"obs_groups"`` of the
        runner; by default all in "policy". Columns that only the critic sees are privileged.
    device: the device of torch for observations, rewards and episode ends.

    Raises ValueError for a vector environment that is not stepcore's or resets worlds in the next
    step, and for a group without columns; ImportError without rsl_rl.

    >>> from stepcore.gymnasium import VectorEnv
    >>> groups = {"policy": slice(0, 48), "privileged": slice(48, 60)}
    >>> adapted = rsl_rl(VectorEnv(task, 512, …), groups)  # doctest: +SKIP
    >>> OnPolicyRunner(adapted, config).learn(100)  # doctest: +SKIP
    """
    library = _library("rsl_rl.env", "rsl-rl-lib")
    torch, tensordict = _library("torch", "torch"), _library("tensordict", "tensordict")
    envs = _with_same_step(envs)
    if not isinstance(envs, VectorEnv):
        raise ValueError(f"envs = {checks.shown(envs)}: must be a VectorEnv of stepcore")
    most = envs._most
    if not np.isfinite(most):
        raise ValueError("max_episode_steps = None: must be a number of actions for rsl_rl")
    (width,) = envs.single_observation_space.shape or (0,)
    columns = {
        name: np.arange(width)[chosen]
        for name, chosen in ({"policy": slice(None)} if groups is None else groups).items()
    }
    if empty := [name for name, chosen in columns.items() if not len(chosen)]:
        raise ValueError(f"groups: {checks.shown(empty[0])} has no column of {width}")

    class Adapted(library.VecEnv):  # type: ignore[name-defined, misc]
        def __init__(self) -> None:
            self.num_envs, self.max_episode_length = envs.num_envs, int(most)
            self.num_actions = envs.single_action_space.shape[0]
            self.device, self.cfg = device, {"task": type(envs).__name__}
            self.observed = envs.reset()[0]

        @property
        def episode_length_buf(self) -> Any:
            return torch.tensor(envs._elapsed, device=device)

        @episode_length_buf.setter
        def episode_length_buf(self, lengths: Any) -> None:
            envs._elapsed[:] = lengths.cpu().numpy()

        def get_observations(self) -> Any:
            parts = {
                name: torch.tensor(self.observed[:, chosen], dtype=torch.float32, device=device)
                for name, chosen in columns.items()
            }
            return tensordict.TensorDict(parts, batch_size=[self.num_envs], device=device)

        def step(self, actions: Any) -> tuple[Any, Any, Any, dict[str, Any]]:
            taken = actions.detach().cpu().numpy()
            self.observed, rewards, terminated, truncated, infos = envs.step(taken)
            extras = {
                "time_outs": torch.tensor(truncated & ~terminated, device=device),
                "log": _means(infos, self.num_envs),
            }
            rewards = torch.tensor(rewards, dtype=torch.float32, device=device)
            done = torch.tensor(terminated | truncated, dtype=torch.long, device=device)
            return self.get_observations(), rewards, done, extras

    return Adapted()


def _library(name: str, distribution: str) -> Any:
    """Return a module of a library; raise ImportError with the command that installs it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        if error.name is not None and error.name.partition(".")[0] != name.partition(".")[0]:
            raise
        text = f"this adapter needs {distribution}: pip install {distribution}"
        raise ImportError(text, name=name) from None


def _with_same_step(envs: Any) -> Any:
    """Return the environment without wrappers; refuse one that resets worlds at another time."""
    envs = envs.unwrapped
    mode = envs.metadata.get("autoreset_mode")
    mode = getattr(mode, "value", mode)
    if mode != "SameStep":
        raise ValueError(f"autoreset_mode = {checks.shown(mode)}: must be SameStep")
    return envs


def _of_world(infos: Mapping[str, Any], world: int) -> dict[str, Any]:
    """Return the information of one world out of that of all."""
    return {
        name: values[world]
        for name, values in infos.items()
        if not name.startswith("_") and infos.get(f"_{name}", {world: True})[world]
    }


def _means(infos: Mapping[str, Any], worlds: int) -> dict[str, float]:
    """Return the mean of each number of the worlds that have it, by its name."""
    means = {}
    for name, values in infos.items():
        if np.shape(values) == (worlds,) and np.issubdtype(values.dtype, np.floating):
            present = infos.get(f"_{name}", np.ones(worlds, dtype=bool))
            if present.any():
                means[f"/{name}"] = float(values[present].mean())
    return means
