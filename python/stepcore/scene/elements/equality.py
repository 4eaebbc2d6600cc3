"""`Equality`: a constraint between bodies, joints or tendons of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from stepcore import checks
from stepcore.scene.element import Element, Places, field_rows
from stepcore.scene.elements import field_types as of
from stepcore.scene.elements.body import Body, Joint, Site, SomeBody, SomeJoint, SomeSite
from stepcore.scene.elements.geom import Geom
from stepcore.scene.elements.tendon import SomeTendon, Tendon
from stepcore.scene.frames import IDENTITY, ORIGIN, Vec

# For each type: the name of the constraint rows.
ROW_KINDS = {
    "connect": "connect",
    "weld": "weld",
    "joint": "joint equality",
    "tendon": "tendon equality",
}

# For each type: the allowed fields apart from the common fields.
_COMMON = ("name", "type", "active", "solref", "solimp")
_BODIES, _SITES = ("body1", "body2", "anchor"), ("site1", "site2")
FIELDS = {
    "connect": (*_BODIES, *_SITES),
    "weld": (*_BODIES, *_SITES, "relpose", "torquescale"),
    "joint": ("joint1", "joint2", "polycoef"),
    "tendon": ("tendon1", "tendon2", "polycoef"),
}
# Fields of the two ends and their frames.
_ENDS = (*_BODIES, *_SITES, "relpose", "joint1", "joint2", "tendon1", "tendon2")


@dataclass(eq=False, repr=False, kw_only=True)
class Equality(Element):
    """A constraint between two bodies, two joints or two tendons.

    name: unique among equalities, or "".
    type: "connect": two bodies share a point. "weld": two bodies share a frame. "joint": a hinge or
        slide follows another, q₁ − ref₁ = p(q₂ − ref₂), or is fixed. "tendon": a tendon follows
        another in the same way, or is fixed; its ref is its length in the initial pose.
    body1, body2: the two `Body` objects of a connect or weld; None for body2 is the world.
    site1, site2: in place of the bodies, two `Site` objects; the constraint makes them coincide.
    anchor: the shared point [m], shape (3,): for a connect in the frame of body1, in the initial
        pose; for a weld in the frame of body2.
    relpose: for a weld, position [m] of the anchor and orientation of body2, in the frame of body1,
        shape (7,); None takes both from the initial pose.
    torquescale: for a weld, factor on rotations relative to displacements, MuJoCo's scale [m/rad];
        0 leaves rotations free.
    joint1, joint2: hinges or slides. Without joint2, joint1 is fixed at ref₁ + polycoef[0].
    tendon1, tendon2: `Tendon` objects, in the same way.
    polycoef: coefficients of the polynomial p by ascending powers [rad or m], shape (5,).
    active: False leaves the constraint out.
    solref, solimp: softness of the constraint.
    """

    name: of.Text = ""
    type: Annotated[str, of.words(*ROW_KINDS)] = "connect"
    body1: SomeBody = None
    body2: SomeBody = None
    site1: SomeSite = None
    site2: SomeSite = None
    joint1: SomeJoint = None
    joint2: SomeJoint = None
    tendon1: SomeTendon = None
    tendon2: SomeTendon = None
    anchor: Annotated[of.Vec3, "m"] = ORIGIN
    relpose: Annotated[of.RelPose, "m and 1"] = None
    torquescale: Annotated[of.Real, "m/rad"] = 1.0
    polycoef: Annotated[of.PolyCoef, "rad or m"] = of.POLYCOEF
    active: of.Flag = True
    solref: of.SolRef = of.SOLREF
    solimp: of.SolImp = of.SOLIMP

    @property
    def row_kind(self) -> str:
        """The name of the constraint rows in `Sim.rows` and `Model.element_name`."""
        return ROW_KINDS[self.type]

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The constrained bodies, directly or through their sites, joints or tendons."""
        holders = (self.site1, self.site2, self.joint1, self.joint2)
        ends = tuple(body for body in (self.body1, self.body2) if body is not None)
        ends += tuple(holder.body for holder in holders if holder is not None)
        tendons = (tendon for tendon in (self.tendon1, self.tendon2) if tendon is not None)
        passed = (element for tendon in tendons for element in tendon.elements())
        return ends + tuple(e.body for e in passed if isinstance(e, (Joint, Site, Geom)))

    @property
    def ties_lengths(self) -> bool:
        """Whether the constraint is between joints or tendons, not bodies."""
        return self.type in ("joint", "tendon")

    def given(self) -> dict[str, Any]:
        """Return the fields of the ends and the polynomial that differ from their defaults."""
        rows = (row for row in field_rows(Equality).values() if row.name not in _COMMON)
        values = {row.name: getattr(self, row.name) for row in rows}
        return {f: value for f, value in values.items() if value != field_rows(Equality)[f].default}

    def check(self, places: Places) -> None:
        """Raise ElementError unless the given fields are those that the type needs."""
        fields, kind = self.given(), self.type
        for field, value in fields.items():
            if field not in FIELDS[kind]:
                raise checks.refuse(self, field, value, f"left out: a {kind} has none")
        if self.ties_lengths:
            return self._check_lengths(places)
        by_site = [field for field in _SITES if field in fields]
        if by_site:
            if len(by_site) < 2:
                raise checks.ElementError(self, f"{by_site[0]} needs the other site too")
            for field in (*_BODIES, "relpose"):
                if field in fields:
                    limit = "left out beside site1 and site2"
                    raise checks.refuse(self, field, fields[field], limit)
        elif self.body1 is None:
            raise checks.ElementError(self, f"a {kind} needs body1, or site1 and site2")
        ends = [getattr(self, field) for field in (by_site or ("body1", "body2"))]
        first, second = (places.needed(self, body) for body in self._tied_bodies(places))
        for site in ends if by_site else ():
            places.needed(self, site)
        if first == second:
            same_body = f"{ends[0]} to {ends[1]}, of the same body"
            problem = same_body if by_site else f"{ends[0]} to itself"
            raise checks.ElementError(self, f"connects {problem}")

    def _check_lengths(self, places: Places) -> None:
        first, second = self._lengths
        if first is None:
            raise checks.ElementError(self, f"a {self.type} equality needs {self.type}1")
        for end in (first, second):
            if end is None:
                continue
            places.needed(self, end)
            if isinstance(end, Joint) and end.type not in ("hinge", "slide"):
                text = f"{end} is a {end.type}: must be a hinge or a slide"
                raise checks.ElementError(self, text)
        if first is second:
            raise checks.ElementError(self, f"connects {first} to itself")

    @property
    def _lengths(self) -> tuple[Joint | Tendon | None, Joint | Tendon | None]:
        of_joints = self.type == "joint"
        return (self.joint1, self.joint2) if of_joints else (self.tendon1, self.tendon2)

    def _tied_bodies(self, places: Places) -> tuple[Any, Any]:
        if self.site1 is not None and self.site2 is not None:
            return self.site1.body, self.site2.body
        return self.body1, self.body2 or places.bodies[0]

    def plain(self, places: Places) -> dict[str, Any]:
        """Return the equality as the engine reads it: its two ends and their frames on bodies.

        A frame that follows from the initial pose is None.
        """
        record: dict[str, Any] = self.record(*_ENDS) | {"frame1": None, "frame2": None}
        if self.ties_lengths:
            first, second = (end and places.place(end) for end in self._lengths)
        else:
            first, second = (places.needed(self, body) for body in self._tied_bodies(places))
            record |= self._frames()
        return record | {"first": first, "second": second}

    def _frames(self) -> dict[str, Any]:
        """Return the frames on the two bodies that the constraint makes coincide."""
        if self.site1 is not None and self.site2 is not None:
            ends = (("frame1", self.site1), ("frame2", self.site2))
            return {name: _frame(site.pos, site.quat) for name, site in ends}
        if self.type == "connect":
            return {"frame1": _frame(self.anchor)}
        frames = {"frame2": _frame(self.anchor)}
        if self.relpose is not None:
            frames["frame1"] = _frame(self.relpose[:3], self.relpose[3:])
        return frames


def _frame(pos: Vec, quat: Vec = IDENTITY) -> dict[str, Any]:
    return {"pos": list(pos), "quat": list(quat)}
