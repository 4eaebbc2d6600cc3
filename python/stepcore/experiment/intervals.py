"""Mean differences of paired measurements, with 95 % confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

# The 97.5 % quantile of the normal distribution.
POINT = 1.959963984540054


@dataclass(frozen=True)
class Difference:
    """The mean difference between pairs of measurements, such as of a setting and the reference.

    mean: the first minus the second, which is the reference.
    interval: half the width of the 95 % confidence interval.
    reference: the mean of the second.
    """

    mean: float
    interval: float
    reference: float

    @property
    def seen(self) -> bool:
        """Whether the interval excludes 0."""
        return abs(self.mean) > self.interval


def difference(mine: ArrayLike, true: ArrayLike) -> Difference:
    """Return the mean difference of pairs with its 95 % interval.

    >>> shown = difference([1.0, 2.0, 3.0], [0.0, 2.0, 2.0])
    >>> round(shown.mean, 3), round(shown.interval, 2), shown.seen
    (0.667, 1.43, False)
    """
    true = np.asarray(true, float)
    apart = np.asarray(mine, float) - true
    count = len(apart)
    spread = float(np.std(apart, ddof=1)) / np.sqrt(count) if count > 1 else np.inf
    return Difference(float(apart.mean()), float(student(count - 1) * spread), float(true.mean()))


def student(freedom: int) -> float:
    """Return Student's t at 97.5 %: exact for 1 and 2 degrees of freedom, else to 0.3 % or better.

    Source: the expansion in 1/ν of Abramowitz and Stegun 26.7.5.

    >>> round(student(31), 4)
    2.0395
    """
    if freedom < 1:
        return np.inf
    if freedom == 1:
        return float(np.tan(np.pi * 0.475))
    if freedom == 2:
        return float(0.95 * np.sqrt(2 / (1 - 0.95**2)))
    z = POINT
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / freedom ** (k + 1) for k, term in enumerate(terms))
