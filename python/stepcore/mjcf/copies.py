"""Copy and rename elements, with the elements that refer to them, for replicate and attach."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from stepcore.mjcf.nodes import Node, below

# The kind of element that each attribute names.
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
# Attributes that name an object, and the attributes that give its kind.
OBJECTS = {"objname": "objtype", "refname": "reftype"}
# Sections whose elements refer to the tree and to each other.
SECTIONS = ("contact", "tendon", "equality", "actuator", "sensor")
# Sections whose elements share one set of names.
_ONE_KIND = ("tendon", "actuator", "sensor", "equality", "keyframe")
# The maximum number of copied elements in one load.
MOST = 1_000_000

# `Names`: names by kind of element. `Part`: a section's tag and an element of that section.
Names = dict[str, set[str]]
Part = tuple[str, Node]


def kind_of(node: Node) -> str:
    """Return the kind by which references name an element: "joint", "tendon", "mesh", …"""
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


def named_by(node: Node) -> Iterator[tuple[str, str]]:
    """Yield (kind, name) of each reference in an element or its descendants.

    References to classes and materials are skipped.
    """
    for inner in below(node):
        for _, kind, name in references(inner):
            if kind not in ("default", "material"):
                yield kind, name


def add_name(names: Names, node: Node) -> None:
    """Add the name of an element, if it has one."""
    if node.attrs.get("name"):
        names.setdefault(kind_of(node), set()).add(node.attrs["name"])


def names_in(nodes: Iterable[Node]) -> Names:
    """Return the names of elements and their descendants."""
    names: Names = {}
    for node in nodes:
        for inner in below(node):
            add_name(names, inner)
    return names


def copied(node: Node, made: dict[int, Node] | None = None) -> Node:
    """Copy an element with its descendants.

    made: receives the copies by the ``id`` of the original.
    """
    whole = _alone(node)
    pending = [(node, whole)]
    while pending:
        original, copy = pending.pop()
        if made is not None:
            made[id(original)] = copy
        copy.children = [_alone(child) for child in original.children]
        pending += zip(original.children, copy.children, strict=True)
    return whole


def _alone(node: Node) -> Node:
    """Copy an element without its children."""
    copy = Node(node.tag, dict(node.attrs), node.file, node.line)
    copy.values, copy.path, copy.compiler = dict(node.values), node.path, node.compiler
    copy.parts = node.parts
    return copy


def rename(node: Node, names: Names, prefix: str = "", suffix: str = "") -> None:
    """Rename an element and its descendants, and update their references to `names`."""
    for inner in below(node):
        changed = {a: name for a, kind, name in references(inner) if name in names.get(kind, ())}
        if inner.attrs.get("name"):
            changed["name"] = inner.attrs["name"]
        new = {attribute: f"{prefix}{name}{suffix}" for attribute, name in changed.items()}
        inner.attrs |= new
        inner.values |= new


def section_of(tag: str, nodes: list[Node]) -> Node:
    """Return a new section with these elements."""
    section = Node(tag, {}, nodes[0].file, nodes[0].line)
    section.children = nodes
    return section


class Copies:
    """The counter of elements copied by all replicates and attachments of one load."""

    def __init__(self) -> None:
        self.made = 0

    def take(self, node: Node, nodes: Iterable[Node], count: int, more: int = 0) -> None:
        """Count the copies of these elements and their descendants before copying.

        Raises MJCFError above the limit.
        node: the element that makes the copies.
        count: the number of copies.
        more: the number of additional elements per copy.
        """
        size = more + sum(1 for outer in nodes for _ in below(outer))
        if self.made + count * size > MOST:
            raise node.error(
                f"<{node.tag}> makes {count * size} elements after {self.made} of other copies: "
                f"a model has at most {MOST} copied elements"
            )
        self.made += count * size


class Referring:
    """An index of a model's section elements by the names that they refer to.

    The cost of a search is proportional to its result. With many copied trees, searches through all
    sections would take quadratic time.
    """

    def __init__(self, root: Node) -> None:
        self.root = root
        self._sections = [section for section in root.children if section.tag in SECTIONS]
        # All elements in order; None replaces a removed element.
        self._parts: list[Part | None] = []
        self._by_name: dict[tuple[str, str], list[int]] = {}
        # Indices of elements without references.
        self._free: list[int] = []
        self.append((section.tag, node) for section in self._sections for node in section.children)
        self._given = len(self._parts)
        self._changed = False

    def append(self, parts: Iterable[Part]) -> None:
        """Add elements at the end of their sections."""
        for tag, node in parts:
            names = set(named_by(node))
            for name in names:
                self._by_name.setdefault(name, []).append(len(self._parts))
            if not names:
                self._free.append(len(self._parts))
            self._parts.append((tag, node))

    def to(self, names: Names, free: bool = False) -> list[Part]:
        """Return the elements that refer to these names, directly or through each other.

        free: whether to include elements without references.
        """
        return [part for _, part in self._referring(names, free)]

    def _referring(self, names: Names, free: bool) -> list[tuple[int, Part]]:
        reached: dict[int, Part] = {}
        waiting = list(self._free) if free else []
        pending = [(kind, name) for kind, inside in names.items() for name in inside]
        while pending or waiting:
            if not waiting:
                waiting = list(self._by_name.get(pending.pop(), ()))
                continue
            number = waiting.pop()
            part = self._parts[number]
            if part is not None and number not in reached:
                reached[number] = part
                if part[1].attrs.get("name"):
                    pending.append((kind_of(part[1]), part[1].attrs["name"]))
        return sorted(reached.items())

    def take(self, names: Names) -> list[Part]:
        """Remove the elements that `to` finds, and add their names to `names`."""
        taken = self._referring(names, False)
        for number, (_, node) in taken:
            self._parts[number] = None
            self._changed = True
            add_name(names, node)
        return [part for _, part in taken]

    def put_back(self) -> None:
        """Write the elements back to the model; added elements go to new sections at the end."""
        if not self._changed:
            return
        kept = {id(part[1]) for part in self._parts[: self._given] if part is not None}
        for section in self._sections:
            section.children = [node for node in section.children if id(node) in kept]
        added: dict[str, list[Node]] = {}
        for part in self._parts[self._given :]:
            if part is not None:
                added.setdefault(part[0], []).append(part[1])
        self.root.children += [section_of(tag, nodes) for tag, nodes in added.items()]
