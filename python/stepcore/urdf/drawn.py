"""The visual geoms of a URDF, which only draw, and their materials, as MJCF."""

from __future__ import annotations

from dataclasses import dataclass

from stepcore.mjcf.nodes import MJCFError, Node
from stepcore.mjcf.refusals import Refusals
from stepcore.urdf.file_paths import file_path
from stepcore.urdf.schema import DRAWN_ROBOT, MATERIAL, VISUAL
from stepcore.urdf.translate import (
    Robot,
    inside,
    mjcf_node,
    numbers_of,
    translated,
    validate,
    written,
)


@dataclass
class DrawnLink:
    """The geoms of a link: those that collide, and those that only draw."""

    collisions: list[Node]
    visuals: list[Node]


def to_drawn_mjcf(root: Node, directory: str | None) -> tuple[Node, list[DrawnLink], list[str]]:
    """The MJCF tree of a URDF with what only draws; the geoms of its links; what is not drawn."""
    unread = _without_unread(root)
    robot, tree, _ = translated(DrawnRobot, DRAWN_ROBOT, root, directory)
    return tree, robot.drawn, unread + robot.undrawn


def _without_unread(root: Node) -> list[str]:
    """Takes out each visual and each material that is not as it must be; returns their errors."""
    links = [node for node in root.children if node.tag == "link"]
    visuals = [node for link in links for node in link.children if node.tag == "visual"]
    unread: list[str] = []
    for parents, tag, schema in (
        ([root, *visuals], "material", MATERIAL),
        (links, "visual", VISUAL),
    ):
        for parent in parents:
            kept = []
            for child in parent.children:
                refusals = Refusals()
                if child.tag == tag:
                    validate(child, schema, refusals)
                unread += map(str, refusals.errors)
                if not refusals.errors:
                    kept.append(child)
            parent.children = kept
    return unread


class DrawnRobot(Robot):
    """A robot with the `<visual>` geoms of its links, which neither collide nor weigh.

    drawn: the geoms of each link. undrawn: what of them could not be read, one line each.
    """

    def __init__(self, root: Node, directory: str | None, extension: list[Node]) -> None:
        super().__init__(root, directory, extension)
        self.drawn: list[DrawnLink] = []
        self.undrawn: list[str] = []
        visuals = [n for link in self.links.values() for n in link.children if n.tag == "visual"]
        # Any link may use what another, or the robot, names.
        materials = [node for of in (*visuals, root) for node in of.children]
        self.materials = {
            node.values.get("name", ""): node
            for node in materials
            if node.tag == "material" and (inside(node, "color") or inside(node, "texture"))
        }
        # Of the materials with a texture, by the id of their nodes: what they are in MJCF.
        self.textured: dict[int, tuple[Node, Node]] = {}

    def tree(self) -> Node:
        """The whole model, with the textures of its materials."""
        model = super().tree()
        asset = inside(model, "asset")
        assert asset is not None
        asset.children += [node for pair in self.textured.values() for node in pair]
        return model

    def _geoms(self, link: Node) -> list[Node]:
        drawn = DrawnLink(super()._geoms(link), [])
        self.drawn.append(drawn)
        for visual in link.children:
            if visual.tag != "visual":
                continue
            try:
                geom = self._geom(visual)
            except MJCFError as error:
                self.undrawn.append(str(error))
                continue
            # The same name may be that of a collision geom.
            geom.attrs.pop("name", None)
            geom.attrs |= {"contype": "0", "conaffinity": "0", "mass": "0"}
            try:
                geom.attrs |= self._colour(visual)
            except MJCFError as error:
                self.undrawn.append(str(error))
            drawn.visuals.append(geom)
        return drawn.collisions + drawn.visuals

    def _colour(self, visual: Node) -> dict[str, str]:
        material = inside(visual, "material")
        if material is None:
            return {}
        if not (inside(material, "color") or inside(material, "texture")):
            material = self.materials.get(material.values.get("name", ""), material)
        rgba = numbers_of(material, "color", "rgba", ())
        own = {"rgba": written(rgba)} if rgba else {}
        texture = inside(material, "texture")
        return own if texture is None else own | {"material": self._textured(material, texture)}

    def _textured(self, material: Node, texture: Node) -> str:
        """The name of the MJCF material of one that has a texture."""
        if id(material) not in self.textured:
            name = f"material {len(self.textured)}"
            path = file_path(texture, self.directory, bool(self.extension))
            image = mjcf_node("texture", texture, name=name, type="2d", file=path)
            self.textured[id(material)] = (
                image,
                mjcf_node("material", material, name=name, texture=name),
            )
        return self.textured[id(material)][1].attrs["name"]
