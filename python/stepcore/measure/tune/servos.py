"""Gains of position servos for a wanted bandwidth, settling time or sag, verified by steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.actuator import SERVO, Actuator, actuators, loads
from stepcore.engine.follow import follow
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.experiment.choose import least
from stepcore.measure.tune.goal import (
    PASSES,
    RISES,
    ROUNDS,
    SETTLED,
    SETTLES,
    SHIPPED,
    WITHIN,
    At,
    Goal,
    Tuned,
    pasted,
    settling,
)
from stepcore.report.units import rounded, seconds
from stepcore.scene.layout import Layout

# The size of a step of the target [rad or m]; of its range, the same share.
STEP = 0.05
# The time that holding the pose and a step of the target get, in units of 1/ω, within bounds [s].
HELD, RESPONSE, LEAST, LONGEST = 30.0, 25.0, 0.2, 10.0
# Gains hold at this multiple of the time step too: the margin without a warning at load.
MARGIN = 2.0
# The largest ω dt of a servo with armature.
SLOW = 0.1
# A value of the goal is proportional to this power of ω.
POWERS = {"bandwidth": 1, "settling": -1, "sag": -2}


class Gains(NamedTuple):
    """kp, kv, and the armature to add to the joint [kg·m² or kg]."""

    kp: float
    kv: float
    armature: float = 0.0


class Response(NamedTuple):
    """What a run shows of a servo. rise, settling: of a step of its target [s]. sag: [rad or m]."""

    rise: float = math.nan
    settling: float = math.nan
    sag: float = math.nan

    def of(self, goal: Goal) -> float:
        """Return the measured value of a goal; nan if the servo did not settle."""
        if goal.name == "bandwidth":
            return PASSES * RISES / (2 * math.pi * self.rise)
        return self.settling if goal.name == "settling" else self.sag


@dataclass(frozen=True)
class Servo:
    """A position servo on a hinge or slide.

    drive: the actuator. name: its name. unit: of its joint. inertia: that it moves while the other
    joints are held. damping, armature: of the joint. load: the force of the servo that the pose
    needs at rest [N or N·m].
    """

    drive: Actuator
    name: str
    unit: str
    inertia: float
    damping: float
    armature: float
    load: float

    def gains(self, omega: float, most: float = math.inf) -> Gains:
        """Return the gains of a critically damped servo of frequency ω [rad/s].

        most: the highest frequency, to which armature lowers that of the servo with these gains.
        """
        more, gear = 0.0, self.drive.gear
        kp = rounded(self.inertia * omega**2 / gear**2)
        if omega > most:
            more = rounded(self.inertia * ((self.frequency(kp) / most) ** 2 - 1))
        kv = 2 * (self.inertia + more) * min(omega, most) - self.damping
        return Gains(kp, rounded(max(0.0, kv) / gear**2), more)

    def frequency(self, kp: float) -> float:
        """Return the frequency of the servo alone, the other joints held [rad/s]."""
        return abs(self.drive.gear) * math.sqrt(kp / self.inertia)

    def first(self, goal: Goal) -> float:
        """Return the frequency at which the closed form has a goal's value [rad/s]."""
        if goal.name == "sag":
            return self.frequency(abs(self.load) / (goal.value * abs(self.drive.gear)))
        return (
            2 * math.pi * goal.value / PASSES if goal.name == "bandwidth" else SETTLES / goal.value
        )

    def value(self, goal: Goal, omega: float) -> float:
        """Return the goal's value at a frequency by the closed form."""
        return goal.value * (omega / self.first(goal)) ** POWERS[goal.name]

    def values(self, model: Model, gains: Gains) -> dict[str, Any]:
        """Return gains as values of the model by path."""
        path = f"actuator/#{self.drive.index}"
        actuator, (kp, kv, more) = model.scene.actuators[self.drive.index], gains
        if actuator.type == "general":
            bias = self.drive.offset, -kp, -kv
            values: dict[str, Any] = {f"{path}/gainprm": (kp,), f"{path}/biasprm": bias}
        else:
            values = {f"{path}/kp": kp, f"{path}/kv": kv}
            values |= {} if actuator.dampratio is None else {f"{path}/dampratio": None}
        if more:
            values[f"joint/#{self.drive.joint}/armature"] = self.armature + more
        return values


