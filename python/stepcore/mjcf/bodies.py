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
from stepcore.checks import cut
from stepcore.mjcf.nodes import below, inside, sections
from stepcore.mjcf.sections import Shape, WorldReader
from stepcore.mjcf.validation import references
from stepcore.scene import frames
from stepcore.scene.elements import Body, Geom, Joint, MassRules, Site
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout
from stepcore.scene.records import plain

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

OF_MASS = ("force", "torque", "subtreecom", "subtreelinvel", "subtreeangmom", "e_potential")
NOTE = (
    "an attached model makes masses by other rules (<compiler>): bodies have the masses that their "
    "own rules make, and changed densities or sizes of geoms would not change these"
)


# Bodies by mass rules; the keys are the values of the rules.
Groups = dict[tuple[object, ...], tuple[MassRules, list[Body]]]


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

    def equals(self, other: Weight | None) -> bool:
        return other is not None and (
            self.mass == other.mass
            and bool((self.ipos == other.ipos).all())
            and bool((self.inertia == other.inertia).all())
        )

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
    tables = _core.compile(plain(Layout(part))).tables()
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
    groups: Groups = {}
    for body in scene.bodies:
        rules = world.rules_of(body)
        counts = sensed or id(body) in touching or rules.boundmass > 0 or rules.boundinertia > 0
        if counts and body.mass is None and id(body) in world.written:
            unbounded = MassRules(**(rules.values() | {"boundmass": 0.0, "boundinertia": 0.0}))
            key = tuple(unbounded.values().values())
            groups.setdefault(key, (unbounded, []))[1].append(body)
    for unbounded, bodies in groups.values():
        known = weights(scene, bodies, unbounded)
        for body in bodies:
            if known[id(body)].mass == 0.0:
                pos, quat = world.written[id(body)]
                Weight(0.0, np.array(pos), np.zeros((3, 3)), quat).give(body)


def settle_masses(world: WorldReader) -> None:
    """Assign masses to bodies of attached models where the mass rules of the models differ.

    As in MuJoCo, a body follows the `<compiler>` of the model that defines it. A scene has one set
    of mass rules: those of the outer model, unless they would change a mass assigned here.
    """
    scene = world.scene
    groups: Groups = {}
    for body in Layout(scene).bodies[1:]:
        rules = world.rules_of(body)
        groups.setdefault(_for_one_body(rules), (rules, []))[1].append(body)
    if not groups.keys() - {_for_one_body(scene.mass_rules)}:
        return
    kept = scene.mass_rules
    if kept.inertiafromgeom is True or kept.boundmass > 0 or kept.boundinertia > 0:
        kept = MassRules(settotalmass=kept.settotalmass)
    settled = False
    for rules, bodies in groups.values():
        if _for_one_body(rules) == _for_one_body(kept):
            continue
        known, otherwise = weights(scene, bodies, rules), _weights_if(kept, scene, bodies)
        for body in bodies:
            if not known[id(body)].equals(otherwise.get(id(body))):
                settled = True
                known[id(body)].give(body)
    scene.mass_rules = kept
    world.settled = True
    if settled:
        scene.notes.append(NOTE)


def _for_one_body(rules: MassRules) -> tuple[object, ...]:
    """Return the rules that concern a single body: all but settotalmass."""
    return tuple((rules.values() | {"settotalmass": None}).values())


def _weights_if(rules: MassRules, scene: Scene, bodies: list[Body]) -> dict[int, Weight]:
    """Return the mass properties by ``id`` of the bodies that these rules accept."""
    try:
        return weights(scene, bodies, rules)
    except ValueError:
        if len(bodies) == 1:
            return {}
    # One rejected body does not affect the others, so compute the bodies one by one.
    return {key: w for body in bodies for key, w in _weights_if(rules, scene, [body]).items()}


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
        if id(body) in kept:
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
    for element in (*layout.geoms, *layout.sites):
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


def _kept_apart(world: WorldReader) -> set[int]:
    """Return the ids of the bodies that are not fused, whatever their masses."""
    scene, root = world.scene, world.root
    # A body that an element refers to by name.
    named = {name for node in below(root) for _, kind, name in references(node) if kind == "body"}
    # A force or torque sensor measures the load from the parent of its body.
    sensors = inside(root, "sensor")
    measured = {node.attrs.get("site") for node in sensors if node.tag in ("force", "torque")}
    return (
        {id(joint.body) for joint in scene.joints}
        | {id(body) for body in scene.bodies if body.name and body.name in named}
        | {id(site.body) for site in scene.sites if site.name and site.name in measured}
    )


def _may_fuse(
    world: WorldReader, body: Body, carrier: Body, known: dict[int, Weight], fluid: bool
) -> bool:
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
