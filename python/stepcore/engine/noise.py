"""`Noise`: random numbers for many worlds, with an independent stream for each world.

A number is a hash of the seed, the stream's name, the world and the count of numbers that the world
has drawn. A number therefore depends neither on the number of worlds nor on the draws of other
worlds. The hash applies SplitMix64's finaliser (Steele, Lea & Flood, "Fast splittable pseudorandom
number generators", 2014) to each of these inputs in turn; a name enters by its 64-bit BLAKE2b hash
(RFC 7693). Normal numbers are quantiles of uniform numbers by Wichura's algorithm AS 241 (1988),
exact to 1e-15. The logarithm uses only +, −, ×, ÷, so results are bit-identical on every machine.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats, indices_of, numbers

Words = NDArray[np.uint64]
Chosen = slice | NDArray[np.intp]

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
# AS 241: numerators and denominators, highest power first, of the middle and of the two tails.
MIDDLE = (
    (
        2509.0809287301226727,
        33430.575583588128105,
        67265.770927008700853,
        45921.953931549871457,
        13731.693765509461125,
        1971.5909503065514427,
        133.14166789178437745,
        3.387132872796366608,
    ),
    (
        5226.495278852854561,
        28729.085735721942674,
        39307.89580009271061,
        21213.794301586595867,
        5394.1960214247511077,
        687.1870074920579083,
        42.313330701600911252,
        1.0,
    ),
)
NEAR = (
    (
        7.7454501427834140764e-4,
        0.0227238449892691845833,
        0.24178072517745061177,
        1.27045825245236838258,
        3.64784832476320460504,
        5.7694972214606914055,
        4.6303378461565452959,
        1.42343711074968357734,
    ),
    (
        1.05075007164441684324e-9,
        5.475938084995344946e-4,
        0.0151986665636164571966,
        0.14810397642748007459,
        0.68976733498510000455,
        1.6763848301838038494,
        2.05319162663775882187,
        1.0,
    ),
)
FAR = (
    (
        2.01033439929228813265e-7,
        2.71155556874348757815e-5,
        0.0012426609473880784386,
        0.026532189526576123093,
        0.29656057182850489123,
        1.7848265399172913358,
        5.4637849111641143699,
        6.6579046435011037772,
    ),
    (
        2.04426310338993978564e-15,
        1.4215117583164458887e-7,
        1.8463183175100546818e-5,
        7.868691311456132591e-4,
        0.0148753612908506148525,
        0.13692988092273580531,
        0.59983220655588793769,
        1.0,
    ),
)
HALF_SQRT = 0.7071067811865476
LOG_2 = 0.6931471805599453


class Noise:
    """A generator of random numbers for n worlds, with an independent stream for each world.

    n: the number of worlds. The stream of world k does not depend on n.
    seed: an integer from 0 to 2**63 - 1.
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
        whole = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
        if not whole or not 0 <= seed < 1 << 63:
            raise checks.refuse("Noise", "seed", seed, "a whole number from 0 to 2**63 - 1")
        if not isinstance(name, str):
            raise checks.refuse("Noise", "name", name, "a text")
        self.seed, self.name = int(seed), name
        # File names may contain lone surrogates.
        text = hashlib.blake2b(name.encode("utf-8", "surrogatepass"), digest_size=8).digest()
        stream = np.array([self.seed, int.from_bytes(text, "little")], dtype=np.uint64)
        key = _mixed(_mixed(stream[:1]) ^ stream[1:])
        self._keys = _mixed(key ^ np.arange(count, dtype=np.uint64))
        self._drawn = np.zeros(count, dtype=np.uint64)

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
        result: Floats = least + width * self._share(chosen, shape[1])
        return result

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
        result: Floats = deviation * quantile(self._share(chosen, shape[1]))
        return result

    def _asked(self, k: int, worlds: ArrayLike | None) -> tuple[Chosen, tuple[int, int]]:
        """Return the worlds that draw, and the shape of the numbers."""
        width = checks.count("k", k, 0)
        if worlds is None:
            return slice(None), (len(self), width)
        chosen = indices_of(worlds, len(self))
        return chosen, (len(chosen), width)

    def _share(self, chosen: Chosen, width: int) -> Floats:
        """Draw numbers strictly between 0 and 1 for some worlds."""
        drawn = self._drawn[chosen]
        places: Words = np.add.outer(drawn, np.arange(width, dtype=np.uint64))
        self._drawn[chosen] = drawn + np.uint64(width)
        words = _mixed(self._keys[chosen][:, None] ^ _mixed(places))
        result: Floats = ((words >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
        return result

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
        return f"Noise({len(self)}, seed={self.seed}{name})"


def _spread(name: str, value: ArrayLike, shape: tuple[int, int]) -> Floats:
    """Return an argument as finite numbers broadcast to a shape; else raise ValueError."""
    table = numbers(name, value)
    if not np.isfinite(table).all():
        raise ValueError(f"{name} = {checks.shown(value)}: must be finite")
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


def quantile(share: Floats) -> Floats:
    """Return the quantile of the standard normal distribution, for shares between 0 and 1.

    >>> import numpy as np
    >>> quantile(np.array([0.025, 0.5, 0.975])).round(6).tolist()
    [-1.959964, 0.0, 1.959964]
    """
    q = share - 0.5
    result: Floats = q * _ratio(MIDDLE, 0.180625 - q * q)
    outside = np.abs(q) > 0.425
    least = np.minimum(share, 1.0 - share)[outside]
    root = np.sqrt(-log(least))
    tail = np.where(root <= 5.0, _ratio(NEAR, root - 1.6), _ratio(FAR, root - 5.0))
    result[outside] = np.where(q[outside] < 0, -tail, tail)
    return result


def _ratio(coefficients: tuple[tuple[float, ...], tuple[float, ...]], x: Floats) -> Floats:
    """Evaluate a ratio of two polynomials."""
    above, below = (np.full_like(x, some[0]) for some in coefficients)
    for a, b in zip(coefficients[0][1:], coefficients[1][1:], strict=True):
        above, below = above * x + a, below * x + b
    result: Floats = above / below
    return result


def log(x: Floats) -> Floats:
    """Return the natural logarithm of positive numbers: 2 artanh((m − 1) / (m + 1)), mantissa m."""
    mantissa, exponent = np.frexp(x)
    low = mantissa < HALF_SQRT
    mantissa, exponent = (
        np.where(low, 2 * mantissa, mantissa),
        np.where(low, exponent - 1, exponent),
    )
    z = (mantissa - 1.0) / (mantissa + 1.0)
    square, series = z * z, np.zeros_like(z)
    for power in range(23, 0, -2):
        series = series * square + 1.0 / power
    result: Floats = exponent * LOG_2 + 2.0 * z * series
    return result
