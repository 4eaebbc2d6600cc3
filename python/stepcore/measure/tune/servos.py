"""Gains of position servos for a wanted bandwidth, settling time or sag, verified by runs.

Alone, a servo on the inertia I with critical damping has the frequency ω = √(kp/I). Its gain falls
to 1/√2 at PASSES ω, its steps settle in SETTLES/ω, and under a load F it sags by F/kp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from stepcore.engine.actuator import SERVO, Actuator, actuators, loads
from stepcore.engine.follow import follow
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.change import Change
from stepcore.experiment.choose import least
from stepcore.measure.monitors.servos import gained
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


def servos_of(model: Model, names: Sequence[str] | None) -> list[Actuator]:
    """Return the position servos on hinges and slides, or those with the given names.

    Raises ValueError for a name that is no position servo.
    """
    called = model.called("actuator")
    drives = [drive for drive in actuators(model) if drive.kind == SERVO and drive.gain > 0]
    found = {called[drive.index]: drive for drive in drives if drive.joint is not None}
    for name in names or ():
        if name not in found:
            model.index("actuator", name)
            raise ValueError(f"servo = {name!r}: is no position servo on a hinge or slide")
    return list(found.values() if names is None else map(found.__getitem__, dict.fromkeys(names)))


def shown(
    model: Model, at: At, indices: Sequence[int], goal: Goal, omega: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Try some servos of a model, each by a motion of its own target while the others hold.

    The motion is a sine of the wanted bandwidth, else a step. omega: the slowest frequency [rad/s].

    Return for each servo the value of the goal, nan if it does not come to rest; how far from its
    target it rests [rad or m]; and how wide the motion is [rad or m].
    """
    own, dt = actuators(model), model.settings.dt
    drives = [own[index] for index in indices]
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


class Servos:
    """Position servos that are changed together, and their runs.

    drives: the servos. inertia: that each moves while the other joints are held. damping: of its
    joint. load: its force that the pose needs at rest [N or N·m].
    change, off, widths: of the last run; see `shown`.
    """

    def __init__(self, model: Model, at: At, drives: Sequence[Actuator]) -> None:
        self.model, self.at, self.drives = model, at, drives
        sim, joints = Sim(model), Layout(model.scene).joints
        at.start.put(sim)
        sim.forward()
        dofs, own = [drive.dof for drive in drives], [joints[drive.joint or 0] for drive in drives]
        self.gear = np.array([drive.gear for drive in drives])
        self.inertia = sim.mass_matrix()[dofs, dofs]
        self.damping = np.array([float(np.ravel(joint.damping)[0]) for joint in own])
        self.load = loads(sim)[dofs] / self.gear
        self.units = ["m" if joint.type == "slide" else "rad" for joint in own]

    def omegas(self, goal: str, asked: np.ndarray) -> np.ndarray:
        """Return the frequencies at which the closed form has these values of a goal [rad/s]."""
        if goal == "sag":
            return np.sqrt(np.abs(self.load * self.gear) / (asked * self.inertia))
        return 2 * np.pi * asked / PASSES if goal == "bandwidth" else SETTLES / asked

    def gains(self, omegas: np.ndarray) -> list[tuple[float, float]]:
        """Return kp and kv of critically damped servos."""
        kp = self.inertia * omegas**2 / self.gear**2
        kv = np.maximum(0.0, 2 * self.inertia * omegas - self.damping) / self.gear**2
        return [(rounded(p), rounded(v)) for p, v in zip(kp, kv, strict=True)]

    def shown(self, model: Model, goal: Goal, omega: float) -> tuple[np.ndarray, ...]:
        """Try the servos; see the function `shown`."""
        return shown(model, self.at, [drive.index for drive in self.drives], goal, omega)

    def holds_longer(self, model: Model, omega: float) -> bool:
        """Return whether all servos settle after a step of the target in longer time steps."""
        longer = Change(dt=MARGIN * model.settings.dt).of(model)
        step = Goal("settling", SETTLES / omega)
        return bool(np.isfinite(self.shown(longer, step, omega)[0]).all())

    @cached_property
    def margin(self) -> bool:
        """Whether longer steps hold as shipped. Other elements may leave no margin, which gains do
        not give back."""
        own = np.array([drive.stiffness for drive in self.drives]) / self.inertia
        return self.holds_longer(self.model, math.sqrt(own.min()))

    def run(self, goal: Goal, asked: np.ndarray, **settings: Any) -> np.ndarray:
        """Return the values of a goal with the gains of what is asked; nan without a margin."""
        omegas, values = self.omegas(goal.name, asked), dict[str, Any]()
        for k, gains in enumerate(self.gains(omegas)):
            values |= gained(self.model, self.drives[k].index, *gains)
        self.change, slowest = Change(values), float(omegas.min())
        model = self.change.also(Change(**settings)).of(self.model)
        found, self.off, self.widths = self.shown(model, goal, slowest)
        if np.isfinite(found).all() and self.margin and not self.holds_longer(model, slowest):
            return np.full(len(found), math.nan)
        return found

    def limit(self, goal: Goal) -> str:
        """Return in words what the time step holds: the goal that comes nearest, which was run."""
        settings, way = self.model.settings, -1 if goal.name == "bandwidth" else 1

        def wanted(percent: int) -> Goal:
            return Goal(goal.name, goal.value * (percent / 100) ** way)

        def holds(percent: int, **other: Any) -> bool:
            asked = np.full(len(self.drives), wanted(percent).value)
            return bool(np.isfinite(self.run(wanted(percent), asked, **other)).all())

        parts = range(100, 12_801)
        held = least(parts, lambda part: float(not holds(part)), 0.5, 200, ratio=1.05, cliff=True)
        if held is None:
            return (
                "The pose does not come to rest, so nothing can be verified: try another keyframe"
            )
        limit = goal.words(wanted(held).value, self.units[0])
        said = f"{seconds(settings.dt)} under {settings.integrator} holds about {limit}"
        if settings.integrator != "implicitfast":
            does = "holds" if holds(100, integrator="implicitfast") else "does not hold"
            said += f"; implicitfast {does} it"
        return said


