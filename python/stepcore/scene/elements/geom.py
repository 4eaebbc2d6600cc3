"""`Geom`."""

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
    """A shape fixed to a body: it collides, and it gives the body mass.

    name: unique among geoms, or "".
    body: the `Body` that it is fixed to.
    type: "plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box" or "mesh".
    size: [m], shape (3,): radius of a sphere; radius and half length of a capsule or cylinder; half
        sizes of a box or ellipsoid; for a plane, half sizes and grid spacing for drawing (0 is
        infinite). Fewer numbers may be given.
    pos, quat: position [m], shape (3,), and orientation, shape (4,), in the body's frame. Those of
        a mesh are of the coordinates of its vertices; the compiled geom stands at its centre.
    mesh: the `Mesh` of a geom of type "mesh", or one that a primitive is fitted to: its size and
        pose are then found from the mesh (see `MassRules.fitaabb`). fitscale: times that size.
    hfield: the `HField` of a geom of type "hfield".
    mass: [kg], >= 0; None means density × volume.
    density: [kg/m³], or [kg/m²] with shellinertia; >= 0.
    shellinertia: True puts the mass on the surface.
    group: an integer that `MassRules.inertiagrouprange` refers to.
    contype, conaffinity: 32-bit masks; two geoms can collide if the contype of one and the
        conaffinity of the other share a bit.
    condim: dimension of the contact: 1 (frictionless), 3 (sliding), 4 (and torsion about the
        normal) or 6 (and rolling).
    friction: sliding, torsional [m] and rolling [m] coefficient, shape (3,), >= 0.
    solref, solimp: softness of its contacts.
    priority, solmix: which of two geoms decides their contact's parameters, and how they are mixed.
    fluidshape: what a fluid around the scene takes the geom for: "ellipsoid", or "none", a part of
        a box with the inertia of its body, which counts where none of its geoms is an ellipsoid.
    fluidcoef: of an ellipsoid: blunt, slender and angular drag, Kutta and Magnus lift, shape (5,).
    hidden: True: rays and rangefinders pass through it, as through MJCF's geoms of opacity 0.
    margin: distance below which contacts act [m]. gap: contacts are listed from margin + gap [m].
    surfacevel: how its surface moves as contacts feel it, in the geom's frame, shape (6,): a
        velocity [m/s], and an angular velocity about the frame's origin [rad/s]: belts, turntables.
    adhesion: with how much each of its contacts can pull [N]; of two geoms the sum, or that of the
        one whose priority is higher. They pull as far as the gap reaches.
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
        """The largest half size [m]; 0 of ground, which has none of its own."""
        if self.type in ("plane", "hfield"):
            return 0.0
        if self.mesh is not None:
            return 0.5 * float(np.ptp(self.mesh.placed(), axis=0).max()) * self.fitscale
        return max(self.size)


AGeom = Annotated[Geom, of.element("Geom")]
