"""`Mesh` and `HField`: arrays that geoms refer to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore.scene.element import Element, FieldType
from stepcore.scene.elements import field_types as of
from stepcore.scene.frames import IDENTITY, ORIGIN, Vec, rotated

if TYPE_CHECKING:
    from typing import Self

MESH_INERTIAS = ("convex", "exact", "legacy", "shell")


class Asset(Element):
    """Base class of meshes and height fields: copies share the read-only arrays."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # All values are immutable.
        result = object.__new__(type(self))
        result.__dict__.update(self.__dict__)
        memo[id(self)] = result
        return result

    def __setstate__(self, state: dict[str, Any]) -> None:
        for value in state.values():
            if hasattr(value, "flags"):
                value.flags.writeable = False
        self.__dict__.update(state)

    def __repr__(self) -> str:
        shapes = {k: v.shape for k, v in self.__dict__.items() if hasattr(v, "shape")}
        parts = [f"{name} {shape[0]} × {shape[1]}" for name, shape in shapes.items()]
        return f"<{self}: {', '.join(parts)}>"


Vertices = Annotated[NDArray[Any], FieldType(checks.table(3), "ArrayLike")]
Faces = Annotated[
    NDArray[Any] | None, of.optional(FieldType(checks.table(3, whole=True), "ArrayLike"))
]
HullVertices = Annotated[int, FieldType(checks.most_vertices, "int", "int")]
FilePath = Annotated[str, FieldType(checks.text, "str | os.PathLike[str]", "")]
Heights = Annotated[NDArray[Any], FieldType(checks.table(None), "ArrayLike")]


@dataclass(eq=False, repr=False, kw_only=True)
class Mesh(Asset):
    """A surface of triangles, for geoms of type "mesh" and primitives fitted to it.

    Collisions use the convex hull. Numbers are stored in double precision (MuJoCo rounds to
    single).

    name: unique among meshes, or "".
    vertices: [m before `scale`], shape (n, 3), n >= 4.
    faces: indices of vertices, counter-clockwise from outside, shape (m, 3); None: the faces of the
        hull.
    scale: factor for each axis, shape (3,); a negative factor mirrors.
    refpos, refquat: position [m] and orientation of the reference frame of the vertices.
    inertia: method for volume and inertia: "convex" (of the hull), "exact" (of a closed surface,
        consistently oriented), "legacy" (MuJoCo's default, which counts hollows as solid) or
        "shell".
    maxhullvert: largest number of vertices of the hull (> 3); -1: no limit.
    file: the source file, or "".
    """

    name: of.Text = ""
    vertices: Annotated[Vertices, "m"]
    faces: Faces = None
    scale: of.Vec3 = (1.0, 1.0, 1.0)
    refpos: Annotated[of.Vec3, "m"] = ORIGIN
    refquat: of.Quat = IDENTITY
    inertia: Annotated[str, of.words(*MESH_INERTIAS)] = "legacy"
    maxhullvert: HullVertices = -1
    file: FilePath = ""

    def placed(self) -> NDArray[Any]:
        """Return the vertices in the frame of the geom: scale · refquatᵀ (vertex − refpos)."""
        vertices: NDArray[Any] = self.vertices
        if self.refpos != ORIGIN:
            vertices = vertices - np.array(self.refpos)
        if self.refquat != IDENTITY:
            axes = np.array([rotated(self.refquat, axis) for axis in np.eye(3).tolist()])
            vertices = vertices @ axes.T
        if self.scale != (1.0, 1.0, 1.0):
            vertices = vertices * np.array(self.scale)
        return np.ascontiguousarray(vertices)

    def record(self, *_: str) -> dict[str, Any]:
        """Return the mesh as the engine reads it, in the geom's frame.

        The faces of a mirrored mesh are flipped.
        """
        faces = np.empty((0, 3), np.uintp) if self.faces is None else self.faces
        if np.prod(np.sign(self.scale)) < 0:
            faces = np.ascontiguousarray(faces[:, [0, 2, 1]])
        return {
            "name": self.name,
            "vertices": self.placed(),
            "faces": faces,
            "inertia": self.inertia,
            "maxhullvert": None if self.maxhullvert == -1 else self.maxhullvert,
        }


@dataclass(eq=False, repr=False, kw_only=True)
class HField(Asset):
    """A height field: the solid below a grid of heights, for geoms of type "hfield".

    name: unique among height fields, or "".
    size: half sizes along x and y, height of the highest point above the lowest, and depth of the
        base below the lowest [m], shape (4,), > 0.
    elevation: heights of any scale, shape (rows, columns), at least 2 × 2: the first row is at the
        largest y, as in an image; the lowest height becomes 0 and the highest `size[2]`.
    file: the source file, or "".
    """

    name: of.Text = ""
    size: Annotated[Vec, of.vector(4, low=0), "m"]
    elevation: Heights
    file: FilePath = ""
