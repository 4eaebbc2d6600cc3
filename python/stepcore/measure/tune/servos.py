"""Gains of position servos for a wanted bandwidth, settling time or sag, verified by runs.

A single servo on the inertia I with critical damping has the frequency ω = √(kp/I). Its gain falls
to 1/√2 at PASSES ω, its step response settles in SETTLES/ω, and it sags by F/kp under a load F.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, cached_property, partial
from typing import Any

import numpy as np

from stepcore.deadline import Deadline
from stepcore.engine.actuator import MOTOR, SERVO, Actuator, actuators, hold_load, passing_stiffness
from stepcore.engine.follow import follow
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.change import Change, Servo
from stepcore.experiment.choose import least
from stepcore.measure.monitors.finding import listed, named
from stepcore.measure.monitors.servos import gained, strength
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
from stepcore.measure.tune.ground import Ground, fall
from stepcore.report.units import rounded, seconds
from stepcore.scene.layout import Layout

# The amplitude of the motion that tests gains [rad or m], and its largest share of the range.
WIDTH = 0.1


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


def for_motors(model: Model, names: Sequence[str] | None) -> tuple[Model, set[int]]:
    """Return the model with servos instead of motors on hinges and slides, and their indices.

    The servos represent the PD controllers of robots with motors. names: of motors; default all.
    """
    called, omega = model.called("actuator"), 2 * np.pi
    motors = [
        drive
        for drive in actuators(model)
        if drive.kind == MOTOR and drive.direct and drive.gear
        if names is None or called[drive.index] in names
    ]
    servos = list[Servo]()
    for drive in motors:
        inertia = drive.inertia / drive.gear**2
        servos.append(Servo(drive.index, omega**2 * inertia, 2 * omega * inertia, drive.forces))
    changed = Change(servos=servos).of(model) if servos else model
    return changed, {drive.index for drive in motors}


def in_place(model: Model, drive: Actuator, kp: float, kv: float) -> tuple[str, ...]:
    """Return the servo that replaces a motor, as MJCF."""
    names, joints = model.names["actuator"], model.names["joint"]
    fields = {"name": names[drive.index], "joint": joints[drive.joint or 0]}
    fields |= {} if drive.gear == 1 else {"gear": f"{drive.gear:g}"}
    fields |= {"kp": f"{kp:g}", "kv": f"{kv:g}"}
    if np.isfinite(drive.forcerange).all():
        fields["forcerange"] = " ".join(f"{end:g}" for end in drive.forcerange)
    said = " ".join(f'{field}="{value}"' for field, value in fields.items() if value)
    return (f"<position {said}/>",)


def shown(
    model: Model, at: At, indices: Sequence[int], goal: Goal, omega: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Test servos of a model, each by a motion of its target while the others hold.

    The motion is a sine of the wanted bandwidth, else a step. omega: the slowest frequency [rad/s].

    Return for each servo the value of the goal, or nan if it does not come to rest; its distance
    from the target at rest [rad or m]; and the width of the motion [rad or m].
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
        # At most a share of the range, and half of the remaining force.
        left, width = drive.bound - drive.kp * far, share_of_range(model, drive)
        width = min(width, left / 2 / drive.kp) if left > 0 else width
        low, high = ends(model, drive)
        if goal.name == "bandwidth":
            # The sine is centred on the pose, or as near to it as its width allows.
            ctrl[n, :, k] = np.clip(asked, low + width, max(low + width, high - width))
        ctrl[n, :, k] += wave * (width if asked + 2 * width <= high else -width)
        off[n], widths[n] = far / gear, width / gear
    # A joint whose range holds it in place cannot move.
    free = np.flatnonzero(widths > 0).tolist()
    ran = follow(model, [rest] * len(drives), len(wave), ctrl=ctrl, record=("qpos",))
    for n in free:
        path = ran["qpos"][n, :, drives[n].qposadr]
        if goal.name == "bandwidth":
            values[n] = goal.value * passed(path, goal.value * dt, widths[n])
        elif is_settled(path, widths[n]):
            values[n] = settling(path, dt) if goal.name == "settling" else off[n]
    return values, off, widths


def ends(model: Model, drive: Actuator) -> tuple[float, float]:
    """Return the least and largest control inside the ranges of a servo and of its joint."""
    reached = drive.holding(drive.gear * model.jnt_range[drive.joint])
    inside = np.clip(np.sort(reached), *drive.ctrlrange)
    return float(inside[0]), float(inside[1])


def share_of_range(model: Model, drive: Actuator) -> float:
    """Return the width of a servo's motion, before the gear, if the force limit allows it."""
    return WIDTH * float(min(abs(drive.gear), np.ptp(ends(model, drive))))


