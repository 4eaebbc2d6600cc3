"""Check a tree of nodes against the schema, convert attributes, and drop the kinds in `without`.

Elements that refer to a left-out element are left out too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from stepcore.checks import cut, nearest, refuse, shown
from stepcore.mjcf.nodes import (
    GROUPS,
    OF_TREE,
    SECTIONS,
    MJCFError,
    Node,
    Refusals,
    effect,
    is_own_text,
    section_nodes,
)
from stepcore.mjcf.schema import ROOT, SEEN, TAKEN_BACK, UNCHECKED, Spec
from stepcore.scene.element import field_rows
from stepcore.scene.elements import Actuator, Equality, Geom, Pair

# Stricter than float(): no nan, inf, underscores or other spellings.
REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
INT = re.compile(r"[+-]?\d+", re.ASCII)

# Names whose empty text is kept; other empty attributes count as not given.
KEPT_EMPTY = ("class", "childclass", "file", *TAKEN_BACK)
WHY = {
    "draws": "only draws",
    "senses": "only senses",
    "data": "data that the simulation does not use",
}


def validate(root: Node, refusals: Refusals, exclusions: Exclusions) -> list[str]:
    """Set `values` and `path` of every node, and return the lines for `Scene.ignored`.

    Errors are collected in `refusals`, and elements with errors are removed from the tree. Errors
    are elements, attributes, keywords or numbers outside the schema, and elements that would change
    the motion and are not built yet. Elements of the kinds in `exclusions` are removed too.
    """
    if root.tag != "mujoco":
        raise root.error(f"the root element is <{root.tag}>, not <mujoco>: not an MJCF model")
    # A schema location only serves text editors.
    root.attrs = {k: v for k, v in root.attrs.items() if not k.startswith(("xmlns", "xsi:"))}
    ignored: list[str] = []
    root.values = values_of(root, ROOT)
    exclusions.begin(root)
    pending: list[tuple[Node, Spec, str]] = [(root, ROOT, "")]
    while pending:
        node, spec, role = pending.pop()
        kept: list[Node] = []
        deeper: list[tuple[Node, Spec, str]] = []
        for child in node.children:
            inner = spec.children.get(child.tag)
            try:
                if inner is None:
                    near = nearest(child.tag, spec.children)
                    raise child.error(f"unknown element <{child.tag}> in <{node.tag}>{near}")
                # A path does not include the tag of the root.
                section = node.path.partition("/")[0] if node is not root else ""
                child.path = f"{section}/{child.tag}" if section else child.tag
                kind = exclusions.kind(child.path) if section != "default" else ""
                if kind:
                    exclusions.add(kind, child)
                    continue
                exclusions.strip(child)
                ignored += _strip(child, inner)
                _read(child, inner, node, role, ignored)
            except MJCFError as error:
                refusals.add(error, child)
                continue
            kept.append(child)
            deeper.append((child, inner, inner.role))
        node.children = kept
        pending += reversed(deeper)
    exclusions.follow(root)
    return ignored


def _strip(node: Node, spec: Spec) -> list[str]:
    """Remove attributes that MuJoCo ignores, and return a line about each.

    The class of a frame acts as its childclass, unless the frame has a childclass.
    """
    if node.tag not in UNCHECKED:
        return []
    if "class" in node.attrs:
        node.attrs.setdefault("childclass", node.attrs["class"])
        del node.attrs["class"]
    unknown = [name for name in node.attrs if name not in spec.attrs]
    for name in unknown:
        del node.attrs[name]
    return [node.ignored_line(f"{name} does nothing in {node.tag}") for name in unknown]


def _read(node: Node, spec: Spec, parent: Node, above: str, ignored: list[str]) -> None:
    node.values = values_of(node, spec)
    for tag in spec.once:
        same = [child for child in node.children if child.tag == tag]
        if len(same) > 1:
            raise same[1].error(f"a second <{tag}> in the same <{node.tag}>")
    if spec.role == "unbuilt":
        raise node.unbuilt(f"<{node.tag}> in <{parent.tag}>")
    if spec.role and spec.role != above and not is_own_text(node):
        ignored.append(node.ignored_line(WHY[spec.role]))


def values_of(node: Node, spec: Spec) -> dict[str, object]:
    """Return the attributes of an element as numbers and words.

    As in MuJoCo, empty numbers and names count as not given. Raises MJCFError for an unknown
    attribute or a bad value.
    """
    result: dict[str, object] = {}
    for name, text in node.attrs.items():
        kind = spec.attrs.get(name)
        if kind is None:
            near = nearest(name, spec.attrs)
            raise node.error(f'unknown attribute "{name}" of <{node.tag}>{near}')
        if text.strip() or "|" in kind or name in spec.required or name in KEPT_EMPTY:
            result[name] = _value(node, name, text, kind)
    for name in spec.required:
        if name not in result:
            raise node.error(f'<{node.tag}> lacks the required attribute "{name}"')
    return result


def seen_values(node: Node, values: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the attributes that views show of an element that only draws.

    values: the attribute texts, completed from the default class. Raises MJCFError for a bad value.
    """
    spec, texts = SEEN[node.tag], node.values if values is None else values
    seen = {name: texts[name] for name in spec.attrs if name in texts}
    return values_of(Node(node.tag, seen, node.file, node.line), spec)


