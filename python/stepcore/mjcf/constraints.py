"""The sections `<contact>` and `<equality>`: explicit and excluded pairs, and connects."""

from __future__ import annotations

from typing import Any

from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.worldbody import WorldReader, soft


def contact(world: WorldReader, defaults: Defaults, node: Node) -> None:
    """Reads an excluded pair of bodies, or an explicit pair of geoms."""
    if node.tag == "pair":
        return _pair(world, defaults, node)
    world.scene.exclude(node.values["body1"], node.values["body2"])


def _pair(world: WorldReader, defaults: Defaults, node: Node) -> None:
    values = defaults.of(node)
    if values.get("adhesion", 0) != 0:
        raise node.unbuilt("adhesion")
    names = ("name", "condim", "friction", "margin", "gap")
    given: dict[str, Any] = {name: values[name] for name in names if name in values}
    given |= soft(values, "solref", "solimp")
    friction = (*values.get("solreffriction", ()), 0.0, 0.0)[:2]
    if any(friction):
        # MuJoCo's "0 0": as the normal.
        given["solreffriction"] = friction
    pair = world.scene.add_pair(values["geom1"], values["geom2"], **given)
    world.keep(node, pair)


def connect(world: WorldReader, defaults: Defaults, node: Node) -> None:
    """Reads a connect between two bodies."""
    values = _equality_values(defaults, node)
    if "site1" in values or "site2" in values:
        raise node.unbuilt("a <connect> between sites (site1, site2)")
    if "body1" not in values or "anchor" not in values:
        raise node.error("<connect> needs body1 and anchor")
    names = ("name", "body1", "body2", "anchor", "active")
    given: dict[str, Any] = {name: values[name] for name in names if name in values}
    given |= soft(values, "solref", "solimp")
    equality = world.scene.add_equality("connect", **given)
    world.keep(node, equality)


def _equality_values(defaults: Defaults, node: Node) -> dict[str, Any]:
    # All kinds of equality share one set of defaults.
    shared = Node("equality", node.attrs, node.file, node.line)
    shared.values = node.values
    return defaults.of(shared)
