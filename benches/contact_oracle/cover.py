"""An upper bound of the distance by a covering of all directions: no search is trusted.

The sphere of directions is cut into triangles. A direction within one is a sum of its corners v_i
with weights w_i ≥ 0, and 1 ≤ Σw_i ≤ 1/cos ρ, with ρ the angle from the triangle's centre to a
corner. For a point x of the difference B − A that gives

    g(n) ≤ n·x ≤ max_i(v_i·x) · (1/cos ρ where that is positive, else 1).

A triangle whose bound is not above the best g known, by more than the tolerance, is done; the
others are cut in four. What is left in the end bounds the distance from above, rigorously but for
rounding.
"""

from __future__ import annotations

import numpy as np

from .convex import Posed
from .search import unit


def _octahedron() -> np.ndarray:
    signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)], float)
    return np.stack([np.diag(s) for s in signs])


def upper_bound(
    posed: Posed, known: np.ndarray, tolerance: float = 1e-9, cells: int = 30_000, levels: int = 40
) -> np.ndarray:
    """Of every pose, (n,): no direction has a g above it.

    known: lower bounds, (n,). tolerance: times the scale, how far above them it may be. A pose that
    needs more than `cells` triangles keeps the bound that it has then.
    """
    n = len(posed.offset)
    corners = np.tile(_octahedron(), (n, 1, 1))
    owner = np.repeat(np.arange(n), 8)
    for _ in range(2):
        corners, owner = _cut(corners, owner)
    target = known + tolerance * posed.scale
    bound = known.copy()
    used = np.zeros(n, int)
    for level in range(levels):
        value = _bounds(posed, corners, owner)
        used += np.bincount(owner, minlength=n)
        open_ = value > target[owner]
        stop = (used > cells) | (level == levels - 1)
        last = open_ & stop[owner]
        np.maximum.at(bound, owner[last], value[last])
        done = ~open_
        # A finished triangle is not above the target.
        np.maximum.at(bound, owner[done], np.minimum(value[done], target[owner[done]]))
        corners, owner = corners[open_ & ~last], owner[open_ & ~last]
        if not len(owner):
            break
        corners, owner = _cut(corners, owner)
    return bound


def _cut(corners: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = unit(a + b), unit(b + c), unit(c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts]), np.tile(owner, 4)


def _bounds(posed: Posed, corners: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """The bound of each triangle: from the support at its centre and at its corners, and the best
    mixture of these that a few rounds of play find (any mixture is a point of B − A)."""
    centre = unit(corners.sum(axis=1))
    directions = np.concatenate([centre[:, None], corners], axis=1)
    here = posed.take(owner)
    x = here.apart(directions)  # (m, 4, 3)
    game = corners @ x.transpose(0, 2, 1)  # (m, corner, point)
    swell = 1 / (centre[:, None] @ corners.transpose(0, 2, 1)).min(axis=(1, 2))

    def worth(height: np.ndarray) -> np.ndarray:
        return np.where(height > 0, height * swell, height)

    best = worth(game.max(axis=1).min(axis=1))
    # Fictitious play: each side answers the other's average so far.
    total = np.zeros(game.shape[:2])
    answer = game.max(axis=1).argmin(axis=1)
    rows = np.arange(len(game))
    seen = np.zeros((len(game), game.shape[2]))
    for turn in range(1, 25):
        total += game[rows, :, answer]
        best = np.minimum(best, worth(total.max(axis=1) / turn))
        seen += game[rows, total.argmax(axis=1)]
        answer = seen.argmin(axis=1)
    return best
