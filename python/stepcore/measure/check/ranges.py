"""Checks of starts, keyframes, servos and limits against their ranges, and finds unused tendons."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from stepcore.engine.actuator import Actuator, actuators
from stepcore.engine.coordinates import turned
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.measure.monitors.actuators import strength
from stepcore.measure.monitors.contacts import LEFT
from stepcore.measure.monitors.finding import PLOT, Finding, listed, named
from stepcore.measure.monitors.joints import (
    BEYOND,
    is_angular,
    length_of,
    limit_remedy,
    width_of,
)
from stepcore.measure.monitors.recording import Recording, followed
from stepcore.measure.monitors.soft_rows import yielding
from stepcore.report.units import hertz, metres, rounded, seconds
from stepcore.scene.layout import Layout

# Least excess over a limit, relative to the range; rest poses are often slightly outside.
OUTSIDE = 0.02
# A keyframe is written on purpose: only the rounding of its numbers may be outside.
KEYED = 1e-3
# A force beyond its range by this factor is more than rounding.
BEYOND_RANGE = 1.01
# ω dt above which a servo without armature is too stiff; a damping rate × dt may be 1.
STIFF = 0.5
# The run in which an actuator pushes against a limit [s], and its steps.
PUSHED, STEPS = 1.0, 4000


def about_ranges(
    model: Model, start: Start, key: int | None, ctrl: np.ndarray
) -> Iterator[Finding]:
    """Yield findings on the start with its controls, the keyframes, and the ranges.

    key: the keyframe of the start, or None.
    """
    features = model.scene.features
    states = [(start.qpos, "The start", False)] if key is None else []
    keys = [(f"Keyframe `{frame.name or k}`", frame) for k, frame in enumerate(model.keys)]
    states += [(frame.qpos, name, True) for name, frame in keys]
    if features.limit:
        sim, known = Sim(model), set[Element]()
        for qpos, where, keyed in states:
            for finding in _outside(model, sim, qpos, where, keyed):
                # Keyframes of one series are often outside in the same joints.
                if not known.issuperset(finding.elements):
                    known.update(finding.elements)
                    yield finding
    direct = [of for of in actuators(model) if of.direct] if features.actuation else []
    for name, frame in keys:
        yield from _clamped(model, frame.ctrl, name)
    if features.limit:
        for name, frame in keys:
            yield from _asked_beyond(model, direct, frame.ctrl, name)
        yield from _overpowered(model, direct, start)
    yield from _saturated(model, direct, start, ctrl)
    yield from _without_armature(model, direct)
    yield from _unused(model)


def _outside(
    model: Model, sim: Sim, qpos: np.ndarray, where: str, keyed: bool
) -> Iterator[Finding]:
    """Yield joints and tendons that a state places outside their limits."""
    sim.qpos = qpos
    joints = [
        (_coordinate(qpos, int(model.jnt_qposadr[k]), kind), *model.jnt_range[k].tolist())
        for k, kind in enumerate(model.jnt_type)
    ]
    lengths = sim.ten_length.tolist() if model.ntendon else []
    tendons = [(x, *ends) for x, ends in zip(lengths, model.tendon_range.tolist(), strict=True)]
    for kind, every in (("joint", joints), ("tendon", tendons)):
        # Without a limit the range is infinite.
        outside = sorted(
            (
                (over / (high - low), k)
                for k, (value, low, high) in enumerate(every)
                if math.isfinite(high - low)
                and (over := max(low - value, value - high))
                > (KEYED if keyed else OUTSIDE) * (high - low)
            ),
            reverse=True,
        )
        if not outside:
            continue
        (share, k), (value, low, high) = outside[0], every[outside[0][1]]
        say: Callable[[float], str]
        elements, at, cure = named(model, kind, [k for _, k in outside]), "at", "correct the pose"
        if kind == "joint":
            say, unit = partial(length_of, model, k), "rad" if is_angular(model, k) else "m"
            cure = "correct its qpos" if keyed else "give a keyframe, or correct its ref"
            cure += f" (the nearest is {low if value < low else high:.4g})"
        else:
            # The length of a fixed tendon, a sum of joints, has no unit.
            at, unit = "at a length of", "" if model.scene.tendons[k].path.fixed else "m"
            say = metres if unit else "{:.4g}".format
        beyond = "outside of"
        if share <= OUTSIDE:
            beyond = f"{say(max(low - value, value - high))} beyond"
        problem = (
            f"{where} has {listed(elements, f'{kind}s')} {at} {say(value)}, {beyond} its range "
            f"of {say(low)} to {say(high)}, whose limit throws it back"
        )
        cure, severity = f"{cure}, or widen the range", "error" if keyed else "warning"
        severity = severity if share > OUTSIDE else "remark"
        yield Finding("outside a limit", severity, problem, cure, elements, value, unit)


def _coordinate(qpos: np.ndarray, at: int, kind: str) -> float:
    """Return the coordinate that a joint's range limits; of a ball, the angle [rad or m]."""
    if kind == "ball":
        return float(np.linalg.norm(turned(qpos[None, at : at + 4])))
    return float(qpos[at])


