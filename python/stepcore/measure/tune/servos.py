"""Gains of position servos for a wanted bandwidth, settling time or sag, verified by runs.

Alone, a servo on the inertia I with critical damping has the frequency ω = √(kp/I). Its gain falls
to 1/√2 at PASSES ω, its steps settle in SETTLES/ω, and under a load F it sags by F/kp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stepcore.engine.actuator import SERVO, Actuator, actuators, loads
from stepcore.engine.follow import follow
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.experiment.choose import least
from stepcore.measure.tune.goal import (
    FEWEST,
    PASSES,
    SETTLED,
    SETTLES,
    WITHIN,
    At,
    Goal,
    Tuned,
    pasted,
    settling,
    steps_of,
)
from stepcore.report.units import rounded, seconds
from stepcore.scene.layout import Layout

# The width of the motion with which gains are tried [rad or m]; of a range, the same share.
WIDTH = 0.1
# Gains hold at this multiple of the time step too: the margin without a warning at load.
MARGIN = 2.0


@dataclass(frozen=True)
class Servo:
    """A position servo on a hinge or slide.

    drive: the actuator. name: its name. unit: of its joint. inertia: that it moves while the other
    joints are held. damping: of the joint. load: the force of the servo that the pose needs at rest
    [N or N·m].
    """

    drive: Actuator
    name: str
    unit: str
    inertia: float
    damping: float
    load: float

    def omega(self, goal: str, value: float) -> float:
        """Return the frequency at which the closed form has a value of a goal [rad/s]."""
        if goal == "sag":
            return math.sqrt(abs(self.load * self.drive.gear) / (value * self.inertia))
        return 2 * math.pi * value / PASSES if goal == "bandwidth" else SETTLES / value

    def kp(self, omega: float) -> float:
        """Return the kp of a frequency [rad/s]."""
        return rounded(self.inertia * omega**2 / self.drive.gear**2)

    def frequency(self, kp: float) -> float:
        """Return the frequency of the servo alone, the other joints held [rad/s]."""
        return abs(self.drive.gear) * math.sqrt(kp / self.inertia)

    def values(self, model: Model, omega: float) -> dict[str, Any]:
        """Return the values of the model, by path, with a critically damped servo."""
        kp, gear, path = self.kp(omega), self.drive.gear, f"actuator/#{self.drive.index}"
        kv = rounded(max(0.0, 2 * self.inertia * omega - self.damping) / gear**2)
        actuator = model.scene.actuators[self.drive.index]
        if actuator.type == "general":
            bias = self.drive.offset, -kp, -kv
            return {f"{path}/gainprm": (kp,), f"{path}/biasprm": bias}
        ratio = {} if actuator.dampratio is None else {f"{path}/dampratio": None}
        return {f"{path}/kp": kp, f"{path}/kv": kv} | ratio


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
            own = float(mass[dof, dof]), float(np.ravel(joint.damping)[0])
            found.append(Servo(drive, called[drive.index], unit, *own, need[dof] / drive.gear))
    known = [servo.name for servo in found]
    for name in names or ():
        if name not in known:
            model.index("actuator", name)
            raise ValueError(f"servo = {name!r}: is no position servo on a hinge or slide")
    return [servo for servo in found if names is None or servo.name in names]


def shown(
    model: Model, at: At, servos: Sequence[Servo], goal: Goal, omega: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Try all servos of a model, each by a motion of its own target while the others hold.

    The motion is a sine of the wanted bandwidth, else a step. omega: the slowest frequency [rad/s].

    Return for each servo the value of the goal, nan if it does not come to rest; how far from its
    target it rests [rad or m]; and how wide the motion is [rad or m].
    """
    own = actuators(model)
    drives, dt = [own[servo.drive.index] for servo in servos], model.settings.dt
    values, off, widths = np.full((3, len(drives)), math.nan)
    steps = steps_of(model, omega)
    states = at.states(model, steps)
    if states is None:
        return values, off, widths
    rest, wave = states[-1], np.ones(steps)
    if goal.name == "bandwidth":
        count = max(FEWEST, math.ceil(4 / goal.value / dt))
        wave = np.sin(2 * np.pi * goal.value * dt * (np.arange(count) + 0.5))
    ctrl = np.tile(at.ctrl, (len(drives), len(wave), 1))
    for n, drive in enumerate(drives):
        k, gear = drive.index, abs(drive.gear)
        asked = ctrl[n, 0, k]
        far = abs(float(drive.target(asked)) - drive.gear * rest.qpos[drive.qposadr])
        # At most a share of the range, and half of the force that is left.
        left, width = drive.bound - drive.kp * far, share_of_range(drive)
        width = min(width, left / 2 / drive.kp) if left > 0 else width
        ctrl[n, :, k] += wave * (width if asked + 2 * width <= drive.ctrlrange[1] else -width)
        off[n], widths[n] = far / gear, width / gear
    ran = follow(model, [rest] * len(drives), len(wave), ctrl=ctrl, record=("qpos",))
    for n, drive in enumerate(drives):
        path = ran["qpos"][n, :, drive.qposadr]
        if goal.name == "bandwidth":
            values[n] = goal.value * passed(path, goal.value * dt, widths[n])
        elif is_settled(path, widths[n]):
            values[n] = settling(path, dt) if goal.name == "settling" else off[n]
    return values, off, widths