def is_settled(path: np.ndarray, width: float) -> bool:
    """Return whether a step response of about this width settles within 80 % of its duration."""
    way, late = abs(path[-1] - path[0]), path[-(len(path) // 5) :]
    return bool(abs(way / width - 1) <= 0.5 and np.ptp(late) <= 2 * SETTLED * way)


def passed(path: np.ndarray, frequency: float, width: float) -> float:
    """Estimate the bandwidth from the response to a sine, as a multiple of the sine's frequency.

    It is the bandwidth of the critically damped oscillator with the same gain, 1/(1 + (ω/ω₀)²), and
    at most four; nan if the response is no sine, or almost none. frequency: periods per step.
    width: the amplitude of the sine.
    """
    late = path[-(len(path) // 4) :]
    phase = 2 * np.pi * frequency * np.arange(len(late))
    sines = np.stack([np.sin(phase), np.cos(phase), np.ones(len(late))], axis=1)
    if not np.isfinite(late).all():
        return math.nan
    size, *_ = np.linalg.lstsq(sines, late, rcond=None)
    gain = math.hypot(size[0], size[1]) / width
    # Under dry friction the response can be a sine of a hundredth of the width.
    if gain < 0.01 or np.std(late - sines @ size) > WITHIN * gain * width:
        return math.nan
    return PASSES / math.sqrt(max(1 / gain - 1, (PASSES / 4) ** 2))


class Servos:
    """Position servos that are changed together, and their runs.

    drives: the servos. For each: inertia, which it moves while the other joints are held; damping,
    spring and friction: damping, stiffness and dry friction of its joint; load: its force that
    holds the pose at rest [N or N·m], on the ground if `ground` is given.
    off, widths: from the last run; see `shown`.
    """

    def __init__(
        self, model: Model, at: At, drives: Sequence[Actuator], ground: Ground | None = None
    ) -> None:
        self.model, self.at, self.drives = model, at, drives
        sim, joints = Sim(model), Layout(model.scene).joints
        at.start.put(sim)
        sim.forward()
        dofs, own = [drive.dof for drive in drives], [joints[drive.joint or 0] for drive in drives]
        self.gear = np.array([drive.gear for drive in drives])
        self.inertia = sim.mass_matrix()[dofs, dofs]
        self.damping = np.array([float(np.ravel(joint.damping)[0]) for joint in own])
        sprung = model.scene.features.spring
        self.spring = np.array([float(np.ravel(one.stiffness)[0]) * sprung for one in own])
        rubs = model.scene.features.constraint and model.scene.features.frictionloss
        self.friction = np.array([joint.frictionloss if rubs else 0.0 for joint in own])
        self.load = (hold_load(sim)[dofs] if ground is None else ground.load(dofs)) / self.gear
        self.units = ["m" if joint.type == "slide" else "rad" for joint in own]

    def omegas(self, goal: str, asked: np.ndarray) -> np.ndarray:
        """Return the frequencies at which the closed form gives the requested values [rad/s].

        If the joint alone is overdamped, the servo is a lag, whose slow pole decays to 0.02 in the
        settling time.
        """
        if goal == "sag":
            return np.sqrt(np.abs(self.load * self.gear) / (asked * self.inertia))
        if goal == "bandwidth":
            stiff = passing_stiffness(2 * np.pi * asked, self.inertia, self.damping)
            return np.sqrt(stiff / self.inertia)
        rate, critical = -math.log(SETTLED) / asked, SETTLES / asked
        lag = np.sqrt(np.abs(self.damping / self.inertia * rate - rate**2))
        return np.where(self.damping > 2 * self.inertia * critical, lag, critical)

    def slowest(self, omegas: np.ndarray) -> float:
        """Return the rate of the slowest pole of servos of these frequencies [rad/s]."""
        half = np.maximum(self.damping / self.inertia / 2, omegas)
        return float((omegas**2 / (half + np.sqrt(half**2 - omegas**2))).min())

    def gains(self, omegas: np.ndarray) -> list[tuple[float, float]]:
        """Return kp and kv for critical damping; kv is 0 if the joint alone is overdamped."""
        kp = self.inertia * omegas**2 / self.gear**2
        kv = np.maximum(0.0, 2 * self.inertia * omegas - self.damping) / self.gear**2
        return [(rounded(p), rounded(v)) for p, v in zip(kp, kv, strict=True)]

    def shown(self, model: Model, goal: Goal, omega: float) -> tuple[np.ndarray, ...]:
        """Test the servos; see the function `shown`."""
        return shown(model, self.at, [drive.index for drive in self.drives], goal, omega)

    def hold_longer(self, model: Model, goal: Goal, omega: float) -> np.ndarray:
        """Return which servos also give a value with steps twice as long, which is their margin."""
        longer = Change(dt=2 * model.settings.dt).of(model)
        return np.isfinite(self.shown(longer, goal, omega)[0])

    @cached_property
    def margin(self) -> np.ndarray:
        """Which servos settle in longer steps as shipped. Other elements may leave no margin, and
        gains do not restore it."""
        own = np.array([drive.stiffness for drive in self.drives]) / self.inertia
        slowest = self.slowest(np.sqrt(own))
        return self.hold_longer(self.model, Goal("settling", SETTLES / slowest), slowest)

    def change(self, goal: str, asked: np.ndarray, **settings: Any) -> Change:
        """Return the gains for requested values of a goal, as a change of the model."""
        values = dict[str, Any]()
        for drive, gains in zip(self.drives, self.gains(self.omegas(goal, asked)), strict=True):
            values |= gained(self.model, drive.index, *gains)
        return Change(values, **settings)

    def run(self, goal: Goal, asked: np.ndarray, **settings: Any) -> np.ndarray:
        """Measure a goal with the gains for the requested values; nan without a margin."""
        model = self.change(goal.name, asked, **settings).of(self.model)
        slowest = self.slowest(self.omegas(goal.name, asked))
        found, self.off, self.widths = self.shown(model, goal, slowest)
        if np.isfinite(found).any() and self.margin.any():
            found[self.margin & ~self.hold_longer(model, goal, slowest)] = math.nan
        return found

    def limits(
        self, goal: Goal, asked: np.ndarray, failing: Sequence[int]
    ) -> dict[int, tuple[float, str]]:
        """Return for failing servos the request nearest to the goal that the step allows, and text.

        asked: the requests to the closed form. All servos are relaxed together and run.
        """
        settings, way = self.model.settings, -1 if goal.name == "bandwidth" else 1

        @cache
        def shown(percent: int, **other: Any) -> np.ndarray:
            share = (percent / 100) ** way
            return self.run(Goal(goal.name, goal.value * share), asked * share, **other)

        def limit(k: int) -> tuple[float, str]:
            def fails(percent: int) -> float:
                return float(math.isnan(shown(percent)[k]))

            held = least(range(100, 1001), fails, 0.5, 200, ratio=1.05, cliff=True)
            if held is None:
                what = "is no sine" if goal.name == "bandwidth" else "does not settle"
                return float(asked[k]), (
                    f"Its motion {what}, even where ten times less is asked: friction, a limit or "
                    "contacts hold it, or the pose does not come to rest; try another keyframe"
                )
            most = goal.words(float(shown(held)[k]), self.units[k])
            said = f"{seconds(settings.dt)} under {settings.integrator} holds about {most}"
            if settings.integrator != "implicitfast":
                holds = math.isfinite(shown(100, integrator="implicitfast")[k])
                said += f"; implicitfast {'holds it' if holds else 'does not hold it'}"
            return float(asked[k]) * (held / 100) ** way, said

        return {k: limit(k) for k in failing}


def tuned_servos(
    model: Model,
    at: At,
    drives: Sequence[Actuator],
    goal: Goal,
    motors: set[int],
    deadline: Deadline,
    ground: Ground | None = None,
) -> list[Tuned]:
    """Return gains for each servo. All servos are changed together, and verified together.

    motors: the indices of the servos that replace motors. ground: the robot's rest on the ground.
    """
    called, idle = model.called("actuator"), list[Tuned]()
    servos = Servos(model, at, drives, ground)
    if goal.name == "sag":
        # A load below a thousandth of the largest counts as none.
        load = np.abs(servos.load * servos.gear)
        carries = load > 1e-3 * load.max()
        bears = carries & (load > servos.friction)
        for k in np.flatnonzero(~bears).tolist():
            why = "It carries no load in this pose; its gains are left as they are"
            if carries[k]:
                held = strength(model, drives[k].index, float(servos.friction[k]))
                why = f"Dry friction ({held}) bears its load in this pose; its gains are left"
            idle.append(Tuned("servo", called[drives[k].index], goal, servos.units[k], why=why))
        servos = Servos(model, at, [drives[k] for k in np.flatnonzero(bears).tolist()], ground)
        if not servos.drives:
            return idle
    count, stands = len(servos.drives), goal.name == "sag" and ground is not None

    def tried(first: np.ndarray | None = None) -> tuple[Any, ...]:
        asked, values = goal.corrected(count, lambda asked: servos.run(goal, asked), first)
        return asked, values, servos.off, servos.widths

    falls, limits, ours = "", dict[int, tuple[float, str]](), tuple[Any, ...]()
    if ground is not None and stands:
        asked, values, falls = ground.sag(servos.drives, goal, partial(servos.change, goal.name))
        ours = asked, values, values, np.full(count, math.nan)
    else:
        ours = tried()
    with deadline.stage("what the time step holds of the servos that are not reached"):
        unknown = np.flatnonzero(np.isnan(ours[1]) & (not stands))
        limits = servos.limits(goal, ours[0], unknown.tolist())
        held = ours[0].copy()
        held[[*limits]] = [asked for asked, _ in limits.values()]
        if limits:
            ours = max(ours, tried(held), key=lambda one: sum(map(goal.near, one[1])))
    asked, values, off, widths = ours
    if ground is not None and not stands:
        falls = fall(ground.run(servos.change(goal.name, asked)))
    found, gains = [], servos.gains(servos.omegas(goal.name, asked))
    # The change applies to the user's model, which may have motors.
    own, placed = dict[str, Any](), list[Servo]()
    for drive, (kp, kv) in zip(servos.drives, gains, strict=True):
        if drive.index in motors:
            named = model.actuator_names[drive.index] or drive.index
            placed.append(Servo(named, kp, kv, drive.forcerange))
        else:
            own |= gained(model, drive.index, kp, kv)
    change, contacts = Change(own, servos=placed), at.contacts(Sim(model), at.start)
    for k, (drive, unit) in enumerate(zip(servos.drives, servos.units, strict=True)):
        (kp, kv), reached, also = gains[k], goal.near(values[k]), ""
        if stands:
            # Joints of one leg sag together, most of them less than the goal.
            reached, also = bool(values[k] <= (1 + WITHIN) * goal.value), ", on the ground"
        why = f"The run shows {goal.words(values[k], unit)} with kp={kp:g}"
        if math.isnan(values[k]):
            why = "The run does not show it, or one with steps twice as long does not"
        if k in limits:
            why = limits[k][1]
        if goal.name == "sag" and not stands and kp * goal.value * abs(drive.gear) > drive.bound:
            why = f"The pose needs more than its forcerange of {drive.bound:g}"
        full = share_of_range(model, drive) / abs(drive.gear)
        far, width = (Goal("sag", x).words(x, unit) for x in (off[k], widths[k]))
        if goal.name != "sag" and reached and off[k] > full:
            reached = False
            why = (
                f"With kp={kp:g} it rests {far} from its target, further than it was moved: ask "
                "for a smaller sag first"
            )
        elif goal.name != "sag" and widths[k] < full:
            also = f", of a motion of {width}, for which half of the force is left"
        if falls:
            reached, why = False, falls
        way = kp * drive.gear**2 / (kp * drive.gear**2 + servos.spring[k])
        if goal.name != "sag" and way < 1 - WITHIN:
            also += f"; the joint's spring lets it come {way:.0%} of the way to its target"
        if k in limits or (not stands and not 0.5 < values[k] / asked[k] < 2):
            rubs = touched(model, contacts, drive)
            why += f"; {rubs} acts there" * bool(rubs)
            also = f", which leaves out {rubs}" * bool(rubs) + also
        found.append(
            Tuned(
                *("servo", called[drive.index], goal, unit if goal.name == "sag" else "", change),
                *(
                    in_place(model, drive, kp, kv)
                    if drive.index in motors
                    else pasted(model, gained(model, drive.index, kp, kv)),
                    float(asked[k]),
                    float(values[k]),
                ),
                *(reached, why, also),
            )
        )
    return [*idle, *found]


def touched(model: Model, contacts: np.ndarray, drive: Actuator) -> str:
    """Return the contacts between bodies that a servo moves and all others, in words."""
    own, pairs = model.jnt_body[drive.joint], list[int]()

    def moved(body: int) -> bool:
        while body and body != own:
            body = int(model.body_parent[body])
        return body > 0

    for contact in contacts:
        if len({moved(int(model.geom_body[contact[geom]])) for geom in ("geom1", "geom2")}) == 2:
            pairs.append(int(contact["index"]))
    return listed(named(model, "contact", pairs), "contact") if pairs else ""
