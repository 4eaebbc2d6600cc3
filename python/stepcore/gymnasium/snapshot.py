"""`Moment`: what a task's functions are given of one world or many; `TaskState`: its memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.gymnasium.draws import Draws


class TaskState:
    """Arrays of a task's own by name, each with an entry for every world.

    An assignment makes an array that is not there yet: zero in the worlds that it does not reach.
    Whoever reads many worlds gets the array itself, and may write into it.
    """

    def __init__(self, arrays: dict[str, NDArray[Any]], n: int, rows: Any) -> None:
        # rows: those at hand, as an index of the first axis; a number for a world without an axis.
        self.__dict__.update(_arrays=arrays, _n=n, _rows=rows)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._arrays:
            known = checks.nearest(name, self._arrays)
            raise AttributeError(f"state has no {checks.quoted(name)}: set it in `begin`{known}")
        return self._arrays[name][self._rows]

    def __setattr__(self, name: str, value: Any) -> None:
        given = np.asarray(value)
        if name not in self._arrays:
            axes = 0 if isinstance(self._rows, int) else 1
            own = given.shape[axes:] if given.ndim else ()
            self._arrays[name] = np.zeros((self._n, *own), dtype=given.dtype)
        array = self._arrays[name]
        if not np.can_cast(given.dtype, array.dtype, "same_kind"):
            text = f"holds {array.dtype.name} and was given {given.dtype.name}"
            raise ValueError(f"state.{name} {text}: begin with numbers of that type")
        array[self._rows] = given

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {array.shape}" for name, array in self._arrays.items())
        return f"<TaskState of {self._n} worlds: {shown or 'nothing'}>"


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
