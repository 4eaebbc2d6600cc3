"""Findings on joints and their actuators in a run.

Connections that gape, limits that a force overcomes, backlash, servos that sag or are saturated,
robots that fall over. Backlash is a joint of small range in series with another: two joints of one
body along one axis. An equality that holds such a joint within its range takes the backlash away.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.actuator import SERVO, Actuator, actuators, loads
from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import rotated, turned
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.change import Change
from stepcore.experiment.moves import SINKS, TILT, moves_about, roots
from stepcore.measure.monitors.finding import (
    DEEP,
    FEW,
    HALF,
    LEFT,
    OTHERS,
    PARTS,
    PLOT,
    SEEN,
    TEST_CONTACTS,
    Cure,
    Finding,
    Next,
    Remedy,
    listed,
    named,
    worst,
)
from stepcore.measure.monitors.recording import FEWEST, Recording, free_bodies, settled
from stepcore.measure.monitors.soft_rows import stiffened
from stepcore.report.units import (
    FORCES,
    TORQUES,
    metres,
    percent,
    quantity,
    radians,
    rounded,
    seconds,
)
from stepcore.scene.layout import QPOS, Layout

# Elements that only resist motion cannot push a joint beyond its limit. An equality that holds the
# joint within its range has damping that points outwards, too (backlash.xml).
RESISTS = ("damper", "friction loss", "joint equality")
# The share of a run above which saturation is told: a servo that lost a quarter of a sine's
# amplitude (fastsine.xml) was at its end for 38 % of the run. And the share of the least sag that a
# cure leaves; a smaller one needs kps that isaacfranka.xml's step does not hold.
THIRD = 1 / 3


def joint_findings(run: Recording) -> Iterator[Finding]:
    """Yield the findings on connections, limits and backlash."""
    if run.model.settings.law == "solref":
        yield from _gaps(run)
    yield from _overpowered(run)
    yield from _played(run)


# Connections.


class Gape(NamedTuple):
    """A connection with a gap: the largest one [m], and that at rest; None if it did not settle."""

    equality: int
    most: float
    rest: float | None


def gapes(run: Recording) -> Iterator[Gape]:
    """Yield every connection with its gap."""
    model = run.model
    features, layout = model.scene.features, Layout(model.scene)
    tied = [
        (k, equality)
        for k, equality in enumerate(model.scene.equalities)
        if equality.active and equality.type in ("connect", "weld")
    ]
    if not tied or not (features.equality and features.constraint):
        return
    sim = unwatched(Sim(model))
    place, turn = sim.xpos, np.array(sim.xmat).reshape(-1, 3, 3)
    for k, equality in tied:
        tie = equality.plain(layout)
        bodies, frames = (tie["first"], tie["second"]), (tie["frame1"], tie["frame2"])
        # A point that is not given follows from the poses in which the scene is described.
        known = 0 if frames[0] is not None else 1
        point = place[bodies[known]] + turn[bodies[known]] @ np.array(frames[known]["pos"])
        ends = []
        for body, frame in zip(bodies, frames, strict=True):
            own = turn[body].T @ (point - place[body]) if frame is None else np.array(frame["pos"])
            ends.append(run["xpos"][:, body] + rotated(run["xquat"][:, body], own))
        gap = np.linalg.norm(ends[1] - ends[0], axis=1)
        yield Gape(k, float(gap.max()), settled(gap))


def _gaps(run: Recording) -> Iterator[Finding]:
    model, layout = run.model, Layout(run.model.scene)
    equalities, sizes = model.scene.equalities, run.sizes.bodies

    def size(at: Gape) -> float:
        bodies = [layout.index[id(body)] for body in equalities[at.equality].bodies]
        # The world has no size to compare with.
        return min((sizes[body] for body in bodies if body), default=sizes[0])

    open_ = worst(gapes(run), lambda at: at.most / (SEEN * size(at)))
    if not open_:
        return

    def now(at: Gape) -> float:
        return at.most if at.rest is None else at.rest

    of, tied = open_[0], [at.equality for at in open_]
    connections = tuple(Element.of(model, equalities[k].row_kind, k) for k in tied)
    solref, solimp = equalities[of.equality].solref, equalities[of.equality].solimp
    problem = (
        f"{listed(connections, 'connection')} gapes by {'up to ' * (of.rest is None)}"
        f"{metres(now(of))}, {percent(now(of) / size(of))} of the smaller body's size, under its "
        f'solref="{solref[0]:g} {solref[1]:g}"'
    )
    wanted = LEFT * min(SEEN * size(of), now(of))
    cures = stiffened(model, connections, solref, solimp, now(of), wanted)

    def widest(other: Recording) -> float | None:
        return max((now(at) for at in gapes(other) if at.equality in tied), default=None)

    remedy = Remedy((cures,), widest, SEEN * size(of), metres)
    commands = (Next("converge", "whether the connections are solved"), TEST_CONTACTS[1])
    yield Finding("gap", "warning", problem, "", connections, now(of), "m", commands, remedy=remedy)


# Limits.


class Beyond(NamedTuple):
    """A joint beyond its range.

    kept: the excess at rest, or that reached for a twentieth of the run or more [rad or m]. rest:
    the excess at rest; None if the joint did not settle. forces: the elements that push outwards
    [N·m or N], strongest first. limit: the limit's force.
    """

    joint: int
    kept: float
    rest: float | None
    forces: tuple[tuple[tuple[str, int], float], ...] = ()
    limit: float = 0.0


def excesses(run: Recording) -> Iterator[tuple[Beyond, Floats]]:
    """Yield every joint that was beyond its range, with its excess over time."""
    for joint, (low, high) in enumerate(run.model.jnt_range.tolist()):
        value = coordinate(run.model, run["qpos"], joint)
        beyond = np.maximum(0.0, np.maximum(low - value, value - high))
        if beyond.any():
            rest = settled(beyond)
            # A short impact does not count.
            often = float(np.sort(beyond)[-max(1, math.ceil(FEW * len(beyond)))])
            yield Beyond(joint, often if rest is None else rest, rest), beyond


def coordinate(model: Model, qpos: Floats, joint: int) -> Floats:
    """Return what a joint's range limits, (n,): its coordinate, or the angle of a ball [rad or m].

    qpos: (n, nq).
    """
    at, kind = int(model.jnt_qposadr[joint]), model.jnt_type[joint]
    if kind in ("ball", "free"):
        quat = qpos[:, at + QPOS[kind] - 4 : at + QPOS[kind]]
        return np.asarray(np.linalg.norm(turned(quat), axis=1))
    return qpos[:, at]


def excess_of(run: Recording, joint: int) -> float:
    """Return how far a joint was beyond its range for a while [rad or m]."""
    return max((at.kept for at, _ in excesses(run) if at.joint == joint), default=0.0)


def overpowered(run: Recording) -> list[Beyond]:
    """Return the joints that a force pushes beyond their range, the furthest first."""

    def over(entry: tuple[Beyond, Floats]) -> float:
        return entry[0].kept / (FEW * width_of(run.model, entry[0].joint))

    pushed = (_pushed(run, at, series) for at, series in worst(excesses(run), over))
    return [at for at in pushed if at.forces and at.forces[0][1] > HALF * at.limit]


def _pushed(run: Recording, at: Beyond, series: Floats) -> Beyond:
    """Return what pushes a joint outwards, where its excess is about the one that is told."""
    dof = int(run.model.jnt_dofadr[at.joint])
    # A limit does not push on a joint that returns fast: the next reading may do.
    for reading in np.argsort(np.abs(series - at.kept), kind="stable")[:4].tolist():
        sim = run.at(reading)
        acting = {of: float(force[dof]) for of, force in sim.element_forces().items()}
        limit = acting.pop(("limit", at.joint), 0.0)
        if limit:
            outwards = {of: -math.copysign(f, f * limit) for of, f in acting.items() if f}
            some = [(of, f) for of, f in outwards.items() if f > 0 and of[0] not in RESISTS]
            forces = sorted(some, key=lambda entry: -entry[1])
            return at._replace(forces=tuple(forces), limit=abs(limit))
    return at


def _overpowered(run: Recording) -> Iterator[Finding]:
    """Yield limits that a force overcomes: the worst with its cure, the others by name."""
    model, pushed = run.model, overpowered(run)
    if not pushed:
        return
    of, joints = pushed[0], [at.joint for at in pushed]
    (kind, index), force = of.forces[0]
    pusher = "gravity" if kind == "gravity" else model.element_name(kind, index)
    cure, unit = "less of that force", unit_of(model, of.joint)
    if kind == "actuator":
        ranges = "forcerange or ctrlrange" if actuators(model)[index].holds else "ctrlrange"
        cure = f"a smaller {ranges} of {pusher}"
    problem = (
        f"{pusher} pushes {listed(named(model, 'joint', joints), 'joint')} "
        f"{length_of(model, of.joint, of.kept)} beyond its range with "
        f"{quantity(force, TORQUES if unit == 'rad' else FORCES)}"
        f"{', and stays there' if of.rest is not None else ''}"
    )
    limits, remedy = named(model, "limit", joints), limit_remedy(model, of.joint, of.kept)
    yield Finding("limit", "warning", problem, cure, limits, of.kept, unit, PLOT, {}, remedy)


def limit_remedy(model: Model, joint: int, now: float) -> Remedy:
    """Return the solreflimits that should make a limit's excess small."""
    cures, enough = tuple[Cure, ...](), FEW * width_of(model, joint)
    if model.settings.law == "solref":
        at, limit = Layout(model.scene).joints[joint], named(model, "limit", [joint])
        wanted = LEFT * enough
        cures = stiffened(model, limit, at.solreflimit, at.solimplimit, now, wanted)
    say = functools.partial(length_of, model, joint)
    return Remedy((cures,), lambda other: excess_of(other, joint), enough, say)


