"""`Geom` and its `Mesh` or `HField`, and contact parameters that do not come from geoms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore.scene.element import Element, FieldType, Places
from stepcore.scene.elements import field_types as of
from stepcore.scene.elements.body import ABody
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
    NDArray[Any] | None, of.optional(FieldType(checks.table(3, indices=True), "ArrayLike"))
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


GEOM_TYPES = ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")


@dataclass(eq=False, repr=False, kw_only=True)
class Geom(Element):
    """A shape fixed to a body. A geom collides and gives mass to its body.

    name: unique among geoms, or "".
    body: the `Body` that the geom is fixed to.
    type: "plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box" or "mesh".
    size: [m], shape (3,): radius of a sphere; radius and half length of a capsule or cylinder; half
        sizes of a box or ellipsoid; for a plane, half sizes and grid spacing for drawing (0 is
        infinite). Fewer numbers may be given.
    pos, quat: position [m], shape (3,), and orientation, shape (4,), in the body's frame. For a
        mesh, this is the frame of the vertices; the compiled geom has its origin at the mesh's
        centre.
    mesh: the `Mesh` of a geom of type "mesh", or the `Mesh` that a primitive is fitted to. A fitted
        primitive takes its size and pose from the mesh (see `MassRules.fitaabb`).
    fitscale: factor on the size of a fitted primitive.
    hfield: the `HField` of a geom of type "hfield".
    mass: [kg], >= 0; None means density × volume.
    density: [kg/m³], or [kg/m²] with shellinertia; >= 0.
    shellinertia: True puts the mass on the surface.
    group: an integer; `MassRules.inertiagrouprange` selects geoms by group.
    contype, conaffinity: 32-bit masks; two geoms can collide if the contype of one and the
        conaffinity of the other share a bit.
    condim: dimension of the contact: 1 (frictionless), 3 (sliding), 4 (and torsion about the
        normal) or 6 (and rolling).
    friction: sliding, torsional [m] and rolling [m] coefficient, shape (3,), >= 0.
    solref, solimp: softness of the geom's contacts.
    priority: the geom with the higher priority sets the parameters of a contact. At equal priority
        the larger condim and friction count, and the softness is mixed.
    solmix: weight of the geom's softness in the mixture.
    fluidshape: model of fluid forces on the geom. "ellipsoid" applies forces to the geom. "none"
        leaves fluid forces to the box with the inertia of the body; this box counts only if no geom
        of the body is an ellipsoid.
    fluidcoef: blunt, slender and angular drag, Kutta and Magnus lift of an ellipsoid, shape (5,).
    hidden: True lets rays and rangefinders pass through the geom, as for MJCF's geoms of opacity 0.
    margin: distance below which contacts act [m].
    gap: contacts are listed at distances below margin + gap [m].
    surfacevel: velocity of the surface in contacts (belts, turntables), in the geom's frame, shape
        (6,): linear velocity [m/s], angular velocity about the frame's origin [rad/s].
    adhesion: largest pulling force of each contact [N]. For two geoms, their adhesions add up; with
        different priorities, only the adhesion of the higher priority counts. Contacts pull at
        distances up to the gap.
    """

    name: of.Text = ""
    body: ABody
    type: Annotated[str, of.words(*GEOM_TYPES)] = "sphere"
    size: Annotated[of.Size, "m"] = ORIGIN
    pos: Annotated[of.Vec3, "m"] = ORIGIN
    quat: of.Quat = IDENTITY
    mesh: Annotated[Mesh | None, of.optional(of.element("Mesh"))] = None
    fitscale: of.Positive = 1.0
    hfield: Annotated[HField | None, of.optional(of.element("HField"))] = None
    mass: Annotated[of.Mass, "kg"] = None
    density: Annotated[of.NonNegative, "kg/m³ or kg/m²"] = 1000.0
    shellinertia: of.Flag = False
    group: of.Int = 0
    hidden: of.OwnFlag = False
    contype: of.Mask = 1
    conaffinity: of.Mask = 1
    condim: of.Condim = 3
    priority: of.Int = 0
    friction: Annotated[of.Friction, "1, m and m"] = of.FRICTION
    margin: Annotated[of.Real, "m"] = 0.0
    gap: Annotated[of.NonNegative, "m"] = 0.0
    surfacevel: Annotated[of.SurfaceVel, "m/s and rad/s"] = of.ZERO_VELOCITY
    adhesion: Annotated[of.NonNegative, "N"] = 0.0
    solmix: of.NonNegative = 1.0
    solref: of.SolRef = of.SOLREF
    solimp: of.SolImp = of.SOLIMP
    fluidshape: Annotated[str, of.words("none", "ellipsoid")] = "none"
    fluidcoef: of.FluidCoef = of.FLUIDCOEF

    @property
    def half_size(self) -> float:
        """The largest half size [m]; 0 for planes and height fields."""
        if self.type in ("plane", "hfield"):
            return 0.0
        if self.mesh is not None:
            return 0.5 * float(np.ptp(self.mesh.placed(), axis=0).max()) * self.fitscale
        return max(self.size)


AGeom = Annotated[Geom, of.element("Geom")]


@dataclass(eq=False, repr=False, kw_only=True)
class Pair(Element):
    """Two geoms that can collide, with contact parameters for this pair.

    The parameters and masks of the geoms have no effect on the pair, nor do excluded bodies. The
    geoms collide even if the body of one geom is the parent of the body of the other geom.

    name: unique among pairs, or "".
    geom1, geom2: the two `Geom` objects.
    condim: dimension of the contact: 1 (frictionless), 3 (sliding), 4 (and torsion about the
        normal) or 6 (and rolling).
    friction: sliding along both tangents [1], torsional [m], and rolling about both [m], shape
        (5,), >= 0. A pyramid or cone can be narrower along one tangent than along the other.
    solref, solimp: softness of the pair's contacts.
    solreffriction: solref of the friction rows of an elliptic cone, where only the damping counts;
        None means the solref of the normal row.
    margin: distance below which contacts act [m].
    gap: contacts are listed at distances below margin + gap [m].
    adhesion: largest pulling force of each contact [N].
    """

    name: of.Text = ""
    geom1: AGeom
    geom2: AGeom
    condim: of.Condim = 3
    friction: of.PairFriction = of.PAIR_FRICTION
    solref: of.SolRef = of.SOLREF
    solimp: of.SolImp = of.SOLIMP
    solreffriction: of.SolRefFriction = None
    margin: Annotated[of.Real, "m"] = 0.0
    gap: Annotated[of.NonNegative, "m"] = 0.0
    adhesion: Annotated[of.NonNegative, "N"] = 0.0

    def check(self, places: Places) -> None:
        """Raise ElementError unless the pair is of two geoms of the scene."""
        for geom in (self.geom1, self.geom2):
            places.needed(self, geom)
        if self.geom1 is self.geom2:
            raise checks.ElementError(self, f"pairs {self.geom1} with itself")


@dataclass(eq=False, repr=False, kw_only=True)
class ContactOverride(Element):
    """Contact parameters that replace the parameters of every contact while `enable` is True.

    MJCF's ``o_margin``, ``o_solref``, ``o_solimp``, ``o_friction`` and the flag ``override``.

    margin: distance below which contacts act [m].
    solref, solimp: softness.
    friction: as in `Pair`, shape (5,).
    """

    enable: of.Flag = False
    margin: Annotated[of.Real, "m"] = 0.0
    solref: of.SolRef = of.SOLREF
    solimp: of.SolImp = of.SOLIMP
    friction: of.PairFriction = of.PAIR_FRICTION

    def __str__(self) -> str:
        return "contact_override"
