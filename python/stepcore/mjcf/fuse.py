"""`fusestatic`: bodies that cannot move against their parent become part of it.

MuJoCo documentation, XML reference, compiler/fusestatic.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.checks import cut
from stepcore.mjcf.expand.naming import references
from stepcore.mjcf.masses import Weight, give, weights
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below
from stepcore.scene import frames
from stepcore.scene.elements import Body, Geom, Site
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.mjcf.worldbody import WorldReader

# Rules under which the bodies alone and the fused one would not weigh the same.
BOUNDS = ("boundmass", "boundinertia", "balanceinertia")


def fuse(world: WorldReader, root: Node) -> None:
    """Fuses the static bodies of the scene: chosen from the world outwards, as in MuJoCo."""
    scene = world.scene
    jointed = {id(joint.body) for joint in scene.joints}
    named = _referred(root)
    sensed = _sensed(root)
    sites = {id(site.body) for site in scene.sites if site.name in sensed}
    options = [section.values for section in root.children if section.tag == "option"]
    fluid = any(o.get(name, 0.0) > 0 for o in options for name in ("density", "viscosity"))
    known = weights(scene)
    layout = Layout(scene)
    # Of a fused body: the one that it is part of, and its pose there.
    whole: dict[int, Body] = {}
    poses: dict[int, tuple[Vec, Vec]] = {}
    for body in layout.bodies[1:]:
        carrier = body.parent
        assert carrier is not None
        if id(carrier) in whole:
            body.pos, body.quat = frames.composed(poses[id(carrier)], body.pos, body.quat)
            body.parent = carrier = whole[id(carrier)]
        kept = id(body) in jointed or id(body) in sites or (body.name and body.name in named)
        if kept or not _may(world, body, carrier, known, fluid):
            continue
        whole[id(body)], poses[id(body)] = carrier, (body.pos, body.quat)
        if body.name:
            scene.fused[body.name] = carrier.name
        if carrier is not scene.world:
            _add_weight(world, body, carrier, known)
    placed: list[Geom | Site] = [*layout.geoms, *layout.sites]
    for element in placed:
        own = id(element.body)
        if own in whole:
            element.pos, element.quat = frames.composed(poses[own], element.pos, element.quat)
            element.body = whole[own]
    scene.bodies = [body for body in layout.bodies if id(body) not in whole]
    # The elements of a body come before those of the bodies that are part of it.
    scene.geoms, scene.sites = layout.geoms, layout.sites
    if scene.fused:
        names = cut(", ".join(scene.fused), 200)
        scene.notes.append(
            f"{root.file}:{root.line}: bodies that nothing moves against their parent are part of "
            f"it (load(..., fuse=False) keeps them): {names}"
        )


def _referred(root: Node) -> set[str]:
    """The names of bodies that any element refers to."""
    return {name for node in below(root) for _, kind, name in references(node) if kind == "body"}


def _sensed(root: Node) -> set[str]:
    """The sites of sensors of forces, which measure between a body and its parent."""
    sections = [section for section in root.children if section.tag == "sensor"]
    return {
        node.attrs.get("site", "")
        for section in sections
        for node in section.children
        if node.tag in ("force", "torque")
    } - {""}


def _may(
    world: WorldReader, body: Body, above: Body, known: dict[int, Weight], fluid: bool
) -> bool:
    """Whether the body's own attributes, and the fluid, let it be fused with one above it."""
    values = world.nodes[id(body)].values
    if values.get("mocap") or values.get("fuse") is False or "sleep" in values:
        return False
    if known[id(body)].mass == 0.0 or above is world.scene.world:
        return True
    there = world.nodes[id(above)].values.get("gravcomp", 0.0)
    return not fluid and bool(values.get("gravcomp", 0.0) == there)


def _add_weight(world: WorldReader, body: Body, parent: Body, known: dict[int, Weight]) -> None:
    """Gives the parent the weight of both, unless it comes from the geoms of both anyway."""
    rules = world.scene.mass_rules
    both = known[id(parent)] + known[id(body)].seen_from(body.pos, body.quat)
    bounded = any(getattr(rules, name) for name in BOUNDS)
    known[id(parent)] = both
    if known[id(body)].mass == 0.0 and body.mass is None:
        return
    inferred = parent.mass is None and body.mass is None
    if not bounded and inferred and rules.inertiafromgeom is None:
        return
    if rules.inertiafromgeom is True:
        if not bounded:
            return
        node = world.nodes[id(body)]
        raise node.unbuilt("fusing bodies (fusestatic) with bounds of their inertia")
    give(parent, both)
