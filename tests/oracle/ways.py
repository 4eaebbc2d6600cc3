"""Friction in more ways than two tangents: torsion about the normal, rolling about both tangents.

A way's impulse is divided by its coefficient over that of the first, so that one bound holds for
all: |x| <= bound for a round cone, |x_j| <= bound for a box. Then x A x / 2 + g x is minimised.
"""

from __future__ import annotations

import itertools

import numpy as np

from .rotation import Array

# What rounding leaves of an eigenvalue or a pivot of zero, beside the largest.
ZERO = 1e-14


def scales(friction: tuple[float, ...]) -> Array:
    """What an impulse in each way is divided by."""
    return np.array(friction) / friction[0]


def in_ball(A: Array, g: Array, bound: float) -> Array:
    """The minimiser over |x| <= bound: inside, or -(A + m)^-1 g with the m > 0 of the rim."""
    if bound <= 0:
        return np.zeros(len(g))
    d, V = np.linalg.eigh(A)
    moves = d > ZERO * max(d[-1], 0.0)
    along = np.where(moves, V.T @ g, 0.0)
    x = -along / np.where(moves, d, 1.0)
    if x @ x <= bound * bound:
        return np.asarray(V @ x)
    m = max(float(np.linalg.norm(along)) / bound - d[-1], 0.0)
    for _ in range(100):
        x = -along / np.where(moves, d + m, 1.0)
        length = np.sqrt(x @ x)
        slope = x @ (x / np.where(moves, d + m, 1.0))
        step = (length / bound - 1) * length**2 / slope
        if m + step <= m:
            break
        m += step
    return np.asarray(V @ x) * (bound / length)


def in_cube(A: Array, g: Array, bound: float) -> Array:
    """The minimiser over |x_j| <= bound: the face whose minimiser is one of the whole."""
    ways = range(len(g))
    if bound <= 0:
        return np.zeros(len(g))
    sides = np.zeros(len(g), int)
    for _ in range(20):
        x = on_face(A, g, bound, sides)
        w = A @ x + g
        outside = np.where(np.abs(x) > bound, np.sign(x), 0).astype(int)
        pressed = np.where(sides * w < 0, sides, 0)
        new = np.where(sides == 0, outside, pressed)
        if (new == sides).all():
            return x
        sides = new
    # It went round in a circle: every face, the one that is missed by least.
    best, least = np.zeros(len(g)), np.inf
    for face in itertools.product((-1, 0, 1), repeat=len(g)):
        x = np.clip(on_face(A, g, bound, np.array(face)), -bound, bound)
        cost = float(0.5 * x @ A @ x + g @ x)
        if cost < least and all(A[j, j] > 0 or x[j] == 0 for j in ways):
            best, least = x, cost
    return best


def on_face(A: Array, g: Array, bound: float, sides: Array) -> Array:
    """The minimiser with some ways held at -bound or bound; what nothing moves stays at zero."""
    x = np.where(np.diagonal(A) > 0, sides * bound, 0.0)
    free = np.flatnonzero(sides == 0)
    if len(free):
        own = A[np.ix_(free, free)]
        x[free] = np.linalg.pinv(own, rcond=ZERO, hermitian=True) @ -(g + A @ x)[free]
    return x


def onto_cube(x: Array, mu: float) -> Array:
    """Nearest point of the cone |x_j| <= mu x_n, x = (normal, ways)."""
    normal = x[0]
    for held, size in enumerate(np.sort(np.abs(x[1:]))[::-1]):
        if size <= mu * normal:
            break
        normal = (normal * (1 + held * mu * mu) + mu * size) / (1 + (held + 1) * mu * mu)
    normal = max(normal, 0.0)
    return np.array([normal, *np.clip(x[1:], -mu * normal, mu * normal)])
