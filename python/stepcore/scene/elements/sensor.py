"""`Sensor`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from stepcore import checks
from stepcore.scene.element import Element, FieldType
from stepcore.scene.elements.field_types import (
    NonNegative,
    Text,
    element,
    optional,
    whole,
    words,
)

# By type: the kinds of elements that it can look at, and those of its reference.
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
# Types whose object, or whose reference, may be missing.
NO_OBJECT = ("contact", "user", *OF_WHOLE)
REFERENCE = ("insidesite", *OF_GAP)

# The most contacts of a contact sensor, and numbers of one of type "user".
MOST_NUMBERS = 10_000

CONTACT_DATA = (
    *("found", "force", "torque", "dist", "pos", "normal", "tangent", "linvel", "angvel"),
)
RAY_DATA = ("dist", "dir", "origin", "point", "normal", "depth")


def _words(owner: object, field: str, value: object) -> tuple[str, ...]:
    """Words that name quantities; a text holds them with blanks between."""
    words = value.split() if isinstance(value, str) else checks.listed(value)
    known = dict.fromkeys((*CONTACT_DATA, *RAY_DATA))
    if words is None or not all(isinstance(word, str) and word in known for word in words):
        raise checks.refuse(owner, field, value, f"words of {', '.join(known)}")
    return tuple(words)


# What a body stands for; MJCF says it by the name of the attribute.
STANDS_FOR = replace(words("", "body", "xbody", "subtree"), attribute=None)
AnObject = element("Site", "Body", "Geom", "Joint", "Tendon", "Actuator")


@dataclass(eq=False, repr=False, kw_only=True)
class Sensor(Element):
    """Something that is read of the world under a name. It changes nothing, and costs nothing
    until it is read. Types, conventions and units are MuJoCo's; docs/sensors.md lists them.

    name: unique among sensors, or "".
    type: "accelerometer", "touch", "jointpos", "framepos", "contact" and so on.
    object: what it looks at: a `Site`, `Body`, `Geom`, `Joint`, `Tendon` or `Actuator`, as the
        type needs; None for types that look at the whole world. One of type "user" may have any of
        these or none: it is for its user to know.
    objtype: what a body stands for: its own frame ("xbody", which frames mean by default), its
        centre of mass and principal axes ("body"); in a contact sensor the body alone ("body",
        the default) or all that hangs on it as well ("subtree").
    reference: the frame of reference of a frame sensor, the second end of a distance or a contact
        sensor, the volume of an insidesite. reftype: as objtype.
    cutoff: bound of the absolute value where positive; of distances, how far apart the geoms may
        be.
    noise: standard deviation, kept for its reader: as in MuJoCo nothing is added.
    data: of a contact sensor or a rangefinder, the quantities that it gives, in this order:
        "found", "force", "torque", "dist", "pos", "normal", "tangent", "linvel", "angvel", or
        "dist", "dir", "origin", "point", "normal", "depth". Empty means "found", or "dist".
    reduce: which contacts a contact sensor gives first: "none", "mindist", "maxforce", "netforce".
    num: how many contacts a contact sensor gives; how many numbers a sensor of type "user", which
        are 0: they are its user's to compute.
    """

    name: Text = ""
    type: Annotated[str, words(*OBJECTS)]
    object: Annotated[Element | None, optional(AnObject)] = None
    objtype: Annotated[str, STANDS_FOR] = ""
    reference: Annotated[Element | None, optional(AnObject)] = None
    reftype: Annotated[str, STANDS_FOR] = ""
    cutoff: NonNegative = 0.0
    noise: NonNegative = 0.0
    data: Annotated[tuple[str, ...], FieldType(_words, "str | Sequence[str]", "")] = ()
    reduce: Annotated[str, words("none", "mindist", "maxforce", "netforce")] = "none"
    num: Annotated[int, whole(1, MOST_NUMBERS)] = 1
