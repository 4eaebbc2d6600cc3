"""Remove geoms that neither collide nor have mass from the scene.

MuJoCo documentation, XML reference, compiler/discardvisual.
"""

from __future__ import annotations

from stepcore.mjcf.copies import references
from stepcore.mjcf.masses import weights
from stepcore.mjcf.nodes import below
from stepcore.mjcf.worldbody import Shape, WorldReader


def leave_out_visual_geoms(world: WorldReader) -> None:
    """List the geoms that only draw in `Scene.ignored`, and remove those with assets.

    Primitives that only draw stay in the scene, so that geoms keep MuJoCo's order. Meshes,
    primitives fitted to meshes, and height fields are removed and their files not read, unless a
    sensor refers to them. A scene with a rangefinder, which also sees visual geoms, keeps them all.
    """
    scene = world.scene
    if any(sensor.type == "rangefinder" for sensor in scene.sensors):
        return
    sensed = {id(end) for sensor in scene.sensors for end in (sensor.object, sensor.reference)}
    gone = set()
    for shape in world.shapes:
        geom = shape.geom
        drags = geom.fluidshape != "none" and (scene.density > 0 or scene.viscosity > 0)
        if shape.collides or drags or id(geom) in sensed or weighs(world, shape):
            continue
        scene.ignored.append(shape.node.listed("only draws: no collisions, no mass"))
        if geom.mesh is not None or geom.hfield is not None:
            gone.add(id(geom))
    _remove(world, gone)


def discard_visual(world: WorldReader) -> None:
    """Remove all geoms that neither collide nor are referred to, as `discardvisual` requires.

    A body keeps the mass that a removed geom gives it.
    """
    scene = world.scene
    nodes = below(world.root)
    named = {name for node in nodes for _, kind, name in references(node) if kind == "geom"}
    there = {id(geom) for geom in scene.geoms}
    gone = [
        shape
        for shape in world.shapes
        if id(shape.geom) in there
        and not shape.collides
        and not (shape.geom.name and shape.geom.name in named)
        and not shape.fluid
    ]
    heavy = [shape for shape in gone if weighs(world, shape)]
    if heavy and scene.mass_rules.inertiafromgeom is True:
        raise heavy[0].node.error(
            "discardvisual would change the inertia of the body, which inertiafromgeom takes "
            "from its geoms"
        )
    bodies = {id(shape.geom.body): shape.geom.body for shape in heavy}
    for key, weight in (weights(scene, bodies.values()) if heavy else {}).items():
        weight.give(bodies[key])
    _remove(world, {id(shape.geom) for shape in gone})
    used = {id(asset) for geom in scene.geoms for asset in (geom.mesh, geom.hfield)}
    scene.meshes = [mesh for mesh in scene.meshes if id(mesh) in used]
    scene.hfields = [hfield for hfield in scene.hfields if id(hfield) in used]


def _remove(world: WorldReader, gone: set[int]) -> None:
    """Remove geoms by ``id``, unless they are kept for drawing."""
    if world.assets.drawn:
        world.only_drawn |= gone
    else:
        world.scene.geoms = [geom for geom in world.scene.geoms if id(geom) not in gone]


def weighs(world: WorldReader, shape: Shape) -> bool:
    """Return whether the geom contributes to the mass of its body.

    The mass of a fixed body counts too, because the user may add a joint to the body.
    """
    body = shape.geom.body
    rules = world.rules_of(body)
    low, high = rules.inertiagrouprange
    if not shape.heavy or not low <= shape.geom.group <= high or rules.inertiafromgeom is False:
        return False
    if rules.inertiafromgeom is None and body.mass is not None:
        return False
    return body is not world.scene.world
