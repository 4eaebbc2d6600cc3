"""Meshes and height fields as the engine reads them: vertices in place, heights from −y to y."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.scene.elements import Geom, HField, Mesh
from stepcore.scene.frames import IDENTITY, ORIGIN, rotated


def plain_mesh(mesh: Mesh) -> dict[str, Any]:
    """A mesh after refpos, refquat and scale; a mirrored one with its faces turned over."""
    faces = np.empty((0, 3), np.uintp) if mesh.faces is None else mesh.faces
    if np.prod(np.sign(mesh.scale)) < 0:
        faces = np.ascontiguousarray(faces[:, [0, 2, 1]])
    return {
        "name": mesh.name,
        "vertices": placed(mesh),
        "faces": faces,
        "inertia": mesh.inertia,
        "maxhullvert": None if mesh.maxhullvert == -1 else mesh.maxhullvert,
    }


def placed(mesh: Mesh) -> NDArray[Any]:
    """The vertices in the frame of the geom: scale · refquatᵀ (vertex − refpos)."""
    vertices: NDArray[Any] = mesh.vertices
    if mesh.refpos != ORIGIN:
        vertices = vertices - np.array(mesh.refpos)
    if mesh.refquat != IDENTITY:
        axes = np.array([rotated(mesh.refquat, axis) for axis in np.eye(3).tolist()])
        vertices = vertices @ axes.T
    if mesh.scale != (1.0, 1.0, 1.0):
        vertices = vertices * np.array(mesh.scale)
    return np.ascontiguousarray(vertices)


def half_size(geom: Geom) -> float:
    """The largest half size of a geom [m]; 0 of ground, which has none of its own."""
    if geom.type in ("plane", "hfield"):
        return 0.0
    if geom.mesh is not None:
        return 0.5 * float(np.ptp(placed(geom.mesh), axis=0).max()) * geom.fitscale
    return max(geom.size)


def plain_hfields(hfields: Iterable[HField]) -> list[dict[str, Any]]:
    """Height fields with their rows from −y to y; those of one file share their heights."""
    heights: dict[int, NDArray[Any]] = {}
    records = []
    for hfield in hfields:
        (nrow, ncol), key = hfield.elevation.shape, id(hfield.elevation)
        if key not in heights:
            heights[key] = hfield.elevation[::-1].ravel()
        own = {"name": hfield.name, "nrow": nrow, "ncol": ncol, "size": list(hfield.size)}
        records.append(own | {"data": heights[key]})
    return records
