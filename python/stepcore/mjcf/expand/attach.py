"""`<attach>`: bodies of another model, or of this one, with all that belongs to them.

MuJoCo documentation, XML reference, body/attach and asset/model. As there, an element outside of
the tree comes along if all that it refers to does; every asset, default class and keyframe of the
other model comes along; names get the prefix; the other model's elements keep its own compiler
settings and default classes; and its options follow the compiler's attribute "conflict".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from stepcore.checks import nearest
from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.defaults import MAIN, Defaults
from stepcore.mjcf.expand.conflict import merge
from stepcore.mjcf.expand.copies import Copies
from stepcore.mjcf.expand.keys import copied_key, key_parts
from stepcore.mjcf.expand.naming import Names, copied, kind_of, names_in, rename
from stepcore.mjcf.expand.referring import SECTIONS, Referring, named_by, section_of
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below
from stepcore.mjcf.schema import ROOT

# Bodies and frames by tag and name, each with the childclass around it.
Parts = dict[tuple[str, str], tuple[Node, str]]


@dataclass
class Model:
    """A model whose own <attach> and <replicate> elements are replaced."""

    root: Node
    compiler: Compiler
    defaults: Defaults

    @cached_property
    def parts(self) -> Parts:
        """Its bodies and frames."""
        return _by_name({}, _tree(self.root), MAIN)

    @cached_property
    def assets(self) -> list[Node]:
        """Its assets, each with a name."""
        return _named_assets(self.root)

    @cached_property
    def keys(self) -> list[Node]:
        """Its keyframes, whose vectors are taken apart while the whole model is there."""
        return key_parts(self.root, self.defaults)

    @cached_property
    def referring(self) -> Referring:
        """What refers to its tree, as it is when first asked."""
        return Referring(self.root)


# The model that an <asset><model> names.
Load = Callable[[Node], Model]


class Attacher:
    """Replaces the <attach> elements of a model. notes: on options of attached models."""

    def __init__(self, model: Model, load: Load, copies: Copies) -> None:
        self.model = model
        self.load = load
        self.copies = copies
        self.notes: list[str] = []
        self.assets: dict[str, Node] = {}
        # What refers to this model's own tree, as far as it is there by now.
        self.own: Referring | None = None
        # Its bodies and frames, likewise.
        self.parts: Parts = {}
        # By tag, what comes along with what is attached.
        self.sections: dict[str, Node] = {}
        for section in model.root.children:
            if section.tag == "asset":
                for node in [child for child in section.children if child.tag == "model"]:
                    name = node.attrs.get("name") or self.load(node).root.attrs.get("model", "")
                    if name in self.assets:
                        raise node.error(f'model "{name}": the name is used twice')
                    self.assets[name] = node

    def run(self) -> None:
        """Replaces every <attach>, in the order of the file."""
        worlds = [section for section in self.model.root.children if section.tag == "worldbody"]
        found = [node for section in worlds for node in _attachments(section)]
        if any("model" not in node.attrs for node in found):
            self.own = Referring(self.model.root)
            self.parts = _by_name({}, _tree(self.model.root), MAIN)
        for node in found:
            self._attach(node)

    def _attach(self, node: Node) -> None:
        """Makes an <attach> the frame that holds what it attaches."""
        other = self._other(node)
        own = other is self.model
        policy = self.model.compiler.values.get("conflict", "warning")
        prefix = node.values["prefix"]
        if not own:
            if other.compiler.mass_rules().fitaabb != self.model.compiler.mass_rules().fitaabb:
                raise node.unbuilt("an attached model with another fitaabb than this one")
            self.notes += merge(self.model.root, other.root, node, policy)
        tree, childclass = _part(node, other.root, self.parts if own else other.parts, own)
        assets, keys = ([], []) if own else (other.assets, other.keys)
        referring = self.own if own and self.own is not None else other.referring
        names, sections, torn = _resolved(referring, [*tree, *assets], own)
        classes = 0 if own else len(other.defaults.classes)
        everything = [*tree, *assets, *keys, *(one for _, one in sections)]
        self.copies.take(node, everything, 1, 1 + classes)
        self.notes += [f"{node.file}:{node.line}: <attach> leaves out {what}" for what in torn]

        made: dict[int, Node] = {}
        twins = [copied(one, made) for one in tree]
        parts = [(tag, copied(one, made)) for tag, one in sections]
        parts += [("asset", copied(one, made)) for one in assets]
        parts += [("keyframe", copied_key(key, made)) for key in keys]
        if not own:
            here = self.model.defaults.adopt(other.defaults, prefix)
            _rename_classes(parts, made, here)
            childclass = here.get(childclass, childclass)
            # Its elements are read with its own compiler settings.
            for one in made.values():
                one.compiler = one.compiler or other.compiler
        self._add(parts, names, prefix)
        for one in twins:
            rename(one, names, lambda name: prefix + name)
        node.tag, node.path, node.children = "frame", "worldbody/frame", twins
        node.attrs = {"childclass": childclass}
        node.values = dict(node.attrs)
        if self.own is not None:
            _by_name(self.parts, twins, node.attrs["childclass"])

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
        return self.load(asset)

    def _add(self, parts: list[tuple[str, Node]], names: Names, prefix: str) -> None:
        """Adds what comes along to the sections of this model, renamed."""
        for tag, one in parts:
            rename(one, names, lambda name: prefix + name)
            if tag == "keyframe":
                one.attrs["name"] = one.values["name"] = prefix + twin_name(one, prefix)
            if tag in self.sections:
                self.sections[tag].children.append(one)
            else:
                self.sections[tag] = section_of(tag, [one])
                self.model.root.children.append(self.sections[tag])
        if self.own is not None:
            self.own.append([part for part in parts if part[0] in SECTIONS])


def _attachments(section: Node) -> list[Node]:
    """The <attach> elements below a node, in the order of the file."""
    found = []
    pending = [section]
    while pending:
        node = pending.pop()
        if node.tag == "attach":
            found.append(node)
        pending += reversed(node.children)
    return found


def twin_name(node: Node, prefix: str) -> str:
    """The name of a keyframe, which has a prefix even where it has no name."""
    return node.attrs.get("name", prefix).removeprefix(prefix)


def _rename_classes(
    parts: list[tuple[str, Node]], made: dict[int, Node], here: dict[str, str]
) -> None:
    """Gives references to the other model's classes the names that these have in this model.

    parts: what stands outside of the tree; what has no class there is of the outermost. made: all
    copies.
    """
    for tag, one in parts:
        if tag in (*SECTIONS, "asset") and "class" in ROOT.children[tag].children[one.tag].attrs:
            one.attrs.setdefault("class", MAIN)
    for one in made.values():
        for attribute in ("class", "childclass"):
            name = one.attrs.get(attribute)
            if name in here:
                one.attrs[attribute] = one.values[attribute] = here[name]


def _named_assets(root: Node) -> list[Node]:
    """The assets of a model, under the names that their files give those without one."""
    assets = [node for s in root.children if s.tag == "asset" for node in s.children]
    assets = [node for node in assets if node.tag != "model"]
    for node in assets:
        file = node.attrs.get("file", "").replace("\\", "/").rpartition("/")[2]
        if "name" not in node.attrs and file:
            node.attrs["name"] = node.values["name"] = file.rpartition(".")[0] or file
    return assets


def _tree(root: Node) -> list[Node]:
    """What stands in the world."""
    sections = [section for section in root.children if section.tag == "worldbody"]
    return [node for section in sections for node in section.children]


def _by_name(parts: Parts, nodes: list[Node], childclass: str) -> Parts:
    """Adds the bodies and frames among these nodes and in them, with the childclass of each."""
    pending = [(one, childclass) for one in reversed(nodes)]
    while pending:
        one, around = pending.pop()
        if one.tag in ("body", "frame") and one.attrs.get("name"):
            parts.setdefault((one.tag, one.attrs["name"]), (one, around))
        inner = one.attrs.get("childclass", around)
        pending += [(child, inner) for child in reversed(one.children)]
    return parts


def _part(node: Node, root: Node, parts: Parts, own: bool) -> tuple[list[Node], str]:
    """The nodes that are attached, and the childclass under which they stand."""
    kind = next((word for word in ("body", "frame") if word in node.attrs), "")
    if not kind:
        return _tree(root), MAIN
    name = node.attrs[kind]
    if (kind, name) not in parts:
        near = nearest(name, [known for tag, known in parts if tag == kind])
        raise node.error(f'<attach {kind}="{name}">: no such {kind}{near}')
    one, childclass = parts[kind, name]
    if own and any(inner.tag == "attach" for inner in below(one)):
        raise node.error(f'<attach {kind}="{name}"> holds an <attach> itself')
    return [one], childclass


def _resolved(
    referring: Referring, attached: list[Node], own: bool
) -> tuple[Names, list[tuple[str, Node]], list[str]]:
    """What comes along with what is attached, because it refers to nothing else.

    Returns the names of all that is attached, section and element of what comes along, and words
    about what refers to something that is attached and to something that is not.
    """
    names = names_in(attached)
    names.setdefault("body", set()).add("world")
    # Of this model only what refers to the tree comes along.
    found = referring.to(names, free=not own)
    needs = [list(named_by(node)) for _, node in found]
    users: dict[tuple[str, str], list[int]] = {}
    for at, (_, node) in enumerate(found):
        if node.attrs.get("name"):
            names.setdefault(kind_of(node), set()).add(node.attrs["name"])
        for need in needs[at]:
            users.setdefault(need, []).append(at)
    left_out: set[int] = set()
    pending = [at for at, need in enumerate(needs) if _missing(need, names)]
    while pending:
        at = pending.pop()
        if at not in left_out:
            left_out.add(at)
            kind, name = kind_of(found[at][1]), found[at][1].attrs.get("name", "")
            names.get(kind, set()).discard(name)
            pending += users.get((kind, name), ())
    torn = [_torn(found[at][1], needs[at], names) for at in sorted(left_out)]
    names["body"].discard("world")
    kept = [part for at, part in enumerate(found) if at not in left_out]
    return names, sorted(kept, key=lambda part: SECTIONS.index(part[0])), [*filter(None, torn)]


def _missing(needs: list[tuple[str, str]], names: Names) -> list[tuple[str, str]]:
    return [(kind, name) for kind, name in needs if name not in names.get(kind, ())]


def _torn(node: Node, needs: list[tuple[str, str]], names: Names) -> str:
    """What is left out of an element that refers to something attached; "" if to nothing."""
    missing = _missing(needs, names)
    if not {*needs} - {*missing, ("body", "world")}:
        return ""
    kind, name = missing[0]
    own = f' "{node.attrs["name"]}"' if node.attrs.get("name") else ""
    return f'<{node.tag}>{own}, whose {kind} "{name}" is not attached'
