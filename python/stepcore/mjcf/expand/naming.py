"""Names of elements and references to them, for copies whose names are made from the originals'."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below

# The kind of what an attribute refers to.
REFERENCES = {
    **{
        name: name
        for name in (
            *("joint", "body", "geom", "site", "camera", "tendon", "actuator", "sensor"),
            *("mesh", "hfield", "material", "texture", "flex", "skin"),
        )
    },
    **dict.fromkeys(("joint1", "joint2", "jointinparent"), "joint"),
    **dict.fromkeys(("body1", "body2", "subtree1", "subtree2", "target"), "body"),
    **dict.fromkeys(("geom1", "geom2"), "geom"),
    **dict.fromkeys(("site1", "site2", "sidesite", "refsite", "slidersite", "cranksite"), "site"),
    **dict.fromkeys(("tendon1", "tendon2"), "tendon"),
    **dict.fromkeys(("class", "childclass"), "default"),
}
# Pairs of attributes: the kind of an object, and its name.
OBJECTS = {"objname": "objtype", "refname": "reftype"}
# What stands under a name of its own in the tree.
_TREE = {"freejoint": "joint"}
# Sections whose elements share one set of names.
_SECTIONS = ("tendon", "actuator", "sensor", "equality", "keyframe")

Names = dict[str, set[str]]


def kind_of(node: Node) -> str:
    """The kind as which others refer to an element: "joint", "tendon", "mesh", …"""
    section, _, tag = node.path.partition("/")
    return section if section in _SECTIONS else _TREE.get(tag or section, tag or section)


def names_in(nodes: Iterable[Node]) -> Names:
    """The names of the elements, and of what they hold, by kind."""
    names: Names = {}
    for node in nodes:
        for one in below(node):
            if one.attrs.get("name"):
                names.setdefault(kind_of(one), set()).add(one.attrs["name"])
    return names


def references(node: Node) -> Iterable[tuple[str, str, str]]:
    """(attribute, kind, name) of what an element alone refers to."""
    for attribute, name in node.attrs.items():
        kind = REFERENCES.get(attribute, "")
        if attribute in OBJECTS:
            kind = node.attrs.get(OBJECTS[attribute], "").removeprefix("x")
        if kind and name:
            yield attribute, kind, name


def copied(node: Node, made: dict[int, Node] | None = None) -> Node:
    """A copy of an element and of all that it holds; made: the copies by the originals' ``id``."""
    whole = _alone(node)
    pending = [(node, whole)]
    while pending:
        one, same = pending.pop()
        if made is not None:
            made[id(one)] = same
        same.children = [_alone(child) for child in one.children]
        pending += zip(one.children, same.children, strict=True)
    return whole


def _alone(node: Node) -> Node:
    """A copy of an element without what it holds."""
    same = Node(node.tag, dict(node.attrs), node.file, node.line)
    same.values, same.path, same.compiler = dict(node.values), node.path, node.compiler
    same.parts = node.parts
    return same


def rename(node: Node, names: Names, new: Callable[[str], str]) -> None:
    """Gives an element, and what it holds, new names; references to `names` follow."""
    for one in below(node):
        changes = {a: new(name) for a, kind, name in references(one) if name in names.get(kind, ())}
        if one.attrs.get("name"):
            changes["name"] = new(one.attrs["name"])
        one.attrs |= changes
        one.values |= changes
