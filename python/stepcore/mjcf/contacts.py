"""The section `<contact>`: explicit and excluded pairs."""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.worldbody import WorldReader, soft


def read(world: WorldReader, node: Node) -> None:
    """Reads an excluded pair of bodies, or an explicit pair of geoms."""
    if node.tag == "pair":
        return _pair(world, node)
    world.scene.exclude(node.values["body1"], node.values["body2"])


def _pair(world: WorldReader, node: Node) -> None:
    values = world.defaults.of(node)
    names = ("name", "condim", "friction", "margin", "gap", "adhesion")
    given: dict[str, Any] = {name: values[name] for name in names if name in values}
    given |= soft(values, "solref", "solimp")
    friction = (*values.get("solreffriction", ()), 0.0, 0.0)[:2]
    if any(friction):
        # MuJoCo's "0 0": as the normal.
        given["solreffriction"] = friction
    pair = world.scene.add_pair(values["geom1"], values["geom2"], **given)
    world.keep(node, pair)
