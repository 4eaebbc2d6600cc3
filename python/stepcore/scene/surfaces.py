"""Meshes and height fields: elements that geoms refer to, with their numbers in arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from numpy.typing import NDArray

from stepcore import checks
from stepcore.scene.element import Element
from stepcore.scene.frames import IDENTITY, ORIGIN, Vec

if TYPE_CHECKING:
    from typing import Self

MESH_INERTIAS = ("convex", "exact", "legacy", "shell")


class Asset(Element):
    """Base of meshes and height fields: arrays are read-only, and shared by copies."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # Its values are constants all of them.
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
        words = [f"{name} {shape[0]} × {shape[1]}" for name, shape in shapes.items()]
        return f"<{self}: {', '.join(words)}>"


@dataclass(eq=False, repr=False, kw_only=True)
class Mesh(Asset):
    """A surface of triangles, for geoms of type "mesh" and primitives fitted to it.

    Its convex hull collides. Numbers are kept in double precision (MuJoCo rounds to single).

    name: unique among meshes, or "".
    vertices: [m before `scale`], shape (n, 3), n >= 4.
    faces: indices of vertices, counter-clockwise from outside, shape (m, 3); None: the hull's.
    scale: of each axis, shape (3,); a negative number mirrors.
    refpos, refquat: position [m] and orientation of the frame that the vertices are meant in.
    inertia: how volume and inertia are found: "convex" (of the hull), "exact" (a closed surface,
        well oriented), "legacy" (MuJoCo's default, which counts hollows as full) or "shell".
    maxhullvert: the most vertices of the hull (> 3); -1: any number.
    file: the file that it was read from, or "".
    """

    name: Annotated[str, checks.text] = ""
    vertices: Annotated[NDArray[Any], checks.table(3)]
    faces: Annotated[NDArray[Any] | None, checks.optional(checks.table(3, whole=True))] = None
    scale: Annotated[Vec, checks.vector(3)] = (1.0, 1.0, 1.0)
    refpos: Annotated[Vec, checks.vector(3)] = ORIGIN
    refquat: Annotated[Vec, checks.unit(4)] = IDENTITY
    inertia: Annotated[str, checks.one_of(*MESH_INERTIAS)] = "legacy"
    maxhullvert: Annotated[int, checks.most_vertices] = -1
    file: Annotated[str, checks.text] = ""


@dataclass(eq=False, repr=False, kw_only=True)
class HField(Asset):
    """A height field: the solid below a grid of heights, for geoms of type "hfield".

    name: unique among height fields, or "".
    size: half sizes along x and y, height of the highest point above the lowest, and depth of the
        base below the lowest [m], shape (4,), > 0.
    elevation: heights of any scale, shape (rows, columns), at least 2 × 2: the first row is at the
        largest y, as in an image; the lowest height becomes 0 and the highest `size[2]`.
    file: the file that it was read from, or "".
    """

    name: Annotated[str, checks.text] = ""
    size: Annotated[Vec, checks.vector(4, low=0)]
    elevation: Annotated[NDArray[Any], checks.table(None)]
    file: Annotated[str, checks.text] = ""
