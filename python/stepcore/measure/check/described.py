"""Findings on the description of a scene: units, masses, ranges, keyframes and gains."""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore.engine.actuator import Actuator, actuators, hold_load
from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.experiment.horizon import LONGEST_RUN, PILOT_STEPS
from stepcore.experiment.proposal import Proposal
from stepcore.experiment.schedule import HORIZON
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.finding import (
    DEEP,
    FEW,
    HALF,
    PLOT,
    SEEN,
    Finding,
    Next,
    Proposals,
    listed,
    named,
    worst,
)
from stepcore.measure.monitors.joints import (
    coordinate,
    length_of,
    limit_proposals,
    unit_of,
    width_of,
)
from stepcore.measure.monitors.recording import Recording, followed, free_bodies
from stepcore.measure.monitors.servos import gained, strength
from stepcore.measure.monitors.soft_rows import yielding
from stepcore.report.units import (
    FORCES,
    TORQUES,
    metres,
    quantity,
    rounded,
    times,
)
from stepcore.scene.elements import Geom
from stepcore.scene.layout import Layout

# Size of moving geoms above which millimetres are likely [m]; boxes.xml has 56 m.
LARGE = 10.0
# Inertia below which units are too large [kg·m²]: ten times MuJoCo's mjMINVAL. A worm of 2e-15
# fails there with a rank-deficient Hessian, one of 2e-13 trains well (MuJoCo's issue 1086).
TINY = 1e-14
# Range of the densities of solids [kg/m³], from less than air to more than osmium.
SOLID = (1.0, 25_000.0)
# Largest excess of a keyframe, relative to the range: keyframes are written on purpose, and only
# the rounding of their numbers may be outside. kitchen_env_model.xml has 0.19 %.
KEYED = 1e-3
# Names of links and joints of legs and wheels, in lower case: FL_foot, left_knee, RR_wheel.
FOOT = re.compile(r"foot|feet|ankle|calf|shank|thigh|knee|wheel|(?<![a-z])(leg|toe)s?(?![a-z])")
# The kind of a finding on a motion that grows at every time step.
ENDLESS = "ball joint"
LIST = (Next("plan", "every body, geom and row that a step computes", ("--all",)),)


@dataclass(frozen=True, eq=False)
class Described:
    """A scene, its start and the controls there; key: the index of the start's keyframe."""

    model: Model
    start: Start
    ctrl: Floats
    key: int | None = None

    @functools.cached_property
    def layout(self) -> Layout:
        return Layout(self.model.scene)

    @functools.cached_property
    def moving(self) -> list[int]:
        """The bodies that can move."""
        return Coordinates(self.model).moving

    @functools.cached_property
    def sizes(self) -> Sizes:
        return Sizes(self.model)

    @functools.cached_property
    def drives(self) -> list[Actuator]:
        """The actuators that drive one joint without delay."""
        acts = self.model.scene.features.actuation
        return [of for of in actuators(self.model) if of.direct] if acts else []

    @property
    def keys(self) -> list[tuple[str, Floats, Floats]]:
        """The keyframes: name, positions and controls."""
        frames = enumerate(self.model.keys)
        return [(f"Keyframe `{frame.name or k}`", frame.qpos, frame.ctrl) for k, frame in frames]

    def geoms(self, body: int, heavy: bool = False) -> dict[int, Geom]:
        """Return a body's geoms by index; heavy: only those that give it mass."""
        low, high = self.model.scene.mass_rules.inertiagrouprange
        mine = np.flatnonzero(self.model.geom_body == body).tolist()
        every = {index: self.layout.geoms[index] for index in mine}
        if not heavy:
            return every
        return {
            index: geom
            for index, geom in every.items()
            if geom.mass != 0 and (geom.mass or geom.density) > 0 and low <= geom.group <= high
        }


def described(scene: Described) -> Iterator[Finding]:
    """Yield the findings on the description of a scene."""
    for find in FINDINGS:
        if scene.model.scene.features.limit or find not in OF_LIMITS:
            yield from find(scene)


# The base.


