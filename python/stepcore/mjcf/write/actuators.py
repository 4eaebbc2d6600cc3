"""The section `<actuator>`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.actuation import LAW, TARGET, law
from stepcore.scene.elements import Actuator, Element

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

# The group of actuators that are left out.
DISABLED = 30
# Attributes of `<general>` alone, and the shortcuts that have them too.
GENERAL = {"actearly": (), "actrange": ("intvelocity",)}


def referred(scene: Contents) -> list[Element]:
    """What actuators name."""
    fields = [getattr(actuator, field) for actuator in scene.actuators for field in TARGET]
    return [element for element in fields if isinstance(element, Element)]


def tags(scene: Contents, names: Names) -> list[Tag]:
    """The elements of the section."""
    return [_actuator(element, names) for element in scene.actuators]


def _actuator(actuator: Actuator, names: Names) -> Tag:
    given = changed(actuator, "name", "type", "enabled")
    first: dict[str, Any] = {"name": actuator.name} if actuator.name else {}
    for field in TARGET:
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
        kind = "general"
    if kind != actuator.type:
        given = {field: value for field, value in given.items() if field not in LAW}
        return Tag(kind, **first, **_as_general(actuator), **given)
    if kind == "pid" and "ctrlrange" in given:
        first[f"{actuator.input}range"] = given.pop("ctrlrange")
    if kind == "dcmotor":
        given |= _motor(given)
    if actuator.biasprm is not None and actuator.biastype is None:
        first["biastype"] = "affine"
    return Tag(kind, **first, **given)


def _motor(given: dict[str, Any]) -> dict[str, Any]:
    """What a motor's words are in MJCF; those that it has in place of others leave `given`."""
    kp, kv = given.pop("kp", None) or 0.0, given.pop("kv", None) or 0.0
    bounds = given.pop("forcerange", None)
    words: dict[str, Any] = {"controller": (kp, 0.0, kv)} if kp or kv else {}
    return words | ({"saturation": (bounds[1], 0.0, 0.0)} if bounds else {})


def _as_general(actuator: Actuator) -> dict[str, Any]:
    """The law of a shortcut in the words of `<general>`."""
    own = law(actuator)
    dyntype, dynprm = own.dynamics
    words: dict[str, Any] = {"dyntype": dyntype, "dynprm": dynprm}
    for term, muscle, affine in (
        ("gain", own.muscle_gain, own.gain),
        ("bias", own.muscle_bias, own.bias),
    ):
        if muscle is None:
            words |= {f"{term}type": "affine", f"{term}prm": affine}
        else:
            numbers = (*muscle["range"], *list(muscle.values())[1:])
            words |= {f"{term}type": "muscle", f"{term}prm": numbers}
    if not any(own.gain[1:]) and own.muscle_gain is None:
        words |= {"gaintype": "fixed", "gainprm": (own.gain[0],)}
    if own.dampratio:
        words["biasprm"] = (*own.bias[:2], own.dampratio)
    return words
