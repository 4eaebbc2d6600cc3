"""`Geom`: a shape that collides and gives mass to a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from stepcore.scene.element import Element
from stepcore.scene.elements import field_types as of
from stepcore.scene.elements.body import ABody
from stepcore.scene.elements.mesh import HField, Mesh
from stepcore.scene.frames import IDENTITY, ORIGIN

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
    surfacevel: Annotated[of.SurfaceVel, "m/s and rad/s"] = of.STILL
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
