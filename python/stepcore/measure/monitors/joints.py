"""Findings on connections and limits in a run: gaps, limits that a force overcomes, and backlash.

Backlash is a joint of small range in series with another: two joints of one body along one axis. An
equality that holds such a joint within its range takes the backlash away.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.coordinates import Coordinates, rotated, turned
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.contacts import LEFT, TEST_CONTACTS
from stepcore.measure.monitors.finding import (
    OTHERS,
    PLOT,
    Cure,
    Finding,
    Next,
    Remedy,
    listed,
    named,
)
from stepcore.measure.monitors.recording import Recording, settled
from stepcore.measure.monitors.soft_rows import stiffened
from stepcore.report.units import FORCES, TORQUES, metres, percent, quantity, radians
from stepcore.scene.layout import QPOS, Layout

# Least share of a run that a joint must be beyond its limit; a short impact does not count.
KEPT = 0.05
# Thresholds of findings: a gap, relative to the smaller body; an excess, relative to the range.
GAPES, BEYOND = 0.01, 0.05
# A force overcomes a limit from this share of the limit's own force.
OVERPOWERS = 0.5
# Ranges wider than this do not define how exact a limit should be [rad].
WIDEST = 3.0
# Elements that only resist motion cannot push a joint beyond its limit.
RESISTS = ("damper", "friction loss")
# A joint in free play falls onto an end of it. One that uses less than the first share of half its
# range is held; once it is free, it uses the second.
HELD, FREE = 0.9, 0.99


def joint_findings(run: Recording) -> Iterator[Finding]:
    """Yield all findings on connections and limits."""
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

    @property
    def now(self) -> float:
        """The gap at rest, or else the largest one [m]."""
        return self.most if self.rest is None else self.rest


def gapes(run: Recording) -> Iterator[Gape]:
    """Yield every connection with its gap."""
    model = run.model
    features, layout = model.scene.features, Layout(model.scene)
    if not (features.equality and features.constraint):
        return
    for k, equality in enumerate(model.scene.equalities):
        if equality.active and equality.type in ("connect", "weld"):
            ends = _ends(equality.plain(layout), run)
            here, there = (
                run["xpos"][:, body] + rotated(run["xquat"][:, body], point) for body, point in ends
            )
            gap = np.linalg.norm(here - there, axis=1)
            yield Gape(k, float(gap.max()), settled(gap))


def _ends(tie: dict[str, Any], run: Recording) -> tuple[tuple[int, Floats], tuple[int, Floats]]:
    """Return the two bodies of a connection, and the connected point in the frame of each [m].

    A point that is not given follows from the poses in which the scene is described.
    """
    sim = run.described
    place, turn = sim.xpos, np.array(sim.xmat).reshape(-1, 3, 3)
    a, b = tie["first"], tie["second"]
    near, far = (frame and np.array(frame["pos"]) for frame in (tie["frame1"], tie["frame2"]))
    if near is None:
        near = turn[a].T @ (place[b] + turn[b] @ far - place[a])
    if far is None:
        far = turn[b].T @ (place[a] + turn[a] @ near - place[b])
    return (a, near), (b, far)


def _gap_of(run: Recording, equalities: Collection[int]) -> float | None:
    """Return the widest gap of some connections [m], at rest if they settled."""
    return max((at.now for at in gapes(run) if at.equality in equalities), default=None)


def _gaps(run: Recording) -> Iterator[Finding]:
    model, layout = run.model, Layout(run.model.scene)
    equalities, notable = model.scene.equalities, list[tuple[float, Gape, float]]()
    for gape in gapes(run):
        bodies = [layout.index[id(body)] for body in equalities[gape.equality].bodies]
        # The world has no size to compare with.
        sizes = run.sizes.bodies
        size = min((sizes[body] for body in bodies if body), default=sizes[0])
        if gape.most > GAPES * size:
            notable.append((gape.most / size, gape, size))
    if not notable:
        return
    notable.sort(key=lambda entry: -entry[0])
    _, worst, size = notable[0]
    tied = [gape.equality for _, gape, _ in notable]
    connections = tuple(Element.of(model, equalities[k].row_kind, k) for k in tied)
    solref, solimp = equalities[worst.equality].solref, equalities[worst.equality].solimp
    now = worst.now
    problem = (
        f"{listed(connections, 'connections')} gapes by {'up to ' * (worst.rest is None)}"
        f"{metres(now)}, {percent(now / size)} of the smaller body's size, under its "
        f'solref="{solref[0]:g} {solref[1]:g}"'
    )
    wanted = min(LEFT * GAPES * size, now * LEFT)
    cures = stiffened(model, connections, solref, solimp, now, wanted)
    remedy = Remedy((cures,), lambda other: _gap_of(other, tied), GAPES * size, metres)
    commands = (Next("converge", "whether the connections are solved"), TEST_CONTACTS[1])
    yield Finding("gap", "warning", problem, "", connections, now, "m", commands, remedy=remedy)


# Limits.


class Beyond(NamedTuple):
    """A joint beyond its range.

    kept: the excess at rest, or that reached for a twentieth of the run or more [rad or m].
    rest: the excess at rest; None if the joint did not settle.
    forces: the elements that push outwards [N·m or N], strongest first. limit: the limit's force.
    """

    joint: int
    kept: float
    rest: float | None
    forces: tuple[tuple[tuple[str, int], float], ...] = ()
    limit: float = 0.0


def excesses(run: Recording) -> Iterator[tuple[Beyond, Floats]]:
    """Yield every joint that was beyond its range, with its excess over time."""
    for joint, (kind, at, _, limits) in enumerate(Coordinates(run.model).joints):
        if not limits:
            continue
        value = run["qpos"][:, at]
        if kind in ("ball", "free"):
            quat = run["qpos"][:, at + QPOS[kind] - 4 : at + QPOS[kind]]
            value = np.linalg.norm(turned(quat), axis=1)
        beyond = np.maximum(0.0, np.maximum(limits[0] - value, value - limits[1]))
        if beyond.any():
            rest = settled(beyond)
            often = float(np.sort(beyond)[-max(1, math.ceil(KEPT * len(beyond)))])
            yield Beyond(joint, often if rest is None else rest, rest), beyond


def excess_of(run: Recording, joint: int) -> float:
    """Return how far a joint was beyond its range for a while [rad or m]."""
    return max((at.kept for at, _ in excesses(run) if at.joint == joint), default=0.0)


def overpowered(run: Recording) -> list[Beyond]:
    """Return the joints that a force pushes beyond their range, the furthest first."""
    found = []
    for at, series in excesses(run):
        if at.kept > BEYOND * width_of(run.model, at.joint):
            # A damper that pushes outwards only slows a joint that returns.
            pushed = _pushed(run, at, series)
            some = tuple(force for force in pushed.forces if force[0][0] not in RESISTS)
            if some and some[0][1] > OVERPOWERS * pushed.limit:
                found.append(pushed._replace(forces=some))
    return sorted(found, key=lambda at: -at.kept / width_of(run.model, at.joint))


def _pushed(run: Recording, at: Beyond, series: Floats) -> Beyond:
    """Return what pushes a joint outwards, where its excess is about the one that is told."""
    dof = int(run.model.jnt_dofadr[at.joint])
    # A limit does not push on a joint that returns fast: the next reading may do.
    for reading in np.argsort(np.abs(series - at.kept), kind="stable")[:4].tolist():
        sim = run.at(reading)
        acting = {of: float(force[dof]) for of, force in sim.element_forces().items()}
        for equality in _restoring(run, at.joint, reading):
            acting.pop(("joint equality", equality), None)
        limit = acting.pop(("limit", at.joint), 0.0)
        if limit:
            outwards = [(of, -math.copysign(f, f * limit)) for of, f in acting.items() if f]
            forces = sorted((f for f in outwards if f[1] > 0), key=lambda f: -f[1])
            return at._replace(forces=tuple(forces), limit=abs(limit))
    return at


def _restoring(run: Recording, joint: int, reading: int) -> Iterator[int]:
    """Yield the joint equalities that hold a joint within its range.

    Their damping can point outwards, but they are not what pushes the joint out.
    """
    model, (low, high) = run.model, run.model.jnt_range[joint]
    for equality, other, coefficients in _held_at(model).get(joint, ()):
        moved = 0.0
        if other is not None:
            at = model.jnt_qposadr[other]
            moved = float(run["qpos"][reading, at] - model.qpos0[at])
        aim = model.qpos0[model.jnt_qposadr[joint]] + np.polyval(coefficients[::-1], moved)
        if low <= aim <= high:
            yield equality


def _overpowered(run: Recording) -> Iterator[Finding]:
    """Yield limits that a force overcomes: the worst with its cure, the others by name."""
    model, (worst, *rest) = run.model, overpowered(run) or (None,)
    if worst is None:
        return
    angular, width = is_angular(model, worst.joint), width_of(model, worst.joint)
    (kind, index), force = worst.forces[0]
    pusher = "gravity" if kind == "gravity" else model.element_name(kind, index)
    cure = "less of that force"
    if kind == "actuator":
        servo = model.actuator_bias[index, 1] < 0
        cure = f"a smaller {'forcerange or ' * bool(servo)}ctrlrange of {pusher}"
    strength = quantity(force, TORQUES if angular else FORCES)
    also = [
        f"{model.element_name('joint', at.joint)} by {length_of(model, at.joint, at.kept)}"
        for at in rest
    ]
    if also:
        more = f" and {len(also) - OTHERS} more" if len(also) > OTHERS else ""
        cure += f". Also beyond: {', '.join(also[:OTHERS])}{more}"
    problem = (
        f"{pusher} pushes {model.element_name('joint', worst.joint)} "
        f"{length_of(model, worst.joint, worst.kept)} beyond its range with {strength}"
        f"{', and stays there' if worst.rest is not None else ''}"
    )
    elements = named(model, "limit", [at.joint for at in (worst, *rest)])
    unit = "rad" if angular else "m"
    remedy = limit_remedy(model, worst.joint, worst.kept, LEFT * BEYOND * width)
    yield Finding("limit", "warning", problem, cure, elements, worst.kept, unit, PLOT, {}, remedy)


def limit_remedy(model: Model, joint: int, now: float, wanted: float) -> Remedy:
    """Return the solreflimits that should reduce a limit's excess from `now` to `wanted`."""
    cures: tuple[Cure, ...] = ()
    if model.settings.law == "solref":
        at, limit = Layout(model.scene).joints[joint], named(model, "limit", [joint])
        cures = stiffened(model, limit, at.solreflimit, at.solimplimit, now, wanted)
    return Remedy(
        (cures,),
        lambda other: excess_of(other, joint),
        BEYOND * width_of(model, joint),
        functools.partial(length_of, model, joint),
    )