def _clamped(model: Model, ctrl: np.ndarray, where: str) -> Iterator[Finding]:
    """Yield controls of a keyframe that will be clamped."""
    if not model.nu or not model.scene.features.clampctrl:
        return
    bounds = model.actuator_ctrlrange
    over = np.maximum(bounds[:, 0] - ctrl, ctrl - bounds[:, 1])
    outside = np.flatnonzero(over > 1e-9 * np.maximum(1.0, np.abs(ctrl)))
    if len(outside):
        k = int(outside[np.argmax(over[outside])])
        elements, (low, high) = named(model, "actuator", (k, *outside)), bounds[k]
        problem = (
            f"{where} has a control of {ctrl[k]:.4g} for {listed(elements, 'actuators')}, clamped "
            f"to its ctrlrange of {low:.4g} to {high:.4g}"
        )
        cure, value = "correct its ctrl, or widen the ctrlrange", float(ctrl[k])
        yield Finding("clamped control", "warning", problem, cure, elements, value, "", PLOT)


def _asked_beyond(
    model: Model, direct: list[Actuator], ctrl: np.ndarray, where: str
) -> Iterator[Finding]:
    """Yield servos that a keyframe asks for a position beyond the range of their joint."""
    beyond = []
    for of in direct:
        assert of.joint is not None
        low, high = (float(bound) for bound in model.jnt_range[of.joint])
        if of.holds and math.isfinite(high - low):
            asked = float(of.target(np.clip(ctrl[of.index], *of.ctrlrange))) / of.gear
            over = max(low - asked, asked - high) / (high - low)
            if over > OUTSIDE:
                beyond.append((over, of.index, of.joint, asked))
    if beyond:
        beyond.sort(reverse=True)
        _, _, joint, asked = beyond[0]
        servos, (low, high) = (
            named(model, "actuator", [k for _, k, *_ in beyond]),
            (model.jnt_range[joint]),
        )
        say = partial(length_of, model, joint)
        problem = (
            f"{where} asks {listed(servos, 'servos')} for {say(asked)}, beyond the range of "
            f"{model.element_name('joint', joint)} ({say(low)} to {say(high)}), so it presses on "
            "the limit"
        )
        cure = "correct its ctrl, unless it is meant to press"
        unit = "rad" if is_angular(model, joint) else "m"
        yield Finding("control beyond a limit", "remark", problem, cure, servos, asked, unit)


def _overpowered(model: Model, direct: list[Actuator], start: Start) -> Iterator[Finding]:
    """Yield actuators that can push their joint far beyond its limit.

    The excess is the closed form of a soft row under the actuator's largest outward force. Gravity
    and other actuators are left out.
    """
    settings, joints = model.settings, Layout(model.scene).joints
    if settings.law != "solref":
        return
    dt, strong = settings.dt if settings.refsafe else 0.0, []
    for of in direct:
        assert of.joint is not None
        if np.isfinite(model.jnt_range[of.joint]).all():
            force, _, _ = _outward(model, of)
            at, width = joints[of.joint], width_of(model, of.joint)
            if math.isfinite(force / of.inertia):
                beyond = yielding(at.solreflimit, at.solimplimit, force / of.inertia, dt)
                if beyond > BEYOND * width:
                    strong.append((beyond / width, of.index, force, beyond))
    if not strong:
        return
    strong.sort(reverse=True)
    ratio, k, force, beyond = strong[0]
    of = actuators(model)[k]
    assert of.joint is not None
    elements = named(model, "actuator", [entry[1] for entry in strong])
    problem = (
        f"{listed(elements, 'actuators')} can push {model.element_name('joint', of.joint)} "
        f"{length_of(model, of.joint, beyond)} beyond its range with {strength(model, k, force)}"
    )
    cure = f"a smaller {'forcerange' if of.holds else 'ctrlrange'} of {elements[0].name}"
    remedy = dataclasses.replace(
        limit_remedy(model, of.joint, beyond, LEFT * BEYOND * beyond / ratio),
        again=lambda other: _pushed(other, start, k),
    )
    limits, unit = named(model, "limit", [of.joint]), "rad" if is_angular(model, of.joint) else "m"
    yield Finding("limit", "warning", problem, cure, limits, beyond, unit, PLOT, remedy=remedy)


