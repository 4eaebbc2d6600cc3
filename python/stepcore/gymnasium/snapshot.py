"""`Moment`: the argument of a task's functions, for one world or many."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.gymnasium.draws import Draws
from stepcore.gymnasium.task_state import TaskState


class Readings:
    """Arrays of a world by name; each is read once, when it is first needed."""

    def __init__(
        self, read: Callable[[str], Any], asked: set[str], kept: dict[str, Any] | None = None
    ) -> None:
        self._read = read
        self._asked = asked
        self._kept = {} if kept is None else kept

    def __getattr__(self, name: str) -> Any:
        # An attribute of its own is missing only while it is being unpickled.
        if name.startswith("_"):
            raise AttributeError(name)
        self._asked.add(name)
        if name not in self._kept:
            self._kept[name] = self._read(name)
        return self._kept[name]


class Moment(Readings):
    """A world after an action, or after a reset; or many worlds.

    Every array of a `Sim` is an attribute: ``now.qpos``, ``now.xpos``, ``now.sensordata``. In a
    vector environment each has the worlds as its first axis, and in a single one no such axis, so
    that ``now.qpos[..., 0]`` and ``np.sum(…, axis=-1)`` mean the same in both.

    action: what was asked for, as it was given, shape (nu,); zeros after a reset.
    before: the same arrays, and `action`, after the action before, or after the reset.
    dt: time between two actions [s]. model: the `Model`. shape: () or (n,).
    worlds: index of each world at hand, shape (); all worlds but where episodes begin.
    state: what the task remembers of each world, as attributes, such as ``now.state.command``,
        each of shape (…); set in `Task.begin`.
    rng: a `Draws`: random numbers of each world's own stream.
    world: the `Sim` or the `Batch`, all worlds of it; for `Task.before_step` to write.
    """

    def __init__(
        self,
        read: Callable[[str], Any],
        asked: set[str],
        kept: dict[str, Any],
        *,
        action: NDArray[Any],
        before: Readings,
        dt: float,
        model: Model,
        worlds: Any,
        state: TaskState,
        rng: Draws,
        world: Sim | Batch,
    ) -> None:
        super().__init__(read, asked, kept)
        self.action = action
        self.before = before
        self.dt = dt
        self.model = model
        self.shape = action.shape[:-1]
        self.worlds, self.state, self.rng, self.world = worlds, state, rng, world


def owned(value: Any, dtype: Any = None) -> Any:
    """Return a copy that does not change with the world; a number for an array without axes."""
    return np.array(value, dtype=dtype)[()]


def state_vector(now: Moment) -> Floats:
    """qpos followed by qvel, shape (nq + nv,)."""
    return np.concatenate([now.qpos, now.qvel], axis=-1)
