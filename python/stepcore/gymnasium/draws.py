"""`Draws`: random numbers of the worlds that a function of a task serves."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore.engine.arrays import Floats
from stepcore.engine.noise import Noise


class Draws:
    """Random numbers of some worlds: each world draws from a stream of its own.

    A world's numbers depend on its seed and on how many it has drawn, and neither on the other
    worlds nor on when they begin anew.
    """

    def __init__(self, noise: Noise, worlds: Any) -> None:
        self._noise, self._worlds = noise, np.asarray(worlds)

    def uniform(
        self, low: ArrayLike = 0.0, high: ArrayLike = 1.0, size: int | None = None
    ) -> Floats:
        """Return numbers from [low, high), shape (…, size), or (…) without a size.

        low, high: numbers, or arrays of shape (size,).
        """
        rows = np.atleast_1d(self._worlds)
        k = 1 if size is None else size
        return self._shaped(self._noise.uniform(k, low, high, worlds=rows), size)

    def normal(self, scale: ArrayLike = 1.0, size: int | None = None) -> Floats:
        """Return normal numbers of mean 0 and standard deviation `scale`; see `uniform`."""
        rows = np.atleast_1d(self._worlds)
        k = 1 if size is None else size
        return self._shaped(self._noise.normal(k, scale, worlds=rows), size)

    def integers(self, low: int, high: int, size: int | None = None) -> NDArray[np.int64]:
        """Return whole numbers from low to high - 1; see `uniform`."""
        return np.floor(self.uniform(low, high, size)).astype(np.int64)

    def _shaped(self, numbers: Floats, size: int | None) -> Floats:
        """Return the numbers with the axes of the worlds at hand."""
        last = () if size is None else (size,)
        shaped: Floats = numbers.reshape(self._worlds.shape + last)[()]
        return shaped


class Streams:
    """The streams of n worlds. Those of a world follow from the seed of its generator."""

    def __init__(self, n: int) -> None:
        self._seeds = np.zeros(n, dtype=np.int64)
        self._noise = Noise.of_seeds(self._seeds)
        self._known: list[Any] = [None] * n

    def seed(self, worlds: Iterable[int], rngs: Iterable[np.random.Generator]) -> None:
        """Begin the streams of worlds whose generators are others than before."""
        new = []
        for world, rng in zip(worlds, rngs, strict=True):
            if self._known[world] is not rng:
                self._known[world] = rng
                # The generator itself, which `start` may draw from, stays as it is.
                words = rng.bit_generator.seed_seq.generate_state(1, np.uint64)
                self._seeds[world] = int(words[0] >> np.uint64(1))
                new.append(world)
        if new:
            drawn = self._noise.state()
            drawn[new] = 0
            self._noise = Noise.of_seeds(self._seeds)
            self._noise.restore(drawn)

    def counts(self) -> NDArray[np.uint64]:
        """Return how many numbers each world has drawn."""
        return self._noise.state()

    def rewind(self, worlds: NDArray[np.bool_], counts: NDArray[np.uint64]) -> None:
        """Let some worlds draw again what they drew since."""
        self._noise.restore(np.where(worlds, counts, self._noise.state()))

    def of(self, worlds: Any) -> Draws:
        """Return the numbers of some worlds; one index for a world without an axis."""
        return Draws(self._noise, worlds)
