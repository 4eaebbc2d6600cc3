"""Checks starts, keyframes, controls and limits against their ranges, and finds unused tendons."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.coordinates import turned
from stepcore.experiment.single_run import SingleRun
from stepcore.measure.monitors import Monitor
from stepcore.measure.monitors.actuators import on_one_dof, strength
from stepcore.measure.monitors.finding import PLOT, Finding, Remedy, listed, named
from stepcore.measure.monitors.joints import (
    BEYOND,
    LEFT,
    harder_limit,
    is_angular,
    length_of,
    width_of,
)
from stepcore.measure.monitors.soft_rows import yielding
from stepcore.mjcf.worldbody import EmptyRange
from stepcore.report.units import metres
from stepcore.scene.layout import Layout

# Least excess over a limit, relative to the range; rest poses are often slightly outside.
OUTSIDE = 0.02
# A keyframe is written on purpose: only the rounding of its numbers may be outside.
KEYED = 1e-3
# The run in which an actuator pushes against a limit [s], its steps, and the control of an actuator
# without a ctrlrange.
PUSHED, STEPS, UNBOUNDED = 1.0, 4000, 1e6


def about_ranges(model: Model, start: Start, key: int | None) -> Iterator[Finding]:
    """Yield findings on the start, the keyframes and the ranges; key: the keyframe of the start."""
    yield from _inverted(model)
    states = [(start.qpos, "The start", False)] if key is None else []
    states += [
        (frame.qpos, f"Keyframe `{frame.name or index}`", True)
        for index, frame in enumerate(model.keys)
    ]
    if model.scene.features.limit:
        sim = Sim(model)
        known: set[Element] = set()
        for qpos, where, keyed in states:
            for finding in _outside(model, sim, qpos, where, keyed):
                # Keyframes of one series are often outside in the same joints.
                if not known.issuperset(finding.elements):
                    known.update(finding.elements)
                    yield finding
    for index, frame in enumerate(model.keys):
        where = f"Keyframe `{frame.name or index}`"
        yield from _clamped(model, frame.ctrl, where)
        yield from _asked_beyond(model, frame.ctrl, where)
    yield from _one_sided(model)
    yield from _overpowered(model, start)
    yield from _pressed(model)
    yield from _unused(model)


def _inverted(model: Model) -> Iterator[Finding]:
    """Yield ranges of the file whose first number is not the smaller: such ranges limit nothing."""
    for note in model.scene.notes:
        if isinstance(note, EmptyRange):
            low, high = (f"{bound:g}" for bound in note.bounds)
            order = f'write {note.field}="{high} {low}"'
            problem = (
                f"{note.where}: {note.field} = {low} {high} limits nothing, because its first "
                "number must be the smaller one"
            )
            cure = order if low != high else "give it two different numbers"
            yield Finding("inverted range", "error", problem, cure, value=float(low))


def _outside(
    model: Model, sim: Sim, qpos: np.ndarray, where: str, keyed: bool
) -> Iterator[Finding]:
    """Yield joints and tendons that a state places outside their limits."""
    lengths = []
    if model.ntendon:
        sim.qpos = qpos
        sim.forward()
        lengths = [(i, float(length)) for i, length in enumerate(sim.ten_length)]
    angles = [
        (k, _coordinate(qpos, int(model.jnt_qposadr[k]), kind))
        for k, kind in enumerate(model.jnt_type)
        if kind != "free"
    ]
    for kind, values, ranges in (
        ("joint", angles, model.jnt_range.tolist()),
        ("tendon", lengths, model.tendon_range.tolist()),
    ):
        outside = []
        for k, value in values:
            low, high = ranges[k]
            over = max(low - value, value - high)
            # Without a limit the range is infinite.
            if math.isfinite(high - low) and over > (KEYED if keyed else OUTSIDE) * (high - low):
                outside.append((over / (high - low), k, value))
        if not outside:
            continue
        outside.sort(reverse=True)
        share, k, value = outside[0]
        elements, (low, high) = named(model, kind, [entry[1] for entry in outside]), ranges[k]
        if kind == "joint":
            say, at, unit = (
                partial(length_of, model, k),
                "at",
                "rad" if is_angular(model, k) else "m",
            )
            cure = "correct its qpos" if keyed else "give a keyframe, or correct its ref"
            cure += f" (the nearest is {low if value < low else high:.4g})"
        else:
            say, at, unit = partial(_tendon, model, k), "at a length of", _unit(model, k)
            cure = "correct the pose"
        over = max(low - value, value - high)
        outside_ = "outside of" if share > OUTSIDE else f"{say(over)} beyond"
        problem = (
            f"{where} has {listed(elements, f'{kind}s')} {at} {say(value)}, {outside_} its range "
            f"of {say(low)} to {say(high)}, whose limit throws it back"
        )
        cure += ", or widen the range"
        severity = "error" if keyed else "warning"
        severity = severity if share > OUTSIDE else "remark"
        yield Finding("outside a limit", severity, problem, cure, elements, value, unit)


def _coordinate(qpos: np.ndarray, at: int, kind: str) -> float:
    """Return the coordinate that a joint's range limits; of a ball, the angle [rad or m]."""
    if kind == "ball":
        return float(np.linalg.norm(turned(qpos[None, at : at + 4])))
    return float(qpos[at])