def tuned_servos(model: Model, at: At, drives: Sequence[Actuator], goal: Goal) -> list[Tuned]:
    """Return gains for each servo. All servos are changed together, and verified together."""
    called, servos, idle = model.called("actuator"), Servos(model, at, drives), list[Tuned]()
    if goal.name == "sag":
        # A thousandth of the largest load is none.
        bears = np.abs(servos.load) > 1e-3 * np.abs(servos.load).max()
        why = "It carries no load in this pose; its gains are left as they are"
        idle = [
            Tuned("servo", called[drives[k].index], goal, servos.units[k], why=why)
            for k in np.flatnonzero(~bears).tolist()
        ]
        servos = Servos(model, at, [drives[k] for k in np.flatnonzero(bears).tolist()])
        if not servos.drives:
            return idle
    count = len(servos.drives)
    asked, values = goal.corrected(count, lambda asked: servos.run(goal, asked))
    change, off, widths = servos.change, servos.off, servos.widths
    limit = "" if np.isfinite(values).all() else servos.limit(goal)
    found, gains = [], servos.gains(servos.omegas(goal.name, asked))
    for k, (drive, unit) in enumerate(zip(servos.drives, servos.units, strict=True)):
        (kp, kv), reached, also = gains[k], goal.near(values[k]), ""
        why = limit or f"The run shows {goal.words(values[k], unit)} with kp={kp:g}"
        if goal.name == "sag" and kp * goal.value * abs(drive.gear) > drive.bound:
            why = f"The pose needs more than its forcerange of {drive.bound:g}"
        full = share_of_range(drive) / abs(drive.gear)
        far, width = (Goal("sag", x).words(x, unit) for x in (off[k], widths[k]))
        if goal.name != "sag" and reached and off[k] > full:
            reached = False
            why = (
                f"With kp={kp:g} it rests {far} from its target, further than it was moved: ask "
                "for a smaller sag first"
            )
        elif goal.name != "sag" and widths[k] < full:
            also = f", of a motion of {width}, for which half of the force is left"
        found.append(
            Tuned(
                *("servo", called[drive.index], goal, unit if goal.name == "sag" else "", change),
                *(
                    pasted(model, gained(model, drive.index, kp, kv)),
                    float(asked[k]),
                    float(values[k]),
                ),
                *(reached, why, also),
            )
        )
    return [*idle, *found]
