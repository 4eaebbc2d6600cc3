"""Triangles of meshes and height fields, in the frame of their geom."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.scene import frames
from stepcore.scene.elements import HField, Mesh

# Vertices, shape (n, 3) [m], and triangles as indices of them, shape (m, 3).
Surface = tuple[NDArray[Any], NDArray[Any]]
# A height field of more points is drawn with fewer.
FINEST = 200


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
    rows, columns = (_some(count) for count in heights.shape)
    low, high = heights.min(), heights.max()
    heights = (heights[np.ix_(rows, columns)] - low) / (high - low or 1.0) * hfield.size[2]
    x = _across(columns, hfield.elevation.shape[1]) * hfield.size[0]
    y = _across(rows, hfield.elevation.shape[0]) * hfield.size[1]
    grid = np.stack([*np.meshgrid(x, y), heights], axis=-1)
    first = np.arange(len(rows) * len(columns)).reshape(len(rows), len(columns))
    a, b, c, d = first[:-1, :-1], first[:-1, 1:], first[1:, 1:], first[1:, :-1]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return grid.reshape(-1, 3), faces


def _some(count: int) -> NDArray[Any]:
    return np.unique(np.linspace(0, count - 1, min(count, FINEST)).round().astype(int))


def _across(indices: NDArray[Any], count: int) -> NDArray[Any]:
    return 2.0 * indices / (count - 1) - 1.0
