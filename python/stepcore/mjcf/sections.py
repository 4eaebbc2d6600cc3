"""The sections around the tree: excluded pairs, connects, motors and keyframes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stepcore.checks import nearest
from stepcore.layout import Layout
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.source import Node
from stepcore.mjcf.tree import Tree, soft
from stepcore.mjcf.values import bad
from stepcore.scene import Scene

TRANSMISSIONS = ("joint", "jointinparent", "tendon", "slidersite", "site", "refsite")
MAX_KEYS = 100_000
STATEFUL = ("actlimited", "actrange")

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


def motor(tree: Tree, defaults: Defaults, node: Node) -> None:
    """Reads one motor on a joint."""
    values = defaults.of(node)
    used = [name for name in TRANSMISSIONS if name in values]
    if not used:
        raise node.error('<motor> needs joint="…"')
    if len(used) > 1:
        raise node.error(f"<motor> has two transmissions: {used[0]} and {used[1]}")
    if used[0] not in ("joint", "jointinparent"):
        raise node.unbuilt(f"a motor that acts through {used[0]}")
    joint = tree.scene.joint(values[used[0]])
    if used[0] == "jointinparent" and joint.type in ("ball", "free"):
        raise node.unbuilt(f"jointinparent on a {joint.type} joint")
    if values.get("delay", 0) != 0:
        raise node.unbuilt("a delay between control and force (delay)")
    if any(values.get("damping", ())) or values.get("armature", 0) != 0:
        raise node.unbuilt("an actuator's own damping or armature")
    for name in STATEFUL:
        if values.get(name, False) not in (False, "auto"):
            raise node.error(f"<motor> inherits {name}, but a motor has no activation")
    actuator = tree.scene.add_actuator(
        joint,
        name=values.get("name", ""),
        gear=values.get("gear", (1.0,)),
        ctrlrange=tree.limits(node, values, "ctrllimited", "ctrlrange"),
        forcerange=tree.limits(node, values, "forcelimited", "forcerange"),
    )
    tree.keep(node, actuator)


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