def servos_of(model: Model, start: Start, names: Sequence[str] | None) -> list[Servo]:
    """Return the position servos of a model, or those with the given names.

    Raises ValueError for a name that is no position servo.
    """
    sim = Sim(model)
    start.put(sim)
    sim.forward()
    mass, need, called = sim.mass_matrix(), loads(sim), model.called("actuator")
    joints, found = Layout(model.scene).joints, []
    for drive in actuators(model):
        if drive.kind == SERVO and drive.joint is not None and drive.gain > 0:
            joint, dof = joints[drive.joint], drive.dof
            unit = "m" if joint.type == "slide" else "rad"
            damping = float(np.ravel(joint.damping)[0])
            own = float(mass[dof, dof]), damping, float(joint.armature)
            found.append(Servo(drive, called[drive.index], unit, *own, need[dof] / drive.gear))
    known = [servo.name for servo in found]
    for name in names or ():
        if name not in known:
            model.index("actuator", name)
            raise ValueError(f"servo = {name!r}: is no position servo on a hinge or slide")
    return [servo for servo in found if names is None or servo.name in names]


def responses(
    model: Model, at: At, gains: Mapping[Servo, Gains], longer: float = 1.0
) -> list[Response]:
    """Return the response of each servo to a step of its own target, the others holding.

    All servos have their gains. longer: multiplies the time step.
    """
    values = {k: v for servo, own in gains.items() for k, v in servo.values(model, own).items()}
    omega = min(servo.frequency(own.kp) for servo, own in gains.items())
    model = Change(values, dt=longer * model.settings.dt).of(model)
    rest = at.after(model, min(max(LEAST, HELD / omega), LONGEST))
    if rest is None:
        return [Response()] * len(gains)
    dt, ctrl = model.settings.dt, np.tile(at.ctrl, (len(gains), 1, 1))
    sizes, sags = [], []
    for row, (servo, (kp, _, _)) in zip(ctrl[:, 0], gains.items(), strict=True):
        drive = servo.drive
        gear, k = abs(drive.gear), drive.index
        sag = abs(row[k] + drive.offset / kp - drive.gear * rest.qpos[drive.qposadr]) / gear
        # At most a share of the range, and half of the force that is left.
        size, left = STEP * min(gear, np.ptp(drive.ctrlrange)), drive.bound - kp * sag * gear
        size = min(size, left / 2 / kp) if left > 0 else size
        row[k] += size if row[k] + 2 * size <= drive.ctrlrange[1] else -size
        sizes.append(size)
        sags.append(sag)
    steps = math.ceil(min(max(LEAST, RESPONSE / omega), LONGEST) / dt)
    ran, made = follow(model, [rest] * len(gains), steps, ctrl=ctrl, record=("qpos",)), []
    for k, (servo, size, sag) in enumerate(zip(gains, sizes, sags, strict=True)):
        path = servo.drive.gear * ran["qpos"][k, :, servo.drive.qposadr]
        way = path[-1] - path[0]
        share = (path - path[0]) / (way or math.nan)
        settled = np.abs(share[-(steps // 5) :] - 1).max() <= SETTLED
        if settled and abs(abs(way) / size - 1) <= 0.5:
            rise = (_crossing(share, 0.9) - _crossing(share, 0.1)) * dt
            made.append(Response(rise, settling(share[1:], dt), sag))
        else:
            made.append(Response())
    return made


def tuned_servos(model: Model, at: At, servos: Sequence[Servo], goal: Goal) -> list[Tuned]:
    """Return gains for each servo. All servos are changed together, and verified together."""
    # A thousandth of the largest load is none.
    whole = 1e-3 * max(abs(servo.load) for servo in servos) if goal.name == "sag" else -1.0
    why = "It carries no load in this pose; its gains are left as they are"
    idle = [Tuned("servo", s.name, goal, s.unit, why=why) for s in servos if abs(s.load) <= whole]
    servos = [servo for servo in servos if abs(servo.load) > whole]
    if not servos:
        return idle
    own = {servo: Gains(servo.drive.kp, servo.drive.kv) for servo in servos}
    # Other elements may leave no margin, which gains do not give back.
    spare = _settle(responses(model, at, own, MARGIN))

    def tried(model: Model, gains: Mapping[Servo, Gains]) -> dict[Servo, Response]:
        made = responses(model, at, gains)
        if spare and _settle(made) and not _settle(responses(model, at, gains, MARGIN)):
            made = [Response()] * len(made)
        return dict(zip(gains, made, strict=True))

    most, omega = math.inf, {servo: servo.first(goal) for servo in servos}
    for _ in range(ROUNDS):
        gains = {servo: servo.gains(omega[servo], most) for servo in servos}
        made = tried(model, gains)
        known = {s: value / goal.value for s in servos if math.isfinite(value := made[s].of(goal))}
        if not known and goal.name == "sag":
            # Armature slows servos that the step cannot resolve.
            most = SLOW / model.settings.dt
        near = [abs(ratio - 1) < WITHIN / 4 for ratio in known.values()]
        if sum(near) == len(servos) or (len(known) < len(servos) and goal.name != "sag"):
            break
        # Contacts, and the other joints, change what the closed form says.
        for servo, ratio in known.items():
            omega[servo] *= min(3.0, max(0.3, ratio ** (-1 / POWERS[goal.name])))
    found = [_told(model, goal, servo, gains[servo], made[servo]) for servo in servos]
    for entry in found:
        entry.change = Change({k: v for s in servos for k, v in s.values(model, gains[s]).items()})
    quick = model.with_settings(integrator="implicitfast")
    other = model.settings.integrator != "implicitfast"
    if goal.name == "sag" and math.isfinite(most) and other:
        plain = tried(quick, {servo: servo.gains(omega[servo]) for servo in servos})
        if all(goal.near(response.sag) for response in plain.values()):
            for entry in found:
                entry.also = "; implicitfast needs no armature"
    elif goal.name != "sag" and not _settle(made.values()):

        def holds(model: Model, omega: float) -> bool:
            return _settle(tried(model, {s: s.gains(omega) for s in servos}).values())

        first = servos[0].first(goal)
        # Parts of it, for the highest frequency that holds.
        parts, n = range(100, 12_801), None
        n = least(
            parts,
            lambda n: 0.0 if holds(model, first * 100 / n) else math.inf,
            0.5,
            200,
            ratio=1.05,
            cliff=True,
        )
        said = "The pose does not come to rest, so nothing can be verified: try another keyframe"
        if n is not None:
            limit = goal.words(servos[0].value(goal, first * 100 / n))
            step = f"{seconds(model.settings.dt)} under {model.settings.integrator}"
            said = f"{step} holds about {limit}"
            if other:
                said += f"; implicitfast {'holds' if holds(quick, first) else 'does not hold'} it"
        for entry in found:
            entry.why = said
    return [*idle, *found]


def _settle(made: Any) -> bool:
    return all(math.isfinite(response.settling) for response in made)


def _told(model: Model, goal: Goal, servo: Servo, gains: Gains, response: Response) -> Tuned:
    """Return a proposal, and why it is not reached if it is not."""
    measured, drive, (kp, kv, _) = response.of(goal), servo.drive, gains
    unit = servo.unit if goal.name == "sag" else ""
    why = f"The run shows {goal.words(measured, unit)} with kp={kp:g} and kv={kv:g}"
    if goal.name == "sag" and not math.isfinite(measured):
        step = f"{seconds(model.settings.dt)} under {model.settings.integrator}"
        why = f"{step} does not rest in the pose with kp={kp:g} and a stability margin of 2"
    if goal.name == "sag" and kp * goal.value * abs(drive.gear) > drive.bound:
        why = f"The pose needs more than its forcerange of {drive.bound:g}"
    lines = tuple(pasted(model, servo.values(model, gains)))
    expected = servo.value(goal, servo.frequency(kp))
    told = Tuned("servo", servo.name, goal, unit, SHIPPED, lines, expected, measured, why=why)
    told.reached = goal.near(measured)
    return told


def _crossing(share: np.ndarray, level: float) -> float:
    """Return after how many steps a response first reaches a level, interpolated."""
    k = int(np.argmax(share >= level))
    return k - 1 + float((level - share[k - 1]) / (share[k] - share[k - 1])) if k else 0.0
