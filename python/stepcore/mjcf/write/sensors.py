"""The section `<sensor>`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag
from stepcore.scene.elements import Element, Sensor
from stepcore.scene.elements.sensor import OF_ACCELERATION, OF_FRAME

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

# Whose objects are named with their type.
TYPED = (*OF_FRAME, *OF_ACCELERATION, "insidesite", "user")


def referred(scene: Contents) -> list[Element]:
    """What sensors look at."""
    ends = [end for sensor in scene.sensors for end in (sensor.object, sensor.reference)]
    return [end for end in ends if end is not None]


def tags(scene: Contents, names: Names) -> list[Tag]:
    """The elements of the section."""
    return [_sensor(element, names) for element in scene.sensors]


def _sensor(sensor: Sensor, names: Names) -> Tag:
    given: dict[str, Any] = {"name": sensor.name} if sensor.name else {}
    given |= _end(sensor, names, sensor.object, sensor.objtype, "1")
    given |= _end(sensor, names, sensor.reference, sensor.reftype, "2")
    if sensor.data:
        given["data"] = " ".join(sensor.data)
    if sensor.type == "user":
        given["dim"] = sensor.num
    counted = () if sensor.type == "user" else (("num", 1),)
    for field, default in (*counted, ("reduce", "none"), ("cutoff", 0.0), ("noise", 0.0)):
        value = getattr(sensor, field)
        if value != default:
            given[field] = value
    return Tag(sensor.type, **given)


def _end(
    sensor: Sensor, names: Names, element: Element | None, word: str, number: str
) -> dict[str, Any]:
    """The attributes that name an object (1) or a reference (2)."""
    if element is None:
        return {}
    kind, name = type(element).__name__.lower(), names.of(element)
    if sensor.type in TYPED:
        if sensor.type == "insidesite" and number == "2":
            return {"site": name}
        prefix = "obj" if number == "1" else "ref"
        typed = (word or "xbody") if kind == "body" else kind
        return {f"{prefix}type": typed, f"{prefix}name": name}
    if sensor.type in ("contact", "distance", "normal", "fromto") and kind != "site":
        return {f"{'subtree' if word == 'subtree' else kind}{number}": name}
    return {kind: name}
