"""`Spaces`: the action and observation spaces of a task, found by a trial of its functions."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Box

from stepcore import checks
from stepcore.gymnasium.env_core import EnvCore
from stepcore.gymnasium.task import Task


def spaces_of(task: Task, core: EnvCore, dtype: Any = None) -> tuple[Box, Box]:
    """Return the spaces of one world's actions and observations.

    Raises ValueError if a function of the task returns something of another shape.
    """
    with core.trial() as now:
        shape = now.shape
        nu = len(core.model.names["actuator"])
        controls = _array("control", task.control(core.ahead(now.action)))
        action = core.action_space
        if not task.has("control") and action.shape != (nu,):
            raise ValueError(f"action_space has shape {action.shape}: must be ({nu},)")
        if controls.shape != (*shape, nu):
            raise ValueError(_text("control", controls, str((*shape, nu))))
        task.after_action(now)
        observation = _array("observe", task.observe(now))
        if observation.ndim != len(shape) + 1 or observation.shape[:-1] != shape:
            limit = f"{(*shape, 'k')}".replace("'", "")
            raise ValueError(_text("observe", observation, limit))
        reward, terminated, info = task.outcome(now)
        for name, value in (("reward", reward), ("terminated", terminated)):
            array = _array(name, value)
            if array.shape != shape:
                raise ValueError(_text(name, array, str(shape)))
        for what, infos in (("info", info), ("info after a reset", task.reset_info(now))):
            for key, value in infos.items():
                if np.shape(value)[: len(shape)] != shape:
                    text = _text(f'{what}["{key}"]', np.asarray(value), f"{shape} first")
                    raise ValueError(text)
        space: Box = task.observation_space(observation.shape[-1])
        if space.shape != observation.shape[-1:]:
            limit = str(observation.shape[-1:])
            raise ValueError(f"observation_space has shape {space.shape}: must be {limit}")
    return action, space if dtype is None else _of_type(space, dtype)


def _of_type(space: Box, dtype: Any) -> Box:
    try:
        own = np.dtype(dtype)
    except TypeError:
        own = np.dtype(object)
    if own.kind != "f":
        limit = "numpy.float32, numpy.float64 or another type of real numbers"
        raise ValueError(f"dtype = {checks.shown(dtype)}: must be {limit}")
    low, high = space.low.astype(own), space.high.astype(own)
    return Box(low, high, space.shape, own)


def _array(name: str, value: Any) -> Any:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} returned {checks.shown(value)}: must be numbers")
    return array


def _text(name: str, array: Any, limit: str) -> str:
    hint = "; write now.qpos[..., i] and axis=-1, which serve one world and many"
    return f"{name} returned shape {array.shape}: must be {limit}{hint}"
