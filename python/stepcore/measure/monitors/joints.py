"""Findings on joints in a run: connections that gape, chatter, limits that a force overcomes."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from stepcore.engine.actuator import actuators
from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import Coordinates, rotated, turned
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.proposal import Proposal
from stepcore.experiment.schedule import SPEED, SPIN
from stepcore.measure.monitors.finding import (
    DEEP,
    FEW,
    HALF,
    LEFT,
    PLOT,
    SEEN,
    TEST_CONTACTS,
    Finding,
    Next,
    Proposals,
    listed,
    named,
    worst,
)
from stepcore.measure.monitors.recording import FEWEST, Recording, settled
from stepcore.measure.monitors.soft_rows import stiffened
from stepcore.report.units import FORCES, TORQUES, metres, percent, quantity, radians
from stepcore.scene.layout import QPOS, Layout

# Elements that only resist motion cannot push a joint beyond its limit. An equality that holds the
# joint within its range has damping that points outwards, too (backlash.xml).
RESISTS = ("damper", "friction loss", "joint equality")


def joint_findings(run: Recording) -> Iterator[Finding]:
    """Yield the findings on connections, chatter and limits."""
    if run.model.settings.law == "solref":
        yield from _gaps(run)
    yield from chatter_findings(run)
    yield from _overpowered(run)


def chatter_findings(run: Recording) -> Iterator[Finding]:
    """Yield joints that move to and fro from step to step at the end of a run."""
    model = run.model
    if len(run) <= FEWEST or model.settings.accuracy is not None:
        return
    speeds = _to_and_fro(run.between(len(run) - 1 - FEWEST, len(run) - 1))
    joints = sorted(speeds, key=lambda k: -speeds[k])
    if joints:
        elements, speed = named(model, "joint", joints), speeds[joints[0]]
        unit = f"{unit_of(model, joints[0])}/s"
        who = f"{listed(elements, 'joint')} chatters"
        problem = f"{who}: it moves to and fro from step to step, at {speed:.3g} {unit}"
        fix = "take a shorter dt, or lower gains; stepcore diagnose names what limits dt"
        limits = (Next("diagnose", "which element limits dt"),)
        yield Finding("chatter", "warning", problem, fix, elements, speed, unit, limits)


def _to_and_fro(run: Recording) -> dict[int, float]:
    """Return joints that move back and forth in place, each with its median speed [rad/s or m/s].

    run: with a reading at every step. Relative to a steady motion, a vibration of four or more time
    steps moves by at least two median steps.
    """
    model = run.model
    joints = [k for k, kind in enumerate(model.jnt_type) if kind in ("hinge", "slide")]
    dofs, dt = model.jnt_dofadr[joints], model.settings.dt
    places, steps = run["qpos"][:, model.jnt_qposadr[joints]], np.arange(len(run))
    slope, begin = np.polyfit(steps, places, 1)
    way = np.ptp(places - begin - slope * steps[:, None], axis=0)
    moves = np.abs(run["qvel"][:, dofs] * dt - slope)
    step = np.median(moves, axis=0)
    # Below a tenth of a slow motion, the movement is rounding or noise.
    least = DEEP * dt * Coordinates(model).scaled(np.ones(model.nv), SPEED, SPIN)[dofs]
    # An explosion grows, and a push comes once.
    found = (way <= 1.5 * step) & (step > least) & (moves.max(axis=0) < 2 * step)
    return {joints[k]: float(step[k]) / dt for k in np.flatnonzero(found)}


# Connections.


class Gape(NamedTuple):
    """A connection with its largest gap [m], and its gap at rest; None if it did not settle."""

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
        # A point without coordinates follows from the poses in the scene's description.
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
    fixes = stiffened(model, connections, solref, solimp, now(of), wanted)

    def widest(other: Recording) -> float | None:
        return max((now(at) for at in gapes(other) if at.equality in tied), default=None)

    proposals = Proposals((fixes,), widest, SEEN * size(of), metres)
    commands = (Next("converge", "whether the connections are solved"), TEST_CONTACTS[1])
    yield Finding(
        "gap", "warning", problem, "", connections, now(of), "m", commands, proposals=proposals
    )


# Limits.


class Beyond(NamedTuple):
    """A joint beyond its range.

    kept: the excess at rest, or the excess reached for a twentieth of the run or more [rad or m].
    rest: the excess at rest; None if the joint did not settle. forces: the elements that push
    outwards [N·m or N], strongest first. limit: the limit's force.
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
    """Return the quantity that a range limits, (n,): coordinate, or angle of a ball [rad or m].

    qpos: (n, nq).
    """
    at, kind = int(model.jnt_qposadr[joint]), model.jnt_type[joint]
    if kind in ("ball", "free"):
        quat = qpos[:, at + QPOS[kind] - 4 : at + QPOS[kind]]
        return np.asarray(np.linalg.norm(turned(quat), axis=1))
    return qpos[:, at]


