"""`<replicate>` and `<attach>`: copies of bodies, with all elements that refer to them.

MuJoCo documentation, XML reference, replicate, body/attach and asset/model; Model editing,
Attribute merging. As in MuJoCo: copies of elements that refer to a replicated element come after
all other elements of their section. An element outside the tree is attached if all its references
are attached. All assets, default classes and keyframes of the other model are attached. Names get
the prefix. The attached elements keep the compiler settings and default classes of their own
model. The compiler attribute "conflict" decides between options of the two models.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from stepcore.checks import nearest
from stepcore.mjcf.defaults import MAIN, Compiler, Defaults
from stepcore.mjcf.nodes import Node, below, inside, options, sections
from stepcore.mjcf.schema import FLAGS_OFF, ROOT
from stepcore.mjcf.validation import bad, kind_of, references
from stepcore.scene import frames
from stepcore.scene.frames import Vec
from stepcore.scene.layout import DOFS, QPOS

# Sections whose elements refer to the tree and to each other.
SECTIONS = ("contact", "tendon", "equality", "actuator", "sensor")
# The maximum number of copied elements in one load.
MOST_COPIES = 1_000_000

# `Names`: names by kind of element. `Part`: a section's tag and an element of that section.
Names = dict[str, set[str]]
Part = tuple[str, Node]


def named_by(node: Node) -> Iterator[tuple[str, str]]:
    """Yield (kind, name) of each reference in an element or its descendants.

    References to classes and materials are skipped.
    """
    for inner in below(node):
        for _, kind, name in references(inner):
            if kind not in ("default", "material"):
                yield kind, name


def add_name(names: Names, node: Node) -> None:
    if node.attrs.get("name"):
        names.setdefault(kind_of(node), set()).add(node.attrs["name"])


def names_in(nodes: Iterable[Node]) -> Names:
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
    copy = Node(node.tag, dict(node.attrs), node.file, node.line)
    copy.values, copy.path = dict(node.values), node.path
    copy.compiler, copy.parts = node.compiler, node.parts
    return copy


def rename(node: Node, names: Names, prefix: str = "", suffix: str = "") -> None:
    for inner in below(node):
        changed = {a: name for a, kind, name in references(inner) if name in names.get(kind, ())}
        if inner.attrs.get("name"):
            changed["name"] = inner.attrs["name"]
        new = {attribute: f"{prefix}{name}{suffix}" for attribute, name in changed.items()}
        inner.attrs |= new
        inner.values |= new


def section_of(tag: str, nodes: list[Node]) -> Node:
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
        if self.made + count * size > MOST_COPIES:
            raise node.error(
                f"<{node.tag}> makes {count * size} elements after {self.made} of other copies: "
                f"a model has at most {MOST_COPIES} copied elements"
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


def expand_replicates(root: Node, compiler: Compiler, copies: Copies) -> None:
    """Replace every <replicate> of a model by frames, the innermost first."""
    parents = _parents(root)
    if not parents:
        return
    referring = Referring(root)
    for parent in parents:
        children: list[Node] = []
        for node in parent.children:
            if node.tag == "replicate":
                children += _replicas(node, node.compiler or compiler, referring, copies)
            else:
                children.append(node)
        parent.children = children
    referring.put_back()


def _parents(root: Node) -> list[Node]:
    every = [node for tree in sections(root, "worldbody") for node in below(tree)]
    depth: dict[int, int] = {}
    for node in every:
        for child in node.children:
            depth[id(child)] = depth.get(id(node), 0) + 1
    holding = [n for n in every if any(child.tag == "replicate" for child in n.children)]
    return sorted(holding, key=lambda node: -depth.get(id(node), 0))


def _replicas(node: Node, compiler: Compiler, referring: Referring, copies: Copies) -> list[Node]:
    """Return a frame for each copy, and add copies of referring elements to `referring`."""
    count, sep = node.values["count"], node.values.get("sep", "")
    if count < 0:
        raise bad(node, "count", count, ">= 0")
    for child in node.children:
        if child.tag in ("joint", "freejoint", "inertial"):
            raise child.error(f"<{child.tag}> cannot be a direct child of <replicate>")
    names = names_in(node.children)
    named = referring.take(names)
    copies.take(node, [node, *(part for _, part in named)], count)
    # The originals become the first replica, because keyframes of attached models refer to them.
    trees = [node.children, *([copied(n) for n in node.children] for _ in range(count - 1))]
    parts = [named, *([(tag, copied(n)) for tag, n in named] for _ in range(count - 1))]
    replicas: list[Node] = []
    for index, (pos, quat) in enumerate(_poses(node, compiler)):
        suffix = f"{sep}{index:0{len(str(count))}d}"
        for element in [*trees[index], *(part for _, part in parts[index])]:
            rename(element, names, suffix=suffix)
        frame = Node("frame", {}, node.file, node.line)
        frame.path, frame.compiler, frame.children = "worldbody/frame", node.compiler, trees[index]
        frame.attrs = {name: node.attrs[name] for name in ("childclass",) if name in node.attrs}
        frame.values = {**({"pos": pos, "quat": quat} if index else {}), **frame.attrs}
        referring.append(parts[index])
        replicas.append(frame)
    return replicas


def _poses(node: Node, compiler: Compiler) -> Iterator[tuple[Vec, Vec]]:
    """Yield the pose of each copy.

    As in MuJoCo, copy k is rotated by k times the Euler angles. With more than one angle this
    differs from k successive rotations. The offset of each copy is in the frame of the previous
    copy.
    """
    angles = [compiler.radians(angle) for angle in node.values.get("euler", frames.ORIGIN)]
    pos = frames.ORIGIN
    for index in range(node.values["count"]):
        quat = frames.from_euler([index * angle for angle in angles], compiler.eulerseq)
        yield pos, quat
        pos = frames.composed((pos, quat), node.values.get("offset", frames.ORIGIN), quat)[0]


# Bodies and frames by tag and name, each with the childclass inherited at its position.
Places = dict[tuple[str, str], tuple[Node, str]]
# How options of two models merge; all others must be the same.
MERGED: dict[str, Callable[[Any, Any], Any]] = {
    **dict.fromkeys(("timestep", "tolerance", "ls_tolerance", "noslip_tolerance"), min),
    **dict.fromkeys(("ccd_tolerance", "sleep_tolerance"), min),
    **dict.fromkeys(("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations"), max),
    **dict.fromkeys(("sdf_iterations", "sdf_initpoints"), max),
    "actuatorgroupdisable": lambda here, there: tuple(dict.fromkeys((*here, *there))),
}


@dataclass
class Model:
    """A model whose own <attach> and <replicate> elements are expanded."""

    root: Node
    compiler: Compiler
    defaults: Defaults

    @cached_property
    def places(self) -> Places:
        return _add_places({}, inside(self.root, "worldbody"), MAIN)

    @cached_property
    def assets(self) -> list[Node]:
        """The model's assets; an asset without a name is named after its file."""
        assets = [node for node in inside(self.root, "asset") if node.tag != "model"]
        for node in assets:
            if node.asset_name():
                node.attrs["name"] = node.values["name"] = node.asset_name()
        return assets

    @cached_property
    def keys(self) -> list[Node]:
        return _split_keys(self.root, self.defaults)

    @cached_property
    def referring(self) -> Referring:
        return Referring(self.root)


