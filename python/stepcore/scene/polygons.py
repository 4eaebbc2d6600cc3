"""Faces of more than three corners as triangles, split as MuJoCo's reader of OBJ files splits them.

The split matters where a face is not flat or not convex: hull, volume and inertia follow it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Polygon = list[int]
# Two coordinates.
Place = tuple[Any, Any]
# A corner is compared with all others before it is cut off, so that the work grows with the square
# of their number. This much takes seconds, and is enough for a face of 10,000 corners.
MOST_WORK = 10**8
# What each corner of a file may take beside, so that there may be any number of small faces, and
# what a comparison takes with however few.
PER_CORNER, LEAST = 1000, 500


class Budget:
    """How much comparing of corners is left for the faces of a file."""

    def __init__(self, polygons: list[Polygon]) -> None:
        self.left = MOST_WORK + PER_CORNER * sum(map(len, polygons))

    def take(self, corners: int) -> None:
        """Counts the comparison of one corner with so many; ValueError where it is too much."""
        self.left -= LEAST + corners
        if self.left < 0:
            raise ValueError(
                "its faces of many corners take too long to split into triangles: save it with "
                "triangles"
            )


def triangles(polygons: list[Polygon], vertices: NDArray[Any]) -> NDArray[Any]:
    """The triangles of polygons, shape (n, 3); a polygon: indices of its vertices in turn.

    Quadrilaterals are split along the shorter diagonal, the second where both are as long; of
    larger ones ears are cut off, in the plane of two axes that they face most, in the single
    precision of MuJoCo's reader.
    """
    found: list[Polygon] = []
    budget = Budget(polygons)
    for polygon in polygons:
        if len(polygon) == 3:
            found.append(polygon)
        elif len(polygon) == 4:
            found += _of_four(polygon, vertices)
        else:
            found += _ears(polygon, vertices, budget)
    return np.array(found, np.int64).reshape(-1, 3)


def _of_four(polygon: Polygon, vertices: NDArray[Any]) -> list[Polygon]:
    a, b, c, d = polygon
    first, second = vertices[c] - vertices[a], vertices[d] - vertices[b]
    if first @ first < second @ second:
        return [[a, b, c], [a, c, d]]
    return [[a, b, d], [b, c, d]]


def _ears(polygon: Polygon, vertices: NDArray[Any], budget: Budget) -> list[Polygon]:
    corners = vertices[polygon].astype(np.float32)
    with np.errstate(all="ignore"):
        x, y = corners[:, _axes(corners)].T
        return _cut(polygon, np.ascontiguousarray(x), np.ascontiguousarray(y), budget)


def _cut(polygon: Polygon, x: NDArray[Any], y: NDArray[Any], budget: Budget) -> list[Polygon]:
    """Cuts off a corner at a time in which no other corner lies, until a triangle is left.

    What no ear can be found of any more is no simple polygon, and is left out, as in MuJoCo.
    """
    left, found, at, tries = list(polygon), [], 0, len(polygon)
    while len(left) > 3 and tries > 0:
        at %= len(left)
        tries -= 1
        budget.take(len(left))
        ear = [at, (at + 1) % len(left), (at + 2) % len(left)]
        corners = [(x[corner], y[corner]) for corner in ear]
        if _points_in(*corners) or _holds_other(ear, corners, x, y):
            at += 1
            continue
        found.append([left[corner] for corner in ear])
        del left[ear[1]]
        x, y = np.delete(x, ear[1]), np.delete(y, ear[1])
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
    return bool(turn * (a[0] * b[1] - a[1] * b[0]) < 0)


def _holds_other(ear: list[int], corners: list[Place], x: NDArray[Any], y: NDArray[Any]) -> bool:
    """Whether a corner beside those three lies in their triangle: a ray crosses one edge of it."""
    inside = np.zeros(len(x), bool)
    for (ax, ay), (bx, by) in zip(corners, corners[-1:] + corners[:-1], strict=True):
        inside ^= ((ay > y) != (by > y)) & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
    inside[ear] = False
    return bool(inside.any())
