"""The section `<contact>`: explicit and excluded pairs."""

from __future__ import annotations

from stepcore.mjcf.attributes import given
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.elements import Pair


def read(world: WorldReader, node: Node) -> None:
    """Reads an excluded pair of bodies, or an explicit pair of geoms."""
    if node.tag == "pair":
        world.keep(node, world.scene.add_pair(**given(Pair, world.defaults.of(node))))
    else:
        world.scene.exclude(node.values["body1"], node.values["body2"])