def unit_of(model: Model, joint: int) -> str:
    """Return the unit of a joint's coordinate."""
    return "m" if model.jnt_type[joint] == "slide" else "rad"


def width_of(model: Model, joint: int) -> float:
    """Return the width of a joint's range [rad or m]; of an angle at most half a turn."""
    width = float(np.ptp(model.jnt_range[joint]))
    return min(width, math.pi) if unit_of(model, joint) == "rad" else width


def length_of(model: Model, joint: int, value: float) -> str:
    """Return a joint's coordinate in words."""
    return radians(value) if unit_of(model, joint) == "rad" else metres(value)


# Backlash.


def share_used(run: Recording, joint: int) -> float:
    """Return the share of half its range that a joint uses at the end of the run."""
    low, high = (float(bound) for bound in run.model.jnt_range[joint])
    places = run["qpos"][max(0, run.late) :, run.model.jnt_qposadr[joint]]
    return float(np.abs(places - (low + high) / 2).mean()) / ((high - low) / 2)


def _played(run: Recording) -> Iterator[Finding]:
    """Yield joints in series with another that an equality holds within their range."""
    model, features = run.model, run.model.scene.features
    if not (features.limit and features.constraint and features.equality):
        return
    place = {id(joint): k for k, joint in enumerate(Layout(model.scene).joints)}
    for k, equality in enumerate(model.scene.equalities):
        if equality.type != "joint" or not equality.active or equality.joint2 is not None:
            continue
        joint = place[id(equality.joint1)]
        if not _in_series(model, joint):
            continue
        aim = float(model.qpos0[model.jnt_qposadr[joint]] + equality.polycoef[0])
        low, high = (float(bound) for bound in model.jnt_range[joint])
        now = share_used(run, joint)
        # A joint in free play falls onto an end of its range.
        if low < aim < high and now <= 1 - DEEP:
            yield _backlash(model, joint, k, aim, now)