def _fixed_base(scene: Described) -> Iterator[Finding]:
    """Yield a robot of a URDF that has legs or wheels and a base fixed to the world."""
    model, source = scene.model, scene.model.scene._source
    if source is None or not source.urdf:
        return
    # For each moving body: the body with which its limb begins; bodies come after their parents.
    first = dict[int, int]()
    for body in scene.moving:
        first[body] = first.get(int(model.body_parent[body]), body)
    joints = [(int(body), k) for k, body in enumerate(model.jnt_body)]
    if any(model.jnt_type[k] != "hinge" for body, k in joints if first[body] == body):
        return
    names = [*((body, model.joint_names[k]) for body, k in joints), *enumerate(model.body_names)]
    names += [(model.index("body", into), name) for name, into in model.scene.fused.items()]
    limbs = {first[body] for body, name in names if body in first and FOOT.search(name.lower())}
    if len(limbs) > 1:
        elements = named(model, "body", sorted(limbs))
        problem = (
            f"{listed(elements, 'body')} look like legs or wheels, and the base is fixed to the "
            "world, as in every URDF without a floating joint"
        )
        fix = "--free adds a free joint and --ground a floor (load(..., free=True, ground=True))"
        yield Finding("fixed base", "warning", problem, fix, elements, commands=LIST)


# Units.


def _lengths(scene: Described) -> Iterator[Finding]:
    """Yield a scene whose lengths look like millimetres."""
    model = scene.model
    on_moving = np.isin(model.geom_body, scene.moving) & np.isfinite(scene.sizes.reach)
    gravity = float(np.linalg.norm(model.scene.gravity)) if model.scene.features.gravity else 0.0
    # Gravity is as on the Moon to Jupiter, so it was not scaled together with lengths.
    if not on_moving.any() or not 1 < gravity < 50:
        return
    typical = float(np.median(np.array(scene.sizes.reach)[on_moving]))
    if typical >= LARGE:
        problem = (
            f"Half of the geoms that move are larger than {metres(typical)}, under a gravity of "
            f"{gravity:.3g} m/s², so sizes and positions look like mm"
        )
        fix = (
            "divide lengths by 1000 (masses that come from density fall by 1e9), or check that the "
            "scene is meant to be so large"
        )
        yield Finding("units", "error", problem, fix, (), typical, "m", LIST)


def _tiny(scene: Described) -> Iterator[Finding]:
    """Yield bodies whose inertia is lost in rounding, or refused by MuJoCo."""
    model = scene.model
    least = {
        body: float(np.linalg.eigvalsh(np.asarray(model.body_inertia[body]))[0])
        for body in scene.moving
        if model.body_mass[body] > 0
    }
    tiny = worst((b for b in least if least[b] > 0), lambda body: TINY / least[body])
    if tiny:
        bodies, value = named(model, "body", tiny), least[tiny[0]]
        problem = (
            f"{listed(bodies, 'body')} has an inertia of {value:.2g} kg·m²; MuJoCo refuses less "
            "than 1e-15, and its solver loses rank near that"
        )
        fix = (
            "write lengths in mm and masses in g, with gravity and lengths × 1e3, masses × 1e3, "
            "and gains, stiffness, damping and torques of hinges × 1e9"
        )
        yield Finding("units", "warning", problem, fix, bodies, value, "kg·m²", LIST)


def _angles(scene: Described) -> Iterator[Finding]:
    """Yield hinge ranges that look like radians read as degrees."""
    model = scene.model
    if not model.scene.features.limit:
        return
    finite = np.isfinite(model.jnt_range).all(axis=1)
    joints = [k for k, kind in enumerate(model.jnt_type) if kind == "hinge" and finite[k]]
    ranges = np.degrees(model.jnt_range[joints])
    most = float(np.abs(ranges).max(initial=0.0))
    # At most one turn of 2π, and seldom less than a half.
    if HALF <= most <= 2 * math.pi * (1 + SEEN):
        hinges, (low, high) = named(model, "joint", joints), ranges[0]
        problem = (
            f"the range of {listed(hinges, 'joint')} is {low:.4g} to {high:.4g} degrees, as if "
            "radians were meant"
        )
        fix = 'write <compiler angle="radian"/>'
        yield Finding("units", "warning", problem, fix, hinges, most, "deg", LIST)


