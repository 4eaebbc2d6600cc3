"""Scenes and states under a transformation: other units, a mirror, another order, two copies.

A `Transform` is the new scene and the maps of qpos and qvel to it. Joints are given names, so that
their coordinates can be found again in another order.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import stepcore as sc
from stepcore.scene.element import field_rows

NQ = {"free": 7, "ball": 4, "slide": 1, "hinge": 1}
NV = {"free": 6, "ball": 3, "slide": 1, "hinge": 1}
TURNS = ("hinge", "ball")


@dataclass(frozen=True)
class Transform:
    """A transformed scene, and what becomes of qpos, qvel, settings and controls."""

    scene: sc.Scene
    qpos: Callable[[np.ndarray], np.ndarray]
    qvel: Callable[[np.ndarray], np.ndarray]
    settings: dict
    ctrl: Callable[[np.ndarray], np.ndarray] = np.array


def named(scene):
    """A copy whose joints, bodies and geoms all have names."""
    scene = copy.deepcopy(scene)
    for elements in (
        *(scene.joints, scene.bodies[1:], scene.geoms, scene.tendons, scene.actuators),
    ):
        kind = type(elements[0]).__name__.lower() if elements else ""
        for i, element in enumerate(elements):
            element.name = element.name or f"{kind}_{i}"
    return scene


def layout(model):
    """For each joint by name: its type, and its slices of qpos and qvel."""
    return {
        name: (kind, slice(q, q + NQ[kind]), slice(v, v + NV[kind]))
        for name, kind, q, v in zip(
            model.joint_names, model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True
        )
    }


def _by_joint(scene, of_kind):
    """The map that multiplies each joint's coordinates by `of_kind(type)`, an array."""
    factors = np.concatenate([of_kind(kind) for kind, *_ in layout(scene.compile()).values()])
    return lambda values: values * factors


# --- other units ----------------------------------------------------------------------------------