class Attacher:
    """The expansion of a model's <attach> elements.

    load: returns the model that an <asset><model> names.
    notes: lines about elements left out and options not used.
    """

    def __init__(self, model: Model, load: Callable[[Node], Model], copies: Copies) -> None:
        self.model = model
        self.load = load
        self.copies = copies
        self.notes: list[str] = []
        self.assets: dict[str, Node] = {}
        # Used only if the model attaches parts of itself; both grow with each attachment.
        self.places: Places = {}
        self.referring: Referring | None = None
        # The sections added for attached elements, by tag.
        self.sections: dict[str, Node] = {}
        for node in inside(model.root, "asset"):
            if node.tag == "model":
                name = node.attrs.get("name") or load(node).root.attrs.get("model", "")
                if name in self.assets:
                    raise node.error(f'model "{name}": the name is used twice')
                self.assets[name] = node

    def run(self) -> None:
        attachments = []
        pending = inside(self.model.root, "worldbody")[::-1]
        while pending:
            node = pending.pop()
            if node.tag == "attach":
                attachments.append(node)
            pending += reversed(node.children)
        if any("model" not in node.attrs for node in attachments):
            self.referring = Referring(self.model.root)
            _add_places(self.places, inside(self.model.root, "worldbody"), MAIN)
        for node in attachments:
            self._attach(node)

    def _attach(self, node: Node) -> None:
        """Turn an <attach> into a frame that contains the attached elements."""
        other = self._other(node)
        own = other is self.model
        if not own:
            if other.compiler.mass_rules().fitaabb != self.model.compiler.mass_rules().fitaabb:
                raise node.unbuilt("an attached model with another fitaabb than this one")
            policy = self.model.compiler.values.get("conflict", "warning")
            self.notes += _merge_options(self.model.root, other.root, node, policy)
        prefix = node.values["prefix"]
        tree, childclass = _tree(node, other.root, self.places if own else other.places, own)
        assets, keys = ([], []) if own else (other.assets, other.keys)
        referring = self.referring if own and self.referring else other.referring
        names, parts, torn = _resolved(referring, [*tree, *assets], own)
        everything = [*tree, *assets, *keys, *(part for _, part in parts)]
        self.copies.take(node, everything, 1, 1 if own else 1 + len(other.defaults.classes))
        self.notes += [f"{node.file}:{node.line}: <attach> leaves out {what}" for what in torn]

        made: dict[int, Node] = {}
        twins = [copied(part, made) for part in tree]
        along = [(tag, copied(part, made)) for tag, part in parts]
        along += [("asset", copied(asset, made)) for asset in assets]
        along += [("keyframe", _copied_key(key, made)) for key in keys]
        if not own:
            here = self.model.defaults.adopt(other.defaults, prefix)
            _rename_classes(along, made, here)
            childclass = here.get(childclass, childclass)
            # Attached elements are read with the compiler settings of their own model.
            for twin in made.values():
                twin.compiler = twin.compiler or other.compiler
        self._add(along, names, prefix)
        for twin in twins:
            rename(twin, names, prefix)
        node.tag, node.path, node.children = "frame", "worldbody/frame", twins
        node.attrs = {"childclass": childclass}
        node.values = dict(node.attrs)
        if self.referring is not None:
            _add_places(self.places, twins, childclass)

    def _other(self, node: Node) -> Model:
        if "body" in node.attrs and "frame" in node.attrs:
            raise node.error("<attach> has both body and frame")
        name = node.attrs.get("model")
        if name is None:
            if "body" not in node.attrs and "frame" not in node.attrs:
                raise node.error("<attach> without a model needs body or frame")
            return self.model
        if name not in self.assets:
            near = nearest(name, sorted(self.assets))
            raise node.error(f'<attach model="{name}">: no such model{near}')
        return self.load(self.assets[name])

    def _add(self, parts: list[Part], names: Names, prefix: str) -> None:
        """Rename the elements and add them to this model's sections."""
        for tag, node in parts:
            rename(node, names, prefix)
            if tag == "keyframe":
                # An unnamed keyframe gets the prefix as its name.
                name = node.attrs.get("name", prefix).removeprefix(prefix)
                node.attrs["name"] = node.values["name"] = prefix + name
            if tag in self.sections:
                self.sections[tag].children.append(node)
            else:
                self.sections[tag] = section_of(tag, [node])
                self.model.root.children.append(self.sections[tag])
        if self.referring is not None:
            self.referring.append(part for part in parts if part[0] in SECTIONS)


