"""What a user leaves out of a file on purpose: elements and attributes of named kinds.

What refers to an element that is left out is left out with it.
"""

from __future__ import annotations

from collections.abc import Iterable

from stepcore.checks import cut, nearest, refuse, shown
from stepcore.mjcf.effects import GROUPS, SECTIONS, effect
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.schema import ROOT

# Attributes that refer to what can be left out, by the section of the latter.
REFERENCES = {
    **dict.fromkeys(("tendon", "tendon1", "tendon2"), "tendon"),
    "actuator": "actuator",
}
# The only elements of the tree that can be left out: the rest of the file stands on the others.
_OF_TREE = ("flexcomp", "composite", "attach", "replicate", "plugin", "camera", "light")
_KEPT = ("compiler", "default", "worldbody", "asset", "size")


def _known() -> dict[str, str]:
    """The words that name a kind, and what they mean: a group, a section, or with a "/"."""
    words = {name: name for name in (*GROUPS, *SECTIONS)}
    elements: list[tuple[str, str]] = []
    with_attributes = {"option": ROOT.children["option"]}
    for section, spec in ROOT.children.items():
        if section == "default":
            continue
        with_attributes |= spec.children
        inside = _OF_TREE if section == "worldbody" else spec.children
        if section not in _KEPT or section == "worldbody":
            elements += [(section, tag) for tag in inside]
    tags = [tag for _, tag in elements]
    for section, tag in elements:
        words.setdefault(f"{section}/{tag}", f"{section}/{tag}")
        if tags.count(tag) == 1:
            words.setdefault(tag, f"{section}/{tag}")
    with_attributes |= ROOT.children["worldbody"].children["body"].children
    for tag, spec in with_attributes.items():
        for attribute in spec.attrs:
            if attribute not in (*spec.required, "name", "class"):
                words.setdefault(f"{tag}/{attribute}", f"{tag}/{attribute}")
    return words


class LeftOut:
    """The kinds that are left out of a file, and what was left out of it.

    Raises ValueError for a kind that does not exist.
    """

    def __init__(self, without: Iterable[str] = ()) -> None:
        self.nodes: dict[str, list[Node]] = {}
        self.kinds: list[str] = []
        self._actuators: list[int] = []
        if not without:
            return
        if not isinstance(without, (list, tuple, set, frozenset)):
            raise refuse("load", "without", without, 'a list of kinds, such as ["flex"]')
        known = _known()
        for word in without:
            if not isinstance(word, str):
                raise refuse("load", "without", word, "the name of a kind")
            one = word.strip()
            kind = next((known[w] for w in (one, one.removesuffix("s")) if w in known), None)
            if kind is None:
                raise ValueError(
                    f"load: without = {shown(word)}: no such kind{nearest(one, known)}"
                )
            self.nodes[kind] = []
            self.kinds = list(self.nodes)

    def takes(self, path: str) -> str:
        """The kind by which an element of this path, "section/tag", is left out, or ""."""
        section, _, tag = path.partition("/")
        for kind in self.kinds:
            group = GROUPS.get(kind, ())
            if kind in (path, section) or path in group or tag in group:
                return kind
        return ""

    def take(self, kind: str, node: Node) -> None:
        """Records a node that is left out; of a section, its elements."""
        if "/" in node.path:
            self.nodes[kind].append(node)
            return
        for one in node.children:
            one.path = f"{node.tag}/{one.tag}"
        self.nodes[kind] += node.children

    def strip(self, node: Node) -> None:
        """Removes the attributes of a node that are left out."""
        for name in list(node.attrs):
            kind = f"{node.tag}/{name}"
            if kind in self.nodes:
                del node.attrs[name]
                self.nodes[kind].append(node)

    def begin(self, root: Node) -> None:
        """Remembers the actuators of the whole file, by whose order keyframes hold controls."""
        sections = [section for section in root.children if section.tag == "actuator"]
        self._actuators = [id(node) for section in sections for node in section.children]

    def follow(self, root: Node) -> None:
        """Removes what refers to an element that is left out, until nothing does."""
        while self.kinds and self._follow(root):
            pass
        gone = {id(node) for nodes in self.nodes.values() for node in nodes}
        kept = [index for index, one in enumerate(self._actuators) if one not in gone]
        if len(kept) < len(self._actuators):
            for key in (node for section in root.children for node in section.children):
                if key.tag == "key" and len(key.values.get("ctrl", ())) == len(self._actuators):
                    key.values["ctrl"] = tuple(key.values["ctrl"][index] for index in kept)

    def _follow(self, root: Node) -> bool:
        gone: dict[str, dict[str, str]] = {}
        for kind, nodes in self.nodes.items():
            for node in nodes:
                if node.attrs.get("name"):
                    section = node.path.partition("/")[0]
                    gone.setdefault(section, {}).setdefault(node.attrs["name"], kind)
        found = False
        for part in root.children:
            kept = []
            for node in part.children:
                by = "" if part.tag == "default" else _refers(node, gone)
                if by:
                    self.nodes[by].append(node)
                    found = True
                else:
                    kept.append(node)
            part.children = kept
        return found

    def notes(self) -> list[str]:
        """A note on each kind: how much was left out, and what it would have done."""
        return [_note(kind, nodes) for kind, nodes in self.nodes.items()]

    def said(self) -> list[str]:
        """The kinds of which something was left out, with how many."""
        return [f"{kind} ({len(nodes)})" for kind, nodes in self.nodes.items() if nodes]


def _refers(node: Node, gone: dict[str, dict[str, str]]) -> str:
    for attribute, name in node.attrs.items():
        section = REFERENCES.get(attribute)
        if attribute == "objname" and node.attrs.get("objtype") in gone:
            section = node.attrs["objtype"]
        if section in gone and name in gone[section]:
            return gone[section][name]
    return ""


def _note(kind: str, nodes: list[Node]) -> str:
    if not nodes:
        return f"without {kind}: the file has none"
    names = [f'<{node.tag}> "{node.attrs["name"]}"' for node in nodes if node.attrs.get("name")]
    shown = ", ".join(names[:5]) + (f" and {len(nodes) - 5} more" if len(nodes) > 5 else "")
    does = effect(kind)
    where = f"{nodes[0].file}:{nodes[0].line}"
    text = f"{where}: without {kind}: {len(nodes)} left out" + (f" ({shown})" if names else "")
    return cut(text + (f": {does}" if does else ""), 400)