def is_angular(model: Model, joint: int) -> bool:
    """Return whether a joint's coordinate is an angle."""
    return bool(model.jnt_type[joint] != "slide")


def width_of(model: Model, joint: int) -> float:
    """Return the width of a joint's range [rad or m], at most `WIDEST` for an angle."""
    low, high = (float(bound) for bound in model.jnt_range[joint])
    return min(high - low, WIDEST) if is_angular(model, joint) else high - low


def length_of(model: Model, joint: int, value: float) -> str:
    """Return a joint's coordinate in words."""
    return radians(value) if is_angular(model, joint) else metres(value)


# Backlash.


def _held_at(model: Model) -> dict[int, list[tuple[int, int | None, Sequence[float]]]]:
    """Return the joint equalities by the joint that they hold.

    Each is its index, the other joint that it depends on, and its polynomial by ascending powers.
    """
    place = {id(joint): k for k, joint in enumerate(Layout(model.scene).joints)}
    held: dict[int, list[tuple[int, int | None, Sequence[float]]]] = {}
    for k, equality in enumerate(model.scene.equalities):
        if equality.type == "joint" and equality.active:
            other = None if equality.joint2 is None else place[id(equality.joint2)]
            entry = (k, other, equality.polycoef)
            held.setdefault(place[id(equality.joint1)], []).append(entry)
    return held