def _degrees(scene: Described) -> Iterator[Finding]:
    """Yield servos whose control range is the joint's range in degrees; MuJoCo converts none."""
    model, wrong = scene.model, []
    for of in actuators(model):
        if of.holds and of.joint is not None and model.jnt_type[of.joint] == "hinge":
            limit = float(np.degrees(np.abs(model.jnt_range[of.joint]).max()))
            most = float(np.abs(model.actuator_ctrlrange[of.index]).max())
            if math.isfinite(limit) and abs(most - limit) < DEEP * limit:
                wrong.append(of.index)
    if wrong:
        servos, (low, high) = named(model, "actuator", wrong), model.actuator_ctrlrange[wrong[0]]
        problem = (
            f"the ctrlrange of {listed(servos, 'servo')} is {low:.4g} to {high:.4g} rad, its "
            "joint's range in degrees"
        )
        fix = (
            "control ranges are in radians whatever the compiler's angle; multiply degrees by π/180"
        )
        value = float(max(abs(low), abs(high)))
        yield Finding("units", "error", problem, fix, servos, value, "rad", LIST)


# Masses.


def volume(model: Model, geom: Geom, index: int) -> float:
    """Return the volume of a geom [m³], for a mesh of its hull; inf for planes and hfields."""
    if geom.type == "mesh":
        vertices, triangles = model.geom_hull(index)
        if not len(triangles):
            return math.inf
        # A closed surface is a sum of tetrahedra.
        a, b, c = np.moveaxis(vertices[triangles] - vertices[0], 1, 0)
        return float(np.sum(a * np.cross(b, c))) / 6
    a, b, c = geom.size if geom.type != "hfield" else (math.inf,) * 3
    ball = 4 / 3 * math.pi
    return {
        "sphere": ball * a**3,
        "capsule": ball * a**3 + 2 * b * math.pi * a**2,
        "ellipsoid": ball * a * b * c,
        "cylinder": 2 * b * math.pi * a**2,
        "box": 8 * a * b * c,
    }.get(geom.type, math.inf)


def _densities(scene: Described) -> Iterator[Finding]:
    """Yield bodies whose geoms give them an implausible density."""
    model, density = scene.model, dict[int, float]()
    for body in scene.moving:
        given = scene.layout.bodies[body].mass is not None
        if given and not model.scene.mass_rules.inertiafromgeom:
            continue
        geoms = scene.geoms(body, heavy=True)
        filled = sum(volume(model, geom, index) for index, geom in geoms.items())
        hollow = any(geom.shellinertia for geom in geoms.values())
        if filled and math.isfinite(filled) and not hollow:
            density[body] = float(model.body_mass[body]) / filled
    massive = {body: value for body, value in density.items() if value}
    dense = worst(massive, lambda body: density[body] / SOLID[1])
    light = worst(massive, lambda body: SOLID[0] / density[body])
    for wrong, than in ((dense, "{} the density of water"), (light, "lighter than air")):
        if wrong:
            value, bodies = density[wrong[0]], named(model, "body", wrong)
            # Relative to water, 1000 kg/m³.
            than = than.format(times(value / 1000))
            problem = (
                f"{listed(bodies, 'body')} has {float(model.body_mass[wrong[0]]):.3g} kg in its "
                f"geoms, {value:.3g} kg/m³, which is {than}"
            )
            fix = "check mass, density and size of its geoms"
            yield Finding("density", "remark", problem, fix, bodies, value, "kg/m³", LIST)


# Starts and keyframes.


def _beyond(scene: Described) -> Iterator[Finding]:
    """Yield joints and tendons that the start or a keyframe places outside of their limits."""
    model, known = scene.model, set[Element]()
    sim = Sim(model)
    states = [(name, qpos, KEYED) for name, qpos, _ in scene.keys]
    if scene.key is None:
        # Rest poses are often slightly outside.
        states.insert(0, ("The start", scene.start.qpos, SEEN))
    for name, qpos, slack in states:
        sim.qpos = qpos
        values = [coordinate(model, qpos[None], joint)[0] for joint in range(model.njnt)]
        lengths = sim.ten_length.tolist() if model.ntendon else []
        for kind, each, ranges in (
            ("joint", values, model.jnt_range),
            ("tendon", lengths, model.tendon_range),
        ):
            finding = _outside(model, kind, np.array(each), ranges, name, slack)
            # Keyframes of one series are often outside in the same joints.
            if finding is not None and not known.issuperset(finding.elements):
                known.update(finding.elements)
                yield finding


