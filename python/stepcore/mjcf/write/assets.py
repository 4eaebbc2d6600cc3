"""The section `<asset>`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.elements import HField, Mesh

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

# What is written of a mesh in another way, or not at all.
OWN = ("name", "vertices", "faces", "file")


def tags(scene: Contents, names: Names) -> list[Tag]:
    """Meshes and height fields, with their numbers."""
    meshes = [_mesh(mesh, names) for mesh in scene.meshes]
    return meshes + [_hfield(hfield, names) for hfield in scene.hfields]


def _mesh(mesh: Mesh, names: Names) -> Tag:
    arrays = {"vertex": mesh.vertices.ravel().tolist()}
    if mesh.faces is not None:
        arrays["face"] = mesh.faces.ravel().tolist()
    return Tag("mesh", **names.attribute(mesh), **changed(mesh, *OWN), **arrays)


def _hfield(hfield: HField, names: Names) -> Tag:
    nrow, ncol = hfield.elevation.shape
    heights = hfield.elevation.ravel().tolist()
    own = {"size": hfield.size, "nrow": nrow, "ncol": ncol, "elevation": heights}
    return Tag("hfield", **names.attribute(hfield), **own)