def _add_places(places: Places, nodes: list[Node], childclass: str) -> Places:
    pending = [(node, childclass) for node in reversed(nodes)]
    while pending:
        node, around = pending.pop()
        if node.tag in ("body", "frame") and node.attrs.get("name"):
            places.setdefault((node.tag, node.attrs["name"]), (node, around))
        inner = node.attrs.get("childclass", around)
        pending += [(child, inner) for child in reversed(node.children)]
    return places


def _tree(node: Node, root: Node, places: Places, own: bool) -> tuple[list[Node], str]:
    """Return the attached nodes and the childclass that they inherit."""
    kind = next((word for word in ("body", "frame") if word in node.attrs), "")
    if not kind:
        return inside(root, "worldbody"), MAIN
    name = node.attrs[kind]
    if (kind, name) not in places:
        near = nearest(name, [known for tag, known in places if tag == kind])
        raise node.error(f'<attach {kind}="{name}">: no such {kind}{near}')
    part, childclass = places[kind, name]
    if own and any(inner.tag == "attach" for inner in below(part)):
        raise node.error(f'<attach {kind}="{name}"> holds an <attach> itself')
    return [part], childclass


def _rename_classes(parts: list[Part], made: dict[int, Node], here: dict[str, str]) -> None:
    """Replace the names of the other model's default classes with their names in this model.

    parts: attached elements outside the tree; those without a class get the main class.
    made: all copied nodes.
    here: for each class of the other model, its name in this model.
    """
    for tag, node in parts:
        if tag in (*SECTIONS, "asset") and "class" in ROOT.children[tag].children[node.tag].attrs:
            node.attrs.setdefault("class", MAIN)
    for node in made.values():
        for attribute in ("class", "childclass"):
            if node.attrs.get(attribute) in here:
                name = here[node.attrs[attribute]]
                node.attrs[attribute] = node.values[attribute] = name


