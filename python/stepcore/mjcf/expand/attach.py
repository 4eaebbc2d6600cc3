"""`<attach>`: bodies of another model, or of this one, with all that belongs to them.

MuJoCo documentation, XML reference, body/attach and asset/model. As there, an element outside of
the tree comes along if all that it refers to does; every asset, default class and keyframe of the
other model comes along; names get the prefix; the other model's elements keep its own compiler
settings and default classes; and its options follow the compiler's attribute "conflict".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from stepcore.checks import nearest
from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.defaults import MAIN, Defaults
from stepcore.mjcf.expand.conflict import merge
from stepcore.mjcf.expand.keys import key_parts, twin_of
from stepcore.mjcf.expand.naming import Names, kind_of, names_in, references, rename
from stepcore.mjcf.expand.replicate import SECTIONS
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below
from stepcore.mjcf.schema import ROOT


@dataclass
class Model:
    """A model whose own <attach> and <replicate> elements are replaced."""

    root: Node
    compiler: Compiler
    defaults: Defaults


# The model that an <asset><model> names.
Load = Callable[[Node], Model]


class Attacher:
    """Replaces the <attach> elements of a model. notes: on options of attached models."""

    def __init__(self, model: Model, load: Load) -> None:
        self.model = model
        self.load = load
        self.notes: list[str] = []
        self.assets: dict[str, Node] = {}
        self.loaded: dict[int, Model] = {}
        for section in model.root.children:
            if section.tag == "asset":
                for node in [child for child in section.children if child.tag == "model"]:
                    name = node.attrs.get("name") or self._load(node).root.attrs.get("model", "")
                    if name in self.assets:
                        raise node.error(f'model "{name}": the name is used twice')
                    self.assets[name] = node

    def _load(self, node: Node) -> Model:
        if id(node) not in self.loaded:
            self.loaded[id(node)] = self.load(node)
        return self.loaded[id(node)]

    def run(self) -> None:
        """Replaces every <attach>, in the order of the file."""
        # What is attached from this model itself is the tree as it is written.
        worlds = [section for section in self.model.root.children if section.tag == "worldbody"]
        found = [pair for section in worlds for pair in _attachments(section)]
        for parent, node in found:
            at = next(i for i, child in enumerate(parent.children) if child is node)
            parent.children[at : at + 1] = self._attached(node)

    def _attached(self, node: Node) -> list[Node]:
        """What takes the place of an <attach>."""
        other = self._other(node)
        own = other is self.model
        policy = self.model.compiler.values.get("conflict", "warning")
        if not own:
            if other.compiler.mass_rules().fitaabb != self.model.compiler.mass_rules().fitaabb:
                raise node.unbuilt("an attached model with another fitaabb than this one")
            self.notes += merge(self.model.root, other.root, node, policy)
        twin = twin_of(other.root)
        tree, childclass = _part(node, twin, own)
        prefix = node.values["prefix"]
        if not own:
            self._mark(twin, other)
            _name_assets(twin)
        # Of keyframes the vectors are taken apart while the whole model is there.
        keys = [] if own else key_parts(twin, other.defaults)
        if not own:
            classes = self.model.defaults.adopt(other.defaults, prefix)
            _rename_classes(twin, classes)
            childclass = classes.get(childclass, childclass)
        where = f"{node.file}:{node.line}: <attach>"
        torn = self._add_sections(twin, tree, prefix, keys, own)
        self.notes += [f"{where} leaves out {what}" for what in torn]
        frame = Node("frame", {}, node.file, node.line)
        frame.path, frame.compiler, frame.children = "worldbody/frame", node.compiler, tree
        frame.values = {"childclass": childclass}
        frame.attrs = dict(frame.values)
        return [frame]

    def _other(self, node: Node) -> Model:
        if "body" in node.attrs and "frame" in node.attrs:
            raise node.error("<attach> has both body and frame")
        name = node.attrs.get("model")
        if name is None:
            if "body" not in node.attrs and "frame" not in node.attrs:
                raise node.error("<attach> without a model needs body or frame")
            return self.model
        asset = self.assets.get(name)
        if asset is None:
            near = nearest(name, sorted(self.assets))
            raise node.error(f'<attach model="{name}">: no such model{near}')
        return self._load(asset)

    def _mark(self, twin: Node, other: Model) -> None:
        """Elements of the other model are read with its own compiler settings."""
        for one in below(twin):
            if one.compiler is None:
                one.compiler = other.compiler

    def _add_sections(
        self, twin: Node, tree: list[Node], prefix: str, keys: list[Node], own: bool
    ) -> list[str]:
        """Adds what belongs to the attached tree to the sections of this model, renamed.

        Returns what belongs to it in part, and is left out for what it names beside.
        """
        names = names_in(tree)
        names.setdefault("body", set()).add("world")
        assets = [] if own else [n for s in twin.children if s.tag == "asset" for n in s.children]
        assets = [node for node in assets if node.tag != "model"]
        for kind, more in names_in(assets).items():
            names.setdefault(kind, set()).update(more)
        chosen = _resolved(twin, names, own)
        torn = list(_torn(twin, names, [node for _, nodes in chosen for node in nodes]))
        names["body"].discard("world")
        parts = {"asset": assets, "keyframe": keys}
        for tag, nodes in [*chosen, *parts.items()]:
            for one in nodes:
                rename(one, names, lambda name: prefix + name)
                if tag == "keyframe":
                    one.attrs["name"] = one.values["name"] = prefix + twin_name(one, prefix)
            if nodes:
                part = Node(tag, {}, nodes[0].file, nodes[0].line)
                part.path, part.children = tag, nodes
                self.model.root.children.append(part)
        for one in tree:
            rename(one, names, lambda name: prefix + name)
        return torn


def _attachments(section: Node) -> list[tuple[Node, Node]]:
    """The <attach> elements below a node, in the order of the file, each after its parent."""
    found = []
    pending = [(section, child) for child in reversed(section.children)]
    while pending:
        parent, node = pending.pop()
        if node.tag == "attach":
            found.append((parent, node))
        pending += [(node, child) for child in reversed(node.children)]
    return found


def twin_name(node: Node, prefix: str) -> str:
    """The name of a keyframe, which has a prefix even where it has no name."""
    return node.attrs.get("name", prefix).removeprefix(prefix)


def _rename_classes(twin: Node, classes: dict[str, str]) -> None:
    """Gives references to the other model's classes the names that these have in this model.

    An element outside of the tree that has no class is of the outermost.
    """
    for section in twin.children:
        for node in section.children if section.tag in (*SECTIONS, "asset") else ():
            if "class" in ROOT.children[section.tag].children[node.tag].attrs:
                node.attrs.setdefault("class", MAIN)
    for node in below(twin):
        for attribute in ("class", "childclass"):
            name = node.attrs.get(attribute)
            if name in classes:
                node.attrs[attribute] = node.values[attribute] = classes[name]


def _name_assets(twin: Node) -> None:
    """Assets of the other model get the names that their files give them."""
    for section in twin.children:
        for node in section.children if section.tag == "asset" else ():
            file = node.attrs.get("file", "").replace("\\", "/").rpartition("/")[2]
            if "name" not in node.attrs and file:
                node.attrs["name"] = node.values["name"] = file.rpartition(".")[0] or file


def _part(node: Node, twin: Node, own: bool) -> tuple[list[Node], str]:
    """The nodes that are attached, and the childclass under which they stand."""
    trees = [section for section in twin.children if section.tag == "worldbody"]
    kind = next((word for word in ("body", "frame") if word in node.attrs), "")
    if not kind:
        return [child for tree in trees for child in tree.children], MAIN
    pending = [(child, MAIN) for tree in reversed(trees) for child in reversed(tree.children)]
    while pending:
        one, childclass = pending.pop()
        if one.tag == kind and one.attrs.get("name") == node.attrs[kind]:
            if own and any(inner.tag == "attach" for inner in below(one)):
                raise node.error(f'<attach {kind}="{node.attrs[kind]}"> holds an <attach> itself')
            return [one], childclass
        inner = one.attrs.get("childclass", childclass)
        pending += [(child, inner) for child in reversed(one.children)]
    known = [
        o.attrs["name"] for t in trees for o in below(t) if o.tag == kind and "name" in o.attrs
    ]
    near = nearest(node.attrs[kind], known)
    raise node.error(f'<attach {kind}="{node.attrs[kind]}">: no such {kind}{near}')


def _resolved(twin: Node, names: Names, own: bool) -> list[tuple[str, list[Node]]]:
    """The elements of each section all of whose references are to `names`, which grow by them."""
    left = {
        tag: [node for section in twin.children if section.tag == tag for node in section.children]
        for tag in SECTIONS
    }
    if own:
        # Of this model only what refers to the tree comes along.
        left = {
            t: [n for n in nodes if any(True for o in below(n) for _ in references(o))]
            for t, nodes in left.items()
        }
    for nodes in left.values():
        for node in nodes:
            if node.attrs.get("name"):
                names.setdefault(kind_of(node), set()).add(node.attrs["name"])
    changed = True
    while changed:
        changed = False
        for tag, nodes in left.items():
            kept = [node for node in nodes if _holds(node, names)]
            for node in nodes:
                if node not in kept:
                    names.get(kind_of(node), set()).discard(node.attrs.get("name", ""))
            changed |= len(kept) < len(nodes)
            left[tag] = kept
    return list(left.items())


def _torn(twin: Node, names: Names, kept: list[Node]) -> Iterator[str]:
    """What names something that is attached and something that is not."""
    known = {id(node) for node in kept}
    for section in twin.children:
        for node in section.children if section.tag in SECTIONS else ():
            if id(node) in known:
                continue
            named = list(_named(node))
            missing = [(kind, name) for kind, name in named if name not in names.get(kind, ())]
            if any(one not in missing and one != ("body", "world") for one in named):
                kind, name = missing[0]
                own = f' "{node.attrs["name"]}"' if node.attrs.get("name") else ""
                yield f'<{node.tag}>{own}, whose {kind} "{name}" is not attached'


def _holds(node: Node, names: Names) -> bool:
    return all(name in names.get(kind, ()) for kind, name in _named(node))


def _named(node: Node) -> Iterator[tuple[str, str]]:
    """What an element refers to, by kind and name."""
    for one in below(node):
        for _, kind, name in references(one):
            if kind not in ("default", "material"):
                yield kind, name
