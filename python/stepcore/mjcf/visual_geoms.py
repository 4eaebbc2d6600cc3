"""Which geoms of a file only draw: they neither collide nor give a body its mass."""

from __future__ import annotations

from stepcore.mjcf.worldbody import Shape, WorldReader
from stepcore.scene.layout import Layout


def list_visual_geoms(world: WorldReader, layout: Layout) -> None:
    """Adds the geoms that only draw to `Scene.ignored`.

    Raises MJCFError for a mesh or height field that gives a body its mass. Such a shape is never
    read and is not in the scene; a primitive that only draws is kept, so that geoms keep
    MuJoCo's order.
    """
    for shape in world.shapes:
        if shape.collides:
            continue
        if not weighs(world, layout, shape):
            world.scene.ignored.append(shape.node.listed("only draws: neither collides nor weighs"))
        elif not shape.kept:
            raise shape.node.unbuilt(f"a geom that gives its body mass as a {shape.what}")


def weighs(world: WorldReader, layout: Layout, shape: Shape) -> bool:
    """Whether the geom takes part in the mass of a body whose mass can matter."""
    rules = world.scene.mass_rules
    low, high = rules.inertiagrouprange
    if not shape.heavy or not low <= shape.group <= high or rules.inertiafromgeom is False:
        return False
    if rules.inertiafromgeom is None and shape.body.mass is not None:
        return False
    # What cannot move has no use for a mass, except as a share of a prescribed total.
    share = shape.body is not world.scene.world and rules.settotalmass > 0
    return layout.moving(shape.body) or share