def _backlash(model: Model, joint: int, equality: int, aim: float, now: float) -> Finding:
    low, high = (float(bound) for bound in model.jnt_range[joint])
    say = functools.partial(length_of, model, joint)
    both = (*named(model, "joint", [joint]), *named(model, "joint equality", [equality]))
    problem = (
        f"{both[1].name} pulls {both[0].name} to {say(aim)}, within its range of "
        f"{say(low)} to {say(high)}, so it is a spring and no backlash: {percent(now)} of the "
        "range is used"
    )
    remedy = Remedy(
        ((Cure("removing the equality", Change({f"equality/#{equality}/active": False})),),),
        lambda other: 1 - share_used(other, joint),
        SEEN,
        lambda left: f"{percent(1 - left)} of it in use",
        now=1 - now,
        needed=True,
    )
    unit, value = unit_of(model, joint), now * (high - low) / 2
    return Finding("backlash", "warning", problem, "", both, value, unit, remedy=remedy)


def _in_series(model: Model, joint: int) -> bool:
    """Return whether a joint with a range has another joint of its body along the same axis."""
    kind, body, axis = model.jnt_type[joint], model.jnt_body[joint], model.jnt_axis[joint]
    if kind not in ("hinge", "slide") or not np.isfinite(model.jnt_range[joint]).all():
        return False
    return any(
        k != joint
        and model.jnt_body[k] == body
        and other == kind
        and abs(float(model.jnt_axis[k] @ axis)) > 1 - 1e-6
        for k, other in enumerate(model.jnt_type)
    )


