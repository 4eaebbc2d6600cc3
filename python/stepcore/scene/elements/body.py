"""`Body`, `Joint` and `Site`: what a scene's tree is made of, besides its geoms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from stepcore import checks
from stepcore.scene.element import Element, Places, place_of
from stepcore.scene.elements import field_types as of
from stepcore.scene.frames import IDENTITY, ORIGIN, Vec, turned_inertia

# Sleep policies of a tree, set on its root.
SLEEP = ("auto", "never", "allowed", "init")


@dataclass(eq=False, repr=False, kw_only=True)
class Body(Element):
    """A rigid body.

    name: unique among bodies, or "".
    parent: the parent `Body`; None for the world.
    pos: position in the parent's frame [m], shape (3,).
    quat: orientation in the parent's frame, shape (4,).
    mass: [kg], >= 0; None takes mass, centre of mass and inertia from the body's geoms.
    ipos: centre of mass in the body's frame [m], shape (3,).
    inertia: about the centre of mass, in body axes [kg·m²], shape (6,): xx yy zz xy xz yz. Three
        numbers give a diagonal.
    iquat: orientation of the principal axes of the inertia in the body's frame, shape (4,); None
        computes the axes from the inertia. The choice of axes matters if principal moments are
        equal: fluid drag (``density``) acts along these axes, and sensors of frames of type "body"
        rotate with these axes. Assigning an inertia with other axes resets iquat to None.
    gravcomp: fraction of the body's weight that a force at the centre of mass compensates; at 1
        the body floats.
    mocap: True for a body whose pose is an input (`Sim.mocap_pos`, `Sim.mocap_quat`). A mocap body
        is a child of the world without joints. The pose is constant during a step, and bodies that
        are welded to the mocap body follow the pose.
    sleep: whether the tree with this root may sleep (`Settings.sleep`). "auto" allows sleep unless
        an actuator drives the tree, a tendon with a spring or damper connects it to another tree,
        or a tendon connects three trees. "never" forbids sleep. "allowed" always allows sleep.
        "init" always allows sleep, and the tree sleeps from the start.
    """

    name: of.Text = ""
    parent: Annotated[Body | None, of.optional(of.element("Body"))] = None
    pos: Annotated[of.Vec3, "m"] = ORIGIN
    quat: of.Quat = IDENTITY
    mass: Annotated[of.Mass, "kg"] = None
    ipos: Annotated[of.Vec3, "m"] = ORIGIN
    inertia: Annotated[of.Inertia, "kg·m²"] = (0.0,) * 6
    iquat: Annotated[Vec | None, of.optional(of.unit(4))] = None
    gravcomp: of.Real = 0.0
    mocap: of.Flag = False
    sleep: Annotated[str, of.words(*SLEEP)] = "auto"

    def __setattr__(self, field: str, value: object) -> None:
        super().__setattr__(field, value)
        axes = self.__dict__.get("iquat") if field == "inertia" else None
        if axes is not None and not _principal(axes, self.inertia):
            self.iquat = None

    def check_mass(self) -> None:
        """Raise ElementError for an inertia without a mass."""
        if self.mass is None and (any((*self.inertia, *self.ipos)) or self.iquat is not None):
            raise checks.refuse(self, "mass", None, "given where ipos, inertia or iquat is")

    def plain(self, places: Places) -> dict[str, Any]:
        """Return the body as the engine reads it, with its mass and inertia in one dict."""
        weight = ("mass", "ipos", "inertia", "iquat")
        inertial = None
        if self.mass is not None:
            axes = None if self.iquat is None else list(self.iquat)
            inertial = {"mass": self.mass, "pos": list(self.ipos), "inertia": list(self.inertia)}
            inertial["axes"] = axes
        parent = 0 if self.parent is None else place_of(places, self.parent)
        return self.record("parent", *weight) | {"parent": parent, "inertial": inertial}


def _principal(axes: Vec, inertia: Vec) -> bool:
    w, x, y, z = axes
    xx, yy, zz, *products = turned_inertia((w, -x, -y, -z), inertia)
    # The engine's limit of the products of inertia in principal axes is slightly larger.
    return max(map(abs, products)) <= 1e-10 * (xx + yy + zz) and any(inertia)


# A required and an optional reference to a body.
ABody = Annotated[Body, of.element("Body")]
SomeBody = Annotated[Body | None, of.optional(of.element("Body"))]


JOINT_TYPES = ("free", "ball", "slide", "hinge")


@dataclass(eq=False, repr=False, kw_only=True)
class Joint(Element):
    """A joint between a body and its parent. Several joints of one body act in order.

    name: unique among joints, or "".
    body: the `Body` that the joint moves.
    type: "hinge", "slide", "ball" or "free".
    pos: anchor in the body's frame [m], shape (3,).
    axis: axis of a hinge or slide in the body's frame, shape (3,), stored at unit length.
    range: (lower, upper) limit [rad or m], or None for no limit; (0, largest angle) for a ball.
    margin: distance from a limit at which the limit starts to act [rad or m].
    ref: coordinate of a hinge or slide in the initial pose of the scene [rad or m].
    springref: coordinate at which the spring is relaxed [rad or m].
    stiffness: stiffness of the spring [N·m/rad or N/m].
    stiffnesspoly: b [.../rad or m] and c [.../rad² or m²] of a spring with the restoring force
        (stiffness + b x + c x²) x at a stretch x. For a ball, x is the norm of the stretch; for a
        free joint, translation and rotation have a norm each.
    damping: [N·m·s/rad or N·s/m].
    dampingpoly: b and c of a damper with the force (damping + b |v| + c v²) v.
    springdamper: time constant [s] and damping ratio, > 0, of spring and damper, for the inertia
        that the joint moves in the initial pose; None uses `stiffness` and `damping`.
    actuatorgravcomp: True counts the gravity compensation of bodies on this joint as a force of
        the joint's actuators.
    armature: inertia added to each dof of the joint [kg·m² or kg], >= 0.
    actuatorfrcrange: (lower, upper) bounds of the sum of all actuator forces on a hinge or slide
        [N·m or N], or None.
    frictionloss: dry friction [N·m or N], >= 0.
    solreflimit, solimplimit: softness of the limit.
    solreffriction, solimpfriction: softness of the dry friction.
    """

    name: of.Text = ""
    body: ABody
    type: Annotated[str, of.words(*JOINT_TYPES)] = "hinge"
    pos: Annotated[of.Vec3, "m"] = ORIGIN
    axis: of.Axis = (0.0, 0.0, 1.0)
    range: Annotated[of.Reach, "rad or m"] = None
    margin: Annotated[of.Real, "rad or m"] = 0.0
    ref: Annotated[of.Real, "rad or m"] = 0.0
    springref: Annotated[of.Real, "rad or m"] = 0.0
    stiffness: Annotated[of.Real, "N·m/rad or N/m"] = 0.0
    stiffnesspoly: of.Poly = (0.0, 0.0)
    damping: Annotated[of.Real, "N·m·s/rad or N·s/m"] = 0.0
    dampingpoly: of.Poly = (0.0, 0.0)
    springdamper: Annotated[of.SpringDamper, "s and 1"] = None
    actuatorgravcomp: of.Flag = False
    armature: Annotated[of.NonNegative, "kg·m² or kg"] = 0.0
    actuatorfrcrange: Annotated[of.Range, "N·m or N"] = None
    frictionloss: Annotated[of.NonNegative, "N·m or N"] = 0.0
    solreflimit: of.SolRef = of.SOLREF
    solimplimit: of.SolImp = of.SOLIMP
    solreffriction: of.SolRef = of.SOLREF
    solimpfriction: of.SolImp = of.SOLIMP

    @property
    def sprung(self) -> bool:
        """Whether the joint has a spring."""
        return self.springdamper is not None or any((self.stiffness, *self.stiffnesspoly))

    @property
    def damped(self) -> bool:
        """Whether the joint has a damper."""
        return self.springdamper is not None or any((self.damping, *self.dampingpoly))

    def record(self, *skip: str) -> dict[str, Any]:
        """Return the fields as the engine reads them; a missing springdamper becomes two zeros."""
        return super().record(*skip) | {"springdamper": list(self.springdamper or (0.0, 0.0))}


SomeJoint = Annotated[Joint | None, of.optional(of.element("Joint"))]


# MuJoCo's default size of a site.
SITE_SIZE = (0.005, 0.005, 0.005)


@dataclass(eq=False, repr=False, kw_only=True)
class Site(Element):
    """A named frame on a body, with a volume that some sensors use.

    name: unique among sites, or "".
    body: the `Body` that the site is fixed to.
    pos, quat: position [m], shape (3,), and orientation, shape (4,), in the body's frame.
    type: shape of the volume: "sphere", "capsule", "ellipsoid", "cylinder" or "box".
    size: size of the volume [m], as for a geom, shape (3,). Fewer numbers may be given.
    """

    name: of.Text = ""
    body: ABody
    pos: Annotated[of.Vec3, "m"] = ORIGIN
    quat: of.Quat = IDENTITY
    type: Annotated[str, of.words("sphere", "capsule", "ellipsoid", "cylinder", "box")] = "sphere"
    size: Annotated[of.Size, "m"] = SITE_SIZE


SomeSite = Annotated[Site | None, of.optional(of.element("Site"))]
