"""Read the elements of the sections `<contact>`, `<tendon>`, `<equality>` and `<sensor>`."""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.attributes import given
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.elements import Element, Equality, Pair, Sensor, Tendon
from stepcore.scene.elements.sensor import ADHERES, MOST_NUMBERS
from stepcore.scene.elements.sensor import OBJECTS as TYPES
from stepcore.scene.elements.tendon import Around, Pulley, Share, Stop

# Attributes that name the object or the reference of a sensor: (kind of element, object type).
NAMED = {
    **{name: (name, "") for name in ("site", "joint", "tendon", "actuator", "body")},
    "geom1": ("geom", ""),
    "body1": ("body", "body"),
    "subtree1": ("body", "subtree"),
}
REFERENCES = {"geom2": ("geom", ""), "body2": ("body", "body"), "subtree2": ("body", "subtree")}


def contact(world: WorldReader, node: Node) -> None:
    """Read an excluded pair of bodies, or an explicit pair of geoms."""
    if node.tag == "pair":
        world.keep(node, world.scene.add_pair(**given(Pair, world.defaults.of(node))))
    else:
        world.scene.exclude(node.values["body1"], node.values["body2"])


def tendon(world: WorldReader, node: Node) -> None:
    """Read a fixed or a spatial tendon."""
    values = world.defaults.of(node, kind="tendon")
    if values.get("springyield", 0) > 0:
        raise node.unbuilt("a spring that yields (springyield)", "springyield")
    if "material" in values:
        world.references.append((node, "material", values["material"]))
    fields = given(Tendon, values, "name", "range", "actuatorfrcrange", "springlength")
    if "springlength" in values:
        # A single number gives both ends, even if a default class has a second number.
        own: Any = node.values.get("springlength", values["springlength"])
        fields["springlength"] = own[0] if len(own) == 1 else own
    added = world.scene.add_tendon(
        values.get("name", ""),
        path=[_stop(world, child) for child in node.children],
        range=world.limits(node, values, "limited", "range"),
        actuatorfrcrange=world.limits(node, values, "actuatorfrclimited", "actuatorfrcrange"),
        **fields,
    )
    world.keep(node, added)
    if "range" in values:
        world.ranges[id(added)] = values["range"]


def _stop(world: WorldReader, node: Node) -> Stop:
    values, scene = node.values, world.scene
    try:
        if node.tag == "joint":
            return Share(scene.joint(values["joint"]), values["coef"])
        if node.tag == "site":
            return scene.site(values["site"])
        if node.tag == "geom":
            side = values.get("sidesite")
            return Around(scene.geom(values["geom"]), None if side is None else scene.site(side))
        return Pulley(values["divisor"])
    except ValueError as error:
        raise node.error(str(error)) from None


def equality(world: WorldReader, node: Node) -> None:
    """Read an equality; the check of the whole scene checks its fields."""
    values = world.defaults.of(node, kind="equality")
    if node.tag in ("connect", "weld") and not {"body1", "site1", "site2"} & set(values):
        raise node.error(f"<{node.tag}> needs body1, or site1 and site2")
    if node.tag == "connect" and "body1" in values and "anchor" not in values:
        raise node.error("<connect> needs body1 and anchor")
    world.keep(node, world.scene.add_equality(node.tag, **given(Equality, values)))


def sensor(world: WorldReader, node: Node) -> None:
    """Read a sensor, or list it in `Scene.ignored` with the reason if it is not computed."""
    values = node.values
    if node.tag not in TYPES:
        # The validation has already listed this sensor as ignored.
        return
    why = _not_computed(world, node)
    if why:
        world.scene.ignored.append(node.listed(f"only senses; {why}"))
        return
    fields = given(Sensor, values)
    if node.tag == "user":
        if not 0 < values["dim"] <= MOST_NUMBERS:
            raise bad(node, "dim", values["dim"], f"1 to {MOST_NUMBERS}")
        fields["num"] = values["dim"]
    world.keep(node, world.scene.add_sensor(node.tag, **_ends(world, node), **fields))


def _not_computed(world: WorldReader, node: Node) -> str:
    """Return the reason why a sensor is not computed; "" if it is."""
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
    """Return the object and the reference of a sensor, as fields of `Sensor`.

    A body also has a type, which distinguishes its frame, inertial frame or subtree.
    """
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
    """Return the element that an attribute names."""
    element: Element = getattr(world.scene, kind)(node.values[attribute])
    return element


def _put(node: Node, ends: dict[str, Any], field: str, element: Element, word: str) -> None:
    if field in ends:
        raise node.error(f"<{node.tag}> names two things as its {field}")
    ends[field] = element
    if word:
        ends["objtype" if field == "object" else "reftype"] = word
