"""The section `<equality>`: connects, welds, and equalities of joints and tendons."""

from __future__ import annotations

from stepcore.mjcf.attributes import given
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.elements import Equality


def read(world: WorldReader, node: Node) -> None:
    """Reads an equality; it is checked with the whole scene."""
    values = world.defaults.of(node, kind="equality")
    if node.tag in ("connect", "weld") and not {"body1", "site1", "site2"} & set(values):
        raise node.error(f"<{node.tag}> needs body1, or site1 and site2")
    if node.tag == "connect" and "body1" in values and "anchor" not in values:
        raise node.error("<connect> needs body1 and anchor")
    world.keep(node, world.scene.add_equality(node.tag, **given(Equality, values)))
