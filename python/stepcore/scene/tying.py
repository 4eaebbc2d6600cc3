"""What an equality ties: which fields belong to which type, and its plain data for the engine."""

from __future__ import annotations

import dataclasses
from typing import Any

from stepcore import checks
from stepcore.scene.elements import Equality, Joint
from stepcore.scene.elements.equality import BODIES, FIELDS, SITES
from stepcore.scene.elements.tendon import Tendon
from stepcore.scene.frames import IDENTITY
from stepcore.scene.layout import Layout

COMMON = ("name", "type", "active", "solref", "solimp")
# Types that tie lengths.
LENGTHS = ("joint", "tendon")


def given(equality: Equality) -> dict[str, Any]:
    """The fields that say what is tied, where they differ from their defaults."""
    defaults = {spec.name: spec.default for spec in dataclasses.fields(equality)}
    own = {f: getattr(equality, f) for f in defaults if f not in COMMON}
    return {field: value for field, value in own.items() if value != defaults[field]}


def check(layout: Layout, equality: Equality) -> None:
    """Checks that an equality has what its type needs, and nothing else."""
    fields, kind = given(equality), equality.type
    for field, value in fields.items():
        if field not in FIELDS[kind]:
            raise checks.refuse(equality, field, value, f"left out: a {kind} has none")
    if kind in LENGTHS:
        return _check_lengths(layout, equality)
    by_site = [field for field in SITES if field in fields]
    if by_site:
        if len(by_site) < 2:
            raise checks.ElementError(equality, f"{by_site[0]} needs the other site too")
        for field in (*BODIES, "relpose"):
            if field in fields:
                limit = "left out beside site1 and site2"
                raise checks.refuse(equality, field, fields[field], limit)
    elif equality.body1 is None:
        raise checks.ElementError(equality, f"a {kind} needs body1, or site1 and site2")
    ends = [getattr(equality, field) for field in (by_site or ("body1", "body2"))]
    one, two = (layout.body(equality, body) for body in _bodies(layout, equality))
    for site in ends if by_site else ():
        if layout.place(site) is None:
            raise checks.ElementError(equality, f"refers to {site}, which is not in this scene")
    if one == two:
        what = f"{ends[0]} to {ends[1]}, of the same body" if by_site else f"{ends[0]} to itself"
        raise checks.ElementError(equality, f"connects {what}")


def _check_lengths(layout: Layout, equality: Equality) -> None:
    kind = equality.type
    first, second = _lengths(equality)
    if first is None:
        raise checks.ElementError(equality, f"a {kind} equality needs {kind}1")
    for element in (first, second):
        if element is None:
            continue
        if layout.place(element) is None:
            raise checks.ElementError(equality, f"refers to {element}, which is not in this scene")
        if isinstance(element, Joint) and element.type not in ("hinge", "slide"):
            limit = "must be a hinge or a slide"
            raise checks.ElementError(equality, f"{element} is a {element.type}: {limit}")
    if first is second:
        raise checks.ElementError(equality, f"connects {first} to itself")


def _lengths(equality: Equality) -> tuple[Joint | Tendon | None, Joint | Tendon | None]:
    """The two joints or tendons of an equality."""
    if equality.type == "joint":
        return equality.joint1, equality.joint2
    return equality.tendon1, equality.tendon2


def plain(layout: Layout, equality: Equality) -> dict[str, Any]:
    """An equality as the engine takes it; sites have become frames on their bodies."""
    record = {
        "name": equality.name,
        "kind": equality.type,
        "torquescale": equality.torquescale,
        "polycoef": list(equality.polycoef),
        "active": equality.active,
        "soft": {"solref": list(equality.solref), "solimp": list(equality.solimp)},
        "frame1": None,
        "frame2": None,
    }
    if equality.type in LENGTHS:
        ends = [None if one is None else layout.place(one) for one in _lengths(equality)]
    else:
        ends = [layout.body(equality, body) for body in _bodies(layout, equality)]
        record |= _frames(equality)
    return record | {"first": ends[0], "second": ends[1]}


def _bodies(layout: Layout, equality: Equality) -> tuple[Any, Any]:
    """The two bodies of a connect or weld; the second is the world where none is given."""
    if equality.site1 is not None and equality.site2 is not None:
        return equality.site1.body, equality.site2.body
    return equality.body1, equality.body2 or layout.bodies[0]


def _frames(equality: Equality) -> dict[str, Any]:
    """What becomes one on the two bodies; None for what follows from the pose of the scene."""
    own, other = equality.site1, equality.site2
    if own is not None and other is not None:
        return {"frame1": _frame(own.pos, own.quat), "frame2": _frame(other.pos, other.quat)}
    at = _frame(equality.anchor)
    if equality.type == "connect":
        return {"frame1": at}
    pose = equality.relpose
    return {"frame2": at} | ({} if pose is None else {"frame1": _frame(pose[:3], pose[3:])})


def _frame(pos: tuple[float, ...], quat: tuple[float, ...] = IDENTITY) -> dict[str, Any]:
    return {"pos": list(pos), "quat": list(quat)}
