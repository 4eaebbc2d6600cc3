"""One cell of a map: a run over the horizon, looked at now and then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.executors import steps

# A run is looked at this often, and at every step where it has fewer.
LOOKS = 32


@dataclass(frozen=True)
class Course:
    """What every cell does. horizon [s]; key: the keyframe it starts from, or None."""

    horizon: float
    key: str | int | None

    def begin(self, sim: Sim) -> None:
        """Puts a Sim at the start, with the controls of the keyframe held."""
        sim.reset(key=self.key)

    def marks(self, dt: float) -> list[int]:
        """The steps after which a run is looked at."""
        steps = max(1, round(self.horizon / dt))
        return sorted({round(steps * k / LOOKS) for k in range(1, LOOKS + 1)} - {0})

    def times(self, dt: float) -> np.ndarray:
        """When that is [s]."""
        return np.array(self.marks(dt)) * dt


class Bodies:
    """The moving bodies with a mass, each as four points: its centre, and three on its axes.

    The three lie one radius of gyration away, so that a turn of the body is a way in metres too.
    Points on a wheel stay near however fast it turns, so each hinge has one more set: its angle
    times that radius, straight on.
    """

    def __init__(self, model: Model) -> None:
        moving = np.zeros(model.nbody, bool)
        jointed = set(model.jnt_body.tolist())
        for body in range(1, model.nbody):
            moving[body] = body in jointed or moving[model.body_parent[body]]
        self.index = np.flatnonzero(moving & (model.body_mass > 0))
        mass = model.body_mass[self.index]
        trace = np.trace(model.body_inertia[self.index], axis1=1, axis2=2)
        self.radius = np.sqrt(trace / 2 / np.maximum(mass, 1e-300))
        self.centre = model.body_ipos[self.index]
        place = {body: k for k, body in enumerate(self.index.tolist())}
        hinges = [j for j, kind in enumerate(model.jnt_type) if kind == "hinge"]
        self.angle = model.jnt_qposadr[hinges]
        own = [place.get(int(model.jnt_body[j]), -1) for j in hinges]
        # A body without mass of its own turns what hangs on it: the largest radius will do.
        largest = float(self.radius.max(initial=0.0))
        self.arm = np.array([self.radius[k] if k >= 0 else largest for k in own])

    def points(self, sim: Sim) -> np.ndarray:
        """Where the points are now [m], shape (bodies + hinges, 4, 3)."""
        turn = sim.xmat[self.index]
        centre = sim.xpos[self.index] + np.einsum("bij,bj->bi", turn, self.centre)
        around = centre[:, None] + self.radius[:, None, None] * turn.transpose(0, 2, 1)
        turned = np.zeros((len(self.arm), 4, 3))
        turned[..., 0] = (sim.qpos[self.angle] * self.arm)[:, None]
        return np.concatenate([np.concatenate([centre[:, None], around], axis=1), turned])


def run(course: Course, sim: Sim) -> dict[str, Any]:
    """The points at the marks, shape (looks, sets, 4, 3), and why the run stopped, if it did."""
    course.begin(sim)
    bodies = Bodies(sim.model)
    seen, stopped, done = [bodies.points(sim)], None, 0
    try:
        for mark in course.marks(sim.settings.dt):
            steps(sim, mark - done)
            done = mark
            seen.append(bodies.points(sim))
    except SimulationError as error:
        stopped = checks.one_line(error)
    return {"points": np.array(seen), "stopped": stopped}