def _resolved(
    referring: Referring, attached: list[Node], own: bool
) -> tuple[Names, list[Part], list[str]]:
    """Find the elements to attach along with a tree: those that refer only to attached elements.

    Returns the names of all attached elements, the found elements, and a description of each
    element that refers both to attached elements and to others.
    """
    names = names_in(attached)
    names.setdefault("body", set()).add("world")
    # Within the same model, only elements that refer to the tree are copied.
    parts = referring.to(names, free=not own)
    needs = [list(named_by(node)) for _, node in parts]
    users: dict[tuple[str, str], list[int]] = {}
    for at, (_, node) in enumerate(parts):
        add_name(names, node)
        for need in needs[at]:
            users.setdefault(need, []).append(at)
    left_out: set[int] = set()
    pending = [at for at, need in enumerate(needs) if _missing(need, names)]
    while pending:
        at = pending.pop()
        if at not in left_out:
            left_out.add(at)
            kind, name = kind_of(parts[at][1]), parts[at][1].attrs.get("name", "")
            names.get(kind, set()).discard(name)
            pending += users.get((kind, name), ())
    torn = [_torn(parts[at][1], needs[at], names) for at in sorted(left_out)]
    names["body"].discard("world")
    kept = [part for at, part in enumerate(parts) if at not in left_out]
    return names, sorted(kept, key=lambda part: SECTIONS.index(part[0])), [*filter(None, torn)]


def _missing(needs: list[tuple[str, str]], names: Names) -> list[tuple[str, str]]:
    return [(kind, name) for kind, name in needs if name not in names.get(kind, ())]


def _torn(node: Node, needs: list[tuple[str, str]], names: Names) -> str:
    """Describe an element that refers to attached elements but is left out; "" for others."""
    missing = _missing(needs, names)
    if not {*needs} - {*missing, ("body", "world")}:
        return ""
    kind, name = missing[0]
    called = f' "{node.attrs["name"]}"' if node.attrs.get("name") else ""
    return f'<{node.tag}>{called}, whose {kind} "{name}" is not attached'


