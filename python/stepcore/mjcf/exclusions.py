"""Kinds of elements and attributes that the user leaves out of a file.

Elements that refer to a left-out element are left out too.
"""

from __future__ import annotations

from collections.abc import Iterable

from stepcore.checks import cut, nearest, refuse, shown
from stepcore.mjcf.copies import references
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusal_texts import GROUPS, SECTIONS, effect
from stepcore.mjcf.schema import ROOT

# The only elements of the tree that can be left out; the rest of the file needs the others.
_OF_TREE = ("flexcomp", "composite", "attach", "replicate", "plugin", "camera", "light")
_KEPT = ("compiler", "default", "worldbody", "asset", "size")


def _known_kinds() -> dict[str, str]:
    """Return the kind for each accepted word: a group, a section, or a path with a "/"."""
    words = {name: name for name in (*GROUPS, *SECTIONS)}
    elements: list[tuple[str, str]] = []
    with_attributes = {"option": ROOT.children["option"]}
    for section, spec in ROOT.children.items():
        if section != "default":
            with_attributes |= spec.children
        if section == "worldbody":
            elements += [(section, tag) for tag in _OF_TREE]
        elif section not in _KEPT:
            elements += [(section, tag) for tag in spec.children]
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


class Exclusions:
    """The kinds that are left out of a file, and the nodes left out for each kind.

    Raises ValueError for a kind that does not exist.
    """

    def __init__(self, without: Iterable[str] = ()) -> None:
        self.nodes: dict[str, list[Node]] = {}
        # The ids of all actuators of the file, in the order of the controls in keyframes.
        self._actuators: list[int] = []
        if not without:
            return
        if not isinstance(without, (list, tuple, set, frozenset)):
            raise refuse("load", "without", without, 'a list of kinds, such as ["flex"]')
        known = _known_kinds()
        for word in without:
            if not isinstance(word, str):
                raise refuse("load", "without", word, "the name of a kind")
            name = word.strip()
            if name not in known:
                name = name.removesuffix("s")
            if name not in known:
                near = nearest(word.strip(), known)
                raise ValueError(f"load: without = {shown(word)}: no such kind{near}")
            self.nodes[known[name]] = []

    def kind(self, path: str) -> str:
        """Return the kind that leaves out elements of this path, "section/tag"; "" if none does."""
        section, _, tag = path.partition("/")
        for kind in self.nodes:
            group = GROUPS.get(kind, ())
            if kind in (path, section) or path in group or tag in group:
                return kind
        return ""

    def add(self, kind: str, node: Node) -> None:
        """Record a node that is left out; for a section, record its elements."""
        if "/" in node.path:
            self.nodes[kind].append(node)
            return
        for child in node.children:
            child.path = f"{node.tag}/{child.tag}"
        self.nodes[kind] += node.children

    def strip(self, node: Node) -> None:
        """Remove the attributes of a node that are left out."""
        for name in list(node.attrs):
            kind = f"{node.tag}/{name}"
            if kind in self.nodes:
                del node.attrs[name]
                self.nodes[kind].append(node)

    def begin(self, root: Node) -> None:
        """Record the actuators of the file, before any is left out."""
        sections = [section for section in root.children if section.tag == "actuator"]
        self._actuators = [id(node) for section in sections for node in section.children]

    def follow(self, root: Node) -> None:
        """Remove all elements that refer, directly or indirectly, to a left-out element."""
        while self.nodes and self._remove_referring(root):
            pass
        gone = {id(node) for nodes in self.nodes.values() for node in nodes}
        kept = [index for index, actuator in enumerate(self._actuators) if actuator not in gone]
        if len(kept) < len(self._actuators):
            for key in (node for section in root.children for node in section.children):
                if key.tag == "key" and len(key.values.get("ctrl", ())) == len(self._actuators):
                    key.values["ctrl"] = tuple(key.values["ctrl"][index] for index in kept)

    def _remove_referring(self, root: Node) -> bool:
        """Remove elements that refer to a removed element; return whether there were any."""
        gone: dict[str, dict[str, str]] = {}
        for kind, nodes in self.nodes.items():
            for node in nodes:
                if node.attrs.get("name"):
                    section = node.path.partition("/")[0]
                    gone.setdefault(section, {}).setdefault(node.attrs["name"], kind)
        removed = False
        for part in root.children:
            kept = []
            for node in part.children:
                kind = "" if part.tag == "default" else _kind_referred_to(node, gone)
                if kind:
                    self.nodes[kind].append(node)
                    removed = True
                else:
                    kept.append(node)
            part.children = kept
        return removed

    def notes(self) -> list[str]:
        """Return a note on each kind: the number of nodes left out, and their effect."""
        return [_note(kind, nodes) for kind, nodes in self.nodes.items()]

    def counts(self) -> list[str]:
        """Return the kinds with left-out nodes, each with its count."""
        return [f"{kind} ({len(nodes)})" for kind, nodes in self.nodes.items() if nodes]


def _kind_referred_to(node: Node, gone: dict[str, dict[str, str]]) -> str:
    """Return the kind of the first removed element that the node refers to, or ""."""
    kinds = (gone.get(section, {}).get(name, "") for _, section, name in references(node))
    return next(filter(None, kinds), "")


def _note(kind: str, nodes: list[Node]) -> str:
    if not nodes:
        return f"without {kind}: the file has none"
    names = [f'<{node.tag}> "{node.attrs["name"]}"' for node in nodes if node.attrs.get("name")]
    listed = ", ".join(names[:5]) + (f" and {len(nodes) - 5} more" if len(nodes) > 5 else "")
    does = effect(kind)
    text = f"{nodes[0].file}:{nodes[0].line}: without {kind}: {len(nodes)} left out"
    text += f" ({listed})" if names else ""
    return cut(text + (f": {does}" if does else ""), 400)