def _unit(model: Model, tendon: int) -> str:
    """Return the unit of a tendon's length; a fixed tendon's length, a sum of joints, has none."""
    return "" if model.scene.tendons[tendon].path.fixed else "m"


def _tendon(model: Model, tendon: int, length: float) -> str:
    return metres(length) if _unit(model, tendon) else f"{length:.4g}"


def _clamped(model: Model, ctrl: np.ndarray, where: str) -> Iterator[Finding]:
    """Yield controls of a keyframe that will be clamped."""
    if not model.nu or not model.scene.features.clampctrl:
        return
    bounds = model.actuator_ctrlrange
    over = np.maximum(bounds[:, 0] - ctrl, ctrl - bounds[:, 1])
    outside = np.flatnonzero(over > 1e-9 * np.maximum(1.0, np.abs(ctrl)))
    if len(outside):
        k = int(outside[np.argmax(over[outside])])
        actuators, (low, high) = named(model, "actuator", (k, *outside)), bounds[k]
        problem = (
            f"{where} has a control of {ctrl[k]:.4g} for {listed(actuators, 'actuators')}, clamped "
            f"to its ctrlrange of {low:.4g} to {high:.4g}"
        )
        cure = "correct its ctrl, or widen the ctrlrange"
        kind = "clamped control"
        yield Finding(kind, "warning", problem, cure, actuators, float(ctrl[k]), "", PLOT)


def _asked_beyond(model: Model, ctrl: np.ndarray, where: str) -> Iterator[Finding]:
    """Yield servos that a keyframe asks for a position beyond the range of their joint."""
    if not model.nu or not (model.scene.features.limit and model.scene.features.actuation):
        return
    beyond = []
    for k in on_one_dof(model):
        joint, bias = int(model.actuator_joint[k]), model.actuator_bias[k]
        low, high = (float(bound) for bound in model.jnt_range[joint])
        gear, control = float(model.actuator_gear[k, 0]), float(ctrl[k])
        if bias[1] >= 0 or not gear or not math.isfinite(high - low):
            continue
        if model.scene.features.clampctrl:
            control = float(np.clip(control, *model.actuator_ctrlrange[k]))
        asked = float(model.actuator_gain[k] * control + bias[0]) / -float(bias[1]) / gear
        over = max(low - asked, asked - high) / (high - low)
        if over > OUTSIDE:
            beyond.append((over, k, joint, asked, low, high))
    if beyond:
        beyond.sort(reverse=True)
        _, k, joint, asked, low, high = beyond[0]
        servos = named(model, "actuator", [entry[1] for entry in beyond])
        say = partial(length_of, model, joint)
        problem = (
            f"{where} asks {listed(servos, 'servos')} for {say(asked)}, beyond the range of "
            f"{model.element_name('joint', joint)} ({say(low)} to {say(high)}), so it presses on "
            "the limit"
        )
        cure = "correct its ctrl, unless it is meant to press"
        unit = "rad" if is_angular(model, joint) else "m"
        yield Finding("control beyond a limit", "remark", problem, cure, servos, asked, unit)


def _one_sided(model: Model) -> Iterator[Finding]:
    """Yield servos whose force range excludes 0, or allows only one direction."""
    low, high = model.actuator_forcerange.T
    wrong = np.flatnonzero((model.actuator_bias[:, 1] < 0) & ((low >= 0) | (high <= 0)))
    if len(wrong):
        low, high = (float(end) for end in model.actuator_forcerange[wrong[0]])
        servos, most = named(model, "actuator", wrong), max(abs(low), abs(high))
        problem = (
            f"the forcerange of {listed(servos, 'servos')}, {low:.4g} to {high:.4g}, lets it push "
            "in one direction only"
        )
        cure = f"{-most:.4g} to {most:.4g} lets it hold a position"
        yield Finding("force range", "warning", problem, cure, servos, most)


def _overpowered(model: Model, start: Start) -> Iterator[Finding]:
    """Yield actuators that can push their joint far beyond its limit.

    The excess is the closed form of a soft row under the actuator's largest outward force. Gravity
    and other actuators are left out.
    """
    features, settings = model.scene.features, model.settings
    if settings.law != "solref" or not features.limit or not features.actuation:
        return
    joints, dt = Layout(model.scene).joints, settings.dt if settings.refsafe else 0.0
    strong = []
    for k in on_one_dof(model):
        index = int(model.actuator_joint[k])
        low, high = (float(bound) for bound in model.jnt_range[index])
        if not np.isfinite([low, high]).all():
            continue
        force = _largest_force(model, k, low, high)
        load = force * float(model.dof_invweight0[model.jnt_dofadr[index]])
        if not math.isfinite(load):
            continue
        width = width_of(model, index)
        beyond = yielding(joints[index].solreflimit, joints[index].solimplimit, load, dt)
        if beyond > BEYOND * width:
            strong.append((beyond / width, k, index, force, beyond))
    if not strong:
        return
    strong.sort(reverse=True)
    ratio, k, index, force, beyond = strong[0]
    actuators = named(model, "actuator", [entry[1] for entry in strong])
    name, wanted = actuators[0].name, LEFT * BEYOND * beyond / ratio
    range_ = "forcerange" if model.actuator_bias[k, 1] < 0 else "ctrlrange"
    problem = (
        f"{listed(actuators, 'actuators')} can push {model.element_name('joint', index)} "
        f"{length_of(model, index, beyond)} beyond its range with {strength(model, k, force)}"
    )
    cure = f"a smaller {range_} of {name}"
    elements = named(model, "limit", [index])
    unit = "rad" if is_angular(model, index) else "m"
    remedy = Remedy(
        (harder_limit(model, index, beyond, wanted),),
        lambda run: run.joints.excess_of(index),
        BEYOND * width_of(model, index),
        partial(length_of, model, index),
        again=lambda other: _pushed(other, start, k),
    )
    yield Finding("limit", "warning", problem, cure, elements, beyond, unit, PLOT, remedy=remedy)


