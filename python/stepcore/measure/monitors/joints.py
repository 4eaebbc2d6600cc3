"""What a run's connections and limits do: gape, and yield to a force that pushes beyond them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.bodies import Joints
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.contacts import settled
from stepcore.measure.monitors.finding import OTHERS, PLOT, Finding, Next, listed, named
from stepcore.measure.monitors.soft_rows import advised
from stepcore.report.units import FORCES, TORQUES, metres, percent, quantity, radians
from stepcore.scene.layout import Layout

# A joint is kept beyond its limit where it is there for this share of a run; one that only runs
# into its limit is not.
KEPT = 0.05
# Worth saying: a gap, of the size of the smaller body; how far beyond a limit, of the range.
GAPES, BEYOND = 0.01, 0.05
# What a cure leaves of these.
LEFT = 0.1
# A limit cannot bear a force that is this part of the limit's own.
OVERPOWERS = 0.5
# A wider range says nothing of how exact a limit should be [rad].
WIDEST = 3.0
# What only resists motion pushes no joint beyond its limit.
RESISTS = ("damper", "friction loss")


@dataclass(frozen=True)
class Gape:
    """A connection that gapes. most: [m]; rest: where it settled [m], None where it did not."""

    equality: int
    most: float
    rest: float | None


@dataclass(frozen=True)
class Beyond:
    """A joint beyond its range.

    most: [rad or m]. rest: where it settled, None where it did not; kept: the same, or how far it
    was for a twentieth of the run or more. forces: what acted outwards while it was kept there, an
    element and its force [N·m or N], the strongest first; limit: the force of the limit itself.
    """

    joint: int
    most: float
    kept: float
    rest: float | None
    forces: tuple[tuple[tuple[str, int], float], ...]
    limit: float


class JointMonitor:
    """The connections and limits of one run."""

    def __init__(self, model: Model, joints: Joints, sizes: Sizes) -> None:
        self.model, self.joints, self.sizes = model, joints, sizes
        self.gaps: list[np.ndarray] = []
        self.beyond: list[np.ndarray] = []
        self.dofs = [int(model.jnt_dofadr[joint]) for joint in joints.limited]
        # By limit: how far beyond it was, and what acted on its dof.
        self.acted: dict[int, list[tuple[float, dict[tuple[str, int], float]]]] = {}

    def look(self, sim: Sim) -> None:
        """Records every connection and limit."""
        with np.errstate(over="ignore", invalid="ignore"):
            if self.joints.connected:
                frames = np.concatenate([sim.xpos, sim.xquat], axis=1)[None]
                self.gaps.append(self.joints.gaps(frames)[0])
            if not self.joints.ranges:
                return
            beyond = self.joints.violations(np.array(sim.qpos)[None])[0]
        self.beyond.append(beyond)
        over = np.flatnonzero(beyond > 0)
        if len(over):
            forces = sim.element_forces()
            for k in over.tolist():
                dof = self.dofs[k]
                acting = {of: float(force[dof]) for of, force in forces.items() if force[dof]}
                self.acted.setdefault(k, []).append((float(beyond[k]), acting))

    def gapes(self) -> Iterator[Gape]:
        """Every connection."""
        series = np.array(self.gaps)
        for column, equality in enumerate(self.joints.tied if len(series) else ()):
            gap = series[:, column]
            yield Gape(equality, float(gap.max()), settled(gap))

    def overshoots(self) -> Iterator[Beyond]:
        """Every joint that was beyond its range."""
        series = np.array(self.beyond)
        for k, seen in self.acted.items():
            joint, values = self.joints.limited[k], series[:, k]
            most, rest = float(values.max()), settled(values)
            often = float(np.sort(values)[-max(1, math.ceil(KEPT * len(values)))])
            kept = often if rest is None else rest
            # What acts belongs to the step before: a limit that was just passed does not push yet.
            pushed = [look for look in seen if ("limit", joint) in look[1]]
            if not pushed:
                continue
            _, acting = min(pushed, key=lambda look: abs(look[0] - kept))
            limit = acting.pop(("limit", joint))
            outwards = [(element, -math.copysign(f, f * limit)) for element, f in acting.items()]
            forces = sorted((f for f in outwards if f[1] > 0), key=lambda f: -f[1])
            yield Beyond(joint, most, kept, rest, tuple(forces), abs(limit))

    def findings(self) -> Iterator[Finding]:
        """All findings on connections and limits."""
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
            # The world has no size of its own to compare with.
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
        cure = advised("", solref, solimp, now, wanted, model.settings)
        commands = (
            Next("converge", "whether the connections are solved"),
            Next("run", "energy and overlap over time", ("--plot", "run.png")),
        )
        yield Finding("gap", "warning", problem, cure, connections, now, "m", commands)

    def _overpowered(self) -> Iterator[Finding]:
        """Limits that a force pushes beyond: the worst with its cure, the others by name."""
        model = self.model
        beyond: list[tuple[float, Beyond]] = []
        for at in self.overshoots():
            # A damper that pushes outwards holds back a joint that returns.
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
        cure = harder_limit(model, worst.joint, worst.kept, wanted)
        if kind == "actuator":
            motor = model.actuator_bias[index, 1] >= 0
            range_ = "ctrlrange" if motor else "forcerange or ctrlrange"
            cure = f"a smaller {range_} of {pusher}" + (f", or {cure}" if cure else "")
        strength = quantity(force, TORQUES if angular else FORCES)
        also = [
            f"{model.element_name('joint', at.joint)} by {length_of(model, at.joint, at.kept)}"
            for _, at in rest
        ]
        if also:
            more = f" and {len(also) - OTHERS} more" if len(also) > OTHERS else ""
            cure = f"{cure or 'less of that force'}. Also beyond: {', '.join(also[:OTHERS])}{more}"
        problem = (
            f"{pusher} pushes {model.element_name('joint', worst.joint)} "
            f"{length_of(model, worst.joint, worst.kept)} beyond its range with {strength}"
            f"{', and stays there' if worst.rest is not None else ''}"
        )
        cure = cure or "less of that force"
        elements = named(model, "limit", [at.joint for at in (worst, *(at for _, at in rest))])
        unit = "rad" if angular else "m"
        yield Finding("limit", "warning", problem, cure, elements, worst.kept, unit, PLOT)


def is_angular(model: Model, joint: int) -> bool:
    """Whether a joint's coordinate is an angle."""
    return bool(model.jnt_type[joint] != "slide")


def width_of(model: Model, joint: int) -> float:
    """The width of a joint's range [rad or m], as far as it says how exact a limit should be."""
    low, high = (float(bound) for bound in model.jnt_range[joint])
    return min(high - low, WIDEST) if is_angular(model, joint) else high - low


def length_of(model: Model, joint: int, value: float) -> str:
    """A joint's coordinate in words."""
    return radians(value) if is_angular(model, joint) else metres(value)


def harder_limit(model: Model, joint: int, now: float, wanted: float) -> str:
    """The solreflimit with which a limit that yields by `now` yields by `wanted`, in words."""
    if model.settings.law != "solref":
        return ""
    at = Layout(model.scene).joints[joint]
    text = length_of(model, joint, wanted)
    return advised("limit", at.solreflimit, at.solimplimit, now, wanted, model.settings, text)
