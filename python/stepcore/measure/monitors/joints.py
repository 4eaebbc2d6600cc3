"""Findings on connections and limits in a run: gaps, and limits that a force overcomes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.bodies import Joints
from stepcore.experiment.sizes import Sizes
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
from stepcore.measure.monitors.readings import settled
from stepcore.measure.monitors.soft_rows import stiffened
from stepcore.report.units import FORCES, TORQUES, metres, percent, quantity, radians
from stepcore.scene.layout import Layout

# Least share of a run that a joint must be beyond its limit; a short impact does not count.
KEPT = 0.05
# Thresholds of findings: a gap, relative to the smaller body; an excess, relative to the range.
GAPES, BEYOND = 0.01, 0.05
# The share of these thresholds that a cure leaves.
LEFT = 0.1
# A force overcomes a limit from this share of the limit's own force.
OVERPOWERS = 0.5
# Ranges wider than this do not define how exact a limit should be [rad].
WIDEST = 3.0
# Forces at limits are read at every so many readings.
FORCES_EVERY = 4
# Elements that only resist motion cannot push a joint beyond its limit.
RESISTS = ("damper", "friction loss")


@dataclass(frozen=True)
class Gape:
    """A connection with a gap.

    most: the largest gap [m].
    rest: the gap at rest [m]; None if the gap did not settle.
    """

    equality: int
    most: float
    rest: float | None


@dataclass(frozen=True)
class Beyond:
    """A joint beyond its range.

    most: the largest excess [rad or m].
    kept: the excess at rest, or the excess reached for a twentieth of the run or more.
    rest: the excess at rest; None if the joint did not settle.
    forces: the elements that pushed outwards during the excess, with their forces [N·m or N],
        strongest first.
    limit: the force of the limit itself.
    """

    joint: int
    most: float
    kept: float
    rest: float | None
    forces: tuple[tuple[tuple[str, int], float], ...]
    limit: float


class JointMonitor:
    """A record of the connections and limits of one run."""

    def __init__(self, model: Model, joints: Joints, sizes: Sizes) -> None:
        self.model, self.joints, self.sizes = model, joints, sizes
        self.gaps: list[np.ndarray] = []
        self.beyond: list[np.ndarray] = []
        self.extreme = np.zeros(len(joints.ranges))
        self.dofs = [int(model.jnt_dofadr[joint]) for joint in joints.limited]
        self.held_at = held_at(model)
        # For each limit: the excess, and the forces on its dof.
        self.acted: dict[int, list[tuple[float, dict[tuple[str, int], float]]]] = {}

    def look(self, sim: Sim) -> None:
        """Record every connection and limit."""
        with np.errstate(over="ignore", invalid="ignore"):
            if self.joints.connected:
                frames = np.concatenate([sim.xpos, sim.xquat], axis=1)[None]
                self.gaps.append(self.joints.gaps(frames)[0])
            if not self.joints.ranges:
                return
            beyond = self.joints.violations(np.array(sim.qpos)[None])[0]
        self.beyond.append(beyond)
        over = np.flatnonzero(beyond > 0)
        # Reading every force is slow: at each new extreme, and now and then.
        further = bool((beyond > 1.1 * self.extreme).any())
        self.extreme = np.where(beyond > 1.1 * self.extreme, beyond, self.extreme)
        if len(over) and (further or len(self.beyond) % FORCES_EVERY == 0):
            forces = sim.element_forces()
            for k in over.tolist():
                dof = self.dofs[k]
                acting = {of: float(force[dof]) for of, force in forces.items() if force[dof]}
                for equality in self._restoring(sim, self.joints.limited[k]):
                    acting.pop(("joint equality", equality), None)
                self.acted.setdefault(k, []).append((float(beyond[k]), acting))

    def _restoring(self, sim: Sim, joint: int) -> Iterator[int]:
        """Yield the joint equalities that hold a joint within its range.

        Their damping can point outwards, but they are not what pushes the joint out.
        """
        model, (low, high) = self.model, self.model.jnt_range[joint]
        for equality, other, coefficients in self.held_at.get(joint, ()):
            moved = 0.0
            if other is not None:
                at = model.jnt_qposadr[other]
                moved = float(sim.qpos[at] - model.qpos0[at])
            aim = model.qpos0[model.jnt_qposadr[joint]] + np.polyval(coefficients[::-1], moved)
            if low <= aim <= high:
                yield equality

    def gapes(self) -> Iterator[Gape]:
        """Yield every connection with its gap."""
        series = np.array(self.gaps)
        for column, equality in enumerate(self.joints.tied if len(series) else ()):
            gap = series[:, column]
            yield Gape(equality, float(gap.max()), settled(gap))

    def gap_of(self, equalities: Sequence[int]) -> float | None:
        """Return the widest gap of some connections [m], at rest if they settled."""
        gapes = (at for at in self.gapes() if at.equality in equalities)
        gaps = [at.most if at.rest is None else at.rest for at in gapes]
        return max(gaps, default=None)

    def excess_of(self, joint: int) -> float:
        """Return how far a joint was beyond its range for a while [rad or m]."""
        return max((at.kept for at in self.overshoots() if at.joint == joint), default=0.0)

    def overshoots(self) -> Iterator[Beyond]:
        """Yield every joint that was beyond its range."""
        series = np.array(self.beyond)
        for k, seen in self.acted.items():
            joint, values = self.joints.limited[k], series[:, k]
            most, rest = float(values.max()), settled(values)
            often = float(np.sort(values)[-max(1, math.ceil(KEPT * len(values)))])
            kept = often if rest is None else rest
            # Forces belong to the previous step: a limit that was just passed does not push yet.
            pushed = [look for look in seen if ("limit", joint) in look[1]]
            if not pushed:
                continue
            _, acting = min(pushed, key=lambda look: abs(look[0] - kept))
            limit = acting.pop(("limit", joint))
            outwards = [(element, -math.copysign(f, f * limit)) for element, f in acting.items()]
            forces = sorted((f for f in outwards if f[1] > 0), key=lambda f: -f[1])
            yield Beyond(joint, most, kept, rest, tuple(forces), abs(limit))

    def findings(self) -> Iterator[Finding]:
        """Yield all findings on connections and limits."""
        if self.model.settings.law == "solref":
            yield from self._gaps()
        yield from self._overpowered()

    def _gaps(self) -> Iterator[Finding]:
        model, layout = self.model, Layout(self.model.scene)
        notable: list[tuple[float, Gape, float]] = []
        for gape in self.gapes():
            bodies = [
                layout.index[id(body)] for body in model.scene.equalities[gape.equality].bodies
            ]
            # The world has no size to compare with.
            sizes = self.sizes.bodies
            size = min((sizes[body] for body in bodies if body), default=sizes[0])
            if gape.most > GAPES * size:
                notable.append((gape.most / size, gape, size))
        if not notable:
            return
        notable.sort(key=lambda entry: -entry[0])
        _, worst, size = notable[0]
        equalities = model.scene.equalities
        tied = [gape.equality for _, gape, _ in notable]
        connections = tuple(Element.of(model, equalities[k].row_kind, k) for k in tied)
        solref, solimp = equalities[worst.equality].solref, equalities[worst.equality].solimp
        now = worst.most if worst.rest is None else worst.rest
        wanted = min(LEFT * GAPES * size, now * LEFT)
        problem = (
            f"{listed(connections, 'connections')} gapes by {'up to ' * (worst.rest is None)}"
            f"{metres(now)}, {percent(now / size)} of the smaller body's size, under its "
            f'solref="{solref[0]:g} {solref[1]:g}"'
        )
        cures = stiffened(model, connections, solref, solimp, now, wanted)
        remedy = Remedy((cures,), lambda m: m.joints.gap_of(tied), GAPES * size, metres)
        commands = (
            Next("converge", "whether the connections are solved"),
            Next("run", "energy and overlap over time", ("--plot", "run.png")),
        )
        yield Finding("gap", "warning", problem, "", connections, now, "m", commands, remedy=remedy)

    def _overpowered(self) -> Iterator[Finding]:
        """Yield limits that a force overcomes: the worst with its cure, the others by name."""
        model = self.model
        beyond: list[tuple[float, Beyond]] = []
        for at in self.overshoots():
            # A damper that pushes outwards only slows a joint that returns.
            pushing = tuple(force for force in at.forces if force[0][0] not in RESISTS)
            width = width_of(model, at.joint)
            if at.kept > BEYOND * width and pushing and pushing[0][1] > OVERPOWERS * at.limit:
                beyond.append((at.kept / width, replace(at, forces=pushing)))
        if not beyond:
            return
        (_, worst), *rest = sorted(beyond, key=lambda entry: -entry[0])
        angular, width = is_angular(model, worst.joint), width_of(model, worst.joint)
        (kind, index), force = worst.forces[0]
        pusher = "gravity" if kind == "gravity" else model.element_name(kind, index)
        wanted = LEFT * BEYOND * width
        cure = "less of that force"
        if kind == "actuator":
            motor = model.actuator_bias[index, 1] >= 0
            range_ = "ctrlrange" if motor else "forcerange or ctrlrange"
            cure = f"a smaller {range_} of {pusher}"
        strength = quantity(force, TORQUES if angular else FORCES)
        also = [
            f"{model.element_name('joint', at.joint)} by {length_of(model, at.joint, at.kept)}"
            for _, at in rest
        ]
        if also:
            more = f" and {len(also) - OTHERS} more" if len(also) > OTHERS else ""
            cure += f". Also beyond: {', '.join(also[:OTHERS])}{more}"
        problem = (
            f"{pusher} pushes {model.element_name('joint', worst.joint)} "
            f"{length_of(model, worst.joint, worst.kept)} beyond its range with {strength}"
            f"{', and stays there' if worst.rest is not None else ''}"
        )
        elements = named(model, "limit", [at.joint for at in (worst, *(at for _, at in rest))])
        unit = "rad" if angular else "m"
        remedy = Remedy(
            (harder_limit(model, worst.joint, worst.kept, wanted),),
            lambda m: m.joints.excess_of(worst.joint),
            BEYOND * width,
            lambda value: length_of(model, worst.joint, value),
        )
        yield Finding(
            "limit", "warning", problem, cure, elements, worst.kept, unit, PLOT, remedy=remedy
        )


def held_at(model: Model) -> dict[int, list[tuple[int, int | None, Sequence[float]]]]:
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


def harder_limit(model: Model, joint: int, now: float, wanted: float) -> tuple[Cure, ...]:
    """Return the solreflimits that should reduce a limit's excess from `now` to `wanted`."""
    if model.settings.law != "solref":
        return ()
    at, limit = Layout(model.scene).joints[joint], named(model, "limit", [joint])
    return stiffened(model, limit, at.solreflimit, at.solimplimit, now, wanted)