def scaled(scene, length, mass, time):
    """The scene in units 2**-length m, 2**-mass kg, 2**-time s: every number of it scaled exactly.

    A free joint's spring, damper and armature act on lengths and angles alike, and the softness
    of the laws on the guess on both kinds of rows: such scenes must keep their length.
    """

    def unit(of_length=0, of_mass=0, of_time=0):
        return 2.0 ** (of_length * length + of_mass * mass + of_time * time)

    def by(element, factor, *names):
        for name in names:
            value = getattr(element, name)
            if value is not None:
                many = isinstance(value, tuple)
                setattr(element, name, tuple(x * factor for x in value) if many else value * factor)

    def soften(element, width, suffix=""):
        first, second = getattr(element, f"solref{suffix}")
        direct = first <= 0
        factors = (unit(0, 0, -2), unit(0, 0, -1)) if direct else (unit(0, 0, 1), 1.0)
        setattr(element, f"solref{suffix}", (first * factors[0], second * factors[1]))
        solimp = list(getattr(element, f"solimp{suffix}"))
        solimp[2] *= width
        setattr(element, f"solimp{suffix}", solimp)

    scene = copy.deepcopy(scene)
    scene.gravity = tuple(x * unit(1, 0, -2) for x in scene.gravity)
    scene.density *= unit(-3, 1)
    scene.viscosity *= unit(-1, 1, -1)
    scene.wind = tuple(x * unit(1, 0, -1) for x in scene.wind)
    for body in scene.bodies:
        by(body, unit(1), "pos", "ipos")
        by(body, unit(0, 1), "mass")
        by(body, unit(2, 1), "inertia")
    for joint in scene.joints:
        turns = joint.type in TURNS
        mixed = (joint.stiffness, joint.damping, joint.armature, joint.frictionloss)
        assert joint.type != "free" or length == 0 or not any(mixed), "has no unit"
        arm, reach = (unit(2), 1.0) if turns else (1.0, unit(1))
        by(joint, unit(1), "pos")
        by(joint, reach, "range", "margin", "ref", "springref")
        by(joint, unit(0, 1, -2) * arm, "stiffness")
        by(joint, unit(0, 1, -1) * arm, "damping")
        by(joint, unit(0, 1) * arm, "armature")
        if joint.springdamper is not None:
            joint.springdamper = (joint.springdamper[0] * unit(0, 0, 1), joint.springdamper[1])
        by(joint, unit(2, 1, -2) if turns else unit(1, 1, -2), "frictionloss")
        by(joint, unit(2, 1, -2) if turns else unit(1, 1, -2), "actuatorfrcrange")
        soften(joint, reach, "limit")
        soften(joint, 1.0, "friction")
    for geom in scene.geoms:
        by(geom, unit(1), "size", "pos", "margin", "gap")
        by(geom, unit(0, 1), "mass")
        by(geom, unit(1, 1, -2), "adhesion")
        by(geom, unit(-2 if geom.shellinertia else -3, 1), "density")
        moves, turns = geom.surfacevel[:3], geom.surfacevel[3:]
        geom.surfacevel = (
            *(x * unit(1, 0, -1) for x in moves),
            *(x * unit(0, 0, -1) for x in turns),
        )
        slide, spin, roll = geom.friction
        geom.friction = (slide, spin * unit(1), roll * unit(1))
        soften(geom, unit(1))
    for site in scene.sites:
        by(site, unit(1), "pos", "size")
    for tendon in scene.tendons:
        # One over joints has the unit of an angle: the coefficients of slides turn theirs into it.
        way, arm = (1.0, unit(2)) if tendon.fixed else (unit(1), 1.0)
        if tendon.fixed:
            tendon.path = [
                (joint, coef if joint.type in TURNS else coef / unit(1))
                for joint, coef in tendon.path
            ]
        if tendon.springlength != (-1.0, -1.0):
            by(tendon, way, "springlength")
        by(tendon, way, "range", "margin")
        by(tendon, unit(0, 1, -2) * arm, "stiffness")
        by(tendon, unit(0, 1, -1) * arm, "damping")
        for field, rate in (("stiffnesspoly", -2), ("dampingpoly", 0)):
            per = unit(0, 0, 1) if field == "dampingpoly" else 1.0
            b, c = getattr(tendon, field)
            first = unit(0, 1, rate) * arm / way
            setattr(tendon, field, (b * first, c * first * per / way))
        by(tendon, unit(0, 1) * arm, "armature")
        by(tendon, unit(1, 1, -2) * arm / (unit(1) if tendon.fixed else 1.0), "frictionloss")
        by(tendon, unit(2, 1, -2) / way, "actuatorfrcrange")
        soften(tendon, way, "limit")
        soften(tendon, 1.0, "friction")
    for actuator in scene.actuators:
        _scale_actuator(actuator, unit, by)
    for pair in scene.pairs:
        by(pair, unit(1), "margin", "gap")
        by(pair, unit(1, 1, -2), "adhesion")
        sliding, turning = pair.friction[:2], pair.friction[2:]
        pair.friction = (*sliding, *(x * unit(1) for x in turning))
        soften(pair, unit(1))
        assert pair.solreffriction is None, "is scaled as its solref is: not done here"
    for equality in scene.equalities:
        by(equality, unit(1), "anchor")
        if equality.relpose is not None:
            pos, quat = equality.relpose[:3], equality.relpose[3:]
            equality.relpose = (*(x * unit(1) for x in pos), *quat)
        own, other = (
            unit(1) if _is_way(joint, tendon) else 1.0
            for joint, tendon in (
                (equality.joint1, equality.tendon1),
                (equality.joint2, equality.tendon2),
            )
        )
        equality.polycoef = [c * own / other**k for k, c in enumerate(equality.polycoef)]
        # What holds turns and ways at once has one impedance, whatever its unit.
        assert equality.type != "weld" or equality.solimp[0] == equality.solimp[1] or not length
        soften(equality, own if equality.type in ("joint", "tendon") else unit(1))
    by(scene.mass_rules, unit(0, 1), "boundmass")
    by(scene.mass_rules, unit(2, 1), "boundinertia")
    if scene.mass_rules.settotalmass > 0:
        by(scene.mass_rules, unit(0, 1), "settotalmass")
    scene.keys.clear()

    ones = np.ones
    positions = {
        "free": np.r_[unit(1) * ones(3), ones(4)],
        "ball": ones(4),
        "slide": unit(1) * ones(1),
        "hinge": ones(1),
    }
    speeds = {
        "free": np.r_[unit(1, 0, -1) * ones(3), unit(0, 0, -1) * ones(3)],
        "ball": unit(0, 0, -1) * ones(3),
        "slide": unit(1, 0, -1) * ones(1),
        "hinge": unit(0, 0, -1) * ones(1),
    }
    dimensions = {
        "dt": unit(0, 0, 1),
        "tolerance": unit(1, 0, -1),
        "cost_tolerance": unit(2, 0, -4),
        "softness": unit(0, -1),
        "slop": unit(1),
        "penalty_stiffness": unit(0, 1, -2),
    }
    settings = scene.settings
    scaled_settings = {name: getattr(settings, name) * x for name, x in dimensions.items()}
    if settings.max_recovery_speed != "none":
        speed = settings.max_recovery_speed
        # The default of laws on velocities is a speed like any other; solref has none.
        speed = (3.0 if settings.law != "solref" else 1e6) if speed == "auto" else speed
        scaled_settings["max_recovery_speed"] = speed * unit(1, 0, -1)
    scene.options.update(scaled_settings)
    return Transform(
        scene, _by_joint(scene, positions.get), _by_joint(scene, speeds.get), scaled_settings
    )


