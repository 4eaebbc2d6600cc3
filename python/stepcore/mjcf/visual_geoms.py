"""Geoms of a file that only draw: they neither collide nor give a body mass."""

from __future__ import annotations

from stepcore.mjcf.worldbody import Shape, WorldReader
from stepcore.scene.contents import Contents

# Sensors that tell of the masses of bodies, of those that cannot move too.
OF_MASS = ("force", "torque", "subtreecom", "subtreelinvel", "subtreeangmom", "e_potential")


def leave_out_visual_geoms(world: WorldReader) -> None:
    """Adds the geoms that only draw to `Scene.ignored`.

    A primitive that only draws stays in the scene, so that geoms keep MuJoCo's order; meshes,
    primitives fitted to them and height fields leave it, and are then never read, but for those of
    which a sensor tells. A scene with a rangefinder keeps them all.
    """
    scene = world.scene
    if any(sensor.type == "rangefinder" for sensor in scene.sensors):
        # They see what only draws.
        return
    sensed = {id(end) for sensor in scene.sensors for end in (sensor.object, sensor.reference)}
    gone = set()
    for shape in world.shapes:
        drags = shape.geom.fluidshape != "none" and (scene.density > 0 or scene.viscosity > 0)
        told = id(shape.geom) in sensed
        if shape.collides or drags or told or weighs(world, shape):
            continue
        scene.ignored.append(shape.node.listed("only draws: no collisions, no mass"))
        if shape.geom.mesh is not None or shape.geom.hfield is not None:
            gone.add(id(shape.geom))
    if world.assets.drawn:
        world.only_drawn |= gone
        return
    scene.geoms = [geom for geom in scene.geoms if id(geom) not in gone]


def weighs(world: WorldReader, shape: Shape) -> bool:
    """Whether the geom contributes to the mass of its body.

    That of a body that cannot move counts too: a joint that is added to it sets it free.
    """
    body = shape.geom.body
    rules = world.rules_of(body)
    low, high = rules.inertiagrouprange
    if not shape.heavy or not low <= shape.geom.group <= high or rules.inertiafromgeom is False:
        return False
    if rules.inertiafromgeom is None and body.mass is not None:
        return False
    return body is not world.scene.world


def senses_mass(scene: Contents) -> bool:
    """Whether a sensor tells of the masses or the centres of mass of bodies that cannot move."""
    kinds = {(sensor.type, sensor.objtype, sensor.reftype) for sensor in scene.sensors}
    centred = any(kind != "contact" and "body" in ends for kind, *ends in kinds)
    return centred or any(kind in OF_MASS for kind, *_ in kinds)
