"""`discardvisual`: geoms that neither collide nor are referred to leave the model.

MuJoCo documentation, XML reference, compiler/discardvisual. Where such a geom gives a body mass,
the body keeps the mass that it has with it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.expand.naming import references
from stepcore.mjcf.masses import give, weights
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below

if TYPE_CHECKING:
    from stepcore.mjcf.worldbody import Shape, WorldReader


def discard_visual(world: WorldReader, root: Node) -> None:
    """Removes the visual geoms of the scene."""
    scene = world.scene
    named = {name for node in below(root) for _, kind, name in references(node) if kind == "geom"}
    there = {id(geom) for geom in scene.geoms}
    gone = [
        shape
        for shape in world.shapes
        if id(shape.geom) in there
        and not shape.collides
        and not (shape.geom.name and shape.geom.name in named)
        and not shape.fluid
    ]
    heavy = [shape for shape in gone if _weighs(world, shape)]
    known = weights(scene) if heavy else {}
    for shape in heavy:
        if scene.mass_rules.inertiafromgeom is True:
            raise shape.node.error(
                "discardvisual would change the inertia of the body, which inertiafromgeom takes "
                "from its geoms"
            )
        give(shape.geom.body, known[id(shape.geom.body)])
    removed = {id(shape.geom) for shape in gone}
    if world.assets.drawn:
        world.only_drawn |= removed
        return
    scene.geoms = [geom for geom in scene.geoms if id(geom) not in removed]
    used = {id(asset) for geom in scene.geoms for asset in (geom.mesh, geom.hfield)}
    scene.meshes = [mesh for mesh in scene.meshes if id(mesh) in used]
    scene.hfields = [hfield for hfield in scene.hfields if id(hfield) in used]


def _weighs(world: WorldReader, shape: Shape) -> bool:
    """Whether the geom gives its body mass."""
    rules, geom = world.scene.mass_rules, shape.geom
    low, high = rules.inertiagrouprange
    inferred = rules.inertiafromgeom is True or (
        rules.inertiafromgeom is None and geom.body.mass is None
    )
    return (
        inferred
        and shape.heavy
        and low <= geom.group <= high
        and geom.body is not world.scene.world
    )
