"""`fusestatic`: bodies that cannot move against their parent become part of it.

MuJoCo documentation, XML reference, compiler/fusestatic.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.expand.naming import references
from stepcore.mjcf.masses import Weight, give, weights
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.refusals import below
from stepcore.scene import frames
from stepcore.scene.elements import Body, Geom, Site

if TYPE_CHECKING:
    from stepcore.mjcf.worldbody import WorldReader

# What stands on each body.
Held = dict[int, list[Geom | Site | Body]]
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
    held: Held = {}
    placed: list[Geom | Site] = [*scene.geoms, *scene.sites]
    for element in placed:
        held.setdefault(id(element.body), []).append(element)
    for body in scene.bodies[1:]:
        held.setdefault(id(body.parent), []).append(body)
    gone = set()
    moved: dict[int, int] = {}
    order = _innermost_first(scene.bodies)
    for body in reversed(order):
        kept = id(body) in jointed or id(body) in sites or (body.name and body.name in named)
        above = body.parent
        while above is not None and id(above) in gone:
            above = above.parent
        if not kept and above is not None and _may(world, body, above, known, fluid):
            gone.add(id(body))
    for body in order:
        if id(body) in gone:
            _fuse(world, body, known, held)
    for elements in held.values():
        moved |= {id(element): place for place, element in enumerate(elements)}
    scene.bodies = [body for body in scene.bodies if id(body) not in gone]
    scene.geoms.sort(key=lambda geom: moved[id(geom)])
    scene.sites.sort(key=lambda site: moved[id(site)])


def _innermost_first(bodies: list[Body]) -> list[Body]:
    """The bodies but the world, each after those that it carries, else in the order of the file."""
    inside: dict[int, list[Body]] = {}
    for body in bodies[1:]:
        inside.setdefault(id(body.parent), []).append(body)
    order: list[Body] = []
    pending = [bodies[0]]
    while pending:
        body = pending.pop()
        order.append(body)
        pending += inside.get(id(body), [])
    return order[:0:-1]


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


def _fuse(world: WorldReader, body: Body, known: dict[int, Weight], held: Held) -> None:
    scene, parent = world.scene, body.parent
    assert parent is not None
    if parent is not scene.world:
        _add_weight(world, body, parent, known)
    # Elements come after all of the parent's own.
    for element in held.pop(id(body), []):
        pose = frames.composed((body.pos, body.quat), element.pos, element.quat)
        element.pos, element.quat = pose
        if isinstance(element, Body):
            element.parent = parent
        else:
            element.body = parent
        held.setdefault(id(parent), []).append(element)


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
