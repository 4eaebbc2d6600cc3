"""Servos at a state: saturated, too weak for their load, stiff on a joint without armature."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Start
from stepcore.measure.findings.actuators import TORQUES
from stepcore.measure.findings.finding import Finding, others
from stepcore.report.units import FORCES, hertz, quantity, seconds
from stepcore.scene.layout import Layout

# ω dt and the damping rate × dt from which a servo on a joint without armature is too stiff.
STIFF, DAMPED = 0.5, 1.0
# A force this part beyond its range is beyond rounding.
BEYOND_RANGE = 1.01


def about_servos(model: Model, start: Start, ctrl: np.ndarray) -> Iterator[Finding]:
    """The start, with its controls, and every keyframe."""
    if not model.nu or not model.scene.features.actuation:
        return
    yield from _saturated(model, start, ctrl)
    seen: set[int] = set()
    states = [("the start", start)]
    states += [
        (f"keyframe `{key.name or index}`", Start(key.qpos, key.qvel))
        for index, key in enumerate(model.keys)
    ]
    for where, state in states:
        yield from _too_weak(model, state, where, seen)
    yield from _without_armature(model)


def _servos(model: Model) -> list[int]:
    """Actuators that pull back to a position, on a hinge or a slide."""
    return [k for k in _on_one_dof(model) if model.actuator_bias[k, 1] < 0]


def _on_one_dof(model: Model) -> list[int]:
    """Actuators on a hinge or a slide that have no activation."""
    both = zip(model.actuator_joint, model.actuator_actadr, strict=True)
    return [
        k
        for k, (joint, act) in enumerate(both)
        if joint >= 0 and act < 0 and model.jnt_type[joint] in ("hinge", "slide")
    ]


def _strength(model: Model, actuator: int, force: float) -> str:
    hinge = model.jnt_type[int(model.actuator_joint[actuator])] == "hinge"
    return quantity(force, TORQUES if hinge else FORCES)


def _saturated(model: Model, start: Start, ctrl: np.ndarray) -> Iterator[Finding]:
    """Servos that ask for more than their force range at the start."""
    if model.scene.features.clampctrl:
        ctrl = np.clip(ctrl, *model.actuator_ctrlrange.T)
    found = []
    for k in _servos(model):
        joint = int(model.actuator_joint[k])
        gear, bias = float(model.actuator_gear[k, 0]), model.actuator_bias[k]
        length = gear * float(start.qpos[model.jnt_qposadr[joint]])
        speed = gear * float(start.qvel[model.jnt_dofadr[joint]])
        force = float(model.actuator_gain[k] * ctrl[k] + bias @ (1.0, length, speed))
        low, high = (float(end) for end in model.actuator_forcerange[k])
        end = low if force < 0 else high
        if abs(force) > BEYOND_RANGE * abs(end) and math.isfinite(end):
            found.append((abs(force / end) if end else math.inf, k, force, end))
    if not found:
        return
    found.sort(reverse=True)
    _, k, force, end = found[0]
    names = [model.element_name("actuator", one[1]) for one in found]
    yield Finding(
        "saturation",
        "warning",
        names[0],
        f"{_capital(names[0])}{others(names, 'servos')} asks for {_strength(model, k, force)} at "
        f"the start and has {_strength(model, k, end)}: while it is saturated it has no damping; "
        "start with a control that matches the pose (the keyframe's ctrl), or widen its "
        "forcerange.",
        force,
    )


def _too_weak(model: Model, state: Start, where: str, seen: set[int]) -> Iterator[Finding]:
    """Actuators whose largest force is below the load of a pose that hangs on its joints alone."""
    loads = _static_loads(model, state)
    joints = model.actuator_joint
    drives = np.bincount(joints[joints >= 0], minlength=model.njnt)
    weak: dict[bool, list[tuple[float, int, float, float]]] = {True: [], False: []}
    linked = bool((joints < 0).any())
    for k in () if linked else _on_one_dof(model):
        joint, gear = int(model.actuator_joint[k]), float(model.actuator_gear[k, 0])
        load = loads.get(int(model.jnt_dofadr[joint]))
        if load is None or not gear or drives[joint] > 1 or k in seen:
            continue
        need, (low, high) = load / gear, _forces(model, k)
        end = low if need < 0 else high
        if abs(need) > BEYOND_RANGE * abs(end):
            servo = bool(model.actuator_bias[k, 1] < 0)
            weak[servo].append((abs(need / end) if end else math.inf, k, need, end))
    for servo, found in weak.items():
        if not found:
            continue
        found.sort(reverse=True)
        seen.update(one[1] for one in found)
        _, k, need, end = found[0]
        names = [model.element_name("actuator", one[1]) for one in found]
        own = "forcerange" if servo else "range"
        yield Finding(
            "servo too weak" if servo else "motor too weak",
            "error" if servo else "remark",
            names[0],
            f"{_capital(names[0])}{others(names, 'actuators')} cannot hold {where}: its load there "
            f"is {_strength(model, k, abs(need))} and its {own} ends at "
            f"{_strength(model, k, abs(end))}: widen the {own}, raise the gear, or lighten what "
            "it carries.",
            need,
        )


def _forces(model: Model, k: int) -> tuple[float, float]:
    """The least and the largest force of an actuator at rest, before the gear."""
    low, high = (float(end) for end in model.actuator_forcerange[k])
    if not model.actuator_bias[k].any() and model.scene.features.clampctrl:
        ends = sorted(float(model.actuator_gain[k] * end) for end in model.actuator_ctrlrange[k])
        low, high = max(low, ends[0]), min(high, ends[1])
    return low, high


def _static_loads(model: Model, state: Start) -> dict[int, float]:
    """What holds each dof still at a pose [N·m or N], where nothing but joints carries it.

    Bias less passive forces at zero velocity; without the dofs of trees that hang on a free joint
    or that a contact or a connection holds too.
    """
    sim = Sim(model, model.settings.replace(precision="f64"))
    sim.qpos[:] = state.qpos
    try:
        sim.forward()
    except (ValueError, RuntimeError):
        return {}
    load = np.array(sim.bias) - np.array(sim.passive)
    carried = {model.root(body) for body in _held_bodies(model, sim)}
    for joint, kind in enumerate(model.jnt_type):
        if kind == "free":
            carried.add(model.root(int(model.jnt_body[joint])))
    held = {}
    for joint in range(model.njnt):
        if model.root(int(model.jnt_body[joint])) not in carried:
            dof = int(model.jnt_dofadr[joint])
            held[dof] = float(load[dof])
    return held


def _held_bodies(model: Model, sim: Sim) -> Iterator[int]:
    """The bodies that contacts and connections act on."""
    layout = Layout(model.scene)
    for kind, index in {(str(row["kind"]), int(row["index"])) for row in sim.rows}:
        if kind == "contact":
            yield from (int(model.geom_body[geom]) for geom in model.contact_pair(index).geoms)
        elif kind not in ("limit", "friction loss"):
            equality = model.scene.equalities[index]
            yield from (layout.index[id(body)] for body in equality.bodies)


def _without_armature(model: Model) -> Iterator[Finding]:
    """Servos that are stiff beside the inertia that their joint moves."""
    joints, dt = Layout(model.scene).joints, model.settings.dt
    found = []
    for k in _on_one_dof(model):
        joint = int(model.actuator_joint[k])
        if joints[joint].armature > 0 or model.scene.actuators[k].armature > 0:
            continue
        inverse = float(model.dof_invweight0[model.jnt_dofadr[joint]])
        gear = float(model.actuator_gear[k, 0])
        kp, kv = (-float(bias) * gear**2 for bias in model.actuator_bias[k, 1:])
        omega = math.sqrt(max(kp, 0.0) * inverse)
        excess = max(omega * dt / STIFF, max(kv, 0.0) * inverse * dt / DAMPED)
        if excess > 1 and inverse > 0:
            needed = max(kp * dt**2 / STIFF**2, kv * dt / DAMPED) - 1 / inverse
            found.append((excess, k, kp, kv, omega, inverse, needed))
    if not found:
        return
    found.sort(reverse=True)
    _, k, kp, kv, omega, inverse, needed = found[0]
    joint = int(model.actuator_joint[k])
    hinge = model.jnt_type[joint] == "hinge"
    names = [model.element_name("actuator", one[1]) for one in found]
    pull = f"kp {kp:.3g}" if omega * model.settings.dt > STIFF else f"kv {kv:.3g}"
    moves = f"{1 / inverse:.3g} {'kg·m²' if hinge else 'kg'}"
    rate = f"{hertz(omega)}" if omega * dt > STIFF else f"a damping rate of {kv * inverse:.3g}/s"
    yield Finding(
        "armature",
        "warning",
        names[0],
        f"{_capital(names[0])}{others(names, 'servos')} has {pull} on a joint without armature "
        f"that moves {moves}, which is {rate} at a dt of {seconds(dt)}: "
        f'armature="{_up(needed):g}" on {model.element_name("joint", joint)} makes it slow enough '
        "(a geared motor has that much), or lower the gains.",
        1 / inverse,
        "kg·m²" if hinge else "kg",
    )


def _up(value: float) -> float:
    """Two digits, rounded up."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / step - 1e-9) * step:.2g}")


def _capital(name: str) -> str:
    return name[:1].upper() + name[1:]