# Actuators.


def actuator_findings(run: Recording) -> Iterator[Finding]:
    """Yield the findings on servos that sag under a load, or are saturated."""
    model = run.model
    if not (model.nu and model.scene.features.actuation):
        return
    still, full = list(at_rest(run)), _saturated(run)
    loaded = (at for at in still if at.loaded and at.actuator.index not in full)
    sagging = worst(loaded, lambda at: abs(at.error) / _notable(model, at.actuator))
    if sagging:
        yield _sags(model, sagging)
    # A servo that presses against an object or a limit does so on purpose, and may be saturated.
    presses = {at.actuator.index for at in still if not at.loaded}
    rests = {at.actuator.index for at in still}
    behind = worst(following(run, rests, full), lambda at: at.error / at.width)
    behind = [at for at in behind if _reason(model, at)]
    if behind:
        yield _behind(run, behind)
        full = {k: full[k] for k in full if k not in {at.actuator.index for at in behind}}
    servos = [of.index for of in _servos(model) if of.index in full.keys() - presses]
    ends = worst(servos, lambda k: full[k] / THIRD)
    if ends:
        elements, share = named(model, "actuator", ends), full[ends[0]]
        force = strength(model, ends[0], float(np.abs(run["actuator_force"][:, ends[0]]).max()))
        problem = (
            f"{listed(elements, 'servo')} is at the end of its forcerange ({force}) for "
            f"{percent(share)} of the run, where kv has no effect"
        )
        cure = "slow the motion or lower kp; a wider forcerange must be one that the hardware has"
        yield Finding("saturation", "warning", problem, cure, elements, share, "1", PLOT)


def _servos(model: Model) -> list[Actuator]:
    return [of for of in actuators(model) if of.direct and of.holds]


def _saturated(run: Recording) -> dict[int, float]:
    """Return for which share of the run the forces of actuators are at an end of their ranges."""
    # The first reading is the start, which no step has led to. A force of 0 is not saturated.
    force = run["actuator_force"][1:]
    low, high = (np.isclose(force, end, 1e-9, 0) for end in run.model.actuator_forcerange.T)
    shares = np.mean((low | high) & (force != 0), axis=0) if len(force) else np.zeros(run.model.nu)
    return {k: float(share) for k, share in enumerate(shares) if share}


