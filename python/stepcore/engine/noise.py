"""`Noise`: random numbers for many worlds, with an independent stream for each world.

A number is a hash of the seed, the stream's name, the world and the count of numbers that the world
has drawn. A number therefore depends neither on the number of worlds nor on the draws of other
worlds. The hash applies SplitMix64's finaliser (Steele, Lea & Flood, "Fast splittable pseudorandom
number generators", 2014) to each of these inputs in order; a name enters by its 64-bit BLAKE2b hash
(RFC 7693). Normal numbers are quantiles of uniform numbers by Wichura's algorithm AS 241 (1988),
exact to 1e-15. Only +, −, ×, ÷ and √ are used, so results are bit-identical on every machine.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import _core, checks
from stepcore.engine.arrays import Floats, indices_of, numbers

Words = NDArray[np.uint64]
Chosen = slice | NDArray[np.intp]

GOLDEN = np.uint64(0x9E3779B97F4A7C15)


class Noise:
    """A generator of random numbers for n worlds, with an independent stream for each world.

    n: the number of worlds. The stream of world k does not depend on n.
    seed: an integer from 0 to 2**63 - 1. See `of_seeds` for a separate seed for each world.
    name: the name of the stream. Streams of different names are independent, so that noise on
        controls does not change the draws of resets.

    A world's numbers depend on the seed, the name, the index of the world and the count of numbers
    that the world has drawn. They do not depend on the other worlds, on n, or on threads.

    >>> import numpy as np
    >>> few, many = Noise(2, seed=1), Noise(1000, seed=1)
    >>> bool(np.array_equal(few.normal(3), many.normal(3)[:2]))
    True
    """

    def __init__(self, n: int, seed: int, name: str = "") -> None:
        count = checks.count("n", n)
        integer = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
        if not integer or not 0 <= seed < 1 << 63:
            raise checks.refuse("Noise", "seed", seed, "a whole number from 0 to 2**63 - 1")
        self._begin(int(seed), name, np.arange(count, dtype=np.uint64))

    @classmethod
    def of_seeds(cls, seeds: ArrayLike, name: str = "") -> Noise:
        """Return a Noise with a separate seed for each world.

        seeds: integers from 0 to 2**63 - 1, shape (n,). World k draws what the first world of
            ``Noise(1, seeds[k], name)`` draws.

        Raises ValueError for other seeds.
        """
        array = np.asarray(seeds)
        if array.ndim != 1 or array.dtype.kind not in "iu" or not (array >= 0).all():
            limit = "whole numbers from 0 to 2**63 - 1, shape (n,)"
            raise ValueError(f"seeds = {checks.shown(seeds)}: must be {limit}")
        noise = cls.__new__(cls)
        noise._begin(array.astype(np.uint64), name, np.zeros(len(array), dtype=np.uint64))
        return noise

    def _begin(self, seed: int | Words, name: str, worlds: Words) -> None:
        """Compute the key of each world's stream, and set the counts of drawn numbers to 0."""
        if not isinstance(name, str):
            raise checks.refuse("Noise", "name", name, "a text")
        self.seed, self.name = seed, name
        # File names may contain lone surrogates.
        text = hashlib.blake2b(name.encode("utf-8", "surrogatepass"), digest_size=8).digest()
        stream = np.array([int.from_bytes(text, "little")], dtype=np.uint64)
        key = _mixed(_mixed(np.atleast_1d(np.asarray(seed, dtype=np.uint64))) ^ stream)
        self._keys = _mixed(key ^ worlds)
        self._drawn = np.zeros(len(worlds), dtype=np.uint64)

    def __len__(self) -> int:
        """Return the number of worlds."""
        return len(self._keys)

    def uniform(
        self, k: int, low: ArrayLike = 0.0, high: ArrayLike = 1.0, worlds: ArrayLike | None = None
    ) -> Floats:
        """Return k uniform numbers from [low, high) for each selected world, shape (n, k).

        low, high: finite numbers, or arrays that broadcast to shape (n, k); low <= high.
        worlds: a mask of shape (n,) or indices; the other worlds draw nothing. None means all.

        Raises ValueError for worlds that do not exist and for invalid bounds; nothing is drawn
        then.
        """
        chosen, shape = self._asked(k, worlds)
        least, most = _spread("low", low, shape), _spread("high", high, shape)
        with np.errstate(over="ignore"):
            width = most - least
        if not (width >= 0).all():
            limit = f"at most high = {checks.shown(high)}"
            raise ValueError(f"low = {checks.shown(low)}: must be {limit}")
        if not np.isfinite(width).all():
            limit = f"at most {np.finfo(float).max:.3g} above low = {checks.shown(low)}"
            raise ValueError(f"high = {checks.shown(high)}: must be {limit}")
        drawn = self._next(chosen, shape, normal=False)
        drawn *= width
        drawn += least
        return drawn

    def normal(self, k: int, scale: ArrayLike = 1.0, worlds: ArrayLike | None = None) -> Floats:
        """Return k normal numbers with mean 0 for each selected world, shape (n, k).

        scale: the standard deviation, a finite number >= 0 or an array that broadcasts to shape
            (n, k).
        worlds: see `uniform`.

        Raises the same errors as `uniform`.
        """
        chosen, shape = self._asked(k, worlds)
        deviation = _spread("scale", scale, shape)
        if (deviation < 0).any():
            raise ValueError(f"scale = {checks.shown(scale)}: must be >= 0")
        drawn = self._next(chosen, shape, normal=True)
        drawn *= deviation
        return drawn

    def _asked(self, k: int, worlds: ArrayLike | None) -> tuple[Chosen, tuple[int, int]]:
        width = checks.count("k", k, 0)
        if worlds is None:
            return slice(None), (len(self), width)
        chosen = indices_of(worlds, len(self))
        return chosen, (len(chosen), width)

    def _next(self, chosen: Chosen, shape: tuple[int, int], normal: bool) -> Floats:
        drawn = self._drawn[chosen]
        numbers = _core.noise(self._keys[chosen], drawn, shape[1], normal)
        self._drawn[chosen] = drawn + np.uint64(shape[1])
        return numbers.reshape(shape)

    def state(self) -> NDArray[np.uint64]:
        """Return the count of numbers drawn by each world, shape (n,): the complete state."""
        return self._drawn.copy()

    def restore(self, state: ArrayLike) -> None:
        """Continue from a `state`."""
        drawn = np.asarray(state)
        if drawn.shape != (len(self),) or drawn.dtype.kind not in "iu" or (drawn < 0).any():
            limit = f"{len(self)} counts, as `state` returns them"
            raise ValueError(f"state = {checks.shown(state)}: must be {limit}")
        self._drawn = drawn.astype(np.uint64)

    def __repr__(self) -> str:
        name = f", name={self.name!r}" if self.name else ""
        seed = f"seed={self.seed}" if isinstance(self.seed, int) else "seeds of their own"
        return f"Noise({len(self)}, {seed}{name})"


def _spread(name: str, value: ArrayLike, shape: tuple[int, int]) -> Floats:
    """Return an argument as finite numbers that broadcast to a shape; else raise ValueError."""
    table = numbers(name, value)
    if not np.isfinite(table).all():
        raise ValueError(f"{name} = {checks.shown(value)}: must be finite")
    if not table.ndim:
        return table
    try:
        return np.broadcast_to(table, shape)
    except ValueError:
        limit = f"of a shape that broadcasts to {shape}"
        raise ValueError(f"{name} has shape {table.shape}: must be {limit}") from None


def _mixed(words: Words) -> Words:
    """Return SplitMix64's next number, with each word as a state."""
    with np.errstate(over="ignore"):
        z = words + GOLDEN
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    result: Words = z ^ (z >> np.uint64(31))
    return result
