"""`Body`: a rigid body of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

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

    def plain(self, places: Places) -> dict[str, Any]:
        """Return the body as the engine reads it, with its own mass and inertia in one dict."""
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