class Following(NamedTuple):
    """A servo on its way. Lengths are those before the gear.

    error: RMS from its target. width: RMS of the target's motion, or, of one that is held, the sag
    that is a warning. hertz: the frequency that has most of the motion; 0 without one. share, lag:
    of its amplitude [1], and behind it [rad]. full: the share of the time at an end of its force.
    load: the largest that it has to hold [N·m or N]. need: that of the motion asked for.
    damping: at the joint, its own and the joint's [N·m·s/rad or N·s/m].
    """

    actuator: Actuator
    error: float
    width: float
    hertz: float
    share: float
    lag: float
    full: float
    load: float
    need: float
    damping: float

    @property
    def omega(self) -> float:
        """Its natural frequency [rad/s]."""
        return math.sqrt(self.actuator.stiffness / self.actuator.inertia)

    @property
    def rings(self) -> bool:
        """Whether its damping takes less than a factor e of a swing in one second."""
        return self.damping / 2 / self.actuator.inertia < 1

    @property
    def passes(self) -> float:
        """The frequency at which its gain falls to 1/√2, at small amplitudes [Hz]."""
        x = 1 - (self.damping / self.omega / self.actuator.inertia) ** 2 / 2
        return self.omega * math.sqrt(x + math.hypot(x, 1)) / (2 * math.pi)

    @property
    def weak(self) -> bool:
        """Whether its load over its kp is most of its error."""
        return self.load / self.actuator.kp > HALF * self.error

    @property
    def late(self) -> bool:
        """Whether it follows one frequency, with a delay."""
        return self.hertz > 0 and self.lag >= 0 and not self.weak


def _reason(model: Model, at: Following) -> str:
    """Return why a servo is behind, in words; "" if none of these shows it."""
    of, said = at.actuator, ""
    say: Callable[[float], str] = functools.partial(strength, model, of.index)
    if at.full > THIRD:
        more = f", and the motion needs {say(at.need)}" if at.need > of.bound else ""
        return f"its force ends at {say(of.bound)} for {percent(at.full)} of the run{more}"
    if at.weak:
        said = f"its kp {of.kp:.3g} is too small for its load of {say(at.load)}"
    elif 0 < at.passes < at.hertz:
        said = f"its bandwidth is {at.passes:.3g} Hz with kp {of.kp:.3g} and kv {of.kv:.3g}"
    ratio = at.damping / 2 / at.omega / of.inertia
    rings = f"its kv {of.kv:.3g} damps nothing (damping ratio {ratio:.2g})" * at.rings
    return " and ".join(filter(None, (said, rings)))


def following(
    run: Recording, rests: Collection[int], full: Mapping[int, float]
) -> Iterator[Following]:
    """Yield servos whose targets move, and others that come to no rest where nothing holds them."""
    # The controls of the first reading have led to no step.
    model, run = run.model, run.part(1)
    if run.late < 0:
        return
    some = np.unique(np.linspace(0, len(run) - 1, FEWEST).astype(int)).tolist()
    held = np.max([np.abs(loads(run.at(k))) for k in some], axis=0)
    joints = Layout(model.scene).joints
    for of in _servos(model):
        asked = of.target(np.clip(run["ctrl"][:, of.index], *of.ctrlrange))
        moves, length = np.ptp(asked) > 0, of.gear * run["qpos"][:, of.qposadr]
        still = of.index in rests or int(run.roots[model.jnt_body[of.joint]]) in free_bodies(model)
        if not moves and still:
            continue
        # Of one that is held, a swing is seen in a period.
        period = 2 * np.pi / math.sqrt(of.stiffness / of.inertia)
        first = 0 if moves else min(run.late, len(run) - math.ceil(period / (run.spacing or 1.0)))
        if first < 0:
            continue
        error = math.sqrt(float(np.mean((asked - length)[first:] ** 2)))
        load = float(held[of.dof]) / abs(of.gear)
        hertz, share, lag, size = _wave(run, of, asked, length) if moves else (0.0,) * 4
        need = of.inertia / of.gear**2 * (2 * np.pi * hertz) ** 2 * size + load
        width = float(np.std(asked)) if moves else FEW / SEEN * _notable(model, of)
        damping = of.damping + float(np.ravel(joints[of.joint or 0].damping)[0])
        forced = full.get(of.index, 0.0)
        yield Following(of, error, width, hertz, share, lag, forced, load, need, damping)