def _outside(
    model: Model, kind: str, values: Floats, ranges: Floats, where: str, slack: float
) -> Finding | None:
    """Return a finding on joints or tendons that are outside of their ranges, or None."""
    # Without a limit the range is infinite.
    limited = [k for k in range(len(values)) if np.isfinite(ranges[k]).all()]
    over = {k: max(ranges[k][0] - values[k], values[k] - ranges[k][1]) for k in limited}
    # A locked joint or tendon counts as 1 rad or 1 m wide.
    share = {k: float(over[k] / (np.ptp(ranges[k]) or 1.0)) for k in limited}
    outside = worst(limited, lambda k: share[k] / slack)
    if not outside:
        return None
    k, keyed, elements = outside[0], slack == KEYED, named(model, kind, outside)
    value, (low, high) = float(values[k]), ranges[k].tolist()
    say: Callable[[float], str] = functools.partial(length_of, model, k)
    unit, at = "m", "at"
    fix = "correct its qpos" if keyed else "give a keyframe, or correct its ref"
    fix += f" (the nearest is {low if value < low else high:.4g})"
    if kind == "joint":
        unit = unit_of(model, k)
    else:
        # The length of a fixed tendon, a sum of joints, has no unit.
        at, fix = "at a length of", "correct the pose"
        unit = "" if model.scene.tendons[k].path.fixed else "m"
        say = metres if unit else "{:.4g}".format
    beyond = "outside of" if share[k] > 2 * SEEN else f"{say(float(over[k]))} beyond"
    problem = (
        f"{where} has {listed(elements, kind)} {at} {say(value)}, {beyond} its range "
        f"of {say(low)} to {say(high)}, whose limit throws it back"
    )
    severity = "error" if keyed else "warning"
    severity = severity if share[k] > 2 * SEEN else "remark"
    fix = f"{fix}, or widen the range"
    return Finding("outside a limit", severity, problem, fix, elements, value, unit)


def _clamped(scene: Described) -> Iterator[Finding]:
    """Yield controls of keyframes that will be clamped."""
    model, (low, high) = scene.model, scene.model.actuator_ctrlrange.T
    for name, _, ctrl in scene.keys if model.nu and model.scene.features.clampctrl else ():
        over = np.maximum(low - ctrl, ctrl - high) / (1e-9 * np.maximum(1.0, np.abs(ctrl)))
        outside = worst(range(model.nu), over.__getitem__)
        if outside:
            k, elements = outside[0], named(model, "actuator", outside)
            problem = (
                f"{name} has a control of {ctrl[k]:.4g} for {listed(elements, 'actuator')}, "
                f"clamped to its ctrlrange of {low[k]:.4g} to {high[k]:.4g}"
            )
            fix, value = "correct its ctrl, or widen the ctrlrange", float(ctrl[k])
            yield Finding("clamped control", "warning", problem, fix, elements, value, "", PLOT)