def _pushed(model: Model, start: Start, k: int) -> Monitor:
    """Return the monitor of a run in which an actuator pushes its joint beyond its range."""
    joint = int(model.actuator_joint[k])
    low, high = (float(bound) for bound in model.jnt_range[joint])
    _, end, control = _outward(model, k, low, high)
    sim, monitor = Sim(model), Monitor(model)
    start.put(sim)
    sim.qpos[model.jnt_qposadr[joint]] = end
    sim.ctrl[k] = np.clip(control, -UNBOUNDED, UNBOUNDED)
    SingleRun(sim, probes=[monitor]).run(max(1, min(round(PUSHED / model.settings.dt), STEPS)))
    return monitor


def _largest_force(model: Model, k: int, low: float, high: float) -> float:
    """Return an actuator's largest outward force at an end of a joint's range."""
    return _outward(model, k, low, high)[0]


def _outward(model: Model, k: int, low: float, high: float) -> tuple[float, float, float]:
    """Return an actuator's largest outward force, the end of the range, and the control."""
    gear, gain = float(model.actuator_gear[k, 0]), model.actuator_gain[k]
    bias, controls = model.actuator_bias[k], model.actuator_ctrlrange[k]
    if not model.scene.features.clampctrl or not np.isfinite(controls).all():
        if bias[1] < 0 or not np.isfinite(model.actuator_forcerange[k]).all():
            # The control of this servo has no range.
            return 0.0, low, 0.0
        controls = np.array([-np.inf, np.inf])
    most = 0.0, low, 0.0
    for end, outwards in ((low, -1.0), (high, 1.0)):
        for control in controls:
            with np.errstate(invalid="ignore"):
                force = gain * control + bias[0] + bias[1] * gear * end
            force = float(np.clip(force, *model.actuator_forcerange[k])) * gear * outwards
            most = max(most, (force, end, float(control)))
    return most


def _pressed(model: Model) -> Iterator[Finding]:
    """Yield springs at rest beyond the tendon's range, which always press on the limit."""
    if not (model.scene.features.limit and model.scene.features.spring):
        return
    rests, ranges = model.tendon_lengthspring.tolist(), model.tendon_range.tolist()
    wrong = [
        (i, slack if slack < low else rest)
        for i, ((rest, slack), (low, high)) in enumerate(zip(rests, ranges, strict=True))
        if model.scene.tendons[i].sprung and (slack < low or rest > high)
    ]
    if wrong:
        i, rest = wrong[0]
        tendons = named(model, "tendon", [index for index, _ in wrong])
        say, (low, high) = partial(_tendon, model, i), ranges[i]
        problem = (
            f"the spring of {listed(tendons, 'tendons')} is at rest at a length of {say(rest)}, "
            f"outside of the tendon's range of {say(low)} to {say(high)}, so it always presses on "
            "the limit"
        )
        cure = "correct its springlength, or widen the range"
        kind, unit = "spring beyond a limit", _unit(model, i)
        yield Finding(kind, "warning", problem, cure, tendons, rest, unit)


def _unused(model: Model) -> Iterator[Finding]:
    """Yield tendons without a force, a limit, an armature or a reference."""
    scene = model.scene
    used = {id(actuator.tendon) for actuator in scene.actuators}
    used |= {id(end) for tie in scene.equalities for end in (tie.tendon1, tie.tendon2)}
    used |= {id(sensor.object) for sensor in scene.sensors}
    idle = [
        i
        for i, tendon in enumerate(scene.tendons)
        if id(tendon) not in used
        and tendon.range is None
        and not (tendon.sprung or tendon.damped or tendon.frictionloss or tendon.armature)
    ]
    if idle:
        tendons = named(model, "tendon", idle)
        verb, its = ("does", "it has") if len(idle) == 1 else ("do", "they have")
        problem = f"{listed(tendons, 'tendons')} {verb} nothing"
        cure = (
            f"{its} no spring, damping, friction loss, armature or limit (a range needs limited or "
            "autolimits), and no actuator, equality or sensor uses it"
        )
        yield Finding("unused tendon", "remark", problem, cure, tendons)