def _wave(
    run: Recording, of: Actuator, asked: Floats, length: Floats
) -> tuple[float, float, float, float]:
    """Return frequency [Hz], share, lag and amplitude of the motion asked for; zeros without one.

    A motion that readings do not resolve has none: its differences are slower than its speeds.
    """
    speeds = abs(of.gear) * np.abs(run["qvel"][:, of.dof])
    made = np.abs(np.diff(length)) / (run.spacing or 1.0)
    power = np.fft.rfft(asked - asked.mean())[1:]
    sizes = np.abs(power) ** 2
    if not len(sizes) or sizes.max() < HALF * sizes.sum() or made.mean() < HALF * speeds.mean():
        return 0.0, 0.0, 0.0, 0.0
    k = int(sizes.argmax())
    passed = complex(np.fft.rfft(length - length.mean())[1 + k] / power[k])
    hertz = (k + 1) / (len(run) * run.spacing)
    return hertz, abs(passed), -math.atan2(passed.imag, passed.real), math.sqrt(2) * asked.std()


def _behind(run: Recording, found: list[Following]) -> Finding:
    """Return a finding on servos that do not follow, with gains that were run."""
    model, first = run.model, found[0]
    of, indices = first.actuator, [at.actuator.index for at in found]
    assert of.joint is not None
    joint, elements = of.joint, named(model, "actuator", indices)

    def say(error: float) -> str:
        return f"{length_of(model, joint, error / abs(of.gear))} RMS"

    does = f"is {say(first.error)} from its target"
    if first.late:
        late = f"{math.degrees(first.lag):.0f}° late"
        does = f"follows {first.hertz:.2g} Hz with {percent(first.share)} of the amplitude, {late}"
        does += f" ({say(first.error)} of error)"
    problem = f"{listed(elements, 'servo')} {does}, because {_reason(model, first)}"
    ways = [tuple(_gained(model, found, part, False) for part in PARTS)]
    if first.full > THIRD:
        ways = [tuple(_gained(model, found, part, True) for part in PARTS)]

    def left(other: Recording) -> float:
        every = following(other, (), {})
        errors = {at.actuator.index: at.error / at.width for at in every}
        return first.width * max((errors.get(k, 0.0) for k in indices), default=0.0)

    remedy = Remedy(tuple(ways), left, HALF * first.width, say)
    cure = "a slower or smaller motion" if first.late else ""
    unit, value = unit_of(model, joint), first.error / abs(of.gear)
    what = "servo does not follow", "warning", problem, cure, elements, value, unit, PLOT
    return Finding(*what, remedy=remedy)


def _gained(model: Model, found: Sequence[Following], part: int, bound: bool) -> Cure:
    """Return critically damped gains that should follow; bound: with the forces that this needs."""
    values, words = dict[str, Any](), list[str]()
    for at in found:
        of, inertia = at.actuator, at.actuator.inertia / at.actuator.gear**2
        # At this frequency a critically damped servo has 1/√2 of the amplitude.
        least = inertia * (2 * math.pi * at.hertz) ** 2 / (math.sqrt(2) - 1)
        kp = rounded(part**2 * max(of.kp, least, at.load / (LEFT * at.width)))
        kv = rounded(2 * math.sqrt(kp * inertia))
        values |= gained(model, of.index, kp, kv)
        words.append(f"kp {kp:g} and kv {kv:g}")
        if bound:
            force = rounded(part * at.need, 2, up=True)
            values[f"actuator/#{of.index}/forcerange"] = (-force, force)
            words[-1] += f" with a forcerange of ±{force:g}"
    more = f" ({len(words) - 1} more in proportion)" if len(words) > 1 else ""
    return Cure(words[0] + more, Change(values))


class Servo(NamedTuple):
    """A position servo at rest under a constant control.

    error: commanded length minus length [rad or m], before the gear. force: [N·m or N].
    loaded: whether it pushes against a weight, and not a limit or an object that it presses.
    """

    actuator: Actuator
    error: float
    force: float
    loaded: bool