def _asked_beyond(scene: Described) -> Iterator[Finding]:
    """Yield servos whose target in a keyframe is beyond the range of their joint."""
    model = scene.model
    limited = np.isfinite(model.jnt_range).all(axis=1)
    servos = {of.index: of for of in scene.drives if of.holds and limited[of.joint]}
    for name, _, ctrl in scene.keys:
        asked, over = dict[int, float](), dict[int, float]()
        for k, of in servos.items():
            low, high = model.jnt_range[of.joint].tolist()
            asked[k] = float(of.target(np.clip(ctrl[k], *of.ctrlrange))) / of.gear
            over[k] = max(low - asked[k], asked[k] - high) / (SEEN * (high - low))
        beyond = worst(over, over.__getitem__)
        if not beyond:
            continue
        k, joint, elements = beyond[0], servos[beyond[0]].joint, named(model, "actuator", beyond)
        assert joint is not None
        say, (low, high) = functools.partial(length_of, model, joint), model.jnt_range[joint]
        problem = (
            f"{name} asks {listed(elements, 'servo')} for {say(asked[k])}, beyond the range of "
            f"{model.element_name('joint', joint)} ({say(low)} to {say(high)}), so it presses on "
            "the limit"
        )
        fix, unit = "correct its ctrl, unless it is meant to press", unit_of(model, joint)
        what = "control beyond a limit", "remark", problem, fix, elements, asked[k], unit
        yield Finding(*what)


# Actuators.


def _overpowered(scene: Described) -> Iterator[Finding]:
    """Yield actuators that can push their joint far beyond its limit.

    The excess is the closed form of a soft row under the actuator's largest outward force. Gravity
    and other actuators are left out.
    """
    model, settings = scene.model, scene.model.settings
    beyond, force = dict[int, float](), dict[int, float]()
    drives = {of.index: of for of in scene.drives} if settings.law == "solref" else {}
    for k, of in drives.items():
        assert of.joint is not None
        force[k], _, _ = _outward(model, of)
        if 0 < force[k] / of.inertia < math.inf:
            joint, dt = scene.layout.joints[of.joint], settings.dt * settings.refsafe
            row = joint.solreflimit, joint.solimplimit
            beyond[k] = yielding(*row, force[k] / of.inertia, dt)
    strong = worst(beyond, lambda k: beyond[k] / (FEW * width_of(model, drives[k].joint or 0)))
    if not strong:
        return
    k, of = strong[0], drives[strong[0]]
    assert of.joint is not None
    elements = named(model, "actuator", strong)
    problem = (
        f"{listed(elements, 'actuator')} can push {model.element_name('joint', of.joint)} "
        f"{length_of(model, of.joint, beyond[k])} beyond its range with "
        f"{strength(model, k, force[k])}"
    )
    fix = f"a smaller {'forcerange' if of.holds else 'ctrlrange'} of {elements[0].name}"
    limits, unit = named(model, "limit", [of.joint]), unit_of(model, of.joint)

    def again(other: Model) -> Recording:
        """Run the actuator as it pushes its joint beyond the end of its range."""
        _, end, control = _outward(other, actuators(other)[k])
        qpos, ctrl = np.array(scene.start.qpos), np.zeros((1, 1, other.nu))
        # A control without a range exceeds any force range.
        qpos[of.qposadr], ctrl[0, 0, k] = end, np.clip(control, -1e6, 1e6)
        steps = max(1, min(round(HORIZON / other.settings.dt), PILOT_STEPS))
        return followed(other, dataclasses.replace(scene.start, qpos=qpos), steps, ctrl=ctrl)

    proposals = dataclasses.replace(limit_proposals(model, of.joint, beyond[k]), again=again)
    yield Finding(
        "limit", "warning", problem, fix, limits, beyond[k], unit, PLOT, proposals=proposals
    )


def _outward(model: Model, of: Actuator) -> tuple[float, float, float]:
    """Return an actuator's largest force outwards of its joint's range, the end, and the control.

    The force is 0 if it is unbounded: a servo without a control range is not meant to push.
    """
    controls, ends = of.ctrlrange, model.jnt_range[of.joint].tolist()
    if not np.isfinite(controls).all():
        controls = -np.inf, np.inf
        if of.holds or not np.isfinite(of.forcerange).all():
            ends = []
    each = [
        (sign * of.gear * float(np.clip(of.force(u, of.gear * end), *of.forcerange)), end, u)
        for sign, end in zip((-1.0, 1.0), ends, strict=False)
        for u in controls
        if math.isfinite(end)
    ]
    return max([(0.0, 0.0, 0.0), *each])