def share_used(run: Recording, joint: int) -> float:
    """Return the share of half its range that a joint uses at the end of the run."""
    low, high = (float(bound) for bound in run.model.jnt_range[joint])
    places = run["qpos"][max(0, run.late) :, run.model.jnt_qposadr[joint]]
    return float(np.abs(places - (low + high) / 2).mean()) / ((high - low) / 2)


def _unused(joint: int, run: Recording) -> float:
    return 1 - share_used(run, joint)


def _played(run: Recording) -> Iterator[Finding]:
    """Yield joints in series with another that an equality holds within their range."""
    model, features = run.model, run.model.scene.features
    if not (features.limit and features.constraint):
        return
    for joint, ties in _held_at(model).items():
        alone = [(k, float(coefficients[0])) for k, other, coefficients in ties if other is None]
        low, high = (float(bound) for bound in model.jnt_range[joint])
        if not alone or not _in_series(model, joint):
            continue
        equality, aim = alone[0][0], float(model.qpos0[model.jnt_qposadr[joint]]) + alone[0][1]
        now = share_used(run, joint)
        if not low < aim < high or now > HELD:
            continue
        say = functools.partial(length_of, model, joint)
        both = (*named(model, "joint", [joint]), *named(model, "joint equality", [equality]))
        problem = (
            f"{both[1].name} pulls {both[0].name} to {say(aim)}, within its range of "
            f"{say(low)} to {say(high)}, so it is a spring and no backlash: {percent(now)} of the "
            "range is used"
        )
        removal = Change({f"equality/#{equality}/active": False})
        remedy = Remedy(
            ((Cure("removing the equality", removal),),),
            functools.partial(_unused, joint),
            1 - FREE,
            lambda left: f"{percent(1 - left)} of it in use",
            now=1 - now,
            needed=True,
        )
        unit, value = "rad" if is_angular(model, joint) else "m", now * (high - low) / 2
        yield Finding("backlash", "warning", problem, "", both, value, unit, remedy=remedy)


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
