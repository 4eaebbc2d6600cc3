"""The section `<sensor>`.

A sensor changes nothing of the motion. One that is not computed is listed in `Scene.ignored`, with
the reason; everything else is read.
"""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.elements import Element
from stepcore.scene.elements.sensor import ADHERES, MOST_NUMBERS
from stepcore.scene.elements.sensor import OBJECTS as TYPES

# Attributes that name the object, or the reference, with what they name and as what.
NAMED = {
    **{name: (name, "") for name in ("site", "joint", "tendon", "actuator", "body")},
    "geom1": ("geom", ""),
    "body1": ("body", "body"),
    "subtree1": ("body", "subtree"),
}
REFERENCES = {"geom2": ("geom", ""), "body2": ("body", "body"), "subtree2": ("body", "subtree")}

# Types whose readings depend on the orientation of their object.
TURNED = ("framequat", "framexaxis", "frameyaxis", "framezaxis")


def read(world: WorldReader, node: Node) -> None:
    """Reads a sensor, or lists it."""
    values = node.values
    if node.tag not in TYPES:
        # Listed already: the schema knows that it is not read.
        return
    why = _not_computed(world, node)
    if why:
        world.scene.ignored.append(node.listed(f"only senses; {why}"))
        return
    given: dict[str, Any] = {f: values[f] for f in ("name", "noise", "reduce") if f in values}
    if values.get("cutoff", 0.0) != 0 or node.tag in ("distance", "normal", "fromto"):
        given["cutoff"] = values.get("cutoff", 0.0)
    given |= {f: values[f] for f in ("data", "num") if f in values}
    if node.tag == "user":
        if not 0 < values["dim"] <= MOST_NUMBERS:
            raise bad(node, "dim", values["dim"], f"1 to {MOST_NUMBERS}")
        given["num"] = values["dim"]
    ends = _ends(world, node)
    world.keep(node, world.scene.add_sensor(node.tag, **ends, **given))


def _not_computed(world: WorldReader, node: Node) -> str:
    """Why the readings of a sensor are not computed, "" if they are."""
    values = node.values
    site = values.get("site", "")
    for attribute in ("objtype", "reftype"):
        if values.get(attribute) == "camera" and node.tag != "user":
            return f"its {attribute} is a camera"
    if "camera" in values:
        return "it needs a camera"
    if values.get("delay", 0) > 0 or any(values.get("interval", ())):
        return "readings that are late or rare (delay, interval) are not computed"
    if node.tag == "actuatorvel" and world.scene.actuator(values["actuator"]).body is not None:
        return ADHERES
    read = node.tag in ("actuatorpos", "actuatorvel", "actuatorfrc")
    if read and world.scene.actuator(values["actuator"]).type == "orientation":
        return "an orientation has three lengths and forces, each of an actuator"
    if values.get("enclosed"):
        return "how far an object juts out of a site (enclosed) is not computed"
    if node.tag in ("touch", "contact", "insidesite") and site in world.mesh_sites:
        return "its site is a mesh"
    return ""


def _ends(world: WorldReader, node: Node) -> dict[str, Any]:
    """The object and the reference, each with what a body stands for."""
    values = node.values
    ends: dict[str, Any] = {}
    for attribute, (kind, word) in NAMED.items():
        if attribute in values and not (node.tag == "insidesite" and attribute == "site"):
            _put(node, ends, "object", _named(world, node, kind, attribute), word)
    for attribute, (kind, word) in REFERENCES.items():
        if attribute in values:
            _put(node, ends, "reference", _named(world, node, kind, attribute), word)
    for field, prefix in (("object", "obj"), ("reference", "ref")):
        kind = values.get(f"{prefix}type", "")
        if not kind:
            if f"{prefix}name" in values:
                raise node.error(f"<{node.tag}> has {prefix}name without {prefix}type")
            continue
        if f"{prefix}name" not in values:
            raise node.error(f"<{node.tag}> has {prefix}type without {prefix}name")
        body = kind in ("body", "xbody")
        if node.tag == "user" and not body and kind not in TYPES["user"][0]:
            why = f"read, but not what it is attached to: the {kind}"
            world.scene.ignored.append(node.listed(f"{why} {values['objname']}"))
            continue
        element = _named(world, node, "body" if body else kind, f"{prefix}name")
        _put(node, ends, field, element, kind if body else "")
    if node.tag == "insidesite":
        ends["reference"] = _named(world, node, "site", "site")
    return ends


def _named(world: WorldReader, node: Node, kind: str, attribute: str) -> Element:
    """The element that an attribute names."""
    element: Element = getattr(world.scene, kind)(node.values[attribute])
    return element


def _put(node: Node, ends: dict[str, Any], field: str, element: Element, word: str) -> None:
    if field in ends:
        raise node.error(f"<{node.tag}> names two things as its {field}")
    ends[field] = element
    if word:
        ends["objtype" if field == "object" else "reftype"] = word
