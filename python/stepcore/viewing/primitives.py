"""Triangles of primitives, for renderers that draw only triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stepcore.viewing.drawing import Shape
from stepcore.viewing.surfaces import Surface

# Corners of a circle, and rings of a half circle.
ROUND, RINGS = 28, 12


def surface_of(shape: Shape, reach: float) -> Surface:
    """Return the triangles of a shape in its frame; reach: half size of an infinite plane [m]."""
    if shape.surface is not None:
        return shape.surface
    r, h = (*shape.size, 0.0)[:2]
    match shape.kind:
        case "plane":
            half = [size or reach for size in shape.size[:2]]
            corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
            return corners * (*half, 0.0), np.array([(0, 1, 2), (0, 2, 3)])
        case "box":
            return _box(np.array(shape.size[:3], float))
        case "cylinder":
            return _turned(np.array([(0.0, -h), (r, -h), (r, -h), (r, h), (r, h), (0.0, h)]))
        case "capsule":
            angles = np.linspace(-np.pi / 2, np.pi / 2, 2 * RINGS)
            ends = np.where(angles < 0, -h, h)
            return _turned(np.stack([r * np.cos(angles), r * np.sin(angles) + ends], axis=1))
        case _:
            angles = np.linspace(-np.pi / 2, np.pi / 2, 2 * RINGS)
            places, faces = _turned(np.stack([np.cos(angles), np.sin(angles)], axis=1))
            radii = (r, r, r) if shape.kind == "sphere" else shape.size[:3]
            return places * radii, faces


def _turned(profile: NDArray[np.float64]) -> Surface:
    """Return the surface of a profile (radius, z), from below upwards, rotated about z."""
    angles = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    round_ = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = [np.concatenate([r * round_, np.full((ROUND, 1), z)], axis=1) for r, z in profile]
    index = np.arange(len(profile) * ROUND).reshape(len(profile), ROUND)
    a, b = index[:-1], np.roll(index[:-1], -1, axis=1)
    c, d = np.roll(index[1:], -1, axis=1), index[1:]
    sides = [np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    return np.concatenate(rings), np.concatenate(sides)


def _box(half: NDArray[np.float64]) -> Surface:
    """Return a box whose sides share no corners, so that each side is lit as a plane."""
    places: list[NDArray[np.float64]] = []
    faces: list[list[tuple[int, ...]]] = []
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for sign in (-1, 1):
            n = sign * np.eye(3)[axis]
            first = 4 * len(faces)
            turn = (-u - v, u - v, u + v, v - u) if sign > 0 else (-u - v, v - u, u + v, u - v)
            places += [(n + corner) * half for corner in turn]
            faces.append([(first, first + 1, first + 2), (first, first + 2, first + 3)])
    return np.array(places), np.array(faces).reshape(-1, 3)
