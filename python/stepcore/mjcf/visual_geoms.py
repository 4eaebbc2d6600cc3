"""Geoms of a file that only draw: they neither collide nor give a body mass."""

from __future__ import annotations

from stepcore.mjcf.worldbody import Shape, WorldReader
from stepcore.scene.layout import Layout


def list_visual_geoms(world: WorldReader, layout: Layout) -> None:
    """Adds the geoms that only draw to `Scene.ignored`.

    A primitive that only draws stays in the scene, so that geoms keep MuJoCo's order; a mesh or
    height field is never read. Raises MJCFError for one that gives a body its mass.
    """
    for shape in world.shapes:
        if shape.collides:
            continue
        if not weighs(world, layout, shape):
            world.scene.ignored.append(shape.node.listed("only draws: no collisions, no mass"))
        elif not shape.kept:
            raise shape.node.unbuilt(f"a geom that gives its body mass as a {shape.what}")


def weighs(world: WorldReader, layout: Layout, shape: Shape) -> bool:
    """Whether the geom contributes to the mass of a body whose mass can matter."""
    rules = world.scene.mass_rules
    low, high = rules.inertiagrouprange
    if not shape.heavy or not low <= shape.group <= high or rules.inertiafromgeom is False:
        return False
    if rules.inertiafromgeom is None and shape.body.mass is not None:
        return False
    # The mass of a body that cannot move matters only as a share of a prescribed total.
    share = shape.body is not world.scene.world and rules.settotalmass > 0
    return layout.moving(shape.body) or share
