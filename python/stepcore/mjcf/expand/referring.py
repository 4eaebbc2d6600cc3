"""The elements outside the tree of a model, found by what they refer to."""

from __future__ import annotations

from collections.abc import Iterator

from stepcore.mjcf.expand.naming import Names, kind_of, references
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below

# Sections whose elements refer to the tree, and to each other.
SECTIONS = ("contact", "tendon", "equality", "actuator", "sensor")


def named_by(node: Node) -> Iterator[tuple[str, str]]:
    """What an element, or what it holds, refers to, by kind and name; classes and looks aside."""
    for one in below(node):
        for _, kind, name in references(one):
            if kind not in ("default", "material"):
                yield kind, name


class Referring:
    """The elements of a model's sections, in order; finding some takes time for these alone.

    A copied tree would else look through all sections, once for each copy.
    """

    def __init__(self, root: Node) -> None:
        self.root = root
        self._sections = [section for section in root.children if section.tag in SECTIONS]
        self._elements: dict[int, tuple[str, Node]] = {}
        self._by_name: dict[tuple[str, str], list[int]] = {}
        # Elements that refer to nothing.
        self._free: list[int] = []
        self._count = 0
        self.changed = False
        for section in self._sections:
            for node in section.children:
                self._add(section.tag, node)
        self._given = self._count

    def _add(self, tag: str, node: Node) -> None:
        number = self._count
        self._count += 1
        self._elements[number] = tag, node
        names = set(named_by(node))
        for name in names:
            self._by_name.setdefault(name, []).append(number)
        if not names:
            self._free.append(number)

    def to(self, names: Names, free: bool = False) -> list[tuple[str, Node]]:
        """Section and element of all that refer to these names, or to such an element by its name.

        free: those that refer to nothing count too.
        """
        return [self._elements[number] for number in self._numbers(names, free)]

    def _numbers(self, names: Names, free: bool) -> list[int]:
        found: set[int] = set()
        waiting = list(self._free) if free else []
        pending = [(kind, name) for kind, inside in names.items() for name in inside]
        while pending or waiting:
            waiting += self._by_name.get(pending.pop(), ()) if pending else ()
            for number in waiting:
                if number in self._elements and number not in found:
                    found.add(number)
                    node = self._elements[number][1]
                    if node.attrs.get("name"):
                        pending.append((kind_of(node), node.attrs["name"]))
            waiting = []
        return sorted(found)

    def take(self, names: Names) -> list[tuple[str, Node]]:
        """Removes what `to` finds, and adds the names of these elements to `names`."""
        taken = [self._elements.pop(number) for number in self._numbers(names, False)]
        for _, node in taken:
            if node.attrs.get("name"):
                names.setdefault(kind_of(node), set()).add(node.attrs["name"])
        self.changed |= bool(taken)
        return taken

    def append(self, elements: list[tuple[str, Node]]) -> None:
        """Adds elements, which then stand behind all others of their sections."""
        for tag, node in elements:
            self._add(tag, node)

    def put_back(self) -> None:
        """Gives the sections these elements; those that were added get sections of their own."""
        if not self.changed:
            return
        kept: set[int] = set()
        added: dict[str, list[Node]] = {}
        for number, (tag, node) in self._elements.items():
            if number < self._given:
                kept.add(id(node))
            else:
                added.setdefault(tag, []).append(node)
        for section in self._sections:
            section.children = [node for node in section.children if id(node) in kept]
        self.root.children += [section_of(tag, nodes) for tag, nodes in added.items()]


def section_of(tag: str, nodes: list[Node]) -> Node:
    """A section that holds these elements."""
    section = Node(tag, {}, nodes[0].file, nodes[0].line)
    section.path, section.children = tag, nodes
    return section