def at_rest(run: Recording) -> Iterator[Servo]:
    """Yield position servos whose control and error are constant over the end of the run."""
    if run.late < 0:
        return
    for of in _servos(run.model):
        asked, error = _errors(run, of)
        mean, held = float(error.mean()), np.ptp(run["ctrl"][run.late :, of.index]) == 0
        if held and float(np.ptp(error)) < FEW * abs(mean):
            force = float(run["actuator_force"][-1, of.index])
            yield Servo(of, mean, force, _loaded(run, of, float(asked[-1]), force))


def _errors(run: Recording, of: Actuator) -> tuple[Floats, Floats]:
    """Return the lengths that a servo is asked for at the end of the run, and its errors."""
    late = max(run.late, 0)
    asked = of.target(np.clip(run["ctrl"][late:, of.index], *of.ctrlrange))
    return asked, asked - of.gear * run["qpos"][late:, of.qposadr]


def _loaded(run: Recording, of: Actuator, asked: float, force: float) -> bool:
    """Return whether a servo pushes against a weight at the end of the run.

    The weight is that of the bodies that hang on the servo's joint, or, in a tree that rests on a
    floor, that of the tree.
    """
    model, sim = run.model, run.at(len(run) - 1)
    assert of.joint is not None
    low, high = model.jnt_range[of.joint]
    if not low <= asked / of.gear <= high:
        return False
    if float(loads(sim)[of.dof]) / of.gear * force >= HALF * force**2:
        return True
    tree = int(run.roots[model.jnt_body[of.joint]])
    if tree not in free_bodies(model):
        return False
    trees = run.roots[model.geom_body[np.stack([sim.contacts[f"geom{k}"] for k in (1, 2)])]]
    touched = trees[:, (trees == tree).any(axis=0)]
    return bool(touched.size) and bool(np.isin(touched, (tree, 0)).all())


def _notable(model: Model, of: Actuator) -> float:
    """Return the least sag that is told, before the gear [rad or m]."""
    assert of.joint is not None
    widest = math.inf if unit_of(model, of.joint) == "rad" else 1.0
    return SEEN * min(width_of(model, of.joint), widest) * abs(of.gear)


def _sags(model: Model, servos: list[Servo]) -> Finding:
    """Return a finding on servos that sag under their loads, the worst first."""
    first, indices = servos[0], [servo.actuator.index for servo in servos]
    of, notable = first.actuator, _notable(model, first.actuator)
    assert of.joint is not None
    joint, elements = of.joint, named(model, "actuator", indices)
    ratios = [abs(s.error) / (_notable(model, s.actuator) * THIRD) for s in servos]
    if max(ratios) < (1 + DEEP) * min(ratios):
        ratios = [max(ratios)] * len(ratios)
    gains = [rounded(s.actuator.kp * r) for s, r in zip(servos, ratios, strict=True)]
    words = _gains(elements, gains)
    by_index = dict(zip(indices, ratios, strict=True))
    way = (
        Cure(words, Change(stronger(model, by_index, damped=False))),
        Cure(f"{words}, with kv in proportion", Change(stronger(model, by_index, damped=True))),
    )

    def left(other: Recording) -> float | None:
        """Return the largest error at the end of the run; None if a control changes there."""
        if np.ptp(other["ctrl"][max(other.late, 0) :, indices], axis=0).any():
            return None
        errors = (_errors(other, o)[1] for o in _servos(other.model) if o.index in indices)
        return max(float(np.abs(error).max()) for error in errors)

    def say(error: float) -> str:
        return length_of(model, joint, abs(error / of.gear))

    remedy = Remedy((way,), left, notable, say)
    problem = (
        f"{listed(elements, 'servo')} sags by {say(first.error)} under its load of "
        f"{strength(model, of.index, abs(first.force))}, which is load / kp with kp {of.kp:.4g}"
    )
    severity = "warning" if abs(first.error) > FEW / SEEN * notable else "remark"
    cure, value = "let the control carry the load", abs(first.error / of.gear)
    what = "servo sags", severity, problem, cure, elements, value, unit_of(model, joint), PLOT
    return Finding(*what, remedy=remedy)