def excess_of(run: Recording, joint: int) -> float:
    """Return the lasting excess of a joint over its range [rad or m]."""
    return max((at.kept for at, _ in excesses(run) if at.joint == joint), default=0.0)


def overpowered(run: Recording) -> list[Beyond]:
    """Return the joints that a force pushes beyond their range, the furthest first."""

    def over(entry: tuple[Beyond, Floats]) -> float:
        return entry[0].kept / (FEW * width_of(run.model, entry[0].joint))

    pushed = (_pushed(run, at, series) for at, series in worst(excesses(run), over))
    return [at for at in pushed if at.forces and at.forces[0][1] > HALF * at.limit]


def _pushed(run: Recording, at: Beyond, series: Floats) -> Beyond:
    """Return a joint's excess with the forces that push outwards near the reported excess."""
    dof = int(run.model.jnt_dofadr[at.joint])
    # A limit does not push on a joint that returns fast; the next reading may have a force.
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
    """Yield limits that a force overcomes: the worst with its fix, the others by name."""
    model, pushed = run.model, overpowered(run)
    if not pushed:
        return
    of, joints = pushed[0], [at.joint for at in pushed]
    (kind, index), force = of.forces[0]
    pusher = "gravity" if kind == "gravity" else model.element_name(kind, index)
    fix, unit = "less of that force", unit_of(model, of.joint)
    if kind == "actuator":
        ranges = "forcerange or ctrlrange" if actuators(model)[index].holds else "ctrlrange"
        fix = f"a smaller {ranges} of {pusher}"
    problem = (
        f"{pusher} pushes {listed(named(model, 'joint', joints), 'joint')} "
        f"{length_of(model, of.joint, of.kept)} beyond its range with "
        f"{quantity(force, TORQUES if unit == 'rad' else FORCES)}"
        f"{', and stays there' if of.rest is not None else ''}"
    )
    limits, proposals = named(model, "limit", joints), limit_proposals(model, of.joint, of.kept)
    yield Finding("limit", "warning", problem, fix, limits, of.kept, unit, PLOT, {}, proposals)


def limit_proposals(model: Model, joint: int, now: float) -> Proposals:
    """Return the solreflimits that should make a limit's excess small."""
    fixes, enough = tuple[Proposal, ...](), FEW * width_of(model, joint)
    if model.settings.law == "solref":
        at, limit = Layout(model.scene).joints[joint], named(model, "limit", [joint])
        wanted = LEFT * enough
        fixes = stiffened(model, limit, at.solreflimit, at.solimplimit, now, wanted)
    say = functools.partial(length_of, model, joint)
    return Proposals((fixes,), lambda other: excess_of(other, joint), enough, say)


def unit_of(model: Model, joint: int) -> str:
    """Return the unit of a joint's coordinate."""
    return "m" if model.jnt_type[joint] == "slide" else "rad"


def width_of(model: Model, joint: int) -> float:
    """Return the width of a joint's range [rad or m]; for angles, at most half a turn.

    A joint that its limits lock counts as 1 rad or 1 m wide.
    """
    width = float(np.ptp(model.jnt_range[joint])) or 1.0
    return min(width, math.pi) if unit_of(model, joint) == "rad" else width


def length_of(model: Model, joint: int, value: float) -> str:
    """Return a joint's coordinate in words."""
    return radians(value) if unit_of(model, joint) == "rad" else metres(value)