def _scale_actuator(actuator, unit, by):
    """Scales an actuator so that controls keep their numbers.

    Its length, gear × that of its target, takes the unit `length`: none for a servo; that of the
    activation, a time, where a control is a rate; one that leaves the force a number for a motor.
    Force × length is an energy.
    """
    time, energy = unit(0, 0, 1), unit(2, 1, -2)
    if actuator.feeds is not None:
        return
    if actuator.body is not None:
        by(actuator, unit(1, 1, -2), "gain", "gainprm", "forcerange")
        return
    rate = actuator.type == "intvelocity" or actuator.dyntype == "integrator"
    length = time if rate or "vel" in (actuator.input, actuator.type[:3]) else 1.0
    forces = actuator.type == "motor" or actuator.input == "ff"
    length = energy if forces else length
    ways = _ways(actuator, unit(1))
    if actuator.tendon is not None and actuator.type == "general":
        # Its gear stays: a tendon bounds the sum of forces before their gears.
        length = ways[0]
    force, speed = energy / length, length / time
    actuator.gear = tuple(x * length / way for x, way in zip(actuator.gear, ways, strict=True))
    by(actuator, unit(1), "cranklength")
    by(actuator, force, "forcerange", "force", "area")
    by(actuator, force / length, "kp")
    by(actuator, force / speed, "kv", "damping")
    by(actuator, force / speed * time, "armature")
    for field, of in (("actrange", length if rate else 1.0), ("lengthrange", length)):
        by(actuator, of, field)
    if actuator.type != "dcmotor":
        by(actuator, 1 / time, "vmax")
    _scale_controller(actuator, (force, length, time), by)
    by(actuator, time, "timeconst", "delay")
    by(actuator, 1 / speed, "motorconst")
    by(actuator, 1 / (speed * force), "resistance")
    # Of its target's velocity, as that one's own coefficients are.
    powers = zip(actuator.dampingpoly, (1, 2), strict=True)
    per = ways[0] / time
    actuator.dampingpoly = tuple(x * force / speed / per**power for x, power in powers)
    terms = (force, force / length, force / speed)
    for field, per in (("bias", 1.0), ("biasprm", 1.0), ("gainprm", length if rate else 1.0)):
        value = getattr(actuator, field)
        if value is not None:
            value = value if isinstance(value, tuple) else (value,)
            scaled = tuple(x * term / per for x, term in zip(value, terms, strict=False))
            setattr(actuator, field, (*scaled, *value[3:]))
    if actuator.dyntype in ("filter", "filterexact"):
        actuator.dynprm = (actuator.dynprm[0] * time, *actuator.dynprm[1:])


def _scale_controller(actuator, units, by):
    """Scales what a pid and a dcmotor have of their own; volts and degrees are numbers."""
    force, length, time = units
    speed, current = length / time, force * length / time
    by(actuator, force / (length * time), "ki")
    by(actuator, length * time, "imax")
    by(actuator, 1 / time, "slewmax")
    by(actuator, time / current, "inductance")
    by(actuator, current / time, "current_rate")
    for field, terms in {
        "thermal": (1 / current, current * time, 1, 1, 1),
        "cogging": (force, 1 / length, 1),
        "lugre": (force / length, force / speed, force, force, speed),
    }.items():
        value = getattr(actuator, field)
        if value is not None:
            setattr(actuator, field, tuple(np.multiply(value, terms)))


def _ways(actuator, length):
    """Of each number of its gear: `length` if it goes with a way, 1 if with an angle."""
    field, target = actuator.target
    if field in ("joint", "jointinparent"):
        if target.type == "free":
            return [length] * 3 + [1.0] * 3
        return [length if target.type == "slide" else 1.0] * 6
    if field == "site":
        return [length] * 3 + [1.0] * 3
    return [1.0 if field == "tendon" and target.fixed else length] * 6


def _is_way(joint, tendon):
    """What an equality ties is a length, and not an angle."""
    if tendon is not None:
        return not tendon.fixed
    return joint is not None and joint.type == "slide"


# --- a mirror -------------------------------------------------------------------------------------

MIRROR = np.array([1.0, -1.0, 1.0])
# A rotation, an angular velocity: what turns about an axis turns the other way.
AXIAL = -MIRROR
TURNED = np.r_[1.0, AXIAL]


