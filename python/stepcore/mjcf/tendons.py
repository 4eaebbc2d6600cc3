"""The section `<tendon>`."""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.attributes import given
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.elements import Tendon
from stepcore.scene.elements.tendon import Around, Pulley, Share, Stop


def read(world: WorldReader, node: Node) -> None:
    """Reads a fixed or a spatial tendon."""
    values = world.defaults.of(node, kind="tendon")
    if values.get("springyield", 0) > 0:
        raise node.unbuilt("a spring that yields (springyield)", "springyield")
    if "material" in values:
        world.references.append((node, "material", values["material"]))
    fields = given(Tendon, values, "name", "range", "actuatorfrcrange", "springlength")
    if "springlength" in values:
        # One number is both ends, whatever a default class has for the second.
        own: Any = node.values.get("springlength", values["springlength"])
        fields["springlength"] = own[0] if len(own) == 1 else own
    tendon = world.scene.add_tendon(
        values.get("name", ""),
        path=[_stop(world, child) for child in node.children],
        range=world.limits(node, values, "limited", "range"),
        actuatorfrcrange=world.limits(node, values, "actuatorfrclimited", "actuatorfrcrange"),
        **fields,
    )
    world.keep(node, tendon)
    if "range" in values:
        world.ranges[id(tendon)] = values["range"]


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
