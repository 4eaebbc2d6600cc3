"""Faces of more than three corners as triangles, split as MuJoCo's reader of OBJ files splits them.

The split matters where a face is not flat or not convex: hull, volume and inertia follow it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Polygon = list[int]
# Two coordinates.
Place = list[Any]


def triangles(polygons: list[Polygon], vertices: NDArray[Any]) -> NDArray[Any]:
    """The triangles of polygons, shape (n, 3); a polygon: indices of its vertices in turn.

    Quadrilaterals are split along the shorter diagonal, the second where both are as long; of
    larger ones ears are cut off, in the plane of two axes that they face most, in the single
    precision of MuJoCo's reader.
    """
    found: list[Polygon] = []
    for polygon in polygons:
        if len(polygon) == 3:
            found.append(polygon)
        elif len(polygon) == 4:
            found += _of_four(polygon, vertices)
        else:
            found += _ears(polygon, vertices)
    return np.array(found, np.int64).reshape(-1, 3)


def _of_four(polygon: Polygon, vertices: NDArray[Any]) -> list[Polygon]:
    a, b, c, d = polygon
    first, second = vertices[c] - vertices[a], vertices[d] - vertices[b]
    if first @ first < second @ second:
        return [[a, b, c], [a, c, d]]
    return [[a, b, d], [b, c, d]]


def _ears(polygon: Polygon, vertices: NDArray[Any]) -> list[Polygon]:
    corners = vertices[polygon].astype(np.float32)
    with np.errstate(all="ignore"):
        flat = dict(zip(polygon, map(list, corners[:, _axes(corners)]), strict=True))
        return _cut(polygon, flat)


def _cut(polygon: Polygon, flat: dict[int, Place]) -> list[Polygon]:
    """Cuts off a corner at a time in which no other corner lies, until a triangle is left.

    What no ear can be found of any more is no simple polygon, and is left out, as in MuJoCo.
    """
    left, found, at, tries = list(polygon), [], 0, len(polygon)
    while len(left) > 3 and tries > 0:
        at %= len(left)
        tries -= 1
        turned = left[at:] + left[:at]
        ear, others = turned[:3], turned[3:]
        corners = [flat[corner] for corner in ear]
        if _points_in(*corners) or any(_inside(flat[one], corners) for one in others):
            at += 1
            continue
        found.append(ear)
        del left[(at + 1) % len(left)]
        tries = len(left) + 1
    return [*found, left] if len(left) == 3 else found


def _axes(corners: NDArray[Any]) -> list[int]:
    """The two axes of the plane that the first proper corner faces most."""
    edges = np.roll(corners, -1, axis=0) - corners
    turns = np.abs(np.cross(edges, np.roll(edges, -1, axis=0)))
    for x, y, z in turns.tolist():
        if max(x, y, z) > np.finfo(np.float32).eps:
            if x > y and x > z:
                return [1, 2]
            return [0, 1] if z > x and z > y else [0, 2]
    return [1, 2]


def _points_in(a: Place, b: Place, c: Place) -> bool:
    """Whether a corner counts as one that points into the polygon.

    What it turns is compared with the side on which its first edge passes the origin, as MuJoCo's
    reader has it, and not with the way round that the polygon goes.
    """
    turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    return turn * (a[0] * b[1] - a[1] * b[0]) < 0


def _inside(point: Place, corners: list[Place]) -> bool:
    """Whether a point lies in a triangle: of its edges a ray crosses an odd number."""
    x, y = point
    inside = False
    for (ax, ay), (bx, by) in zip(corners, corners[-1:] + corners[:-1], strict=True):
        if (ay > y) != (by > y) and x < (bx - ax) * (y - ay) / (by - ay) + ax:
            inside = not inside
    return inside
