"""Judges an answer by what it claims, without looking for a better one.

A contact claims a distance d, a direction n and (by its point) a point on each shape. Each of
these is checked against the definition of the shapes:

* g(n) = d: the planes across n that touch the shapes are d apart. So the true distance is at
  least d, up to `plane`.
* the points lie on their shapes, up to `point`. Where the shapes are apart the true distance is
  hence at most d, up to `point`: the answer is proven, by itself.
* the points lie on those planes, up to `support`: they are where the shapes touch them.

Where the shapes overlap no point can prove that there is no shorter way out: `search.py` and
`cover.py` look for one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .convex import Posed


class Certificate(NamedTuple):
    """Errors of each pose's claim [m], each zero for a right answer; shape (n,)."""

    plane: np.ndarray
    point: np.ndarray
    support: np.ndarray
    unit: np.ndarray


def certify(posed: Posed, dist: np.ndarray, pos: np.ndarray, normal: np.ndarray) -> Certificate:
    """Judges one contact of each pose: dist (n,), pos and normal (n, 3) in A's frame."""
    n = normal[:, None]
    length = np.linalg.norm(normal, axis=1)
    plane = np.abs(posed.gap(n)[:, 0] - dist)
    on_a, on_b = pos - normal * dist[:, None] / 2, pos + normal * dist[:, None] / 2
    into_b = ((on_b - posed.offset)[:, None] @ posed.turn)[:, 0]
    point = np.maximum(posed.a.outside(on_a), posed.b.outside(into_b))
    toward_b = -(n @ posed.turn)
    support = np.maximum(
        np.abs(posed.a.height(n)[:, 0] - (on_a * normal).sum(1)),
        np.abs(posed.b.height(toward_b)[:, 0] - (into_b * toward_b[:, 0]).sum(1)),
    )
    return Certificate(plane, np.maximum(point, 0), support, np.abs(length - 1))
