"""Read the visual geoms and colours of a file when a scene is drawn.

Nothing here affects the physics. The source text of a scene is read a second time, with the geoms
that the reader leaves out (`Scene.ignored`) and with their mesh files. MuJoCo documentation, XML
reference, asset/material, asset/texture and geom/rgba.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from stepcore import checks, files
from stepcore.mjcf.assets import Assets
from stepcore.mjcf.defaults import Model
from stepcore.mjcf.nodes import MJCFError, Node, Refusals, expand, parse, section_nodes
from stepcore.mjcf.reader import finish, prepared, read_sections
from stepcore.mjcf.validation import Exclusions, seen_values
from stepcore.scene.elements import Geom, Mesh
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

# MuJoCo's default colour of a geom.
GREY = (0.5, 0.5, 0.5, 1.0)
# The colour in place of a cube texture, or of an image that cannot be read.
LIGHT_GREY = (0.8, 0.8, 0.8, 1.0)


class Look(NamedTuple):
    """The colours of a geom. rgba: the mean. squares: the two colours of a checker texture."""

    rgba: Vec
    squares: tuple[Vec, Vec] | None = None

    def times(self, rgba: Vec) -> Look:
        squares = self.squares and (
            _product(self.squares[0], rgba),
            _product(self.squares[1], rgba),
        )
        return Look(_product(self.rgba, rgba), squares)


def _product(colour: Vec, other: Vec) -> Vec:
    return tuple(a * b for a, b in zip(colour, other, strict=True))


@dataclass
class Looks:
    """The appearance of a scene according to its file.

    colours: the look of each geom of the scene, in the order of the compiled model.
    geoms: (body index, geom, look) of each geom that only draws.
    notes: a line for each asset that could not be read.
    """

    colours: list[Look] = field(default_factory=list)
    geoms: list[tuple[int, Geom, Look]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class _DrawnAssets(Assets):
    """Assets for drawing: geoms that only draw stay, and unreadable files are skipped."""

    drawn = True

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.unread: dict[int, str] = {}

    def _fill(self, scene: Scene, node: Node, asset: Any) -> None:
        try:
            super()._fill(scene, node, asset)
        except (ValueError, OSError) as error:
            self.unread[id(asset)] = str(error)
            # The empty asset stays, so that geoms that refer to it can be recognised.
            assets: list[Any] = scene.meshes if isinstance(asset, Mesh) else scene.hfields
            assets.append(asset)

    def place_of_texture(self, node: Node) -> str | None:
        """Return the path of a texture's image; None in a text without a folder."""
        return self.compiler.asset(node, node.attrs["file"], "texturedir")


def read_looks(scene: Scene) -> Looks | None:
    """Return the appearance of a scene according to its source file or text.

    Returns None for a scene built in code, for a URDF, and for a scene whose bodies or geoms have
    changed.
    """
    source = scene._source
    if source is None or not source.data:
        return None
    root = parse(source.data, source.files[0])
    home = None if source.directory is None else Path(source.directory)
    expand(root, home, Path(source.files[0]) if home is not None else None)
    drawn, refusals = type(scene)(), Refusals()
    model = prepared(drawn, root, source.directory, refusals, Exclusions(source.without))
    world = read_sections(drawn, model, refusals, _DrawnAssets)
    refusals.raise_all()
    finish(world, source.fuse)
    layout, original = Layout(drawn), Layout(scene)
    seen = [geom for geom in layout.geoms if id(geom) not in world.only_drawn]
    names = [body.name for body in layout.bodies], [geom.name for geom in seen]
    if names != ([body.name for body in original.bodies], [geom.name for geom in original.geoms]):
        return None
    assets = world.assets
    assert isinstance(assets, _DrawnAssets)
    surfaces = _Surfaces(model, assets)
    colours = {id(shape.geom): surfaces.of(shape.values) for shape in world.shapes}
    looks = Looks([colours[id(geom)] for geom in seen])
    looks.notes += sorted({*assets.unread.values(), *surfaces.unread})
    for geom in layout.geoms:
        asset = geom.mesh if geom.mesh is not None else geom.hfield
        if id(geom) in world.only_drawn and id(asset) not in assets.unread:
            looks.geoms.append((layout.index[id(geom.body)], geom, colours[id(geom)]))
    return looks


class _Surfaces:
    """The looks of geoms by material: the colour times the mean colour of the texture.

    unread: a line for each image or material that could not be read.
    """

    def __init__(self, model: Model, assets: _DrawnAssets) -> None:
        self.assets = assets
        self.unread: list[str] = []
        # Textures by name; a texture without a name is named after its file.
        self.textures: dict[str, Node] = {}
        self.materials: dict[str, tuple[Vec, Look]] = {}
        nodes = section_nodes(model.root, "asset")
        for node in nodes:
            if node.tag == "texture":
                self.textures[node.asset_name()] = node
        self.textures.pop("", None)
        for node in nodes:
            if node.tag == "material":
                try:
                    values = seen_values(node, model.defaults.of(node))
                    look = values.get("rgba", (1.0,) * 4), self._look(node, values)
                    self.materials[node.attrs.get("name", "")] = look
                except MJCFError as error:
                    self.unread.append(str(error))

    def of(self, values: dict[str, Any]) -> Look:
        colour = values.get("rgba", GREY)
        if values.get("material") not in self.materials:
            return Look(colour)
        rgba, texture = self.materials[values["material"]]
        return texture.times(rgba if colour == GREY else colour)

    def _look(self, node: Node, values: dict[str, Any]) -> Look:
        """Return the look of a material's texture, or white without a texture."""
        layers = [
            layer.attrs.get("texture", "")
            for layer in node.children
            if layer.tag == "layer" and layer.attrs.get("role") in ("rgb", "rgba")
        ]
        names = [str(values.get("texture", "")), *layers]
        texture = next((self.textures[name] for name in names if name in self.textures), None)
        if texture is None:
            return Look((1.0,) * 4)
        values = seen_values(texture)
        builtin = values.get("builtin", "none")
        if builtin == "none":
            return Look(self._mean(texture))
        first = values.get("rgb1", (0.8, 0.8, 0.8))
        second = first if builtin == "flat" else values.get("rgb2", (0.5, 0.5, 0.5))
        both = (*first, 1.0), (*second, 1.0)
        mean = tuple((a + b) / 2 for a, b in zip(*both, strict=True))
        return Look(mean, both if builtin == "checker" else None)

    def _mean(self, texture: Node) -> Vec:
        if "file" not in texture.attrs:
            return LIGHT_GREY
        try:
            path = self.assets.place_of_texture(texture)
            return LIGHT_GREY if path is None else _mean_colour(path)
        except (ImportError, ValueError, OSError) as error:
            text = f'texture "{texture.attrs["file"]}": {error}'
            self.unread.append(f"{texture.file}:{texture.line}: {text}")
            return LIGHT_GREY


def _mean_colour(path: str) -> Vec:
    """Return the mean colour of an image file; raise ValueError if it is invalid or too large."""
    from PIL import Image, ImageStat

    data = files.contents(path, "an image")
    try:
        with warnings.catch_warnings():
            # Pillow only warns of oversized images; treat the warning as an error.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data)) as image:
                mean = ImageStat.Stat(image.convert("RGB")).mean
    except Exception as error:
        # After any error of the image reader, the surface is drawn grey.
        raise ValueError(f"not a whole image: {checks.cut(checks.one_line(error), 200)}") from None
    return (*(value / 255 for value in mean), 1.0)
