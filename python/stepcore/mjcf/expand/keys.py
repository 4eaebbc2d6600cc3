"""Keyframes of an attached model: their vectors, taken apart by the elements they belong to."""

from __future__ import annotations

from collections.abc import Iterable

from stepcore.mjcf.actuators import sizes
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.expand.naming import copied
from stepcore.mjcf.nodes import Node
from stepcore.scene.layout import DOFS, QPOS


def key_parts(root: Node, defaults: Defaults) -> list[Node]:
    """The keyframes of a model, whose vectors are in `parts` by the element they belong to."""
    keys = [node for s in root.children if s.tag == "keyframe" for node in s.children]
    if not keys:
        return []
    joints = list(_joints(root, defaults))
    mocaps = [body for body, _ in _bodies(root) if body.values.get("mocap")]
    nodes = [node for s in root.children if s.tag == "actuator" for node in s.children]
    actuators = [(node, *sizes(defaults.gains(node))) for node in nodes]
    layout = {
        "qpos": [(node, QPOS[kind]) for node, kind in joints],
        "qvel": [(node, DOFS[kind]) for node, kind in joints],
        "ctrl": [(node, controls) for node, controls, _ in actuators],
        "act": [(node, activations) for node, _, activations in actuators],
        "mpos": [(node, 3) for node in mocaps],
        "mquat": [(node, 4) for node in mocaps],
    }
    for key in keys:
        if key.parts is not None:
            continue
        key.parts = {}
        for name, elements in layout.items():
            given = key.values.pop(name, ())
            key.attrs.pop(name, None)
            if len(given) > sum(size for _, size in elements):
                raise key.error(f"<key> {name} has {len(given)} numbers, more than its model")
            key.parts[name] = []
            for node, size in elements:
                if len(given) >= size > 0:
                    key.parts[name].append((node, given[:size]))
                given = given[size:]
    return keys


def copied_key(key: Node, made: dict[int, Node]) -> Node:
    """A copy of a keyframe for copied elements; made: these by the originals' ``id``."""
    same = copied(key)
    same.parts = {
        name: [(made[id(node)], numbers) for node, numbers in parts if id(node) in made]
        for name, parts in (key.parts or {}).items()
    }
    return same


def _joints(root: Node, defaults: Defaults) -> Iterable[tuple[Node, str]]:
    """The joints of a model in its order, with their types."""
    for _, inside in _bodies(root):
        for node, of_node in inside:
            if node.tag == "freejoint":
                yield node, "free"
            elif node.tag == "joint":
                yield node, defaults.of(node, of_node).get("type", "hinge")


def _bodies(root: Node) -> Iterable[tuple[Node, list[tuple[Node, str | None]]]]:
    """The world and the bodies of a model in its order, each with what it holds."""
    pending: list[tuple[Node, str | None]] = [
        (section, None) for section in reversed(root.children) if section.tag == "worldbody"
    ]
    while pending:
        body, childclass = pending.pop()
        inside = list(_flat(body, body.attrs.get("childclass", childclass)))
        yield body, inside
        pending += reversed([(node, one) for node, one in inside if node.tag == "body"])


def _flat(parent: Node, childclass: str | None) -> Iterable[tuple[Node, str | None]]:
    """What a body holds, through its frames, each with its childclass."""
    pending = [(child, childclass) for child in reversed(parent.children)]
    while pending:
        node, inherited = pending.pop()
        if node.tag == "frame":
            inner = node.attrs.get("childclass", inherited)
            pending += [(child, inner) for child in reversed(node.children)]
        else:
            yield node, inherited