def _pushed(model: Model, start: Start, k: int) -> Recording:
    """Run an actuator that pushes its joint beyond its range."""
    of = actuators(model)[k]
    _, end, control = _outward(model, of)
    qpos, ctrl = np.array(start.qpos), np.zeros((1, 1, model.nu))
    qpos[of.qposadr] = end
    # A control without a range is asked for more than any force range.
    ctrl[0, 0, k] = np.clip(control, -1e6, 1e6)
    steps = max(1, min(round(PUSHED / model.settings.dt), STEPS))
    return followed(model, dataclasses.replace(start, qpos=qpos), steps, ctrl=ctrl)


def _outward(model: Model, of: Actuator) -> tuple[float, float, float]:
    """Return an actuator's largest force outwards of its joint's range, the end, and the control.

    The force is 0 where nothing bounds it: a servo without a control range is not meant to push.
    """
    controls = of.ctrlrange
    if not np.isfinite(controls).all():
        if of.holds or not np.isfinite(of.forcerange).all():
            return 0.0, 0.0, 0.0
        controls = -np.inf, np.inf
    most = 0.0, 0.0, 0.0
    for end, outwards in zip(model.jnt_range[of.joint].tolist(), (-1.0, 1.0), strict=True):
        for control in controls:
            force = float(np.clip(of.force(control, of.gear * end), *of.forcerange)) * of.gear
            most = max(most, (force * outwards, end, control))
    return most


def _saturated(
    model: Model, direct: list[Actuator], start: Start, ctrl: np.ndarray
) -> Iterator[Finding]:
    """Yield servos whose wanted force exceeds their force range at the start."""
    full = []
    for of in direct:
        if of.holds:
            length, speed = (of.gear * x for x in (start.qpos[of.qposadr], start.qvel[of.dof]))
            asked = of.force(float(np.clip(ctrl[of.index], *of.ctrlrange)), length, speed)
            end = of.forcerange[int(asked > 0)]
            if abs(asked) > BEYOND_RANGE * abs(end):
                full.append((abs(asked / end) if end else math.inf, of.index, float(asked), end))
    if full:
        full.sort(reverse=True)
        _, k, force, end = full[0]
        servos = named(model, "actuator", [entry[1] for entry in full])
        problem = (
            f"{listed(servos, 'servos')} asks for {strength(model, k, force)} at the start and has "
            f"{strength(model, k, end)}, so it is saturated and kv has no effect"
        )
        cure = "start with a control that matches the pose (the keyframe's ctrl), or widen its "
        cure += "forcerange"
        yield Finding("saturation", "warning", problem, cure, servos, force, commands=PLOT)


def _without_armature(model: Model, direct: list[Actuator]) -> Iterator[Finding]:
    """Yield servos that are stiff relative to the inertia that their joint moves."""
    joints, dt, stiff = Layout(model.scene).joints, model.settings.dt, []
    for of in direct:
        assert of.joint is not None
        if joints[of.joint].armature > 0 or model.scene.actuators[of.index].armature > 0:
            continue
        kp, kv = max(of.stiffness, 0.0), max(of.damping, 0.0)
        omega = math.sqrt(kp / of.inertia)
        excess = max(omega * dt / STIFF, kv / of.inertia * dt)
        if excess > 1:
            needed = max(kp * dt**2 / STIFF**2, kv * dt) - of.inertia
            stiff.append((excess, of.index, omega, needed))
    if not stiff:
        return
    stiff.sort(reverse=True)
    _, k, omega, needed = stiff[0]
    of = actuators(model)[k]
    assert of.joint is not None
    unit = "kg·m²" if model.jnt_type[of.joint] == "hinge" else "kg"
    servos = named(model, "actuator", [entry[1] for entry in stiff])
    gain, rate = f"kv {of.damping:.3g}", f"a damping rate of {of.damping / of.inertia:.3g}/s"
    if omega * dt > STIFF:
        gain, rate = f"kp {of.stiffness:.3g}", hertz(omega)
    problem = (
        f"{listed(servos, 'servos')} has {gain} on a joint without armature that moves "
        f"{of.inertia:.3g} {unit}, which is {rate} at a dt of {seconds(dt)}"
    )
    cure = (
        f'armature="{rounded(needed, 2, up=True):g}" on {model.element_name("joint", of.joint)} '
        "makes it slow enough (a geared motor has that much), or lower the gains"
    )
    yield Finding("armature", "warning", problem, cure, servos, of.inertia, unit)


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
