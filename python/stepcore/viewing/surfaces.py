"""Triangles of meshes, height fields and primitives, in the frame of their geom."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.scene import frames
from stepcore.scene.elements import Geom, HField, Mesh
from stepcore.scene.frames import Vec

# Vertices, shape (n, 3) [m], and triangles as indices of them, shape (m, 3).
Surface = tuple[NDArray[Any], NDArray[Any]]
# Corners of a circle; a half circle has as many rings as fit.
ROUND = 28


def of_geom(geom: Geom) -> Surface | None:
    """Return the triangles of a geom's mesh or height field; None for other geoms."""
    if geom.type == "mesh" and geom.mesh is not None:
        return of_mesh(geom.mesh)
    if geom.type == "hfield" and geom.hfield is not None:
        return of_hfield(geom.hfield)
    return None


def of_mesh(mesh: Mesh) -> Surface | None:
    """Return the triangles of a mesh's file, scaled and in the frame of the geom.

    Returns None for a mesh without faces, whose hull is drawn.
    """
    if mesh.faces is None or not len(mesh.faces):
        return None
    vertices = np.asarray(mesh.vertices, float) - mesh.refpos
    vertices = vertices @ np.array(frames.matrix(mesh.refquat))
    faces = np.asarray(mesh.faces, np.int64)
    if np.prod(mesh.scale) < 0:
        # A mirror turns triangles inside out.
        faces = faces[:, ::-1]
    return vertices * mesh.scale, faces


def of_hfield(hfield: HField) -> Surface:
    """Return the upper side of a height field, thinned out if it has very many points."""
    heights = np.asarray(hfield.elevation, float)[::-1]
    rows, columns = (
        np.unique(np.linspace(0, count - 1, min(count, 200)).round().astype(int))
        for count in heights.shape
    )
    low, high = heights.min(), heights.max()
    y, x = (
        (2.0 * indices / (count - 1) - 1.0) * half
        for indices, count, half in zip(
            (rows, columns), heights.shape, hfield.size[1::-1], strict=True
        )
    )
    heights = (heights[np.ix_(rows, columns)] - low) / (high - low or 1.0) * hfield.size[2]
    first = np.arange(len(rows) * len(columns)).reshape(len(rows), len(columns))
    faces = _halved(first[:-1, :-1], first[:-1, 1:], first[1:, 1:], first[1:, :-1])
    return np.stack([*np.meshgrid(x, y), heights], axis=-1).reshape(-1, 3), faces


def of_primitive(kind: str, size: Vec, reach: float) -> Surface:
    """Return the triangles of a primitive; reach: the half size of an infinite plane [m]."""
    r, h = (*size, 0.0)[:2]
    half_circle = np.linspace(-np.pi / 2, np.pi / 2, ROUND - 4)
    profile = np.stack([np.cos(half_circle), np.sin(half_circle)], axis=1)
    match kind:
        case "plane":
            half = [each or reach for each in size[:2]]
            corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
            return corners * (*half, 0.0), np.array([(0, 1, 2), (0, 2, 3)])
        case "box":
            return _box(np.array(size[:3], float))
        case "cylinder":
            return _turned(np.array([(0.0, -h), (r, -h), (r, -h), (r, h), (r, h), (0.0, h)]))
        case "capsule":
            ends = np.where(half_circle < 0, -h, h)
            return _turned(r * profile + np.stack([0 * ends, ends], axis=1))
        case _:
            places, faces = _turned(profile)
            return places * (r if kind == "sphere" else size[:3]), faces


def _turned(profile: NDArray[np.float64]) -> Surface:
    """Return the surface of a profile (radius, z), from below upwards, rotated about z."""
    angles = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    round_ = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = [np.concatenate([r * round_, np.full((ROUND, 1), z)], axis=1) for r, z in profile]
    below = np.arange(len(profile) * ROUND).reshape(len(profile), ROUND)
    next_ = np.roll(below, -1, axis=1)
    return np.concatenate(rings), _halved(below[:-1], next_[:-1], next_[1:], below[1:])


def _halved(*corners: NDArray[Any]) -> NDArray[Any]:
    """Return the two triangles of each quadrangle; corners: its four, in order."""
    a, b, c, d = corners
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])


def _box(half: NDArray[np.float64]) -> Surface:
    """Return a box whose sides share no corners, so that each side is lit as a plane."""
    places: list[NDArray[np.float64]] = []
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for sign in (-1, 1):
            turn = (-u - v, u - v, u + v, v - u) if sign > 0 else (-u - v, v - u, u + v, u - v)
            places += [(sign * np.eye(3)[axis] + corner) * half for corner in turn]
    return np.array(places), _halved(*np.arange(len(places)).reshape(-1, 4).T)