def _gains(elements: tuple[Element, ...], gains: list[float]) -> str:
    """Return "kp 1810 (servo `j2` 995)", or "kp 91.2 of each"."""
    if len(gains) > 1 and len(set(gains)) == 1:
        return f"kp {gains[0]:g} of each"
    also = [f"{e.name} {gain:g}" for e, gain in zip(elements, gains, strict=True)][1:]
    more = f" and {len(also) - OTHERS} more in proportion" if len(also) > OTHERS else ""
    return f"kp {gains[0]:g}" + (f" ({', '.join(also[:OTHERS])}{more})" if also else "")


def stronger(model: Model, ratios: Mapping[int, float], damped: bool) -> dict[str, Any]:
    """Return the gains of servos, by path, with kp multiplied by a ratio each.

    damped: whether kv grows, too, so that the damping ratio is kept.
    """
    changes: dict[str, Any] = {}
    every = actuators(model)
    for k, ratio in ratios.items():
        faster = math.sqrt(ratio) if damped else 1.0
        changes |= gained(model, k, rounded(every[k].kp * ratio), rounded(every[k].kv * faster))
    return changes


def gained(model: Model, k: int, kp: float, kv: float) -> dict[str, Any]:
    """Return gains of a position servo as values of the model, by path."""
    fields = {field.name: field for field in Element.of(model, "actuator", k).fields(model)}
    path, actuator = f"actuator/#{k}", model.scene.actuators[k]
    if "kp" in fields:
        ratio = {} if actuator.dampratio is None else {f"{path}/dampratio": None}
        return {f"{path}/kp": kp, f"{path}/kv": kv} | ratio
    own = actuators(model)[k]
    return {f"{path}/gainprm": (own.gain * kp / own.kp,), f"{path}/biasprm": (own.offset, -kp, -kv)}


def strength(model: Model, actuator: int, force: float) -> str:
    """Return an actuator's force in words, as a torque if the joint turns."""
    joint = int(model.actuator_joint[actuator])
    linear = joint < 0 or model.jnt_type[joint] == "slide"
    return quantity(force, FORCES if linear else TORQUES)


# Falls.


def fall_findings(run: Recording) -> Iterator[Finding]:
    """Yield a robot on a free base, with servos, that falls over: nothing balances it.

    Robots without servos are not watched: motors at zero hold nothing, and walkers that learn fall
    by design.
    """
    model, drives = run.model, actuators(run.model)
    if not any(drive.kind == SERVO for drive in drives) or not moves_about(model, drives):
        return
    down = {body: _down(run, body) for body in sorted(roots(model, drives))}
    falls = {body: float(run.times[at.argmax()]) for body, at in down.items() if at.any()}
    if not falls:
        return
    body = min(falls, key=falls.__getitem__)
    after, of = falls[body] - float(run.times[0]), named(model, "body", [body])
    problem = (
        f"{of[0].name} falls over within {seconds(after)}, because its servos do not balance it"
    )
    cure = "give the controls or the controller that balance it (--ctrl, --control)"
    yield Finding("fall", "warning", problem, cure, of, after, "s")


def _down(run: Recording, body: int) -> np.ndarray:
    """Return at which readings a robot is no longer upright."""
    axis = rotated(run["xquat"][:, body] * (1.0, -1.0, -1.0, -1.0), np.array([0.0, 0.0, 1.0]))
    down: np.ndarray = axis @ axis[0] < np.cos(TILT)
    geoms = np.flatnonzero(run.roots[run.model.geom_body] == body)
    if len(geoms):
        lowest = run.geoms[0][:, geoms, 2] - run.model.geom_size[geoms].max(axis=1)
        height = run.centre_of_mass(body)[:, 2] - lowest.min(axis=1)
        down |= height < (1 - SINKS) * height[0]
    return down
