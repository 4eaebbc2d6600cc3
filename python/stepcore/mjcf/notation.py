"""The notation of the MJCF schema: elements, their attributes, and the type of each attribute.

``pos:3`` is three reals, ``size:1-3`` one to three, ``qpos:*`` any number of reals, ``group:int``
an integer, ``limited:false|true|auto`` a keyword, and a name without ":" any text. ``!`` marks a
required attribute.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from stepcore.scene.element import Element, table

ORIENTATION = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
POSE = "pos:3 quat:4 axisangle:4 xyaxes:6 zaxis:3 euler:3"


@dataclass
class Spec:
    """The schema of an element: its attributes (name → type), required attributes, and children.

    role: "" for an element that is read, else the reason why it is not: "draws", "senses", "data"
        or "unbuilt".
    once: children that can appear only once.
    """

    attrs: dict[str, str] = field(default_factory=dict)
    required: tuple[str, ...] = ()
    children: dict[str, Spec] = field(default_factory=dict)
    role: str = ""
    once: tuple[str, ...] = ()


def spec(
    attrs: str = "",
    children: dict[str, Spec] | None = None,
    role: str = "",
    once: tuple[str, ...] = (),
) -> Spec:
    """Return a `Spec` from the notation above."""
    types: dict[str, str] = {}
    required = []
    for word in attrs.split():
        name, _, kind = word.partition(":")
        if name.endswith("!"):
            name = name[:-1]
            required.append(name)
        types[name] = kind
    return Spec(types, tuple(required), children or {}, role, once)


def of(kind: type[Element], *names: str, but: str = "") -> str:
    """Return the fields of an element class that MJCF has, in the notation above.

    names: the fields to include; all if empty.
    but: the fields to leave out. A field with polynomial coefficients takes up to three numbers.
    """
    rows = [table(kind)[name] for name in names] if names else table(kind).values()
    return " ".join(
        f"{row.name}:{'1-3' if row.poly else row.type.attribute}".rstrip(":")
        for row in rows
        if row.type.attribute is not None and row.name not in but.split()
    )


def without(attrs: str, names: str) -> str:
    """Return `attrs` without the attributes in `names`."""
    drop = set(names.split())
    return " ".join(w for w in attrs.split() if w.partition(":")[0].rstrip("!") not in drop)


# A default class has no names and no references.
_OWN = (
    "name class geom1 geom2 target lengthrange joint jointinparent tendon slidersite cranksite "
    "site refsite body body1 body2 instance plugin"
)


def default_of(attrs: str) -> Spec:
    """Return the schema of a default-class element for an element with these attributes."""
    return spec(without(attrs, _OWN).replace("!", ""))