def _value(node: Node, name: str, text: str, kind: str) -> object:
    """Return the attribute's value: text, bool, keyword, int, or a tuple of numbers."""
    if not kind:
        return text
    if "|" in kind:
        words = kind.split("|")
        if text not in words:
            raise bad(node, name, text, f"one of {', '.join(words)}{nearest(text, words, 0)}")
        return {"true": True, "false": False}.get(text, text) if words[0] == "false" else text
    entries = text.split()
    if kind == "int":
        if len(entries) != 1 or not INT.fullmatch(entries[0]):
            raise bad(node, name, text, "an integer")
        return _int(node, name, entries[0])
    if kind.startswith("int"):
        count = None if kind == "int*" else int(kind[3:])
        if count not in (None, len(entries)) or not all(map(INT.fullmatch, entries)):
            raise bad(node, name, text, f"{count or 'any number of'} integers")
        return tuple(_int(node, name, entry) for entry in entries)
    low, _, high = kind.partition("-")
    if kind == "*":
        fits, limit = True, "finite numbers"
    elif high:
        fits = int(low) <= len(entries) <= int(high)
        limit = f"{low} to {high} finite numbers"
    else:
        fits = len(entries) == int(low)
        limit = f"{low} finite number{'s' if low != '1' else ''}"
    if not fits or not all(map(REAL.fullmatch, entries)):
        raise bad(node, name, text, limit)
    numbers = tuple(map(float, entries))
    if not all(map(math.isfinite, numbers)):
        raise bad(node, name, text, limit)
    return numbers[0] if kind == "1" else numbers


def _int(node: Node, name: str, text: str) -> int:
    if len(text) > 11 or not -(2**31) <= int(text) < 2**31:
        raise bad(node, name, text, "a 32-bit integer")
    return int(text)


def bad(node: Node, name: str, value: object, limit: str) -> MJCFError:
    return node.error(f"<{node.tag}> {name} = {shown(value)}: must be {limit}")


# The kind of element that each attribute names: of fields that refer to elements, and of others.
REFERENCES = {
    **{
        row.name: row.type.refers[0].lower()
        for kind in (Geom, Actuator, Equality, Pair)
        for row in field_rows(kind).values()
        if len(row.type.refers) == 1 and row.name != "feeds"
    },
    **{name: name for name in ("camera", "actuator", "sensor", "geom", "material", "texture")},
    **{"flex": "flex", "skin": "skin", "sidesite": "site"},
    **dict.fromkeys(("subtree1", "subtree2", "target"), "body"),
    **dict.fromkeys(("class", "childclass"), "default"),
}
# Attributes that name an object, and the attributes that give its kind.
OBJECTS = {"objname": "objtype", "refname": "reftype"}
# Sections whose elements share one set of names.
_ONE_KIND = ("tendon", "actuator", "sensor", "equality", "keyframe")
_KEPT = ("compiler", "default", "worldbody", "asset", "size")


def removable_kind(node: Node) -> str:
    section, _, tag = node.path.partition("/")
    if section in _ONE_KIND or not tag:
        return section
    return "joint" if tag == "freejoint" else tag


def references(node: Node) -> Iterator[tuple[str, str, str]]:
    """Yield (attribute, kind, name) of each reference in the element's own attributes."""
    for attribute, name in node.attrs.items():
        kind = REFERENCES.get(attribute, "")
        if attribute in OBJECTS:
            kind = node.attrs.get(OBJECTS[attribute], "").removeprefix("x")
        if kind and name:
            yield attribute, kind, name


def _known_kinds() -> dict[str, str]:
    """Return the kind for each accepted word: a group, a section, or a path with a "/"."""
    words = {name: name for name in (*GROUPS, *SECTIONS)}
    elements: list[tuple[str, str]] = []
    with_attributes = {"option": ROOT.children["option"]}
    for section, spec in ROOT.children.items():
        if section != "default":
            with_attributes |= spec.children
        if section == "worldbody":
            elements += [(section, tag) for tag in OF_TREE]
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
        element_kinds = _known_kinds()
        for word in without:
            if not isinstance(word, str):
                raise refuse("load", "without", word, "the name of a kind")
            name = word.strip()
            if name not in element_kinds:
                name = name.removesuffix("s")
            if name not in element_kinds:
                near = nearest(word.strip(), element_kinds)
                raise ValueError(f"load: without = {shown(word)}: no such kind{near}")
            self.nodes[element_kinds[name]] = []

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
        for name in list(node.attrs):
            kind = f"{node.tag}/{name}"
            if kind in self.nodes:
                del node.attrs[name]
                self.nodes[kind].append(node)

    def begin(self, root: Node) -> None:
        self._actuators = [id(node) for node in section_nodes(root, "actuator")]

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
            kept: list[Node] = []
            for node in part.children:
                kinds = (gone.get(target, {}).get(name, "") for _, target, name in references(node))
                kind = "" if part.tag == "default" else next(filter(None, kinds), "")
                removed |= bool(kind)
                (self.nodes[kind] if kind else kept).append(node)
            part.children = kept
        return removed

    def notes(self) -> list[str]:
        """Return a note on each kind: the number of nodes left out, and their effect."""
        notes = []
        for kind, nodes in self.nodes.items():
            if not nodes:
                notes.append(f"without {kind}: the file has none")
                continue
            names = [f'<{n.tag}> "{n.attrs["name"]}"' for n in nodes if n.attrs.get("name")]
            more = f" and {len(nodes) - 5} more" if len(nodes) > 5 else ""
            examples = f" ({', '.join(names[:5])}{more})" if names else ""
            where, does = f"{nodes[0].file}:{nodes[0].line}", effect(kind)
            text = f"{where}: without {kind}: {len(nodes)} left out{examples}"
            notes.append(cut(text + (f": {does}" if does else ""), 400))
        return notes

    def counts(self) -> list[str]:
        return [f"{kind} ({len(nodes)})" for kind, nodes in self.nodes.items() if nodes]
