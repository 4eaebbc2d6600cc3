"""Writes a `Scene` as MJCF, with exact numbers and without defaults: a file for each section."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf import custom
from stepcore.mjcf.write import (
    actuators,
    assets,
    contacts,
    equalities,
    keyframes,
    sensors,
    tendons,
)
from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.option import add_compiler, add_option
from stepcore.mjcf.write.tags import Tag, printed
from stepcore.mjcf.write.tree import add_tree
from stepcore.scene.consistency import check
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

# The sections after the tree, in the order in which they are written. Those that refer to
# elements by name say in `referred` to which, so that all of these have names.
SECTIONS = {
    "contact": contacts,
    "tendon": tendons,
    "equality": equalities,
    "actuator": actuators,
    "sensor": sensors,
    "keyframe": keyframes,
}


def written(scene: Contents) -> str:
    """The scene as an MJCF text; see `Scene.to_mjcf`."""
    layout = Layout(scene)
    check(layout)
    world = scene.world
    if world.name != "world" or world.mass is not None:
        raise ValueError(f"{world}: the world of an MJCF file is called world and has no mass")
    sections = [section for section in SECTIONS.values() if hasattr(section, "referred")]
    names = Names(layout, [element for section in sections for element in section.referred(scene)])
    root = Tag("mujoco", **({"model": scene.name} if scene.name else {}))
    add_compiler(root, scene)
    words = add_option(root, scene)
    _add_section(root, "asset", assets.tags(scene, names))
    add_tree(root, layout, names)
    for name, section in SECTIONS.items():
        _add_section(root, name, section.tags(scene, names))
    data = custom.data(words, names.made)
    if data:
        root.add(Tag("custom")).add(Tag("text", name=custom.NAME, data=data))
    return printed(root, _left_out(scene))


def _add_section(root: Tag, name: str, tags: list[Tag]) -> None:
    if tags:
        root.add(Tag(name)).inside = tags


def _left_out(scene: Contents) -> str:
    """The comment about elements of the scene's file that this text leaves out."""
    count = len(scene.ignored)
    if not count:
        return ""
    what = "1 element" if count == 1 else f"{count} elements"
    return f"<!-- Left out: {what} of the scene's file that cannot change the motion. -->\n"
