"""`Equality`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from stepcore.scene.element import Element
from stepcore.scene.elements.body import Body
from stepcore.scene.elements.field_types import (
    POLYCOEF,
    SOLIMP,
    SOLREF,
    Flag,
    PolyCoef,
    Real,
    RelPose,
    SolImp,
    SolRef,
    Text,
    Vec3,
    element,
    optional,
    words,
)
from stepcore.scene.elements.geom import Geom
from stepcore.scene.elements.joint import Joint
from stepcore.scene.elements.site import Site
from stepcore.scene.elements.tendon import Tendon
from stepcore.scene.frames import ORIGIN

# By type: what its rows are called.
ROW_KINDS = {
    "connect": "connect",
    "weld": "weld",
    "joint": "joint equality",
    "tendon": "tendon equality",
}

# By type: the fields that it can have beside its name, softness and `active`.
BODIES, SITES = ("body1", "body2", "anchor"), ("site1", "site2")
FIELDS = {
    "connect": (*BODIES, *SITES),
    "weld": (*BODIES, *SITES, "relpose", "torquescale"),
    "joint": ("joint1", "joint2", "polycoef"),
    "tendon": ("tendon1", "tendon2", "polycoef"),
}

SomeBody = Annotated[Body | None, optional(element("Body"))]
SomeSite = Annotated[Site | None, optional(element("Site"))]
SomeTendon = Annotated[Tendon | None, optional(element("Tendon"))]
SomeJoint = Annotated[Joint | None, optional(element("Joint"))]


@dataclass(eq=False, repr=False, kw_only=True)
class Equality(Element):
    """A constraint that ties two bodies, two joints or two tendons together.

    name: unique among equalities, or "".
    type: "connect": two bodies share one point; "weld": they share one frame; "joint": a hinge or
        slide follows another, q₁ − ref₁ = p(q₂ − ref₂), or stays where it is; "tendon": a tendon
        does, by its length beside that in the pose of the scene.
    body1, body2: the two `Body` objects of a connect or weld.
    site1, site2: in place of them, two `Site` objects, which the constraint brings together.
    anchor: the shared point [m], shape (3,); of a connect in the frame of body1, in the pose of the
        scene; of a weld in the frame of body2.
    relpose: of a weld: position [m] of the point and orientation of body2, in the frame of body1,
        shape (7,); None for that in the pose of the scene.
    torquescale: of a weld: by what its turns are multiplied beside its displacements, MuJoCo's
        scale [m/rad]. 0: it does not mind turns.
    joint1, joint2: hinges or slides. Without joint2, joint1 stays at ref₁ + polycoef[0].
    tendon1, tendon2: `Tendon` objects, in the same way.
    polycoef: coefficients of the polynomial p by ascending powers [rad or m], shape (5,).
    active: False leaves the constraint out.
    solref, solimp: softness of the constraint.
    """

    name: Text = ""
    type: Annotated[str, words(*ROW_KINDS)] = "connect"
    body1: SomeBody = None
    body2: SomeBody = None
    site1: SomeSite = None
    site2: SomeSite = None
    joint1: SomeJoint = None
    joint2: SomeJoint = None
    tendon1: SomeTendon = None
    tendon2: SomeTendon = None
    anchor: Annotated[Vec3, "m"] = ORIGIN
    relpose: Annotated[RelPose, "m and 1"] = None
    torquescale: Annotated[Real, "m/rad"] = 1.0
    polycoef: Annotated[PolyCoef, "rad or m"] = POLYCOEF
    active: Flag = True
    solref: SolRef = SOLREF
    solimp: SolImp = SOLIMP

    @property
    def row_kind(self) -> str:
        """What its rows are called, in `Sim.rows` and `Model.element_name`."""
        return ROW_KINDS[self.type]

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The bodies that it ties, directly or by their sites, joints or tendons."""
        holders = (self.site1, self.site2, self.joint1, self.joint2)
        own = tuple(body for body in (self.body1, self.body2) if body is not None)
        own += tuple(holder.body for holder in holders if holder is not None)
        tendons = (tendon for tendon in (self.tendon1, self.tendon2) if tendon is not None)
        passed = (element for tendon in tendons for element in tendon.elements())
        return own + tuple(e.body for e in passed if isinstance(e, (Joint, Site, Geom)))
