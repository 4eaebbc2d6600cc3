"""The sections around the tree: excluded pairs, connects and keyframes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stepcore.checks import nearest
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.source import Node
from stepcore.mjcf.tree import Tree, soft
from stepcore.mjcf.values import bad
from stepcore.scene.layout import Layout
from stepcore.scene.scene import Scene

MAX_KEYS = 100_000

# Attributes by which sensors, cameras and lights refer to named elements.
REFERENCES = {
    **{name: name for name in ("joint", "actuator", "site", "geom", "camera", "body", "mesh")},
    **dict.fromkeys(("body1", "body2", "subtree1", "subtree2", "target"), "body"),
    **dict.fromkeys(("geom1", "geom2"), "geom"),
    "tendon": "tendon",
}


def exclude(tree: Tree, node: Node) -> None:
    """Reads one excluded pair."""
    tree.scene.exclude(node.values["body1"], node.values["body2"])


def connect(tree: Tree, defaults: Defaults, node: Node) -> None:
    """Reads one connect between two bodies."""
    values = _equality_values(defaults, node)
    if "site1" in values or "site2" in values:
        raise node.unbuilt("a <connect> between sites (site1, site2)")
    if "body1" not in values or "anchor" not in values:
        raise node.error("<connect> needs body1 and anchor")
    names = ("name", "body1", "body2", "anchor", "active")
    given: dict[str, Any] = {name: values[name] for name in names if name in values}
    given |= soft(values, "solref", "solimp")
    equality = tree.scene.add_equality("connect", **given)
    tree.keep(node, equality)


def _equality_values(defaults: Defaults, node: Node) -> dict[str, Any]:
    # One set of defaults serves all kinds of equality.
    shared = Node("equality", node.attrs, node.file, node.line)
    shared.values = node.values
    return defaults.of(shared)


def key(tree: Tree, layout: Layout, node: Node) -> None:
    """Reads one keyframe; what it leaves out is the default state."""
    values = node.values
    for name, what in (("act", "activations"), ("mpos", "mocap bodies"), ("plastic", "plastic")):
        if values.get(name):
            raise bad(node, name, values[name], f"empty: the model has no {what}")
    if values.get("mquat"):
        raise bad(node, "mquat", values["mquat"], "empty: the model has no mocap bodies")
    rest = {
        "qpos": layout.qpos0(),
        "qvel": [0.0] * layout.nv,
        "ctrl": [0.0] * len(tree.scene.actuators),
    }
    fields: dict[str, Any] = {}
    for name, default in rest.items():
        given = list(values.get(name, ()))
        if len(given) > len(default):
            raise bad(node, name, tuple(given), f"at most {len(default)} numbers, not {len(given)}")
        if given:
            fields[name] = given + default[len(given) :]
    if "qpos" in fields:
        fields["qpos"] = layout.unit_quaternions(fields["qpos"])
    added = tree.scene.add_key(values.get("name", ""), time=values.get("time", 0.0), **fields)
    tree.keep(node, added)


def add_empty_keys(scene: Scene, sizes: Iterable[Node]) -> None:
    """Adds the default states that ``<size nkey>`` asks for beyond the keyframes given."""
    count = 0
    for node in sizes:
        count = node.values.get("nkey", count)
        if count > MAX_KEYS:
            raise bad(node, "nkey", count, f"at most {MAX_KEYS}")
    while len(scene.keys) < count:
        scene.add_key()


def check_references(tree: Tree, root: Node) -> None:
    """Checks the names by which ignored elements refer to others: a typo there is a typo too."""
    scene = tree.scene
    known = {
        **tree.names,
        "joint": {element.name for element in scene.joints},
        "site": {element.name for element in scene.sites},
        "actuator": {element.name for element in scene.actuators},
        "tendon": set(),
        **_assets(root),
    }
    for node, kind, name in tree.references:
        _known(node, kind, name, known[kind])
    for section in root.children:
        if section.tag == "sensor":
            for node in section.children:
                for attribute, name in node.attrs.items():
                    if attribute in REFERENCES:
                        _known(node, attribute, name, known[REFERENCES[attribute]])


def _known(node: Node, attribute: str, name: str, names: set[str]) -> None:
    if name not in names or not name:
        near = nearest(name, sorted(names))
        raise node.error(f'<{node.tag}> {attribute}="{name}": no such {attribute}{near}')


def _assets(root: Node) -> dict[str, set[str]]:
    """Names of materials, meshes and height fields; a mesh is named after its file by default."""
    names: dict[str, set[str]] = {"material": set(), "mesh": set(), "hfield": set()}
    for section in root.children:
        if section.tag == "asset":
            for node in section.children:
                file = node.attrs.get("file", "").replace("\\", "/").rpartition("/")[2]
                stem = file.rpartition(".")[0] or file
                names.setdefault(node.tag, set()).add(node.attrs.get("name", stem))
    return names
