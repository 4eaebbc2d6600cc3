"""The plain colours of materials and textures: what a surface looks like from far away.

MuJoCo documentation, XML reference, asset/material and asset/texture.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

from stepcore import checks, files
from stepcore.mjcf.attach import Model
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.models import sections
from stepcore.mjcf.nodes import MJCFError, Node
from stepcore.mjcf.validation import seen_values
from stepcore.scene.frames import Vec

# MuJoCo's colour of a geom that has none.
GREY = (0.5, 0.5, 0.5, 1.0)
WHITE = (1.0, 1.0, 1.0, 1.0)
# The roles of a material's layers that colour it.
COLOURING = ("rgb", "rgba")


class Look(NamedTuple):
    """rgba: the colour of a geom. squares: the two colours of its squares, of a checker texture."""

    rgba: Vec
    squares: tuple[Vec, Vec] | None = None

    def times(self, rgba: Vec) -> Look:
        """The same under a colour."""
        squares = self.squares and (_mixed(self.squares[0], rgba), _mixed(self.squares[1], rgba))
        return Look(_mixed(self.rgba, rgba), squares)


class Colours:
    """The looks of geoms by their materials: a colour times that of the texture.

    place: where the image of a texture lies. unread: images and materials that could not be read,
    a line each.
    """

    def __init__(self, root: Node, model: Model, place: Callable[[Node], str | None]) -> None:
        self.place = place
        self.unread: list[str] = []
        nodes = [node for section in sections(root, "asset") for node in section.children]
        self.textures = {n.attrs["name"]: n for n in nodes if n.tag == "texture" and _named(n)}
        # By name: the colour, and the look of the texture.
        self.materials: dict[str, tuple[Vec, Look]] = {}
        for node in nodes:
            if node.tag == "material":
                try:
                    look = self._material(node, model.defaults)
                except MJCFError as error:
                    self.unread.append(str(error))
                    continue
                self.materials[node.attrs.get("name", "")] = look

    def _material(self, node: Node, defaults: Defaults) -> tuple[Vec, Look]:
        values = seen_values(node, defaults.of(node))
        rgba = values.get("rgba", WHITE)
        names = [str(values.get("texture", ""))]
        names += [n.attrs.get("texture", "") for n in node.children if _colours(n)]
        texture = next((self.textures[name] for name in names if name in self.textures), None)
        return rgba, Look(WHITE) if texture is None else self._texture(texture)

    def _texture(self, node: Node) -> Look:
        """The mean colour of a texture."""
        values = seen_values(node)
        builtin = values.get("builtin", "none")
        if builtin == "none":
            return Look(self._image(node))
        first = values.get("rgb1", (0.8, 0.8, 0.8))
        second = first if builtin == "flat" else values.get("rgb2", (0.5, 0.5, 0.5))
        both = (*first, 1.0), (*second, 1.0)
        mean = tuple((a + b) / 2 for a, b in zip(*both, strict=True))
        return Look(mean, both if builtin == "checker" else None)

    def _image(self, node: Node) -> Vec:
        """The mean of an image; light grey for one of a cube's sides, or that cannot be read."""
        grey = 0.8, 0.8, 0.8, 1.0
        if "file" not in node.attrs:
            return grey
        try:
            path = self.place(node)
            return grey if path is None else _mean(path)
        except (ImportError, ValueError, OSError) as error:
            self.unread.append(f'{node.file}:{node.line}: texture "{node.attrs["file"]}": {error}')
            return grey

    def of(self, values: dict[str, Any]) -> Look:
        """The look of a geom with these attributes; its own colour goes before its material's."""
        own = values.get("rgba", GREY)
        if values.get("material") not in self.materials:
            return Look(own)
        rgba, texture = self.materials[values["material"]]
        return texture.times(rgba if own == GREY else own)


def _named(node: Node) -> bool:
    """Sets the name of a texture: its own, or that of its file."""
    file = node.attrs.get("file", "").replace("\\", "/").rpartition("/")[2]
    node.attrs.setdefault("name", file.rpartition(".")[0])
    return bool(node.attrs["name"])


def _colours(node: Node) -> bool:
    return node.tag == "layer" and node.attrs.get("role") in COLOURING


def _mean(path: str) -> Vec:
    """The mean colour of the image in a file; ValueError for what is none, or far too large."""
    from PIL import Image, ImageStat

    data = files.read(path, "an image")
    try:
        with warnings.catch_warnings():
            # Pillow warns of more pixels than any texture has, and then reads them.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data)) as image:
                mean = ImageStat.Stat(image.convert("RGB")).mean
    except Exception as error:
        # Whatever a reader of images finds wrong, the surface is drawn grey.
        raise ValueError(f"not a whole image: {checks.cut(checks.one_line(error), 200)}") from None
    return (*(value / 255 for value in mean), 1.0)


def _mixed(one: Vec, other: Vec) -> Vec:
    return tuple(a * b for a, b in zip(one, other, strict=True))
