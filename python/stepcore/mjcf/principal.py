"""The principal axes of an inertia, as MuJoCo chooses among those that differ by turns and signs.

Jacobi's method: the largest entry off the diagonal is turned away until it is rounding; then the
moments are put in descending order by quarter turns. (MuJoCo documentation, fullinertia; the
order and signs were compared with its compiler.)
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stepcore.scene import frames
from stepcore.scene.frames import Vec

SMALL = 1e-15
# Moments this close, relatively, are equal.
SORTED = 1e-12
# Which row and column a turn about an axis mixes.
PLANES = ((1, 2), (0, 2), (0, 1))


def principal_axes(inertia: NDArray[np.float64]) -> tuple[Vec, Vec]:
    """(quaternion of the axes, moments about them, the largest first)."""
    quat = frames.IDENTITY
    for _ in range(500):
        seen = _seen(inertia, quat)
        sizes = [abs(seen[row, column]) for row, column in PLANES]
        axis = max(range(3), key=lambda k: (sizes[k], -k))
        row, column = PLANES[axis]
        if sizes[axis] <= SMALL * np.abs(np.diag(seen)).max():
            break
        tau = (seen[column, column] - seen[row, row]) / (2 * seen[row, column])
        tangent = math.copysign(1.0, tau) / (abs(tau) + math.sqrt(1 + tau * tau))
        cosine = 1 / math.sqrt(1 + tangent * tangent)
        # Of half the angle, without the rounding of 1 - cosine.
        half = math.sqrt(0.5 + 0.5 * cosine)
        sine = 0.5 * abs(tangent) * cosine / half
        turn = [half, 0.0, 0.0, 0.0]
        turn[axis + 1] = -sine if (tau >= 0) != (axis == 1) else sine
        quat = frames.normalised(frames.product(quat, turn), "the quaternion")
    moments = list(np.diag(_seen(inertia, quat)))
    for first in (0, 1, 0):
        if moments[first] < moments[first + 1] * (1 - SORTED):
            moments[first], moments[first + 1] = moments[first + 1], moments[first]
            turn = [math.sqrt(0.5), 0.0, 0.0, 0.0]
            turn[(first + 2) % 3 + 1] = turn[0]
            quat = frames.normalised(frames.product(quat, turn), "the quaternion")
    return quat, tuple(float(moment) for moment in moments)


def _seen(inertia: NDArray[np.float64], quat: Vec) -> NDArray[np.float64]:
    turn = np.array(frames.matrix(quat))
    result: NDArray[np.float64] = turn.T @ inertia @ turn
    return result