def _saturated(scene: Described) -> Iterator[Finding]:
    """Yield servos whose requested force exceeds their force range at the start."""
    model, start, asked = scene.model, scene.start, dict[int, tuple[float, float]]()
    for of in scene.drives:
        if of.holds:
            length, speed = (of.gear * x for x in (start.qpos[of.qposadr], start.qvel[of.dof]))
            force = of.force(float(np.clip(scene.ctrl[of.index], *of.ctrlrange)), length, speed)
            asked[of.index] = float(force), of.forcerange[int(force > 0)]
    full = worst(asked, lambda k: abs(asked[k][0]) / max((1 + SEEN) * abs(asked[k][1]), 1e-300))
    if full:
        force, end = asked[full[0]]
        servos = named(model, "actuator", full)
        problem = (
            f"{listed(servos, 'servo')} asks for {strength(model, full[0], force)} at the start "
            f"and has {strength(model, full[0], end)}, so it is saturated and kv has no effect"
        )
        fix = "start with a control that matches the pose (the keyframe's ctrl), or widen its "
        fix += "forcerange"
        yield Finding("saturation", "warning", problem, fix, servos, force, commands=PLOT)


def _balance(scene: Described) -> Iterator[Finding]:
    """Yield actuators that cannot carry the weight at the start, whatever their controls.

    The engine computes the forces at both ends of the controls, at joints, sites, tendons and
    bodies. Joints with a constraint force are left out: a contact or an equality may carry them.
    """
    model, sim = scene.model, Sim(scene.model)
    if not model.nu or sim.act.size or not model.scene.features.actuation:
        return
    scene.start.put(sim)
    least, most = np.zeros((2, model.nu, model.nv))
    for ends in np.clip(model.actuator_ctrlrange.T, -1e9, 1e9):
        sim.ctrl = ends
        sim.forward()
        acting = sim.element_forces()
        each = np.array([acting.get(("actuator", k), np.zeros(model.nv)) for k in range(model.nu)])
        least, most = np.minimum(least, each), np.maximum(most, each)
    sim.ctrl = scene.ctrl
    sim.forward()
    need, carried = hold_load(sim), np.array(sim.constraint_force) != 0
    up, free = -np.asarray(model.scene.gravity, float), free_bodies(model)
    for joint, kind in enumerate(model.jnt_type):
        dof, body = int(model.jnt_dofadr[joint]), int(model.jnt_body[joint])
        if kind == "free" and up.any():
            axis = np.zeros(model.nv)
            axis[dof : dof + 3] = up / np.linalg.norm(up)
            yield from _unlifted(
                scene, body, np.maximum(least @ axis, most @ axis), float(need @ axis)
            )
        if kind not in ("hinge", "slide") or carried[dof] or model.root(body) in free:
            continue
        each = most[:, dof] if need[dof] > 0 else -least[:, dof]
        have = float(each.sum()) + scene.layout.joints[joint].frictionloss
        if each.any() and have < (1 - SEEN) * abs(need[dof]):
            drives = named(model, "actuator", np.flatnonzero(each))
            units = TORQUES if kind == "hinge" else FORCES
            problem = (
                f"{listed(drives, 'actuator')} cannot hold this pose: {quantity(have, units)} at "
                f"most at {model.element_name('joint', joint)}, whose load at the start is "
                f"{quantity(abs(float(need[dof])), units)}"
            )
            fix, unit = f"{times(abs(float(need[dof])) / have)} the force, or another pose", "N·m"
            unit = unit if kind == "hinge" else "N"
            yield Finding("balance", "warning", problem, fix, drives, have, unit, PLOT)


