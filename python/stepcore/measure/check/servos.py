"""Checks servos at a state: saturated, too weak for the load, or too stiff without armature."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.engine.stiffness import joint_gains
from stepcore.measure.monitors.actuators import on_one_dof, strength
from stepcore.measure.monitors.finding import PLOT, Finding, listed, named
from stepcore.report.units import hertz, rounded, seconds
from stepcore.scene.layout import Layout

# ω dt, and damping rate × dt, above which a servo without armature is too stiff.
STIFF, DAMPED = 0.5, 1.0
# A force beyond its range by this factor is more than rounding.
BEYOND_RANGE = 1.01


def about_servos(model: Model, start: Start, ctrl: np.ndarray) -> Iterator[Finding]:
    """Yield findings on servos at the start, with its controls, and at every keyframe."""
    if not model.nu or not model.scene.features.actuation:
        return
    yield from _saturated(model, start, ctrl)
    weak: set[int] = set()
    yield from _too_weak(model, start.qpos, "the start", weak)
    for index, key in enumerate(model.keys):
        yield from _too_weak(model, key.qpos, f"keyframe `{key.name or index}`", weak)
    yield from _without_armature(model)


def _saturated(model: Model, start: Start, ctrl: np.ndarray) -> Iterator[Finding]:
    """Yield servos whose wanted force exceeds their force range at the start."""
    if model.scene.features.clampctrl:
        ctrl = np.clip(ctrl, *model.actuator_ctrlrange.T)
    full = []
    for k in on_one_dof(model):
        joint = int(model.actuator_joint[k])
        gear, bias = float(model.actuator_gear[k, 0]), model.actuator_bias[k]
        if bias[1] >= 0:
            continue
        length = gear * float(start.qpos[model.jnt_qposadr[joint]])
        speed = gear * float(start.qvel[model.jnt_dofadr[joint]])
        force = float(model.actuator_gain[k] * ctrl[k] + bias @ (1.0, length, speed))
        low, high = (float(end) for end in model.actuator_forcerange[k])
        end = low if force < 0 else high
        if abs(force) > BEYOND_RANGE * abs(end) and math.isfinite(end):
            full.append((abs(force / end) if end else math.inf, k, force, end))
    if not full:
        return
    full.sort(reverse=True)
    _, k, force, end = full[0]
    servos = named(model, "actuator", [entry[1] for entry in full])
    problem = (
        f"{listed(servos, 'servos')} asks for {strength(model, k, force)} at the start and has "
        f"{strength(model, k, end)}, so it is saturated and kv has no effect"
    )
    cure = (
        "start with a control that matches the pose (the keyframe's ctrl), or widen its forcerange"
    )
    yield Finding("saturation", "warning", problem, cure, servos, force, commands=PLOT)


def _too_weak(model: Model, qpos: np.ndarray, where: str, seen: set[int]) -> Iterator[Finding]:
    """Yield actuators weaker than the static load of a pose that only joints carry."""
    joints = model.actuator_joint
    # An actuator on anything but a joint may carry the load.
    if (joints < 0).any():
        return
    loads = _static_loads(model, qpos)
    drives = np.bincount(joints, minlength=model.njnt)
    weak: dict[bool, list[tuple[float, int, float, float]]] = {True: [], False: []}
    for k in on_one_dof(model):
        joint, gear = int(joints[k]), float(model.actuator_gear[k, 0])
        load = loads.get(int(model.jnt_dofadr[joint]))
        if load is None or not gear or drives[joint] > 1 or k in seen:
            continue
        need, (low, high) = load / gear, _forces(model, k)
        end = low if need < 0 else high
        lacks = (need - end) * gear
        if abs(need) > BEYOND_RANGE * abs(end) and not _sprung(model, joint, qpos, lacks):
            servo = bool(model.actuator_bias[k, 1] < 0)
            weak[servo].append((abs(need / end) if end else math.inf, k, need, end))
    for servo, some in weak.items():
        if not some:
            continue
        some.sort(reverse=True)
        seen.update(entry[1] for entry in some)
        _, k, need, end = some[0]
        actuators = named(model, "actuator", [entry[1] for entry in some])
        range_ = "forcerange" if servo else "range"
        problem = (
            f"{listed(actuators, 'actuators')} cannot hold {where}: its load there is "
            f"{strength(model, k, abs(need))} and its {range_} ends at "
            f"{strength(model, k, abs(end))}"
        )
        cure = f"widen the {range_}, raise the gear, or lighten what it carries"
        kind = "servo too weak" if servo else "motor too weak"
        severity = "error" if servo else "remark"
        yield Finding(kind, severity, problem, cure, actuators, need, "", PLOT if servo else ())


def _sprung(model: Model, joint: int, qpos: np.ndarray, lacks: float) -> bool:
    """Return whether the spring of a joint gives a force within the joint's range.

    lacks: the force that the joint lacks [N·m or N]; at the start its spring may not be loaded yet.
    """
    stiffness = Layout(model.scene).joints[joint].stiffness
    low, high = (float(bound) for bound in model.jnt_range[joint])
    if not model.scene.features.spring or stiffness <= 0:
        return False
    return low <= float(qpos[model.jnt_qposadr[joint]]) - lacks / stiffness <= high


def _forces(model: Model, k: int) -> tuple[float, float]:
    """Return the smallest and the largest force of an actuator at rest, before the gear."""
    low, high = (float(end) for end in model.actuator_forcerange[k])
    if not model.actuator_bias[k].any() and model.scene.features.clampctrl:
        ends = sorted(float(model.actuator_gain[k] * end) for end in model.actuator_ctrlrange[k])
        low, high = max(low, ends[0]), min(high, ends[1])
    return low, high


def _static_loads(model: Model, qpos: np.ndarray) -> dict[int, float]:
    """Return the static load of each dof at a pose [N·m or N], if only joints carry the load.

    The load is the bias force less passive forces at zero velocity. Trees on a free joint, and
    trees held by a contact or a connection, are left out.
    """
    sim = Sim(model, model.settings.replace(precision="f64"))
    sim.qpos[:] = qpos
    try:
        sim.forward()
    except (ValueError, RuntimeError):
        return {}
    load = np.array(sim.bias) - np.array(sim.passive)
    carried = {model.root(body) for body in _held_bodies(model, sim)}
    owners = model.jnt_body.tolist()
    free = (body for body, kind in zip(owners, model.jnt_type, strict=True) if kind == "free")
    carried |= {model.root(body) for body in free}
    dofs = zip(owners, model.jnt_dofadr.tolist(), strict=True)
    return {dof: float(load[dof]) for body, dof in dofs if model.root(body) not in carried}


def _held_bodies(model: Model, sim: Sim) -> Iterator[int]:
    """Yield the bodies on which contacts and connections act."""
    layout = Layout(model.scene)
    for kind, index in {(str(row["kind"]), int(row["index"])) for row in sim.rows}:
        if kind == "contact":
            yield from (int(model.geom_body[geom]) for geom in model.contact_pair(index).geoms)
        elif kind not in ("limit", "friction loss"):
            equality = model.scene.equalities[index]
            yield from (layout.index[id(body)] for body in equality.bodies)


def _without_armature(model: Model) -> Iterator[Finding]:
    """Yield servos that are stiff relative to the inertia that their joint moves."""
    joints, dt = Layout(model.scene).joints, model.settings.dt
    gains = {gain.index: gain for gain in joint_gains(model) if gain.kind == "actuator"}
    stiff = []
    for k in on_one_dof(model):
        joint = int(model.actuator_joint[k])
        if joints[joint].armature > 0 or model.scene.actuators[k].armature > 0:
            continue
        inverse = float(model.dof_invweight0[model.jnt_dofadr[joint]])
        kp, kv = gains[k].stiffness, gains[k].damping
        omega = math.sqrt(max(kp, 0.0) * inverse)
        excess = max(omega * dt / STIFF, max(kv, 0.0) * inverse * dt / DAMPED)
        if excess > 1 and inverse > 0:
            needed = max(kp * dt**2 / STIFF**2, kv * dt / DAMPED) - 1 / inverse
            stiff.append((excess, k, kp, kv, omega, inverse, needed))
    if not stiff:
        return
    stiff.sort(reverse=True)
    _, k, kp, kv, omega, inverse, needed = stiff[0]
    joint = int(model.actuator_joint[k])
    unit = "kg·m²" if model.jnt_type[joint] == "hinge" else "kg"
    servos = named(model, "actuator", [entry[1] for entry in stiff])
    swings = omega * dt > STIFF
    gain, rate = f"kv {kv:.3g}", f"a damping rate of {kv * inverse:.3g}/s"
    if swings:
        gain, rate = f"kp {kp:.3g}", hertz(omega)
    problem = (
        f"{listed(servos, 'servos')} has {gain} on a joint without armature that moves "
        f"{1 / inverse:.3g} {unit}, which is {rate} at a dt of {seconds(dt)}"
    )
    cure = (
        f'armature="{rounded(needed, 2, up=True):g}" on {model.element_name("joint", joint)} makes '
        "it slow enough (a geared motor has that much), or lower the gains"
    )
    yield Finding("armature", "warning", problem, cure, servos, 1 / inverse, unit)
