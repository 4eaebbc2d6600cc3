"""The section `<actuator>`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.elements import Actuator, Element
from stepcore.scene.elements.actuator import TARGET_FIELDS
from stepcore.scene.elements.actuator_laws import ALL_LAW_FIELDS, FED

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

# The group of actuators that are left out.
DISABLED = 30
# Attributes of `<general>` alone, and the shortcuts that have them too.
GENERAL = {"actearly": (), "actrange": ("intvelocity",)}


def referred(scene: Contents) -> list[Element]:
    """What actuators name."""
    ends = [field for field in TARGET_FIELDS if field != "feeds"]
    fields = [getattr(actuator, field) for actuator in scene.actuators for field in ends]
    return [element for element in fields if isinstance(element, Element)]


def tags(scene: Contents, names: Names) -> list[Tag]:
    """The elements of the section."""
    found = []
    for at, actuator in enumerate(scene.actuators):
        if actuator.type != "input":
            behind = scene.actuators[at + 1 : at + len(actuator.inputs)]
            found.append(_actuator(actuator, behind, names))
    return found


def _actuator(actuator: Actuator, behind: list[Actuator], names: Names) -> Tag:
    """behind: what stands behind it in the scene, as many as it has more inputs."""
    given = changed(actuator, "name", "type", "enabled")
    first: dict[str, Any] = {"name": actuator.name} if actuator.name else {}
    for field in TARGET_FIELDS:
        element = given.pop(field, None)
        if element is not None:
            first[field] = names.of(element) if isinstance(element, Element) else element
    if not actuator.enabled:
        first["group"] = DISABLED
    kind = actuator.type
    if any(field in given and kind not in also for field, also in GENERAL.items()):
        kind = "general"
    low, high = actuator.forcerange or (-1.0, 1.0)
    if kind == "dcmotor" and low != -high:
        if actuator.law.controller is not None:
            limit = "alike both ways, to be written as MJCF"
            raise checks.refuse(actuator, "forcerange", actuator.forcerange, limit)
        kind = "general"
    if kind != actuator.type:
        given = {field: value for field, value in given.items() if field not in ALL_LAW_FIELDS}
        return Tag(kind, **first, **actuator.law.general(), **given)
    if kind in FED:
        first |= _of_inputs(actuator, behind, given)
    if kind == "dcmotor":
        given |= _motor(given)
    if actuator.biasprm is not None and actuator.biastype is None:
        first["biastype"] = "affine"
    return Tag(kind, **first, **given)


def _of_inputs(actuator: Actuator, behind: list[Actuator], given: dict[str, Any]) -> dict[str, Any]:
    """The bounds of a controller's controls, each of which is an actuator here."""
    words = actuator.inputs
    for word, other in zip(words[1:], behind, strict=False):
        name = f"{actuator.name}/{word}" if actuator.name else ""
        late = ("delay", "nsample", "interp")
        same = all(getattr(other, field) == getattr(actuator, field) for field in late)
        stands = other.feeds is actuator and other.input == word and other.name == name
        bounded = actuator.type == "pid" or other.ctrlrange == actuator.ctrlrange
        if not (stands and same and bounded):
            limit = "inputs right behind it, named by it and late like it, to be written as MJCF"
            raise checks.refuse(actuator, "input", actuator.input, limit)
    if actuator.type != "pid":
        return {}
    own = given.pop("ctrlrange", None)
    bounds = [own, *(other.ctrlrange for other in behind)]
    return {f"{word}range": b for word, b in zip(words, bounds, strict=False) if b is not None}


def _motor(given: dict[str, Any]) -> dict[str, Any]:
    """What a motor's words are in MJCF; those that it has in place of others leave `given`."""
    asked = [given.pop(name, None) or 0.0 for name in ("kp", "ki", "kv", "slewmax", "imax", "vmax")]
    bounds, rate = given.pop("forcerange", None), given.pop("current_rate", None) or 0.0
    words: dict[str, Any] = {"controller": tuple(asked)} if any(asked) else {}
    if thermal := given.pop("thermal", None):
        words["thermal"] = (*thermal[:2], 0.0, *thermal[2:])
    if bounds or rate:
        words["saturation"] = (bounds[1] if bounds else 0.0, 0.0, rate)
    return words
