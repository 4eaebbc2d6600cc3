"""The signed distance as the maximum of g over all directions.

g is smooth except where it crosses a crease: on the great circle across an edge or an axis. So its
maximum is one of finitely many kinds, and each is looked for by itself:

* where two creases cross (a face, two edges) or at a pole: tried one by one, exact;
* on one crease: sampled round each circle, then a golden section from the best;
* on no crease: sampled over the sphere, then a climb and Newton's method from the best of these and
  of the other two kinds.

What it returns is g at some direction, hence never above the true distance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .convex import Posed

GOLDEN = (np.sqrt(5) - 1) / 2
SAMPLES = 320  # over the sphere
ROUND = 48  # round a circle
BEST = 5  # starts of each refinement
SHARES = np.array([1.0, 0.5, 0.2, 0.05, 0.01])  # of a Newton step


class Maximum(NamedTuple):
    """dist: (n,) [m]; normal: in A's frame, (n, 3); kind: 0 crossing, 1 crease, 2 smooth."""

    dist: np.ndarray
    normal: np.ndarray
    kind: np.ndarray


def search(posed: Posed, portion: int = 2000) -> Maximum:
    """The distance and its direction at every pose."""
    starts = range(0, len(posed.offset), portion)
    parts = [_search(posed.take(np.arange(i, min(i + portion, len(posed.offset))))) for i in starts]
    return Maximum(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _search(posed: Posed) -> Maximum:
    if posed.a.kind == "plane":
        up = np.broadcast_to(np.eye(3)[2], (len(posed.offset), 3))
        return Maximum(posed.gap(up[:, None])[:, 0], up, np.zeros(len(up), int))
    crossings, circles = _crossings(posed), _circles(posed)
    starts = np.concatenate([crossings, circles], axis=1)
    found = [_best(posed, crossings), _best(posed, circles), _smooth(posed, starts)]
    dist = np.stack([value for value, _ in found], axis=1)
    normal = np.stack([direction for _, direction in found], axis=1)
    best = dist.argmax(axis=1)
    rows = np.arange(len(best))
    return Maximum(dist[rows, best], normal[rows, best], best)


def sphere(count: int) -> np.ndarray:
    """Directions spread evenly over the sphere: Fibonacci's lattice."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


def _creases(posed: Posed) -> np.ndarray:
    """All creases in A's frame, (poses, k, 3)."""
    own = np.broadcast_to(posed.a.creases, (len(posed.offset), *posed.a.creases.shape))
    return np.concatenate([own, posed.b.creases @ posed.turn.transpose(0, 2, 1)], axis=1)


def _poles(posed: Posed) -> np.ndarray:
    own = np.broadcast_to(posed.a.poles, (len(posed.offset), *posed.a.poles.shape))
    other = -posed.b.poles @ posed.turn.transpose(0, 2, 1)
    length = np.linalg.norm(posed.offset, axis=1)[:, None]
    between = np.where(length > 0, posed.offset / np.where(length > 0, length, 1), np.eye(3)[0])
    return np.concatenate([own, other, between[:, None]], axis=1)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _best(posed: Posed, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    value = posed.gap(directions)
    rows, best = np.arange(len(value)), value.argmax(axis=1)
    return value[rows, best], directions[rows, best]


def _top(posed: Posed, directions: np.ndarray, count: int) -> np.ndarray:
    """The best `count` of each pose."""
    order = np.argsort(-posed.gap(directions), axis=1)[:, :count]
    return np.take_along_axis(directions, order[..., None], axis=1)


def _crossings(posed: Posed) -> np.ndarray:
    tried = [_poles(posed)]
    a, b = posed.a.creases, posed.b.creases @ posed.turn.transpose(0, 2, 1)
    if len(a) and b.shape[1]:
        crosses = np.cross(a[None, :, None], b[:, None]).reshape(len(posed.offset), -1, 3)
        length = np.linalg.norm(crosses, axis=-1, keepdims=True)
        # Parallel edges have no direction across; their circle is searched all the same.
        crosses = np.where(length > 1e-9, crosses / np.where(length > 0, length, 1), np.eye(3)[0])
        tried += [crosses, -crosses]
    return _top(posed, np.concatenate(tried, axis=1), BEST)


def _circles(posed: Posed) -> np.ndarray:
    e = _creases(posed)
    if not e.shape[1]:
        return np.broadcast_to(np.eye(3)[0], (len(e), 1, 3))
    spare = np.where(np.abs(e[..., :1]) < 0.6, np.eye(3)[0], np.eye(3)[1])
    x = unit(np.cross(e, spare))
    y = np.cross(e, x)
    angles = np.arange(ROUND) * (2 * np.pi / ROUND)
    n = np.cos(angles)[:, None] * x[:, :, None] + np.sin(angles)[:, None] * y[:, :, None]
    value = posed.gap(n.reshape(len(e), -1, 3)).reshape(n.shape[:3])
    top = (value >= np.roll(value, 1, axis=2)) & (value >= np.roll(value, -1, axis=2))
    order = np.argsort(np.where(top, -value, np.inf).reshape(len(e), -1), axis=1)[:, : 5 * BEST]
    rows = np.arange(len(e))[:, None]
    circle, at = order // ROUND, angles[order % ROUND]
    width = np.full(at.shape, 2 * np.pi / ROUND)
    for narrow in (0.1, 0.01):
        more, angle = _near_creases(posed, e, x, y)
        circle, at = np.concatenate([circle, more], axis=1), np.concatenate([at, angle], axis=1)
        width = np.concatenate([width, np.full(angle.shape, narrow)], axis=1)
    x, y = x[rows, circle], y[rows, circle]

    def along(angle: np.ndarray) -> np.ndarray:
        return np.cos(angle)[..., None] * x + np.sin(angle)[..., None] * y

    low, high = at - width, at + width
    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_left, at_right = posed.gap(along(left)), posed.gap(along(right))
    for _ in range(40):
        worse = at_left < at_right
        low, high = np.where(worse, left, low), np.where(worse, high, right)
        new = np.where(worse, low + GOLDEN * (high - low), high - GOLDEN * (high - low))
        at_new = posed.gap(along(new))
        left, right = np.where(worse, right, new), np.where(worse, new, left)
        at_left, at_right = np.where(worse, at_right, at_new), np.where(worse, at_new, at_left)
    return _top(posed, along(np.where(at_left < at_right, right, left)), BEST)


def _near_creases(
    posed: Posed, e: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where circles cross those of an ellipsoid's axes: its maximum there may be narrow. The best
    of these crossings: which circle, (poses, k), and the angle on it."""
    own = posed.a.creases if posed.a.kind == "ellipsoid" else np.zeros((0, 3))
    other = posed.b.creases if posed.b.kind == "ellipsoid" else np.zeros((0, 3))
    axes = np.concatenate(
        [np.broadcast_to(own, (len(e), *own.shape)), other @ posed.turn.transpose(0, 2, 1)], axis=1
    )
    n = np.cross(e[:, :, None], axes[:, None])
    angle = np.arctan2((n * y[:, :, None]).sum(-1), (n * x[:, :, None]).sum(-1))
    angle = np.concatenate([angle, angle + np.pi], axis=2)
    n = np.cos(angle)[..., None] * x[:, :, None] + np.sin(angle)[..., None] * y[:, :, None]
    value = posed.gap(n.reshape(len(e), -1, 3))
    order = np.argsort(-value, axis=1)[:, :BEST]
    angles = np.take_along_axis(angle.reshape(len(e), -1), order, axis=1)
    return order // max(angle.shape[2], 1), angles


def _smooth(posed: Posed, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not {posed.a.kind, posed.b.kind} - {"box", "mesh"} and not (posed.gap(starts) > 0).any():
        # Between creases the support of two polytopes is a point; a maximum is ahead of it.
        return _best(posed, starts)
    directions = sphere(SAMPLES)
    value = posed.gap(np.broadcast_to(directions, (len(posed.offset), SAMPLES, 3)))
    order = np.argsort(np.where(_tops(directions, value), -value, np.inf), axis=1)[:, :BEST]
    n = np.concatenate([directions[order], starts], axis=1)
    return _best(posed, newton(posed, climb(posed, n)))


def _tops(directions: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Where a sample is not below any of its six neighbours."""
    near = np.argsort(-(directions @ directions.T), axis=1)[:, 1:7]
    return (value[:, :, None] >= value[:, near]).all(axis=2)


def _tangents(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    spare = np.where(np.abs(n[..., :1]) < 0.6, np.eye(3)[0], np.eye(3)[1])
    x = unit(np.cross(n, spare))
    return x, np.cross(n, x)


def climb(posed: Posed, n: np.ndarray, rounds: int = 36) -> np.ndarray:
    """Tries eight directions around each; nearer ones where none is better."""
    step = np.full(n.shape[:2], 0.16)
    value = posed.gap(n)
    for turn in range(rounds):
        x, y = _tangents(n)
        angles = np.arange(8) * (np.pi / 4) + turn
        shift = np.cos(angles)[:, None] * x[:, :, None] + np.sin(angles)[:, None] * y[:, :, None]
        tried = unit(n[:, :, None] + step[..., None, None] * shift)
        before = value
        n, value = _better(posed, n, value, tried)
        better = value > before
        step = np.where(better, 1.3 * step, 0.45 * step)
    return n


def newton(posed: Posed, n: np.ndarray, rounds: int = 10) -> np.ndarray:
    """Newton's method in the tangent plane: slope of g the tangential part of b − a, its change
    by differences of the support; uphill also where g is not concave. Of some shares of each step
    the best is taken, if it is better."""
    value = posed.gap(n)
    h = 1e-6
    for _ in range(rounds):
        x, y = _tangents(n)
        apart = posed.apart(n)
        slope = np.stack([(apart * x).sum(-1), (apart * y).sum(-1)], axis=-1)
        columns = []
        for axis in (x, y):
            change = (posed.apart(unit(n + h * axis)) - posed.apart(unit(n - h * axis))) / (2 * h)
            columns.append(np.stack([(change * x).sum(-1), (change * y).sum(-1)], axis=-1))
        hessian = np.stack(columns, axis=-1) - value[..., None, None] * np.eye(2)
        bends, ways = np.linalg.eigh((hessian + hessian.swapaxes(-1, -2)) / 2)
        along = (ways.swapaxes(-1, -2) @ slope[..., None])[..., 0]
        bends = np.abs(bends)
        step = (ways @ (along / np.where(bends > 0, bends, np.inf))[..., None])[..., 0]
        length = np.linalg.norm(step, axis=-1, keepdims=True)
        step = step * np.minimum(1, 0.1 / np.where(length > 0, length, 1))
        whole = step[..., :1] * x + step[..., 1:] * y
        tried = unit(n[:, :, None] + SHARES[:, None] * whole[:, :, None])
        n, value = _better(posed, n, value, tried)
    return n


def _better(
    posed: Posed, n: np.ndarray, value: np.ndarray, tried: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The best of what was tried around each direction, or the direction itself."""
    values = posed.gap(tried.reshape(len(n), -1, 3)).reshape(tried.shape[:3])
    best = values.argmax(axis=2)
    top = np.take_along_axis(values, best[..., None], axis=2)[..., 0]
    to = np.take_along_axis(tried, best[..., None, None], axis=2)[:, :, 0]
    better = top > value
    return np.where(better[..., None], to, n), np.where(better, top, value)
