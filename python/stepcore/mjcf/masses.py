"""Compute the masses of bodies as the engine will, for the reader's passes."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stepcore import _core
from stepcore.scene import frames
from stepcore.scene.elements import Body, MassRules
from stepcore.scene.frames import Vec
from stepcore.scene.layout import Layout
from stepcore.scene.records import plain

if TYPE_CHECKING:
    from stepcore.mjcf.worldbody import WorldReader
    from stepcore.scene.scene import Scene

# Sensors whose readings depend on masses, even of bodies that cannot move.
OF_MASS = ("force", "torque", "subtreecom", "subtreelinvel", "subtreeangmom", "e_potential")
NOTE = (
    "an attached model makes masses by other rules (<compiler>): bodies have the masses that their "
    "own rules make, and changed densities or sizes of geoms would not change these"
)


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
        """Return whether mass, centre of mass and inertia are bit-identical."""
        return other is not None and (
            self.mass == other.mass
            and bool((self.ipos == other.ipos).all())
            and bool((self.inertia == other.inertia).all())
        )

    def give(self, body: Body) -> None:
        """Assign these properties to a body."""
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
    touching, sensed = {id(geom.body) for geom in scene.geoms}, _senses_mass(scene)
    groups: dict[tuple[object, ...], tuple[MassRules, list[Body]]] = {}
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


def _senses_mass(scene: Scene) -> bool:
    """Return whether a sensor depends on masses or centres of mass of bodies that cannot move."""
    kinds = {(sensor.type, sensor.objtype, sensor.reftype) for sensor in scene.sensors}
    centred = any(kind != "contact" and "body" in ends for kind, *ends in kinds)
    return centred or any(kind in OF_MASS for kind, *_ in kinds)


def settle_masses(world: WorldReader) -> None:
    """Assign masses to bodies of attached models where the mass rules of the models differ.

    As in MuJoCo, a body follows the `<compiler>` of the model that defines it. A scene has one set
    of mass rules: those of the outer model, unless they would change a mass assigned here.
    """
    scene = world.scene
    groups: dict[tuple[object, ...], tuple[MassRules, list[Body]]] = {}
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
