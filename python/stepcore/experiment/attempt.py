"""A trial of a motion under the shipped settings: how it loads the actuators, and what it meets."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.experiment.coordinates import rotated
from stepcore.experiment.drives import Drives
from stepcore.experiment.point_to_point import PointToPoint
from stepcore.experiment.poses import Point, touching

# Speeds and forces of this time [s] belong to the start: it may jump to its servos' targets, or
# out of an overlap.
SHOCK = 0.1
# A force is at its bound within this relative distance.
AT_END = 1e-9
# A robot falls if it tilts by more than this [rad], or the height of its centre of mass above the
# lowest of its geoms shrinks by this share. What sinks into the floor as a whole has not fallen.
TILT, SINKS = 0.35, 0.25

# A pair of geoms; a joint.
Pair = tuple[int, int]


@dataclass
class Attempt:
    """What happened in one run of a motion.

    saturated: the share of the run in which each actuator's force was at its bound, (nu,).
    force: the largest force of each actuator as a share of its bound, (nu,); 0 without a bound.
    speed: the largest speed of each dof [rad/s or m/s], (nv,).
    met: the pairs of geoms in contact at some time, and the joints at a limit.
    ends_on: the pairs of geoms in contact at the end.
    points: the contacts at the end: both bodies and the place [m].
    end: the state at the end.
    fell: when the robot fell [s], or None.
    flops: floating-point operations of a second of such runs, by the step at the end.
    failure: why the run failed, or "".
    """

    saturated: np.ndarray
    force: np.ndarray
    speed: np.ndarray
    met: set[Pair | int] = field(default_factory=set)
    ends_on: set[Pair] = field(default_factory=set)
    points: list[Point] = field(default_factory=list)
    end: Start | None = None
    fell: float | None = None
    flops: float = 0.0
    failure: str = ""

    def beside(self, other: Attempt) -> Attempt:
        """Return what happens in this or in another trial; contacts at the end are of both."""
        fell = [time for time in (self.fell, other.fell) if time is not None]
        return replace(
            self,
            saturated=np.maximum(self.saturated, other.saturated),
            force=np.maximum(self.force, other.force),
            met=self.met | other.met,
            ends_on=self.ends_on & other.ends_on,
            fell=min(fell, default=None),
        )


def attempt(
    model: Model,
    drives: Drives,
    start: Start,
    control: PointToPoint,
    period: float,
    horizon: float,
    whole: bool = False,
) -> Attempt:
    """Run a motion once under the model's settings.

    period: the control period [s]. horizon: the length of the run [s]. whole: whether controls are
        constant over each period.
    """
    sim, dt = unwatched(Sim(model)), model.settings.dt
    start.put(sim)
    steps = max(1, round(period / dt))
    periods = max(1, round(horizon / (steps * dt)))
    rows = None
    if control.gains is None:
        rows = control.log(periods, steps * dt, whole).steps(0.0, dt, periods * steps)
    seen, upright = _Seen(model, drives), Upright(sim, drives)
    result = Attempt(np.zeros(model.nu), np.zeros(model.nu), np.zeros(model.nv))
    try:
        for done in range(0, periods * steps, steps):
            if rows is None:
                sim.ctrl[:] = control(sim.time, sim)
                sim.step(steps)
            else:
                for row in rows[done : done + steps]:
                    sim.ctrl[:] = row
                    sim.step()
            seen.look(sim)
            if result.fell is None and upright.lost(sim) is not None:
                result.fell = sim.time
        result.flops = sim.count_flops() / dt
        sim.forward()
        result.points, result.ends_on = touching(sim), _pairs(sim)
        result.end = Start(np.array(sim.qpos), np.array(sim.qvel), np.array(sim.act), start.mocap)
    except (SimulationError, ValueError) as error:
        result.failure = one_line(error)
    result.saturated, result.force = seen.loads()
    result.speed, result.met = seen.speed, seen.met
    return result


class _Seen:
    """Everything that is read from a Sim once a period."""

    def __init__(self, model: Model, drives: Drives) -> None:
        self.model, self.bounds = model, drives.bounds
        self.forces: list[np.ndarray] = []
        self.speed, self.early = np.zeros(model.nv), 0
        self.met: set[Pair | int] = set()
        kinds = np.array([kind in ("hinge", "slide") for kind in model.jnt_type], bool)
        self.joints = np.flatnonzero(kinds & np.isfinite(model.jnt_range).any(axis=1))
        if not model.scene.features.limit:
            self.joints = self.joints[:0]
        self.at = model.jnt_qposadr[self.joints]
        self.low, self.high = model.jnt_range[self.joints].T

    def look(self, sim: Sim) -> None:
        self.forces.append(np.abs(sim.actuator_force))
        self.early += sim.time <= SHOCK
        if sim.time > SHOCK:
            np.maximum(self.speed, np.abs(sim.qvel), out=self.speed)
        where = sim.qpos[self.at]
        self.met.update(self.joints[(where < self.low) | (where > self.high)].tolist())
        if sim.overlap > 0:
            self.met |= _pairs(sim)

    def loads(self) -> tuple[np.ndarray, np.ndarray]:
        if not self.forces or not self.model.nu:
            return np.zeros(self.model.nu), np.zeros(self.model.nu)
        forces = np.array(self.forces)
        late = forces[self.early :] if self.early < len(forces) else forces
        bounded = np.isfinite(self.bounds) & (self.bounds > 0)
        bounds = np.where(bounded, self.bounds, np.inf)
        full = late >= bounds * (1 - AT_END)
        return full.mean(axis=0), (late / bounds).max(axis=0, initial=0.0)


def _pairs(sim: Sim) -> set[Pair]:
    """Return the pairs of geoms that overlap in the last solve."""
    table = sim.contacts
    table = table[table["dist"] < 0]
    return set(zip(table["geom1"].tolist(), table["geom2"].tolist(), strict=True))


class Upright:
    """Tells when a robot on a free base falls over."""

    def __init__(self, sim: Sim, drives: Drives) -> None:
        model = sim.model
        self.bodies: list[int] = []
        if drives.moves_about:
            joints = {j for k in drives.all if (j := drives.joint(k)) is not None}
            self.bodies = sorted({model.root(int(model.jnt_body[j])) for j in joints})
        sim.forward()
        self.axes = [self._axis(sim, body) for body in self.bodies]
        roots = [model.root(body) for body in model.geom_body.tolist()]
        self.geoms = [[k for k, root in enumerate(roots) if root == b] for b in self.bodies]
        self.heights = [self._height(sim, k) for k in range(len(self.bodies))]

    def lost(self, sim: Sim) -> int | None:
        """Return the base of a robot that has fallen, or None."""
        for k, body in enumerate(self.bodies):
            tilted = self._axis(sim, body) @ self.axes[k] < np.cos(TILT)
            if tilted or self._height(sim, k) < (1 - SINKS) * self.heights[k]:
                return body
        return None

    @staticmethod
    def _axis(sim: Sim, body: int) -> np.ndarray:
        """Return the vertical of the world in the body's frame."""
        back = np.array(sim.xquat[body]) * (1.0, -1.0, -1.0, -1.0)
        axis: np.ndarray = rotated(back, np.array([0.0, 0.0, 1.0]))
        return axis

    def _height(self, sim: Sim, k: int) -> float:
        """Return the height of the centre of mass above the lowest geom of a robot."""
        geoms = self.geoms[k]
        if not geoms:
            return math.inf
        lowest = sim.geom_xpos[geoms, 2] - sim.model.geom_size[geoms].max(axis=1)
        return float(sim.subtree_com[self.bodies[k], 2] - lowest.min())
