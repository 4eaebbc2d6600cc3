"""`Sensor`: a named measurement of a scene."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from stepcore import checks
from stepcore.scene.element import Element, FieldType, Places
from stepcore.scene.elements import field_types as of

# For each type: the allowed kinds of the object and of the reference.
FRAMES = ("site", "body", "geom")
AT_SITE = (
    *("touch", "accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer"),
    "rangefinder",
)
OF_SCALAR_JOINT = ("jointpos", "jointvel", "jointactuatorfrc")
OF_BALL = ("ballquat", "ballangvel")
OF_LIMIT = ("jointlimitpos", "jointlimitvel", "jointlimitfrc")
OF_TENDON = (
    *("tendonpos", "tendonvel", "tendonactuatorfrc"),
    *("tendonlimitpos", "tendonlimitvel", "tendonlimitfrc"),
)
OF_ACTUATOR = ("actuatorpos", "actuatorvel", "actuatorfrc")
OF_FRAME = (
    *("framepos", "framequat", "framexaxis", "frameyaxis", "framezaxis"),
    *("framelinvel", "frameangvel"),
)
OF_ACCELERATION = ("framelinacc", "frameangacc")
OF_SUBTREE = ("subtreecom", "subtreelinvel", "subtreeangmom")
OF_GAP = ("distance", "normal", "fromto")
OF_WHOLE = ("e_potential", "e_kinetic", "clock")
OBJECTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    **dict.fromkeys(AT_SITE, (("site",), ())),
    **dict.fromkeys((*OF_SCALAR_JOINT, *OF_BALL, *OF_LIMIT), (("joint",), ())),
    **dict.fromkeys(OF_TENDON, (("tendon",), ())),
    **dict.fromkeys(OF_ACTUATOR, (("actuator",), ())),
    **dict.fromkeys(OF_FRAME, (FRAMES, FRAMES)),
    **dict.fromkeys(OF_ACCELERATION, (FRAMES, ())),
    **dict.fromkeys(OF_SUBTREE, (("body",), ())),
    "insidesite": (FRAMES, ("site",)),
    **dict.fromkeys(OF_GAP, (("geom", "body"), ("geom", "body"))),
    "contact": (("site", "geom", "body"), ("geom", "body")),
    **dict.fromkeys(OF_WHOLE, ((), ())),
    "user": ((*FRAMES, "joint", "tendon", "actuator"), ()),
}
# Types whose object is optional, and types whose reference is required.
NO_OBJECT = ("contact", "user", *OF_WHOLE)
REFERENCE = ("insidesite", *OF_GAP)
# For each attribute of MJCF: the field that it names, the kind of element, and the type of a body.
ENDS: dict[str, tuple[str, str, str]] = {
    **{name: ("object", name, "") for name in ("site", "joint", "tendon", "actuator", "body")},
    **{"geom1": ("object", "geom", ""), "geom2": ("reference", "geom", "")},
    **{"body1": ("object", "body", "body"), "body2": ("reference", "body", "body")},
    **{"subtree1": ("object", "body", "subtree"), "subtree2": ("reference", "body", "subtree")},
}
# Types that name their ends by kind and name.
TYPED = (*OF_FRAME, *OF_ACCELERATION, "insidesite", "user")
# Types without a cutoff; by type, the allowed types of joint.
_DIRECTIONS = ("ballquat", "framequat", "framexaxis", "frameyaxis", "framezaxis")
_JOINTS = {
    **dict.fromkeys(OF_SCALAR_JOINT, ("hinge", "slide")),
    **dict.fromkeys(OF_BALL, ("ball",)),
    **dict.fromkeys(OF_LIMIT, ("hinge", "slide", "ball")),
}
# The error text for a sensor of an adhesion's speed.
ADHERES = "the speed along the contacts of an adhesion is not computed"
# Largest number of contacts of a contact sensor, and of values of a sensor of type "user".
MOST_NUMBERS = 10_000

CONTACT_DATA = (
    *("found", "force", "torque", "dist", "pos", "normal", "tangent", "linvel", "angvel"),
)
RAY_DATA = ("dist", "dir", "origin", "point", "normal", "depth")


def _words(owner: object, field: str, value: object) -> tuple[str, ...]:
    words = value.split() if isinstance(value, str) else checks.as_list(value)
    allowed = dict.fromkeys((*CONTACT_DATA, *RAY_DATA))
    if words is None or not all(isinstance(word, str) and word in allowed for word in words):
        raise checks.refuse(owner, field, value, f"words of {', '.join(allowed)}")
    return tuple(words)


# The frame or part that a body means; in MJCF the name of the attribute gives this.
STANDS_FOR = replace(of.words("", "body", "xbody", "subtree"), attribute=None)
AnObject = of.element("Site", "Body", "Geom", "Joint", "Tendon", "Actuator")


@dataclass(eq=False, repr=False, kw_only=True)
class Sensor(Element):
    """A named measurement of the world.

    A sensor does not change the motion, and is computed only when its value is read. Types,
    conventions and units are MuJoCo's; docs/sensors.md lists the types.

    name: unique among sensors, or "".
    type: "accelerometer", "touch", "jointpos", "framepos", "contact" and so on.
    object: the observed `Site`, `Body`, `Geom`, `Joint`, `Tendon` or `Actuator`, as the type needs;
        None for types that observe the whole world. A sensor of type "user" may have any object or
        None, without effect.
    objtype: the meaning of a body as object. For frame sensors, "xbody" (default) is the body's own
        frame, and "body" is the frame of its centre of mass and principal axes. For contact
        sensors, "body" (default) is the body alone, and "subtree" includes all its descendants.
    reference: the reference frame of a frame sensor, the second end of a distance or a contact
        sensor, the volume of an insidesite.
    reftype: as objtype, for the reference.
    cutoff: bound of the absolute value if positive; for distances, the largest distance between the
        geoms that is measured.
    noise: standard deviation, as a note for users; as in MuJoCo, no noise is added.
    data: the quantities of a contact sensor or a rangefinder, in this order: "found", "force",
        "torque", "dist", "pos", "normal", "tangent", "linvel", "angvel", or "dist", "dir",
        "origin", "point", "normal", "depth". Empty means "found", or "dist".
    reduce: order of the contacts of a contact sensor: "none", "mindist", "maxforce", "netforce".
    num: number of contacts of a contact sensor; number of values of a sensor of type "user". The
        values of type "user" are 0 for the user to compute.
    """

    name: of.Text = ""
    type: Annotated[str, of.words(*OBJECTS)]
    object: Annotated[Element | None, of.optional(AnObject)] = None
    objtype: Annotated[str, STANDS_FOR] = ""
    reference: Annotated[Element | None, of.optional(AnObject)] = None
    reftype: Annotated[str, STANDS_FOR] = ""
    cutoff: of.NonNegative = 0.0
    noise: of.NonNegative = 0.0
    data: Annotated[tuple[str, ...], FieldType(_words, "str | Sequence[str]", "")] = ()
    reduce: Annotated[str, of.words("none", "mindist", "maxforce", "netforce")] = "none"
    num: Annotated[int, of.whole(1, MOST_NUMBERS)] = 1

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities of a contact sensor or a rangefinder; () for other types."""
        return self.data or {"contact": ("found",), "rangefinder": ("dist",)}.get(self.type, ())

    def check(self, places: Places) -> None:
        """Raise ElementError if object, reference or data do not fit the sensor's type."""
        kinds, reference_kinds = OBJECTS[self.type]
        self._check_end(places, "object", kinds, self.type in NO_OBJECT)
        self._check_end(places, "reference", reference_kinds, self.type not in REFERENCE)
        types = _JOINTS.get(self.type)
        if types and self.object.type not in types:  # type: ignore[union-attr]
            joints = " or a ".join(types)
            raise checks.ElementError(self, f"{self.object}: must be a {joints} joint")
        self._check_data()
        if self.cutoff and self.type in _DIRECTIONS:
            raise checks.refuse(self, "cutoff", self.cutoff, "0: a direction has no bound")
        if self.type == "actuatorvel" and self.object.body is not None:  # type: ignore[union-attr]
            raise checks.ElementError(self, ADHERES)

    def _check_end(self, places: Places, field: str, kinds: Sequence[str], free: bool) -> None:
        element = getattr(self, field)
        kind = type(element).__name__.lower()
        needed = "a " + " or a ".join(kinds) if kinds else "None"
        if element is None:
            if not free:
                raise checks.ElementError(self, f"{field} = None: must be {needed}")
        elif kind not in kinds:
            limit = f"{needed} for a sensor of type {self.type}"
            raise checks.ElementError(self, f"{field} = {element}: must be {limit}")
        else:
            places.needed(self, element)
        word = self.objtype if field == "object" else self.reftype
        if word and kind != "body":
            raise checks.ElementError(self, f"{field}: only a body can stand for its {word}")
        if word == "subtree" and self.type != "contact":
            raise checks.ElementError(self, f"{field}: only contact sensors see a subtree")

    def _check_data(self) -> None:
        if self.type not in ("contact", "rangefinder"):
            counted = self.num != 1 and self.type != "user"
            if self.data or self.reduce != "none" or counted:
                text = "only contact sensors and rangefinders choose data"
                raise checks.ElementError(self, text)
            return
        order = CONTACT_DATA if self.type == "contact" else RAY_DATA
        ranks = [order.index(word) if word in order else -1 for word in self.data]
        if -1 in ranks or any(b <= a for a, b in itertools.pairwise(ranks)):
            limit = f"words of {', '.join(order)}, in this order"
            raise checks.refuse(self, "data", " ".join(self.data), limit)
        if self.reduce == "netforce" and {"linvel", "angvel"} & set(self.data):
            raise checks.ElementError(self, "a net force has no velocity (linvel, angvel)")

    def plain(self, places: Places) -> dict[str, Any]:
        """Return the sensor as the engine reads it.

        The object of a sensor of type "user" is left out, because its values are zeros.
        """
        looked_at = None if self.type == "user" else self.object
        return self.record("objtype", "reftype", "noise") | {
            "object": self._plain_end(places, looked_at, self.objtype),
            "reference": self._plain_end(places, self.reference, self.reftype),
            "data": list(self.quantities),
        }

    def _plain_end(
        self, places: Places, element: Element | None, word: str
    ) -> dict[str, Any] | None:
        if element is None:
            return None
        kind = type(element).__name__.lower()
        if kind == "body":
            alone = self.type in ("contact", "distance", "normal", "fromto")
            kind = {"subtree": "xbody"}.get(word, word) or ("body" if alone else "xbody")
        return {"kind": kind, "index": places.place(element)}
