"""The section `<equality>`: connects."""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.worldbody import WorldReader, soft


def read(world: WorldReader, node: Node) -> None:
    """Reads an equality."""
    _connect(world, node)


def _connect(world: WorldReader, node: Node) -> None:
    """A connect between two bodies."""
    values = world.defaults.of(node, kind="equality")
    if "site1" in values or "site2" in values:
        raise node.unbuilt("a <connect> between sites (site1, site2)")
    if "body1" not in values or "anchor" not in values:
        raise node.error("<connect> needs body1 and anchor")
    names = ("name", "body1", "body2", "anchor", "active")
    given: dict[str, Any] = {name: values[name] for name in names if name in values}
    given |= soft(values, "solref", "solimp")
    equality = world.scene.add_equality("connect", **given)
    world.keep(node, equality)
