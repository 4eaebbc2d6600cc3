"""Rotations as the reference uses them: unit quaternions w x y z, and rotation vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def cross(a: Array, b: Array) -> Array:
    """`numpy.cross` of vectors or stacks of vectors, shape (..., 3), in half of its time."""
    a, b = np.broadcast_arrays(a, b)
    out = np.empty(a.shape)
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def multiply(p: Array, q: Array) -> Array:
    """The rotation q followed by p, as one quaternion."""
    w, x, y, z = p
    a, b, c, d = q
    return np.array(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ]
    )


def conjugate(q: Array) -> Array:
    """The rotation back, of a unit quaternion."""
    return np.array([q[0], -q[1], -q[2], -q[3]])


def unit(vector: ArrayLike) -> Array:
    """The same direction with length 1."""
    v = np.asarray(vector, float)
    return v / float(np.sqrt(v @ v))


def matrix(q: Array) -> Array:
    """Rotation matrix of a unit quaternion, shape (3, 3): its columns are the turned axes."""
    w, x, y, z = q
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def from_vector(turn: Array) -> Array:
    """Quaternion of a rotation vector: axis times angle [rad]."""
    angle = np.sqrt(turn @ turn)
    if angle == 0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return np.concatenate(([np.cos(angle / 2)], np.sin(angle / 2) / angle * turn))


def to_vector(q: Array) -> Array:
    """Rotation vector of a unit quaternion, its angle in [0, pi]."""
    if q[0] < 0:  # q and -q are one rotation; take the shorter way
        q = -q
    sine = float(np.sqrt(q[1:] @ q[1:]))
    if sine == 0:
        return np.zeros(3)
    return float(2 * np.arctan2(sine, q[0]) / sine) * q[1:]
