"""The reader's passes over bodies: their masses, geoms that only draw, and their frames.

MuJoCo documentation, XML reference, compiler/discardvisual, compiler/fusestatic, freejoint/align.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stepcore import _core
from stepcore.checks import ElementError, cut
from stepcore.mjcf.nodes import below, section_nodes, sections, with_file_lines
from stepcore.mjcf.sections import Shape, WorldReader
from stepcore.mjcf.validation import references
from stepcore.scene import frames
from stepcore.scene.elements import Body, MassRules
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout
from stepcore.scene.records import plain

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

OF_MASS = ("force", "torque", "subtreecom", "subtreelinvel", "subtreeangmom", "e_potential")


@dataclass(frozen=True)
class Weight:
    """The mass properties of a body, in the body's frame.

    mass: the mass [kg].
    ipos: the centre of mass [m], shape (3,).
    inertia: the inertia about the centre of mass [kg·m²], shape (3, 3).
    iquat: the principal axes as a quaternion; None for a sum of bodies.
    """

    mass: float
    ipos: NDArray[np.float64]
    inertia: NDArray[np.float64]
    iquat: Vec | None = None

    def seen_from(self, pos: Vec, quat: Vec) -> Weight:
        """Return the same properties in the frame in which the body has this pose."""
        turn = np.array(frames.matrix(quat))
        return Weight(self.mass, np.array(pos) + turn @ self.ipos, turn @ self.inertia @ turn.T)

    def __add__(self, other: Weight) -> Weight:
        mass = self.mass + other.mass
        if mass == 0.0:
            return self
        ipos = (self.mass * self.ipos + other.mass * other.ipos) / mass
        inertia = np.zeros((3, 3))
        for part in (self, other):
            d = part.ipos - ipos
            inertia += part.inertia + part.mass * (d @ d * np.eye(3) - np.outer(d, d))
        return Weight(mass, ipos, inertia)

    @property
    def six(self) -> Vec:
        """The inertia as xx yy zz xy xz yz [kg·m²]."""
        places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        return tuple(float(self.inertia[place]) for place in places)

    def give(self, body: Body) -> None:
        body.mass, body.inertia, body.iquat = self.mass, self.six, self.iquat
        body.ipos = tuple(map(float, self.ipos))


def weights(
    scene: Scene, bodies: Iterable[Body], rules: MassRules | None = None
) -> dict[int, Weight]:
    """Return the mass properties of bodies by ``id``, before scaling to a total mass.

    Only these bodies and the geoms that give them mass are compiled.
    rules: mass rules to use instead of the scene's.
    """
    part = type(scene)()
    part.mass_rules = MassRules(**((rules or scene.mass_rules).values() | {"settotalmass": -1.0}))
    twins = {id(body): copy.copy(body) for body in bodies}
    for twin in twins.values():
        twin.parent = part.world
        part.bodies.append(twin)
    for geom in scene.geoms:
        body = twins.get(id(geom.body))
        if body and (body.mass is None or part.mass_rules.inertiafromgeom is True):
            part.geoms.append(copy.copy(geom))
            part.geoms[-1].body = body
    used = {id(asset) for geom in part.geoms for asset in (geom.mesh, geom.hfield)}
    part.meshes = [mesh for mesh in scene.meshes if id(mesh) in used]
    part.hfields = [hfield for hfield in scene.hfields if id(hfield) in used]
    try:
        tables = _core.compile(plain(Layout(part))).tables()
    except ElementError:
        raise
    except ValueError as error:
        raise with_file_lines(error, Layout(part)) from None
    columns = [tables[f"body_{name}"][1:] for name in ("mass", "ipos", "inertia", "iquat")]
    # All bodies have the same parent here, so compiling keeps their order.
    return {
        key: Weight(float(mass), np.array(ipos), np.array(inertia), tuple(map(float, iquat)))
        for key, mass, ipos, inertia, iquat in zip(twins, *columns, strict=True)
    }


def place_weightless(world: WorldReader) -> None:
    """Give massless bodies inside frames an inertial with mass 0.

    As in MuJoCo, the inertial has the body's pose in the file, without the poses of the frames. The
    inertial matters where `boundmass` or `boundinertia` add mass, at contacts, and for sensors that
    depend on masses.
    """
    scene = world.scene
    touching = {id(geom.body) for geom in scene.geoms}
    # Sensors may depend on masses or centres of mass even of bodies that cannot move.
    sensed = any(
        sensor.type in OF_MASS
        or (sensor.type != "contact" and "body" in (sensor.objtype, sensor.reftype))
        for sensor in scene.sensors
    )
    rules = scene.mass_rules
    every = sensed or rules.boundmass > 0 or rules.boundinertia > 0
    bodies = [
        body
        for body in scene.bodies
        if body.mass is None and id(body) in world.written and (every or id(body) in touching)
    ]
    if not bodies:
        return
    unbounded = MassRules(**(rules.values() | {"boundmass": 0.0, "boundinertia": 0.0}))
    by_body = weights(scene, bodies, unbounded)
    for body in bodies:
        if by_body[id(body)].mass == 0.0:
            pos, quat = world.written[id(body)]
            Weight(0.0, np.array(pos), np.zeros((3, 3)), quat).give(body)


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
        scene.ignored.append(shape.node.ignored_line("only draws: no collisions, no mass"))
        if geom.mesh is not None or geom.hfield is not None:
            gone.add(id(geom))
    _remove(world, gone)


def _remove(world: WorldReader, gone: set[int]) -> None:
    if world.assets.drawn:
        world.only_drawn |= gone
    else:
        world.scene.geoms = [geom for geom in world.scene.geoms if id(geom) not in gone]


def weighs(world: WorldReader, shape: Shape) -> bool:
    """Return whether the geom contributes to the mass of its body.

    The mass of a fixed body counts too, because the user may add a joint to the body.
    """
    body = shape.geom.body
    rules = world.scene.mass_rules
    low, high = rules.inertiagrouprange
    if not shape.heavy or not low <= shape.geom.group <= high or rules.inertiafromgeom is False:
        return False
    if rules.inertiafromgeom is None and body.mass is not None:
        return False
    return body is not world.scene.world


Pose = tuple[Vec, Vec]
# Rules under which mass or inertia of a fused body would differ from the sum of its parts.
BOUNDS = ("boundmass", "boundinertia", "balanceinertia")


def fuse(world: WorldReader) -> None:
    """Fuse each body that cannot move relative to its parent with the parent, world first."""
    scene, root = world.scene, world.root
    kept = _kept_apart(world)
    sets = [section.values for section in sections(root, "option")]
    fluid = any(values.get(name, 0.0) > 0 for values in sets for name in ("density", "viscosity"))
    layout = Layout(scene)
    # Computed at the first body whose parent is not the world.
    by_body: dict[int, Weight] = {}
    # For each fused body: the body that it joins, and its pose in that body.
    roots: dict[int, Body] = {}
    poses: dict[int, Pose] = {}
    for body in layout.bodies[1:]:
        carrier = body.parent
        assert carrier is not None
        if id(carrier) in roots:
            body.pos, body.quat = frames.composed(poses[id(carrier)], body.pos, body.quat)
            body.parent = carrier = roots[id(carrier)]
        if id(body) in kept:
            continue
        if carrier is not scene.world and not by_body:
            by_body = weights(scene, scene.bodies[1:])
        if not _may_fuse(world, body, carrier, by_body, fluid):
            continue
        roots[id(body)], poses[id(body)] = carrier, (body.pos, body.quat)
        if body.name:
            scene.fused[body.name] = carrier.name
        if carrier is not scene.world:
            _add_weight(world, body, carrier, by_body)
    for element in (*layout.geoms, *layout.sites):
        key = id(element.body)
        if key in roots:
            element.pos, element.quat = frames.composed(poses[key], element.pos, element.quat)
            element.body = roots[key]
    scene.bodies = [body for body in layout.bodies if id(body) not in roots]
    # A body's own elements come before those of the bodies fused with it.
    scene.geoms, scene.sites = layout.geoms, layout.sites
    if scene.fused:
        names = cut(", ".join(scene.fused), 200)
        scene.notes.append(
            f"{root.file}:{root.line}: bodies that nothing moves against their parent are part of "
            f"it (load(..., fuse=False) keeps them): {names}"
        )


def _kept_apart(world: WorldReader) -> set[int]:
    """Return the ids of the bodies that are not fused, whatever their masses."""
    scene, root = world.scene, world.root
    # A body that an element refers to by name.
    named = {name for node in below(root) for _, kind, name in references(node) if kind == "body"}
    # A force or torque sensor measures the load from the parent of its body.
    sensors = section_nodes(root, "sensor")
    measured = {node.attrs.get("site") for node in sensors if node.tag in ("force", "torque")}
    return (
        {id(joint.body) for joint in scene.joints}
        | {id(body) for body in scene.bodies if body.name and body.name in named}
        | {id(site.body) for site in scene.sites if site.name and site.name in measured}
    )


def _may_fuse(
    world: WorldReader, body: Body, carrier: Body, by_body: dict[int, Weight], fluid: bool
) -> bool:
    values = world.nodes[id(body)].values
    if values.get("mocap") or values.get("fuse") is False or "sleep" in values:
        return False
    if carrier is world.scene.world or by_body[id(body)].mass == 0.0:
        return True
    compensation = world.nodes[id(carrier)].values.get("gravcomp", 0.0)
    return not fluid and bool(values.get("gravcomp", 0.0) == compensation)


def _add_weight(world: WorldReader, body: Body, carrier: Body, by_body: dict[int, Weight]) -> None:
    """Give the carrier the summed mass and inertia, unless its geoms determine them anyway."""
    # MuJoCo (mjMINVAL) drops the inertia of a fused body without mass.
    if by_body[id(body)].mass < 1e-15:
        return
    rules = world.scene.mass_rules
    both = by_body[id(carrier)] + by_body[id(body)].seen_from(body.pos, body.quat)
    bounded = any(getattr(rules, name) for name in BOUNDS)
    by_body[id(carrier)] = both
    inferred = carrier.mass is None and body.mass is None
    if not bounded and inferred and rules.inertiafromgeom is None:
        return
    if rules.inertiafromgeom is True:
        if not bounded:
            return
        node = world.nodes[id(body)]
        raise node.unbuilt("fusing bodies (fusestatic) with bounds of their inertia")
    both.give(carrier)