def share_of_range(drive: Actuator) -> float:
    """Return how wide the motion of a servo is, before the gear, if its force allows it."""
    return WIDTH * float(min(abs(drive.gear), np.ptp(drive.ctrlrange)))


def is_settled(path: np.ndarray, width: float) -> bool:
    """Return whether a step response of about this width has settled in four fifths of its time."""
    way, late = abs(path[-1] - path[0]), path[-(len(path) // 5) :]
    return bool(abs(way / width - 1) <= 0.5 and np.ptp(late) <= 2 * SETTLED * way)


def passed(path: np.ndarray, frequency: float, width: float) -> float:
    """Return the bandwidth that a response to a sine shows, as a multiple of the sine's frequency.

    It is that of the critically damped oscillator with the same gain, 1/(1 + (ω/ω₀)²), and four at
    most; nan if the response is no sine. frequency: periods in a step. width: of the sine.
    """
    late = path[-(len(path) // 4) :]
    phase = 2 * np.pi * frequency * np.arange(len(late))
    sines = np.stack([np.sin(phase), np.cos(phase), np.ones(len(late))], axis=1)
    if not np.isfinite(late).all():
        return math.nan
    size, *_ = np.linalg.lstsq(sines, late, rcond=None)
    gain = math.hypot(size[0], size[1]) / width
    if np.std(late - sines @ size) > WITHIN * gain * width:
        return math.nan
    return PASSES / math.sqrt(max(1 / gain - 1, (PASSES / 4) ** 2))


@dataclass
class Servos:
    """Servos that are changed together, and their runs.

    margin: whether steps twice as long hold, too. Other elements may leave none, which gains do not
    give back. change, off, widths: of the last run; see `shown`.
    """

    model: Model
    at: At
    servos: Sequence[Servo]
    margin: bool = True

    def __post_init__(self) -> None:
        slowest = min(servo.frequency(servo.drive.kp) for servo in self.servos)
        self.margin = self.holds_longer(self.model, slowest)

    def holds_longer(self, model: Model, omega: float) -> bool:
        """Return whether all servos settle after a step of the target in longer time steps."""
        longer = Change(dt=MARGIN * model.settings.dt).of(model)
        step = Goal("settling", SETTLES / omega)
        return bool(np.isfinite(shown(longer, self.at, self.servos, step, omega)[0]).all())

    def run(self, goal: Goal, asked: np.ndarray, **settings: Any) -> np.ndarray:
        """Return the values of a goal with the gains of what is asked; nan without a margin."""
        values, slowest = dict[str, Any](), math.inf
        for servo, value in zip(self.servos, asked, strict=True):
            omega = servo.omega(goal.name, value)
            values |= servo.values(self.model, omega)
            slowest = min(slowest, omega)
        self.change = Change(values)
        model = self.change.also(Change(**settings)).of(self.model)
        found, self.off, self.widths = shown(model, self.at, self.servos, goal, slowest)
        if self.margin and np.isfinite(found).all() and not self.holds_longer(model, slowest):
            return np.full(len(found), math.nan)
        return found

    def limit(self, goal: Goal) -> str:
        """Return in words what the time step holds: the goal that comes nearest, which was run."""
        settings, way = self.model.settings, -1 if goal.name == "bandwidth" else 1

        def wanted(percent: int) -> Goal:
            return Goal(goal.name, goal.value * (percent / 100) ** way)

        def holds(percent: int, **other: Any) -> bool:
            asked = np.full(len(self.servos), wanted(percent).value)
            return bool(np.isfinite(self.run(wanted(percent), asked, **other)).all())

        parts = range(100, 12_801)
        held = least(parts, lambda part: float(not holds(part)), 0.5, 200, ratio=1.05, cliff=True)
        if held is None:
            return (
                "The pose does not come to rest, so nothing can be verified: try another keyframe"
            )
        limit = goal.words(wanted(held).value, self.servos[0].unit)
        said = f"{seconds(settings.dt)} under {settings.integrator} holds about {limit}"
        if settings.integrator != "implicitfast":
            does = "holds" if holds(100, integrator="implicitfast") else "does not hold"
            said += f"; implicitfast {does} it"
        return said


def tuned_servos(model: Model, at: At, servos: Sequence[Servo], goal: Goal) -> list[Tuned]:
    """Return gains for each servo. All servos are changed together, and verified together."""
    # A thousandth of the largest load is none.
    whole = 1e-3 * max(abs(servo.load) for servo in servos) if goal.name == "sag" else -1.0
    why = "It carries no load in this pose; its gains are left as they are"
    idle = [Tuned("servo", s.name, goal, s.unit, why=why) for s in servos if abs(s.load) <= whole]
    servos = [servo for servo in servos if abs(servo.load) > whole]
    if not servos:
        return idle
    tried = Servos(model, at, servos)
    asked, values = goal.corrected(len(servos), lambda asked: tried.run(goal, asked))
    change, off, widths = tried.change, tried.off, tried.widths
    limit = "" if np.isfinite(values).all() else tried.limit(goal)
    found = []
    for k, servo in enumerate(servos):
        omega = servo.omega(goal.name, asked[k])
        kp, reached, unit = servo.kp(omega), goal.near(values[k]), servo.unit
        why = limit or f"The run shows {goal.words(values[k], unit)} with kp={kp:g}"
        if goal.name == "sag" and kp * goal.value * abs(servo.drive.gear) > servo.drive.bound:
            why = f"The pose needs more than its forcerange of {servo.drive.bound:g}"
        full, also = share_of_range(servo.drive) / abs(servo.drive.gear), ""
        far, width = (Goal("sag", x).words(x, unit) for x in (off[k], widths[k]))
        if goal.name != "sag" and reached and off[k] > full:
            reached = False
            why = (
                f"With kp={kp:g} it rests {far} from its target, further than it was moved: ask "
                "for a smaller sag first"
            )
        elif goal.name != "sag" and widths[k] < full:
            also = f", of a motion of {width}, for which half of the force is left"
        tuned = Tuned("servo", servo.name, goal, unit if goal.name == "sag" else "", change)
        found.append(
            replace(
                tuned,
                lines=pasted(model, servo.values(model, omega)),
                expected=float(asked[k]),
                measured=float(values[k]),
                reached=reached,
                why=why,
                also=also,
            )
        )
    return [*idle, *found]
