"""Poses: quaternion formulas for describing a scene (w x y z, right-handed)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from stepcore.checks import TINY_LENGTH

Vec = tuple[float, ...]
ORIGIN: Vec = (0.0, 0.0, 0.0)
IDENTITY: Vec = (1.0, 0.0, 0.0, 0.0)


def cross(a: Sequence[float], b: Sequence[float]) -> Vec:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def normalised(v: Sequence[float], name: str) -> Vec:
    """Return `v` scaled to length 1; raise ValueError, naming `what`, if `v` is too short."""
    norm = math.hypot(*v)
    if not TINY_LENGTH < norm < math.inf:
        raise ValueError(f"{name} is too short to give a direction")
    return tuple(x / norm for x in v)


def product(a: Sequence[float], b: Sequence[float]) -> Vec:
    """Return the quaternion of the rotation by `b` followed by the rotation by `a`."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def rotated(quat: Sequence[float], v: Sequence[float]) -> Vec:
    """Return `v` rotated by a unit quaternion."""
    if tuple(quat) == IDENTITY:
        return tuple(v)
    # v + 2 w (u × v) + 2 u × (u × v), with quat = (w, u)
    u = quat[1:]
    t = tuple(2 * x for x in cross(u, v))
    return tuple(x + quat[0] * y + z for x, y, z in zip(v, t, cross(u, t), strict=True))


def matrix(quat: Sequence[float]) -> tuple[Vec, Vec, Vec]:
    """Return the rotation matrix of a unit quaternion, as three rows."""
    columns = [rotated(quat, axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    return tuple(zip(*columns, strict=True))  # type: ignore[return-value]


def from_axis_angle(axis: Sequence[float], angle: float) -> Vec:
    """Return the rotation by `angle` [rad] about `axis`, a vector of any length."""
    u = normalised(axis, "the axis")
    s = math.sin(angle / 2)
    return (math.cos(angle / 2), s * u[0], s * u[1], s * u[2])


def from_z_axis(z: Sequence[float]) -> Vec:
    """Return the smallest rotation of the z axis to `z` (half a turn about x for -z)."""
    u = normalised(z, "the z axis")
    axis = (-u[1], u[0], 0.0)
    norm = math.hypot(*axis)
    if norm < TINY_LENGTH:
        axis, norm = (1.0, 0.0, 0.0), 0.0
    else:
        axis = (axis[0] / norm, axis[1] / norm, 0.0)
    angle = math.atan2(norm, u[2])
    s = math.sin(angle / 2)
    return (math.cos(angle / 2), s * axis[0], s * axis[1], 0.0)


def from_xy_axes(x: Sequence[float], y: Sequence[float]) -> Vec:
    """Return the frame with x axis `x` and with y axis `y`, made perpendicular to `x`."""
    u = normalised(x, "the x axis")
    along = sum(a * b for a, b in zip(u, y, strict=True))
    v = normalised([b - along * a for a, b in zip(u, y, strict=True)], "the y axis")
    w = normalised(cross(u, v), "the z axis")
    return _from_axes(u, v, w)


def _from_axes(x: Vec, y: Vec, z: Vec) -> Vec:
    """Return the quaternion of the rotation with these columns, from its largest component."""
    trace = x[0] + y[1] + z[2]
    if trace > 0:
        w = 0.5 * math.sqrt(1 + trace)
        return (w, (y[2] - z[1]) / (4 * w), (z[0] - x[2]) / (4 * w), (x[1] - y[0]) / (4 * w))
    if x[0] > y[1] and x[0] > z[2]:
        a = 0.5 * math.sqrt(1 + x[0] - y[1] - z[2])
        return ((y[2] - z[1]) / (4 * a), a, (y[0] + x[1]) / (4 * a), (z[0] + x[2]) / (4 * a))
    if y[1] > z[2]:
        a = 0.5 * math.sqrt(1 - x[0] + y[1] - z[2])
        return ((z[0] - x[2]) / (4 * a), (y[0] + x[1]) / (4 * a), a, (z[1] + y[2]) / (4 * a))
    a = 0.5 * math.sqrt(1 - x[0] - y[1] + z[2])
    return ((x[1] - y[0]) / (4 * a), (z[0] + x[2]) / (4 * a), (z[1] + y[2]) / (4 * a), a)


def from_euler(angles: Sequence[float], sequence: str = "xyz") -> Vec:
    """Return the product of three rotations by `angles` [rad] about the axes in `sequence`.

    Small letters are intrinsic (about rotated axes), capitals extrinsic (about fixed axes).
    """
    quat = IDENTITY
    for angle, letter in zip(angles, sequence, strict=True):
        axis = [0.0, 0.0, 0.0]
        axis["xyz".index(letter.lower())] = 1.0
        turn = from_axis_angle(axis, angle)
        quat = product(quat, turn) if letter.islower() else product(turn, quat)
    return quat


def composed(
    outer: tuple[Sequence[float], Sequence[float]], pos: Sequence[float], quat: Sequence[float]
) -> tuple[Vec, Vec]:
    """Return the pose (`pos`, `quat`), given in the frame `outer`, in the parent of `outer`."""
    offset, turn = outer
    moved = tuple(a + b for a, b in zip(offset, rotated(turn, pos), strict=True))
    return moved, product(turn, quat)


def from_to(kind: str, ends: Sequence[float], radius: float) -> tuple[Vec, Vec, Vec]:
    """Return (size, pos, quat) of a capsule, cylinder, box or ellipsoid between two points.

    The geom's z axis points from the second point to the first, as MuJoCo compiles it.
    """
    if kind not in ("capsule", "cylinder", "box", "ellipsoid"):
        raise ValueError(f"fromto is for a capsule, cylinder, box or ellipsoid, not a {kind}")
    first, second = ends[:3], ends[3:]
    axis = [a - b for a, b in zip(first, second, strict=True)]
    length = math.hypot(*axis)
    if not TINY_LENGTH < length < math.inf:
        raise ValueError("the two points of fromto are too close")
    half = length / 2
    size = (radius, half, 0.0) if kind in ("capsule", "cylinder") else (radius, radius, half)
    pos = tuple(0.5 * (a + b) for a, b in zip(first, second, strict=True))
    return size, pos, from_z_axis(axis)


def turned_inertia(quat: Sequence[float], inertia: Sequence[float]) -> Vec:
    """Return an inertia (xx yy zz xy xz yz), given in a frame rotated by `quat`, in outer axes."""
    if tuple(quat) == IDENTITY:
        return tuple(inertia)
    xx, yy, zz, xy, xz, yz = inertia
    inner = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    rows = matrix(quat)

    def entry(i: int, j: int) -> float:
        return sum(rows[i][k] * inner[k][m] * rows[j][m] for k in range(3) for m in range(3))

    return (entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2))
