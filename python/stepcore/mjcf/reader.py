"""The MJCF reader: fills an empty `Scene` from a file or a text.

The reader is strict. An element, attribute, keyword or reference that does not exist is an error
with file, line and the nearest name. A feature that would change the motion and is not built yet
is refused by name. `Scene.ignored` lists elements that only draw or sense, and `Scene.notes` what
was translated.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from stepcore.checks import ElementError
from stepcore.mjcf import actuators, contacts, custom, equalities, keyframes, option
from stepcore.mjcf.assets import Assets
from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.include import expand, read_bytes
from stepcore.mjcf.nodes import MJCFError, Node, Source, parse
from stepcore.mjcf.references import check_references
from stepcore.mjcf.validation import validate
from stepcore.mjcf.visual_geoms import leave_out_visual_geoms
from stepcore.mjcf.worldbody import WorldReader
from stepcore.scene.consistency import check
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

# The sections that are read one element after the other once the tree is there, in an order in
# which names exist before something refers to them.
SECTIONS: dict[str, Callable[[WorldReader, Node], None]] = {
    "contact": contacts.read,
    "equality": equalities.read,
    "actuator": actuators.read,
}


def read_file(scene: Contents, path: str | os.PathLike[str]) -> None:
    """Fills an empty scene from an MJCF file; see `stepcore.load`."""
    shown = os.fsdecode(path)
    main = Path(shown)
    data = read_bytes(shown)
    root = parse(data, shown)
    scene.notes += expand(root, main.parent, main)
    _fill(scene, root, Source(data, os.path.abspath(main.parent)))


def read_text(
    scene: Contents,
    text: str | bytes,
    *,
    base: str | os.PathLike[str] | None = None,
    name: str = "<string>",
) -> None:
    """Fills an empty scene from an MJCF text; see `stepcore.loads`."""
    if not isinstance(text, (str, bytes)):
        raise MJCFError(name, 1, "an MJCF text must be a str or bytes")
    root = parse(text, name)
    scene.notes += expand(root, None if base is None else Path(base), None)
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    _fill(scene, root, Source(data, None if base is None else os.path.abspath(base)))


def _fill(scene: Contents, root: Node, source: Source) -> None:
    """Fills the scene from a whole model whose includes are expanded."""
    scene.name = root.attrs.get("model", "")
    scene._source = source.of(root)
    scene.ignored += validate(root)
    compiler = Compiler(_sections(root, "compiler"))
    defaults = Defaults(_sections(root, "default"))
    assets = Assets(_sections(root, "asset"), compiler, defaults, source.directory)
    world = WorldReader(scene, compiler, defaults, assets)
    world.paired = {
        pair.attrs.get(end, "")
        for pair in _inside(root, "contact")
        for end in ("geom1", "geom2")
        if pair.tag == "pair"
    }
    try:
        scene.mass_rules = compiler.mass_rules()
        for node in _sections(root, "option"):
            _at(node, lambda node: option.read(scene, node))
        for node in _sections(root, "worldbody"):
            world.read(node)
        for section, read in SECTIONS.items():
            for node in _inside(root, section):
                _at(node, lambda node, read=read: read(world, node))  # type: ignore[misc]
        layout = Layout(scene)
        for node in _inside(root, "keyframe"):
            _at(node, lambda node: keyframes.read(world, layout, node))
        keyframes.add_empty_keys(scene, _sections(root, "size"))
        check_references(world, root)
        leave_out_visual_geoms(world, layout)
        assets.read_used(scene)
        layout = Layout(scene)
        for node in custom.own_texts(_inside(root, "custom")):
            _at(node, lambda node: custom.read(scene, node))
        check(layout)
    except ElementError as error:
        # The check of the whole scene names an element, whose line is known.
        node = world.nodes.get(id(error.owner), root)
        raise node.error(str(error)) from None
    scene.ignored.sort(key=_place)


def _place(line: str) -> tuple[str, int]:
    file, number, _ = line.rsplit(" <", 1)[0].rsplit(":", 2)
    return file, int(number)


def _sections(root: Node, tag: str) -> list[Node]:
    return [node for node in root.children if node.tag == tag]


def _inside(root: Node, tag: str) -> list[Node]:
    return [node for section in _sections(root, tag) for node in section.children]


def _at(node: Node, read: Callable[[Node], None]) -> None:
    """Calls `read` on a node; an error gets the node's file and line."""
    try:
        read(node)
    except MJCFError:
        raise
    except ValueError as error:
        raise node.error(str(error)) from None
