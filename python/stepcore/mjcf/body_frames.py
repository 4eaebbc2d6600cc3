"""Compiler options that change the frames of bodies: `fusestatic`, and `align` with `alignfree`.

MuJoCo documentation, XML reference, compiler/fusestatic and freejoint/align.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.checks import cut
from stepcore.mjcf.copies import references
from stepcore.mjcf.masses import Weight, weights
from stepcore.mjcf.nodes import below, inside, sections
from stepcore.scene import frames
from stepcore.scene.elements import Body, Geom, Joint, Site
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.mjcf.worldbody import Shape, WorldReader

Pose = tuple[Vec, Vec]
# Rules under which mass or inertia of a fused body would differ from the sum of its parts.
BOUNDS = ("boundmass", "boundinertia", "balanceinertia")


def fuse(world: WorldReader) -> None:
    """Fuse each body that cannot move relative to its parent with the parent, world first."""
    scene, root = world.scene, world.root
    jointed = {id(joint.body) for joint in scene.joints}
    # A body that an element refers to by name is not fused.
    named = {name for node in below(root) for _, kind, name in references(node) if kind == "body"}
    # Nor is a body with a force or torque sensor, which measures the load from the parent.
    sensors = inside(root, "sensor")
    measured = {node.attrs.get("site") for node in sensors if node.tag in ("force", "torque")}
    measured_on = {id(site.body) for site in scene.sites if site.name and site.name in measured}
    options = [section.values for section in sections(root, "option")]
    fluid = any(o.get(name, 0.0) > 0 for o in options for name in ("density", "viscosity"))
    layout = Layout(scene)
    # Computed at the first body whose parent is not the world.
    known: dict[int, Weight] = {}
    # For each fused body: the body that it joins, and its pose in that body.
    whole: dict[int, Body] = {}
    poses: dict[int, Pose] = {}
    for body in layout.bodies[1:]:
        carrier = body.parent
        assert carrier is not None
        if id(carrier) in whole:
            body.pos, body.quat = frames.composed(poses[id(carrier)], body.pos, body.quat)
            body.parent = carrier = whole[id(carrier)]
        kept = id(body) in jointed or id(body) in measured_on or (body.name and body.name in named)
        if kept:
            continue
        if carrier is not scene.world and not known:
            known = weights(scene, scene.bodies[1:])
        if not _may_fuse(world, body, carrier, known, fluid):
            continue
        whole[id(body)], poses[id(body)] = carrier, (body.pos, body.quat)
        if body.name:
            scene.fused[body.name] = carrier.name
        if carrier is not scene.world:
            _add_weight(world, body, carrier, known)
    placed: list[Geom | Site] = [*layout.geoms, *layout.sites]
    for element in placed:
        key = id(element.body)
        if key in whole:
            element.pos, element.quat = frames.composed(poses[key], element.pos, element.quat)
            element.body = whole[key]
    scene.bodies = [body for body in layout.bodies if id(body) not in whole]
    # A body's own elements come before those of the bodies fused with it.
    scene.geoms, scene.sites = layout.geoms, layout.sites
    if scene.fused:
        names = cut(", ".join(scene.fused), 200)
        scene.notes.append(
            f"{root.file}:{root.line}: bodies that nothing moves against their parent are part of "
            f"it (load(..., fuse=False) keeps them): {names}"
        )


def _may_fuse(
    world: WorldReader, body: Body, carrier: Body, known: dict[int, Weight], fluid: bool
) -> bool:
    """Return whether the body's attributes and the fluid allow fusing it with the carrier."""
    values = world.nodes[id(body)].values
    if values.get("mocap") or values.get("fuse") is False or "sleep" in values:
        return False
    if carrier is world.scene.world or known[id(body)].mass == 0.0:
        return True
    there = world.nodes[id(carrier)].values.get("gravcomp", 0.0)
    return not fluid and bool(values.get("gravcomp", 0.0) == there)


def _add_weight(world: WorldReader, body: Body, carrier: Body, known: dict[int, Weight]) -> None:
    """Give the carrier the summed mass and inertia, unless its geoms determine them anyway."""
    rules = world.scene.mass_rules
    both = known[id(carrier)] + known[id(body)].seen_from(body.pos, body.quat)
    bounded = any(getattr(rules, name) for name in BOUNDS)
    known[id(carrier)] = both
    if known[id(body)].mass == 0.0 and body.mass is None:
        return
    inferred = carrier.mass is None and body.mass is None
    if not bounded and inferred and rules.inertiafromgeom is None:
        return
    if rules.inertiafromgeom is True:
        if not bounded:
            return
        node = world.nodes[id(body)]
        raise node.unbuilt("fusing bodies (fusestatic) with bounds of their inertia")
    both.give(carrier)


def align(world: WorldReader) -> None:
    """Align the frames of free bodies with their principal axes of inertia where `align` is set.

    As in MuJoCo, only a body without child bodies is aligned. Values in the body's frame that other
    elements give (anchors of equalities, keyframes) are not changed.
    """
    scene = world.scene
    parents = {id(body.parent) for body in scene.bodies}
    bodies = [
        joint.body
        for joint in scene.joints
        if joint.type == "free" and id(joint.body) not in parents and _is_aligned(world, joint)
    ]
    known = weights(scene, bodies) if bodies else {}
    placed: dict[int, list[Geom | Site]] = {id(body): [] for body in bodies}
    elements: list[Geom | Site] = [*scene.geoms, *scene.sites]
    for element in elements:
        placed.setdefault(id(element.body), []).append(element)
    shapes: dict[int, list[Shape]] = {}
    for shape in world.shapes:
        shapes.setdefault(id(shape.geom.body), []).append(shape)
    for body in bodies:
        weight = known[id(body)]
        # balanceinertia makes the moments equal, and so the computed axes arbitrary.
        quat = _written_axes(world, body, shapes.get(id(body), [])) or weight.iquat
        assert quat is not None
        pose = (tuple(map(float, weight.ipos)), quat)
        back = _inverse(pose)
        for element in placed[id(body)]:
            element.pos, element.quat = frames.composed(back, element.pos, element.quat)
        if body.mass is not None:
            moments = weight.seen_from(*back).six[:3]
            body.ipos, body.inertia = frames.ORIGIN, (*moments, 0.0, 0.0, 0.0)
            body.iquat = frames.IDENTITY
        body.pos, body.quat = frames.composed((body.pos, body.quat), *pose)


def _is_aligned(world: WorldReader, joint: Joint) -> bool:
    """Return whether the joint's `align` or its model's `alignfree` requests alignment."""
    node = world.nodes[id(joint)]
    asked = node.values.get("align", "auto")
    alignfree = (node.compiler or world.main).values.get("alignfree")
    return asked is True or (asked == "auto" and bool(alignfree))


def _written_axes(world: WorldReader, body: Body, shapes: list[Shape]) -> Vec | None:
    """Return the principal axes that the file gives: of the inertial, or of a body's only geom."""
    rules = world.rules_of(body)
    if body.mass is not None and rules.inertiafromgeom is not True:
        return body.iquat
    low, high = rules.inertiagrouprange
    geoms = [shape.geom for shape in shapes if shape.heavy and low <= shape.geom.group <= high]
    # The principal axes of a mesh are computed.
    return geoms[0].quat if len(geoms) == 1 and geoms[0].mesh is None else None


def _inverse(pose: Pose) -> Pose:
    pos, (w, x, y, z) = pose
    back = (w, -x, -y, -z)
    return tuple(-a for a in frames.rotated(back, pos)), back