def _merge_options(root: Node, child: Node, node: Node, policy: str) -> list[str]:
    """Merge the options of `child` into those of `root` by `policy`; return notes.

    node: the <attach>. Raises MJCFError for a conflict that the policy does not allow.
    """
    mine, theirs = options(root), options(child)
    my_flags, their_flags = (
        {name: word for flag in inside(model, "option") for name, word in flag.values.items()}
        for model in (root, child)
    )
    both = ((mine, theirs), (my_flags, their_flags))
    named = f'"{child.attrs.get("model", "") or node.attrs.get("model", "")}"'

    def check(name: str, here: Any, there: Any) -> Any:
        if here != there:
            text = f"the model {named} has {name} = {there}, this one {here}, a conflict"
            raise node.error(f"<attach>: {text}")
        return here

    def note(names: list[str], what: str) -> list[str]:
        where = f"{node.file}:{node.line}: <attach> of the model {named}"
        verb = "is" if len(names) == 1 else "are"
        return [f"{where}: its {', '.join(names)} {verb} {what} (conflict)"] if names else []

    if policy == "error":
        for here, there in both:
            for name in there:
                check(name, here.get(name, there[name]), there[name])
        return []
    if policy == "warning":
        names = [name for here, there in both for name in there if here.get(name) != there[name]]
        return note(names, "not used")
    # An option section at the end overrides earlier sections.
    section = Node("option", {}, node.file, node.line)
    for name, there in theirs.items():
        here = mine.get(name, there)
        merge = MERGED.get(name)
        section.values[name] = merge(here, there) if merge else check(name, here, there)
    # A flag differs from its default if either model changes it.
    turned = {
        name: word
        for name, word in their_flags.items()
        if word == ("enable" if name in FLAGS_OFF else "disable")
    }
    if turned:
        section.children = [Node("flag", {}, node.file, node.line)]
        section.children[0].values = dict(turned)
    root.children.append(section)
    changed = [name for name, value in section.values.items() if value != mine.get(name)]
    return note([*changed, *turned], "used")


def _split_keys(root: Node, defaults: Defaults) -> list[Node]:
    """Return the keyframes of a model, with each vector split by element in `parts`."""
    keys = inside(root, "keyframe")
    if not keys:
        return []
    joints, mocaps = _joints_and_mocaps(root, defaults)
    laws = [(node, defaults.gains(node)) for node in inside(root, "actuator")]
    layout = {
        "qpos": [(node, QPOS[kind]) for kind, node in joints],
        "qvel": [(node, DOFS[kind]) for kind, node in joints],
        "ctrl": [(node, len(gains.inputs) or 1) for node, gains in laws],
        "act": [(node, gains.law.states) for node, gains in laws],
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


def _copied_key(key: Node, made: dict[int, Node]) -> Node:
    """Copy a keyframe for copied elements. made: the copies by the ``id`` of the original."""
    copy = copied(key)
    copy.parts = {
        name: [(made[id(node)], numbers) for node, numbers in parts if id(node) in made]
        for name, parts in (key.parts or {}).items()
    }
    return copy


def _joints_and_mocaps(root: Node, defaults: Defaults) -> tuple[list[Part], list[Node]]:
    """Return the joints as (type, node), and the mocap bodies, both in model order.

    The content of a frame belongs to the body around the frame.
    """
    joints: list[Part] = []
    mocaps: list[Node] = []
    pending: list[tuple[Node, str | None]] = [(n, None) for n in sections(root, "worldbody")[::-1]]
    while pending:
        body, childclass = pending.pop()
        if body.values.get("mocap"):
            mocaps.append(body)
        bodies: list[tuple[Node, str | None]] = []
        waiting = [(body, childclass)]
        while waiting:
            node, inherited = waiting.pop()
            if node is body or node.tag == "frame":
                inner = node.attrs.get("childclass", inherited)
                waiting += [(child, inner) for child in reversed(node.children)]
            elif node.tag == "body":
                bodies.append((node, inherited))
            elif node.tag == "freejoint":
                joints.append(("free", node))
            elif node.tag == "joint":
                joints.append((defaults.of(node, inherited).get("type", "hinge"), node))
        pending += reversed(bodies)
    return joints, mocaps