def mirrored(scene):
    """The scene in a mirror, the plane y = 0."""
    scene = copy.deepcopy(scene)
    scene.gravity = tuple(scene.gravity * MIRROR)
    scene.wind = tuple(scene.wind * MIRROR)
    for body in scene.bodies:
        body.pos, body.quat, body.ipos = body.pos * MIRROR, body.quat * TURNED, body.ipos * MIRROR
        body.inertia = np.array(body.inertia) * [1, 1, 1, -1, 1, -1]
        if body.iquat is not None:
            body.iquat = body.iquat * TURNED
    for joint in scene.joints:
        joint.pos = joint.pos * MIRROR
        joint.axis = joint.axis * (MIRROR if joint.type == "slide" else AXIAL)
    for placed in (*scene.geoms, *scene.sites):
        placed.pos, placed.quat = placed.pos * MIRROR, placed.quat * TURNED
    for geom in scene.geoms:
        geom.surfacevel = geom.surfacevel * np.r_[MIRROR, AXIAL]
    for actuator in scene.actuators:
        field, target = actuator.target
        kind = target.type if field in ("joint", "jointinparent") else field
        if kind in ("free", "site"):
            actuator.gear = actuator.gear * np.r_[MIRROR, AXIAL]
        if kind == "ball":
            actuator.gear = actuator.gear * np.r_[AXIAL, 1, 1, 1]
    for equality in scene.equalities:
        equality.anchor = equality.anchor * MIRROR
        if equality.relpose is not None:
            equality.relpose = equality.relpose * np.r_[MIRROR, TURNED]
    scene.keys.clear()
    signs = np.array([_mirrored_part(actuator) for actuator in scene.actuators])
    one = np.ones(1)
    positions = {"free": np.r_[MIRROR, TURNED], "ball": TURNED, "slide": one, "hinge": one}
    speeds = {"free": np.r_[MIRROR, AXIAL], "ball": AXIAL, "slide": one, "hinge": one}
    by_joint = [_by_joint(scene, table.get) for table in (positions, speeds)]
    return Transform(scene, *by_joint, {}, lambda ctrl: ctrl * signs)


def _mirrored_part(actuator):
    """The sign of a part of an orientation; 1 for other controls."""
    if (actuator.feeds or actuator).type != "orientation":
        return 1.0
    part = actuator.input if actuator.feeds else actuator.inputs[0]
    return dict(zip("wxyz", TURNED, strict=True))[part]


# --- another order, two copies --------------------------------------------------------------------


def reordered(scene):
    """The same scene, its bodies and geoms listed the other way round."""
    scene = named(scene)
    before = layout(scene.compile())
    other = copy.deepcopy(scene)
    other.bodies[1:] = other.bodies[:0:-1]
    other.geoms.reverse()
    other.equalities.reverse()
    other.tendons.reverse()
    other.actuators.reverse()
    other.pairs.reverse()
    after = layout(other.compile())

    def map_by(part):
        def apply(values):
            out = np.empty_like(values)
            for name, spans in after.items():
                out[spans[part]] = values[before[name][part]]
            return out

        return apply

    other.keys.clear()
    return Transform(other, map_by(1), map_by(2), {})


def doubled(scene):
    """Two copies of the scene in one, that cannot touch each other; `qpos` sets both alike."""
    scene = copy.deepcopy(scene)
    scene.keys.clear()
    twin = copy.deepcopy(scene)
    for geom in twin.geoms:
        geom.contype, geom.conaffinity = geom.contype << 16, geom.conaffinity << 16
    lists = (twin.bodies, twin.joints, twin.geoms, twin.sites, twin.tendons, twin.actuators)
    for elements in (*lists, twin.equalities, twin.pairs):
        for element in elements:
            element.name = element.name and f"{element.name}_twin"
    world = scene.bodies[0]
    for body in twin.bodies[1:]:
        if body.parent is twin.bodies[0]:
            body.parent = world
        scene.bodies.append(body)
    for mine, theirs in (
        (scene.joints, twin.joints),
        (scene.geoms, twin.geoms),
        (scene.sites, twin.sites),
        (scene.tendons, twin.tendons),
        (scene.actuators, twin.actuators),
        (scene.equalities, twin.equalities),
        (scene.pairs, twin.pairs),
    ):
        for element in theirs:
            for field in field_rows(type(element)):
                if getattr(element, field) is twin.bodies[0]:
                    setattr(element, field, world)
            mine.append(element)
    swap = {id(twin.bodies[0]): world}
    scene.excludes += [(swap.get(id(a), a), swap.get(id(b), b)) for a, b in twin.excludes]

    def twice(values):
        return np.concatenate([values, values])

    return Transform(scene, twice, twice, {})
