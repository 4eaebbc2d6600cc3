"""What only draws: a file's visual geoms and its colours, read when a scene is looked at.

Nothing here reaches the physics: the text of a scene is read a second time, with the geoms that
the reader leaves out (`Scene.ignored`) and with the files of their meshes. MuJoCo documentation,
XML reference, asset/material, asset/texture, geom/rgba, body/light and visual/headlight.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stepcore.mjcf.assets import Assets
from stepcore.mjcf.include import expand
from stepcore.mjcf.left_out import LeftOut
from stepcore.mjcf.lights import Headlight, Light, headlight_of, lights_of
from stepcore.mjcf.materials import Colours, Look
from stepcore.mjcf.models import Models
from stepcore.mjcf.nodes import Node, parse
from stepcore.mjcf.reader import finish, read_sections
from stepcore.mjcf.refusals import Refusals
from stepcore.scene.contents import Contents
from stepcore.scene.elements import Geom, Mesh
from stepcore.scene.layout import Layout
from stepcore.urdf.translate import DrawnLink, to_mjcf


@dataclass
class Looks:
    """What a file says of how its scene looks.

    colours: of each geom of the scene, in the order of the compiled model.
    geoms: those that only draw, with the index of their body and their colours.
    covered: the geoms of the scene that are not to be seen, since they collide on a link of a URDF
        that has some that only draw.
    lights: those of the file. headlight: the one at the camera.
    notes: what could not be read, one line each.
    """

    colours: list[Look] = field(default_factory=list)
    geoms: list[tuple[int, Geom, Look]] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    headlight: Headlight = field(default_factory=Headlight)
    notes: list[str] = field(default_factory=list)
    covered: list[int] = field(default_factory=list)


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

    def place_of_texture(self, node: Node) -> str | None:
        """The path of the image of a texture; None in a text without a folder."""
        return self._place(node, node.attrs["file"], "texturedir")


def read_looks(scene: Contents) -> Looks | None:
    """The looks of a scene by the file or text that it was read from.

    None where it was built by hand, or changed since so that geoms and bodies are others.
    """
    source = scene._source
    if source is None or not (source.data or source.urdf):
        return None
    root = parse(source.data or source.urdf, source.files[0])
    home = None if source.directory is None else Path(source.directory)
    expand(root, home, Path(source.files[0]) if home is not None else None)
    links: list[DrawnLink] = []
    undrawn: list[str] = []
    if source.urdf:
        urdf = to_mjcf(root, source.directory, drawn=True)
        root, links, undrawn = urdf.tree, urdf.links, urdf.undrawn
    drawn, refusals = Contents(), Refusals()
    models = Models(drawn, refusals, LeftOut(scene.without))
    model = models.prepared(root, source.directory)
    world = read_sections(drawn, model, refusals, _DrawnAssets)
    refusals.raise_all()
    finish(world, source.fuse)
    of_links = {id(node) for link in links for node in link.visuals}
    world.only_drawn |= {id(shape.geom) for shape in world.shapes if id(shape.node) in of_links}
    layout, own = Layout(drawn), Layout(scene)
    seen = [geom for geom in layout.geoms if id(geom) not in world.only_drawn]
    names = [body.name for body in layout.bodies], [geom.name for geom in seen]
    if names != ([body.name for body in own.bodies], [geom.name for geom in own.geoms]):
        return None
    assert isinstance(world.assets, _DrawnAssets)
    plain = Colours(root, model, world.assets.place_of_texture)
    colours = {id(shape.geom): plain.of(shape.values) for shape in world.shapes}
    looks = Looks([colours[id(geom)] for geom in seen])
    looks.notes += [*undrawn, *sorted({*world.assets.unread.values(), *plain.unread})]
    for geom in layout.geoms:
        asset = geom.mesh if geom.mesh is not None else geom.hfield
        if id(geom) in world.only_drawn and id(asset) not in world.assets.unread:
            looks.geoms.append((layout.index[id(geom.body)], geom, colours[id(geom)]))
    geoms = {id(shape.node): id(shape.geom) for shape in world.shapes}
    drawn_too = {id(geom) for _, geom, _ in looks.geoms}
    covers = [link for link in links if any(geoms.get(id(n)) in drawn_too for n in link.visuals)]
    covered = {geoms.get(id(node)) for link in covers for node in link.collisions}
    looks.covered = [index for index, geom in enumerate(seen) if id(geom) in covered]
    bodies = {id(node): at for key, node in world.nodes.items() if (at := layout.index.get(key))}
    looks.lights = lights_of(root, model.compiler, model.defaults, bodies, looks.notes)
    looks.headlight = headlight_of(root, looks.notes)
    return looks
