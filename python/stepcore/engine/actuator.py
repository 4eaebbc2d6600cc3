"""`Actuator`: the law, ranges and joint of one actuator of a compiled model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.scene.layout import Layout

if TYPE_CHECKING:
    from stepcore.engine.model import Model
    from stepcore.engine.sim import Sim

# The quantity that a control sets: a length, a velocity, a force, or something else (muscles,
# adhesion, controllers with further inputs).
SERVO, VELOCITY_SERVO, MOTOR, OTHER = "servo", "velocity servo", "motor", "other"


@dataclass(frozen=True)
class Actuator:
    """One actuator. Its force is gain × control + offset − kp × length − kv × velocity.

    Forces, lengths and gains are before the gear, unless stated otherwise.

    index: in the model. kind: "servo", "velocity servo", "motor" or "other".
    gain: force per unit of control. offset: force at control 0 [N or N·m].
    kp, kv: the stiffness and the damping of its feedback. A servo that pushes away from its target
        has a negative kp.
    joint: the hinge or slide that it drives; None for tendons, bodies and joints of more dofs.
    tendon: the tendon that it pulls; None for all others.
    dof, qposadr: indices of the joint's velocity and position; -1 without a joint.
    gear: the ratio of its length to the joint's coordinate.
    forcerange, ctrlrange: (low, high), ±inf without a range; the ctrlrange as it is applied.
    jointrange: the range of the force of all actuators of its joint, before the gear.
    filtered: whether its control acts on its force through an activation.
    integrates: whether its control sets the velocity of a servo's target.
    inertia: the inertia that moves with its joint in the model's initial pose, the other joints
        free [kg·m² or kg]; inf without a joint.
    """

    index: int
    kind: str
    gain: float
    offset: float
    kp: float
    kv: float
    joint: int | None
    tendon: int | None
    dof: int
    qposadr: int
    gear: float
    forcerange: tuple[float, float]
    ctrlrange: tuple[float, float]
    jointrange: tuple[float, float]
    filtered: bool
    integrates: bool
    inertia: float

    @property
    def holds(self) -> bool:
        """Whether its feedback pulls it to a length."""
        return self.kp > 0

    @property
    def direct(self) -> bool:
        """Whether it drives one joint, and its force follows its control at once."""
        return self.joint is not None and not self.filtered

    @property
    def stiffness(self) -> float:
        """The stiffness of its feedback at the joint or tendon [N·m/rad or N/m]."""
        return self.kp * self.gear**2

    @property
    def damping(self) -> float:
        """The damping of its feedback at the joint or tendon [N·m·s/rad or N·s/m]."""
        return self.kv * self.gear**2

    @property
    def forces(self) -> tuple[float, float]:
        """The least and the greatest force at rest; a motor's are limited by its control range."""
        low, high = self.forcerange
        if self.kind == MOTOR:
            ends = sorted(self.gain * end for end in self.ctrlrange)
            low, high = max(low, ends[0]), min(high, ends[1])
        return low, high

    @property
    def bound(self) -> float:
        """The largest |force|: the nearest end of its ranges, and a motor's largest control."""
        bound = min(*map(abs, self.forcerange), max(map(abs, self.jointrange)))
        if self.kind == MOTOR:
            bound = min(bound, max(abs(self.gain * end) for end in self.ctrlrange))
        return bound

    def target(self, ctrl: Floats | float) -> Floats:
        """Return the target length of a servo at a control."""
        requested: Floats = (self.gain * np.asarray(ctrl) + self.offset) / self.kp
        return requested

    def holding(self, length: Floats | float) -> Floats:
        """Return the control at which a servo exerts no force at a length."""
        ctrl: Floats = (self.kp * np.asarray(length) - self.offset) / self.gain
        return ctrl

    def force(self, ctrl: float, length: float, velocity: float = 0.0) -> float:
        """Return the force before it is clamped to the force range."""
        return self.gain * ctrl + self.offset - self.kp * length - self.kv * velocity


def actuators(model: Model) -> list[Actuator]:
    """Return the actuators of a model, in its order."""
    layout = Layout(model.scene)
    return [_actuator(model, layout, k) for k in range(model.nu)]


def hold_load(sim: Sim) -> Floats:
    """Return the force on each dof that holds a Sim at rest in its pose, (nv,) [N or N·m].

    The force is the bias minus the passive forces of the last `forward` or step, without contacts.
    """
    speeds = np.array(sim.qvel)
    if speeds.any():
        # At rest, dampers and inertial forces are zero.
        sim.qvel[:] = 0.0
        sim.forward()
    need: Floats = np.array(sim.bias) - np.array(sim.passive)
    if speeds.any():
        sim.qvel[:] = speeds
        sim.forward()
    return need


def passing_stiffness(
    omega: Floats | float, inertia: Floats | float, damping: Floats | float
) -> Floats:
    """Return the stiffness of servos whose gain falls to 1/√2 at a frequency [rad/s].

    The servos are critically damped, or overdamped by the damping of their joints alone.
    """
    weight = inertia * omega**2
    critical = weight / (math.sqrt(2) - 1)
    lag = np.hypot(math.sqrt(2) * weight, damping * omega) - weight
    stiff: Floats = np.where(damping**2 > 4 * inertia * critical, lag, critical)
    return stiff


def _actuator(model: Model, layout: Layout, k: int) -> Actuator:
    law, (offset, length, velocity) = model.scene.actuators[k].law, model.actuator_bias[k].tolist()
    tendon = model.scene.actuators[k].tendon
    joint, gear = int(model.actuator_joint[k]), float(model.actuator_gear[k, 0])
    single = joint >= 0 and model.jnt_type[joint] in ("hinge", "slide") and gear != 0
    dof = int(model.jnt_dofadr[joint]) if single else -1
    total = layout.joints[joint].actuatorfrcrange if single else None
    applied = model.scene.features.clampctrl
    return Actuator(
        index=k,
        kind=_kind(model, k, single),
        gain=float(model.actuator_gain[k]),
        offset=offset,
        kp=0.0 - length,
        kv=0.0 - velocity,
        joint=joint if single else None,
        tendon=None if tendon is None else layout.place(tendon),
        dof=dof,
        qposadr=int(model.jnt_qposadr[joint]) if single else -1,
        gear=gear,
        forcerange=_pair(model.actuator_forcerange[k]),
        ctrlrange=_pair(model.actuator_ctrlrange[k]) if applied else (-np.inf, np.inf),
        jointrange=(-np.inf, np.inf) if total is None else _pair(np.sort(np.array(total) / gear)),
        filtered=bool(model.actuator_actadr[k] >= 0),
        integrates=law.dyntype == "integrator",
        inertia=1.0 / float(model.dof_invweight0[dof]) if single else np.inf,
    )


def _pair(ends: Floats) -> tuple[float, float]:
    low, high = ends.tolist()
    return low, high


def _kind(model: Model, k: int, single: bool) -> str:
    actuator, (_, length, velocity) = model.scene.actuators[k], model.actuator_bias[k].tolist()
    law = actuator.law
    plain = law.gaintype == "fixed" and not law.is_muscle and law.controller is None
    apart = actuator.target[0] == "body" or actuator.feeds is not None or actuator.axis is not None
    if not plain or apart or not model.actuator_gain[k] or law.dyntype == "muscle":
        return OTHER
    if law.dyntype == "integrator":
        return VELOCITY_SERVO if length < 0 else OTHER
    if length < 0:
        return SERVO
    if length == 0 and velocity < 0:
        return VELOCITY_SERVO
    return MOTOR if length == velocity == 0 and single else OTHER
