"""`Moment`, the argument of a task's functions for one or many worlds; its state and its draws."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.model import Model
from stepcore.engine.noise import Noise
from stepcore.engine.sim import Sim

F = TypeVar("F", bound=Callable[..., Any])


class Draws:
    """Random numbers of some worlds, with a separate stream for each world.

    A world's numbers depend on its seed and on the count of numbers it has drawn, and neither on
    the other worlds nor on their resets.
    """

    def __init__(self, streams: Streams, worlds: Any) -> None:
        self._streams, self._worlds = streams, np.asarray(worlds)

    def uniform(
        self, low: ArrayLike = 0.0, high: ArrayLike = 1.0, size: int | None = None
    ) -> Floats:
        """Return numbers from [low, high), shape (…, size), or (…) without a size.

        low, high: numbers, or arrays of shape (size,).
        """
        return self._drawn(self._streams.noise.uniform, size, low, high)

    def normal(self, scale: ArrayLike = 1.0, size: int | None = None) -> Floats:
        """Return normal numbers of mean 0 and standard deviation `scale`; see `uniform`."""
        return self._drawn(self._streams.noise.normal, size, scale)

    def integers(self, low: int, high: int, size: int | None = None) -> NDArray[np.int64]:
        """Return whole numbers from low to high - 1; see `uniform`."""
        return np.floor(self.uniform(low, high, size)).astype(np.int64)

    def _drawn(self, draw: Callable[..., Floats], size: int | None, *bounds: ArrayLike) -> Floats:
        """Return numbers with the axes of these worlds."""
        drawn = draw(1 if size is None else size, *bounds, worlds=np.atleast_1d(self._worlds))
        last = () if size is None else (size,)
        shaped: Floats = drawn.reshape(self._worlds.shape + last)[()]
        return shaped


class Streams:
    """The streams of n worlds. A world's stream follows from the seed of its generator."""

    def __init__(self, n: int) -> None:
        self._seeds = np.zeros(n, dtype=np.int64)
        self.noise = Noise.of_seeds(self._seeds)
        self._known: list[Any] = [None] * n

    def seed(self, worlds: Iterable[int], rngs: Iterable[np.random.Generator]) -> None:
        """Restart the streams of worlds whose generators have changed."""
        new = []
        for world, rng in zip(worlds, rngs, strict=True):
            if self._known[world] is not rng:
                self._known[world] = rng
                # The generator, from which `start` may draw, does not change.
                words = rng.bit_generator.seed_seq.generate_state(1, np.uint64)
                self._seeds[world] = int(words[0] >> np.uint64(1))
                new.append(world)
        if new:
            drawn = self.noise.state()
            drawn[new] = 0
            self.noise = Noise.of_seeds(self._seeds)
            self.noise.restore(drawn)

    def counts(self) -> NDArray[np.uint64]:
        """Return the count of numbers that each world has drawn."""
        return self.noise.state()

    def rewind(self, worlds: NDArray[np.bool_], counts: NDArray[np.uint64]) -> None:
        """Reset some worlds to earlier counts, so that they draw the same numbers again."""
        self.noise.restore(np.where(worlds, counts, self.noise.state()))

    def of(self, worlds: Any) -> Draws:
        """Return the `Draws` of some worlds; a single index gives no axis of worlds."""
        return Draws(self, worlds)


class TaskState:
    """A task's arrays by name, each with an entry for every world.

    Assignment creates a missing array, with zeros in the worlds that are not assigned. Reading an
    array of all worlds returns the array itself, which may be written.
    """

    def __init__(self, arrays: dict[str, NDArray[Any]], n: int, rows: Any) -> None:
        # rows: an index of the first axis; an integer for one world without an axis.
        self.__dict__.update(_arrays=arrays, _n=n, _rows=rows)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._arrays:
            nearest = checks.nearest(name, self._arrays)
            raise AttributeError(f"state has no {checks.quoted(name)}: set it in `begin`{nearest}")
        return self._arrays[name][self._rows]

    def __setattr__(self, name: str, value: Any) -> None:
        numbers = np.asarray(value)
        if name not in self._arrays:
            axes = 0 if isinstance(self._rows, int) else 1
            entries = numbers.shape[axes:] if numbers.ndim else ()
            self._arrays[name] = np.zeros((self._n, *entries), dtype=numbers.dtype)
        array = self._arrays[name]
        if not np.can_cast(numbers.dtype, array.dtype, "same_kind"):
            text = f"holds {array.dtype.name} and was given {numbers.dtype.name}"
            raise ValueError(f"state.{name} {text}: begin with numbers of that type")
        array[self._rows] = numbers

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {array.shape}" for name, array in self._arrays.items())
        return f"<TaskState of {self._n} worlds: {shown or 'nothing'}>"


class Readings:
    """Arrays of a world by name; each is read once, when it is first needed."""

    def __init__(
        self, read: Callable[[str], Any], requested: set[str], kept: dict[str, Any] | None = None
    ) -> None:
        self._read = read
        self._asked = requested
        self._kept = {} if kept is None else kept

    def __getattr__(self, name: str) -> Any:
        # Private attributes are missing only during unpickling.
        if name.startswith("_"):
            raise AttributeError(name)
        self._asked.add(name)
        value = self._kept[name] if name in self._kept else self._read(name)
        # An attribute from now on, which Python finds without this method.
        self.__dict__[name] = value
        return value


class Moment(Readings):
    """A world after an action, or after a reset; or many worlds.

    Every array of a `Sim` is an attribute: ``now.qpos``, ``now.xpos``, ``now.sensordata``. In a
    vector environment each has the worlds as its first axis, and in a single one no such axis, so
    that ``now.qpos[..., 0]`` and ``np.sum(…, axis=-1)`` mean the same in both.

    action: the action as it was given, shape (nu,); zeros after a reset.
    before: the same arrays, and `action`, after the previous action, or after the reset.
    dt: time between two actions [s]. model: the `Model`. shape: () or (n,).
    worlds: index of each of these worlds, shape (); all worlds, except where episodes begin.
    state: the task's arrays of each world, as attributes, such as ``now.state.command``, each of
        shape (…); set in `Task.begin`.
    rng: a `Draws`: random numbers from the stream of each world.
    world: the `Sim` or the `Batch`, all worlds of it; for `Task.before_step` to write.
    """

    def __init__(
        self,
        read: Callable[[str], Any],
        requested: set[str],
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
        super().__init__(read, requested, kept)
        self.action = action
        self.before = before
        self.dt = dt
        self.model = model
        self.shape = action.shape[:-1]
        self.worlds, self.state, self.rng, self.world = worlds, state, rng, world
        # The results of functions that are computed once for each moment.
        self._results: dict[Any, Any] = {}


def owned(value: Any, dtype: Any = None) -> Any:
    """Return a copy that does not change with the world; a number for an array without axes."""
    if dtype is None and isinstance(value, np.generic):
        return value
    return np.array(value, dtype=dtype)[()]


def once(method: F) -> F:
    """Decorate a task's method of a `Moment`: the result is computed once for each moment."""

    @wraps(method)
    def looked_up(task: Any, now: Moment, *arguments: Any) -> Any:
        key = (method, *arguments)
        if key not in now._results:
            now._results[key] = method(task, now, *arguments)
        return now._results[key]

    return cast("F", looked_up)


def state_vector(now: Moment) -> Floats:
    """Return qpos followed by qvel, shape (nq + nv,)."""
    return np.concatenate([now.qpos, now.qvel], axis=-1)
