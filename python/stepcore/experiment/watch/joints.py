"""What a run's connections and limits did: how far they gaped, and what pushed beyond a limit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.watch.contacts import FEWEST, REST, STEADY

Element = tuple[str, int]
# A joint is kept beyond its limit where it is there for this share of a run; one that only runs
# into it is not.
KEPT = 0.05


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
    forces: tuple[tuple[Element, float], ...]
    limit: float


class JointWatch:
    """The connections and limits of one run."""

    def __init__(self, model: Model, bodies: Bodies) -> None:
        self.model, self.joints = model, bodies.joints
        self.gaps: list[np.ndarray] = []
        self.beyond: list[np.ndarray] = []
        self.dofs = [int(model.jnt_dofadr[joint]) for joint in self.joints.limited]
        # By limit: how far beyond it was, and what acted on its dof.
        self.acted: dict[int, list[tuple[float, dict[Element, float]]]] = {}

    def look(self, sim: Sim) -> None:
        """Every connection and limit now."""
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
                acting = {one: float(force[dof]) for one, force in forces.items() if force[dof]}
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
            pushed = [one for one in seen if ("limit", joint) in one[1]]
            if not pushed:
                continue
            _, acting = min(pushed, key=lambda one: abs(one[0] - kept))
            limit = acting.pop(("limit", joint))
            outwards = [(element, -math.copysign(f, f * limit)) for element, f in acting.items()]
            forces = sorted((one for one in outwards if one[1] > 0), key=lambda one: -one[1])
            yield Beyond(joint, most, kept, rest, tuple(forces), abs(limit))


def settled(series: np.ndarray) -> float | None:
    """The mean of the end of a series; None where it still varies there."""
    late = series[-max(FEWEST, int(REST * len(series))) :]
    mean = float(late.mean())
    steady = len(late) >= FEWEST and mean > 0 and float(np.ptp(late)) < STEADY * mean
    return mean if steady else None