def _unlifted(scene: Described, body: int, each: Floats, need: float) -> Iterator[Finding]:
    """Yield the actuators that push a body up with less than its weight; each: their forces [N]."""
    model, have = scene.model, float(each.sum())
    if not 0 < have < (1 - SEEN) * need:
        return
    lifting = np.flatnonzero(each > SEEN * each.max()).tolist()
    drives, ratio = named(model, "actuator", lifting), need / have
    problem = (
        f"{listed(drives, 'actuator')} cannot lift {model.element_name('body', body)}: "
        f"{have:.4g} N of thrust at most against {need:.4g} N of weight"
    )
    gears = {k: np.asarray(model.scene.actuators[k].gear) * ratio * (1 + FEW) for k in lifting}
    values = {f"actuator/#{k}/gear": tuple(map(rounded, gear)) for k, gear in gears.items()}
    words = f"{times(ratio * (1 + FEW))} the gear of each"

    def again(other: Model) -> Recording:
        """Run with all lifting controls at their upper ends."""
        ctrl = np.array(scene.ctrl)[None, None].copy()
        ctrl[..., lifting] = np.clip(model.actuator_ctrlrange[lifting, 1], -1e9, 1e9)
        return followed(other, scene.start, round(HORIZON / other.settings.dt), ctrl=ctrl)

    def sinks(run: Recording) -> float:
        heights = run.centre_of_mass(body) @ -np.sign(np.asarray(model.scene.gravity, float))
        return float(heights[0] - heights[-1])

    way = ((Proposal(words, Change(values)),),)
    proposals = Proposals(
        way, sinks, 0.0, lambda left: "it rising under full controls", again=again
    )
    fix = "less mass"
    yield Finding("balance", "warning", problem, fix, drives, have, "N", PLOT, proposals=proposals)


def _turning(scene: Described) -> Iterator[Finding]:
    """Yield servos that keep turning a ball joint at every time step.

    Torques that each follow one component of the rotation are not the gradient of an energy, so a
    motion through other angles may gain energy on each round.
    """
    model, of_joint = scene.model, dict[int, list[Actuator]]()
    for of in actuators(model):
        joint = int(model.actuator_joint[of.index])
        if of.holds and joint >= 0 and model.jnt_type[joint] == "ball":
            of_joint.setdefault(joint, []).append(of)
    for joint, servos in of_joint.items():
        proposals = _damped(scene, joint, servos)
        finer = Change(dt=model.settings.dt / 4).of(model)
        runs = (proposals.again(other) for other in (model, finer) if proposals.again)
        if len(servos) > 1 and all((proposals.left(run) or 0.0) > HALF for run in runs):
            drives = named(model, "actuator", (of.index for of in servos))
            problem = (
                f"{listed(drives, 'servo')} turns {model.element_name('joint', joint)} on and on, "
                "at a quarter of the dt too: torques that each follow one angle are no spring's, "
                "and their damping is too small to bear it"
            )
            yield Finding(ENDLESS, "error", problem, "", drives, commands=PLOT, proposals=proposals)


def _damped(scene: Described, joint: int, servos: list[Actuator]) -> Proposals:
    """Return critical damping of the servos of a ball joint, judged by whether it comes to rest."""
    model, sim, dof = scene.model, Sim(scene.model), int(scene.model.jnt_dofadr[joint])
    scene.start.put(sim)
    sim.forward()
    inertia = float(np.diag(sim.mass_matrix())[dof : dof + 3].max())
    values, damping = dict[str, Any](), 0.0
    for of in servos:
        kv = rounded(2 * math.sqrt(of.kp * inertia))
        values |= gained(model, of.index, of.kp, kv)
        damping = max(damping, kv)

    def again(other: Model) -> Recording:
        """Hold the controls of the start until the joint should rest."""
        steps = min(round(LONGEST_RUN / other.settings.dt), PILOT_STEPS)
        return followed(other, scene.start, steps, ctrl=scene.ctrl[None, None])

    def turns(run: Recording) -> float:
        """Return the speed of the joint at the end over its largest; 1 for a run that fails."""
        speed = np.abs(run["qvel"][:, dof : dof + 3]).max(axis=1)
        end = float(speed[max(run.late, 0) :].max() / max(float(speed.max()), 1e-300))
        return end if run.failure is None else 1.0

    way = ((Proposal(f"kv {damping:g} of each", Change(values)),),)
    return Proposals(way, turns, FEW, lambda left: "it at rest", again=again)


# Equally severe findings are reported in this order; OF_LIMITS only if limits are enabled.
OF_LIMITS = (_beyond, _asked_beyond, _overpowered)
FINDINGS = (
    *(_fixed_base, _lengths, _tiny, _angles, _degrees, _densities, _beyond, _clamped),
    *(_asked_beyond, _overpowered, _saturated, _balance, _turning),
)
