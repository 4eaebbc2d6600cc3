"""What only draws: a file's visual geoms and its colours, read when a scene is looked at.

Nothing here reaches the physics: the text of a scene is read a second time, with the geoms that
the reader leaves out (`Scene.ignored`) and with the files of their meshes. MuJoCo documentation,
XML reference, asset/material, asset/texture and geom/rgba.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stepcore.mjcf.assets import Assets
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.include import expand
from stepcore.mjcf.left_out import LeftOut
from stepcore.mjcf.models import Models, sections
from stepcore.mjcf.nodes import Node, parse
from stepcore.mjcf.reader import finish, read_sections
from stepcore.mjcf.refusals import Refusals
from stepcore.scene.contents import Contents
from stepcore.scene.elements import Geom, Mesh
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout

# MuJoCo's colour of a geom that has none.
GREY = (0.5, 0.5, 0.5, 1.0)
WHITE = (1.0, 1.0, 1.0, 1.0)


@dataclass
class Looks:
    """What a file says of how its scene looks.

    colours: rgba of each geom of the scene, in the order of the compiled model.
    geoms: those that only draw, with the index of their body and their rgba.
    notes: what could not be read, one line each.
    """

    colours: list[Vec] = field(default_factory=list)
    geoms: list[tuple[int, Geom, Vec]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class _DrawnAssets(Assets):
    """Keeps what only draws, and goes on without the files that cannot be read."""

    drawn = True

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.unread: dict[int, str] = {}

    def _fill(self, scene: Contents, node: Node, asset: Any) -> None:
        try:
            super()._fill(scene, node, asset)
        except (ValueError, OSError) as error:
            self.unread[id(asset)] = str(error)
            # It stays empty, so that the geoms that refer to it can be told apart.
            held: list[Any] = scene.meshes if isinstance(asset, Mesh) else scene.hfields
            held.append(asset)


def read_looks(scene: Contents) -> Looks | None:
    """The looks of a scene by the file or text that it was read from.

    None where it was built by hand, or changed since so that geoms and bodies are others.
    """
    source = scene._source
    if source is None or not source.data:
        return None
    root = parse(source.data, source.files[0])
    home = None if source.directory is None else Path(source.directory)
    expand(root, home, Path(source.files[0]) if home is not None else None)
    drawn, refusals = Contents(), Refusals()
    models = Models(drawn, refusals, LeftOut(scene.without))
    model = models.prepared(root, source.directory)
    world = read_sections(drawn, model, refusals, _DrawnAssets)
    refusals.raise_all()
    finish(world, root)
    layout, own = Layout(drawn), Layout(scene)
    seen = [geom for geom in layout.geoms if id(geom) not in world.only_drawn]
    names = [body.name for body in layout.bodies], [geom.name for geom in seen]
    if names != ([body.name for body in own.bodies], [geom.name for geom in own.geoms]):
        return None
    plain = _Colours(root, model.defaults)
    colours = {id(shape.geom): plain.of(shape.values) for shape in world.shapes}
    assert isinstance(world.assets, _DrawnAssets)
    looks = Looks([colours[id(geom)] for geom in seen])
    looks.notes += sorted(set(world.assets.unread.values()))
    for geom in layout.geoms:
        asset = geom.mesh if geom.mesh is not None else geom.hfield
        if id(geom) in world.only_drawn and id(asset) not in world.assets.unread:
            looks.geoms.append((layout.index[id(geom.body)], geom, colours[id(geom)]))
    return looks


class _Colours:
    """The plain colours of materials by name: their rgba times that of their texture."""

    def __init__(self, root: Node, defaults: Defaults) -> None:
        nodes = [node for section in sections(root, "asset") for node in section.children]
        textures = {n.attrs["name"]: _of_texture(n) for n in nodes if _named_texture(n)}
        self.materials: dict[str, Vec] = {}
        for node in nodes:
            if node.tag == "material":
                values = defaults.of(node, kind="material") | node.attrs
                rgba = _numbers(values.get("rgba", ()), WHITE)
                tint = textures.get(str(values.get("texture", "")), WHITE)
                mixed = tuple(a * b for a, b in zip(rgba, tint, strict=True))
                self.materials[node.attrs.get("name", "")] = mixed

    def of(self, values: dict[str, Any]) -> Vec:
        """The rgba of a geom with these attributes; its own colour goes before its material's."""
        own = _numbers(values.get("rgba", ()), GREY)
        if own == GREY and values.get("material") in self.materials:
            return self.materials[values["material"]]
        return own


def _named_texture(node: Node) -> bool:
    return node.tag == "texture" and "name" in node.attrs


def _of_texture(node: Node) -> Vec:
    """The mean colour of a texture that MJCF describes; light grey for an image in a file."""
    if node.attrs.get("builtin", "none") == "none":
        return 0.8, 0.8, 0.8, 1.0
    first = _numbers(node.attrs.get("rgb1", ()), (0.8, 0.8, 0.8))
    second = _numbers(node.attrs.get("rgb2", ()), (0.5, 0.5, 0.5))
    if node.attrs["builtin"] == "flat":
        second = first
    return (*((a + b) / 2 for a, b in zip(first, second, strict=True)), 1.0)


def _numbers(value: Any, default: Vec) -> Vec:
    """The entries of an attribute, completed with its defaults."""
    words = value.split() if isinstance(value, str) else value
    given = tuple(float(word) for word in words)
    return (*given, *default[len(given) :])[: len(default)]
