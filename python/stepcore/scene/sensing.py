"""What sensors look at: checking it, and handing it to the engine."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore.scene.elements import Element, Sensor
from stepcore.scene.elements.sensor import (
    CONTACT_DATA,
    NO_OBJECT,
    OBJECTS,
    OF_BALL,
    OF_LIMIT,
    OF_SCALAR_JOINT,
    RAY_DATA,
    REFERENCE,
)
from stepcore.scene.sensor_ends import ADHERES

if TYPE_CHECKING:
    from stepcore.scene.layout import Layout

# What has no bound.
DIRECTIONS = ("ballquat", "framequat", "framexaxis", "frameyaxis", "framezaxis")
JOINTS = {
    **dict.fromkeys(OF_SCALAR_JOINT, ("hinge", "slide")),
    **dict.fromkeys(OF_BALL, ("ball",)),
    **dict.fromkeys(OF_LIMIT, ("hinge", "slide", "ball")),
}


def fields_of_sensor(sensor: Sensor) -> tuple[str, ...]:
    """The quantities that it gives, of those that some sensors choose."""
    default = {"contact": ("found",), "rangefinder": ("dist",)}.get(sensor.type, ())
    return sensor.data or default


def check(layout: Layout) -> None:
    """Raises ValueError for a sensor that does not look at what its type needs."""
    for sensor in layout.scene.sensors:
        own, other = OBJECTS[sensor.type]
        _check_end(layout, sensor, "object", own, sensor.type in NO_OBJECT)
        _check_end(layout, sensor, "reference", other, sensor.type not in REFERENCE)
        types = JOINTS.get(sensor.type)
        if types and sensor.object.type not in types:  # type: ignore[union-attr]
            words = " or a ".join(types)
            raise checks.ElementError(sensor, f"{sensor.object}: must be a {words} joint")
        _check_data(sensor)
        if sensor.cutoff and sensor.type in DIRECTIONS:
            raise checks.refuse(sensor, "cutoff", sensor.cutoff, "0: a direction has no bound")
        if sensor.type == "actuatorvel" and sensor.object.body is not None:  # type: ignore[union-attr]
            raise checks.ElementError(sensor, ADHERES)


def _check_end(
    layout: Layout, sensor: Sensor, field: str, kinds: Sequence[str], free: bool
) -> None:
    element = getattr(sensor, field)
    kind = type(element).__name__.lower()
    words = "a " + " or a ".join(kinds) if kinds else "None"
    if element is None:
        if not free:
            raise checks.ElementError(sensor, f"{field} = None: must be {words}")
    elif kind not in kinds:
        limit = f"{words} for a sensor of type {sensor.type}"
        raise checks.ElementError(sensor, f"{field} = {element}: must be {limit}")
    elif layout.place(element) is None:
        raise checks.ElementError(sensor, f"refers to {element}, which is not in this scene")
    word = getattr(sensor, "objtype" if field == "object" else "reftype")
    if word and kind != "body":
        raise checks.ElementError(sensor, f"{field}: only a body can stand for its {word}")
    if (word == "subtree") > (sensor.type == "contact"):
        raise checks.ElementError(sensor, f"{field}: only contact sensors see a subtree")


def _check_data(sensor: Sensor) -> None:
    if sensor.type not in ("contact", "rangefinder"):
        counted = sensor.num != 1 and sensor.type != "user"
        if sensor.data or sensor.reduce != "none" or counted:
            raise checks.ElementError(sensor, "only contact sensors and rangefinders choose data")
        return
    order = CONTACT_DATA if sensor.type == "contact" else RAY_DATA
    places = [order.index(word) if word in order else -1 for word in sensor.data]
    if -1 in places or any(b <= a for a, b in itertools.pairwise(places)):
        limit = f"words of {', '.join(order)}, in this order"
        raise checks.refuse(sensor, "data", " ".join(sensor.data), limit)
    if sensor.reduce == "netforce" and {"linvel", "angvel"} & set(sensor.data):
        raise checks.ElementError(sensor, "a net force has no velocity (linvel, angvel)")


def plain(layout: Layout, sensor: Sensor) -> dict[str, Any]:
    """The sensor as the engine reads it."""
    # What a sensor of its user looks at is for that user: it gives zeros.
    looked_at = None if sensor.type == "user" else sensor.object
    return {
        "name": sensor.name,
        "kind": sensor.type,
        "object": _end(layout, sensor, looked_at, sensor.objtype),
        "reference": _end(layout, sensor, sensor.reference, sensor.reftype),
        "cutoff": sensor.cutoff,
        "data": list(fields_of_sensor(sensor)),
        "reduce": sensor.reduce,
        "num": sensor.num,
    }


def _end(
    layout: Layout, sensor: Sensor, element: Element | None, word: str
) -> dict[str, Any] | None:
    if element is None:
        return None
    kind = type(element).__name__.lower()
    index = layout.place(element)
    if kind == "body":
        alone = sensor.type in ("contact", "distance", "normal", "fromto")
        kind = {"subtree": "xbody"}.get(word, word) or ("body" if alone else "xbody")
    return {"kind": kind, "index": index}
