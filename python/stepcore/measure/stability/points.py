"""One cell of a map: a run over the horizon, and where points on its bodies are now and then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.executors import steps
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.coordinates import Coordinates

# Points are read this often in a run, and at every step where it has fewer.
READINGS = 32


@dataclass(frozen=True)
class CellMotion:
    """What every cell does. horizon [s]; key: the keyframe it starts from, or None."""

    horizon: float
    key: str | int | None

    def begin(self, sim: Sim) -> None:
        """Puts a Sim at the start, with the controls of the keyframe held."""
        sim.reset(key=self.key)

    def readings(self, dt: float) -> list[int]:
        """The steps after which points are read."""
        steps = max(1, round(self.horizon / dt))
        return sorted({round(steps * k / READINGS) for k in range(1, READINGS + 1)} - {0})

    def times(self, dt: float) -> np.ndarray:
        """When that is [s]."""
        return np.array(self.readings(dt)) * dt

    def all_times(self, dts: list[float]) -> np.ndarray:
        """All times at which points are read in any cell, the start included [s]."""
        return np.unique(np.concatenate([[0.0], *(self.times(dt) for dt in dts)]))


class BodyPoints:
    """Four points on each moving body with a mass: its centre, and three on its axes.

    The three are one radius of gyration away, so that a rotation counts as a length too. Points on
    a wheel stay near however fast it turns, so each hinge has one more set: its angle times that
    radius, along a straight line.
    """

    def __init__(self, model: Model) -> None:
        bodies = Bodies(model, Coordinates(model))
        heavy = bodies.mass > 0
        self.index = np.array(bodies.moving, int)[heavy]
        self.radius, self.centre = bodies.gyration[heavy], bodies.ipos[heavy]
        position = {body: k for k, body in enumerate(self.index.tolist())}
        hinges = [j for j, kind in enumerate(model.jnt_type) if kind == "hinge"]
        self.angle = model.jnt_qposadr[hinges]
        own = [position.get(int(model.jnt_body[j]), -1) for j in hinges]
        # A body without mass moves those that hang on it: the largest radius will do.
        self.arm = np.array([self.radius[k] if k >= 0 else self.largest for k in own])

    @property
    def largest(self) -> float:
        """The largest radius of gyration [m]."""
        return float(self.radius.max(initial=0.0))

    def at(self, sim: Sim) -> np.ndarray:
        """Where the points are now [m], shape (bodies + hinges, 4, 3)."""
        turn = sim.xmat[self.index]
        centre = sim.xpos[self.index] + np.einsum("bij,bj->bi", turn, self.centre)
        around = centre[:, None] + self.radius[:, None, None] * turn.transpose(0, 2, 1)
        turned = np.zeros((len(self.arm), 4, 3))
        turned[..., 0] = (sim.qpos[self.angle] * self.arm)[:, None]
        return np.concatenate([np.concatenate([centre[:, None], around], axis=1), turned])


def run(motion: CellMotion, sim: Sim) -> dict[str, Any]:
    """The points as read, shape (readings, sets, 4, 3), and why the run stopped, if it did."""
    motion.begin(sim)
    points = BodyPoints(sim.model)
    read, stopped, done = [points.at(sim)], None, 0
    try:
        for step in motion.readings(sim.settings.dt):
            steps(sim, step - done)
            done = step
            read.append(points.at(sim))
    except SimulationError as error:
        stopped = checks.one_line(error)
    return {"points": np.array(read), "stopped": stopped}
