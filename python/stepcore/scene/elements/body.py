"""`Body`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from stepcore.scene.element import Element, Places, place_of
from stepcore.scene.elements import field_types as of
from stepcore.scene.frames import IDENTITY, ORIGIN, Vec, turned_inertia

# Who may sleep, said of the root of a tree.
SLEEP = ("auto", "never", "allowed", "init")
# Products of inertia in principal axes, of the trace; the engine allows a little more.
PRINCIPAL = 1e-10


@dataclass(eq=False, repr=False, kw_only=True)
class Body(Element):
    """A rigid body.

    name: unique among bodies, or "".
    parent: the `Body` that carries it; None for the world.
    pos: position in the parent's frame [m], shape (3,).
    quat: orientation in the parent's frame, shape (4,).
    mass: [kg], >= 0; None takes mass, centre of mass and inertia from the body's geoms.
    ipos: centre of mass in the body's frame [m], shape (3,).
    inertia: about the centre of mass, in body axes [kg·m²], shape (6,): xx yy zz xy xz yz. Three
        numbers give a diagonal.
    iquat: orientation of the principal axes of that inertia in the body's frame, shape (4,); None
        finds them from it. It matters where moments are equal: a fluid drags a body by its axes
        (``density``), and sensors of frames of type "body" turn with them. It becomes None where
        an inertia is assigned that has other axes.
    gravcomp: share of its weight that a force at its centre of mass holds up; 1 floats.
    mocap: True for a body whose pose is an input (`Sim.mocap_pos`, `Sim.mocap_quat`): a child of
        the world without joints, that stands still in every step, and holds what is welded to it.
    sleep: whether the tree of which this body is the root may sleep (`Settings.sleep`): "auto"
        unless an actuator drives it, a tendon with a spring or damper ties it to another tree, or
        a tendon joins three; "never"; "allowed" in any case; "init" in any case, and it sleeps
        from the start.
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
        """As for every element; what the body weighs by itself stands together."""
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
    return max(map(abs, products)) <= PRINCIPAL * (xx + yy + zz) and any(inertia)


# A reference to a body, and one that may be missing.
ABody = Annotated[Body, of.element("Body")]
SomeBody = Annotated[Body | None, of.optional(of.element("Body"))]
