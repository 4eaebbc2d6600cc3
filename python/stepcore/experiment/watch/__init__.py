"""`Watch`: a probe that sees what goes wrong in a run: creep, gaps, depths, saturation.

It only records; `stepcore.measure.findings` judges. Everything is measured on the run itself and
needs no reference, so that any run can be watched.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.run import Probe
from stepcore.experiment.watch.actuators import ActuatorWatch
from stepcore.experiment.watch.contacts import ContactWatch
from stepcore.experiment.watch.joints import JointWatch

# About so many looks in a run.
LOOKS = 1000


class Watch(Probe):
    """Watches a run. contacts, joints, actuators: what was seen of each.

    residuals: at every look [m/s]; most: the worst, and unsolved: the row that was worst then.
    times: when it looked [s]. periods: control periods of the run, in each of which it looks.
    """

    def __init__(self, model: Model, bodies: Bodies | None = None, periods: int = 1) -> None:
        bodies = bodies or Bodies(model, Coordinates(model))
        self.model, self.looks = model, max(1, LOOKS // periods)
        self.contacts = ContactWatch(model, bodies.friction)
        self.joints = JointWatch(model, bodies)
        self.actuators = ActuatorWatch(model)
        self.times: list[float] = []
        self.residuals: list[float] = []
        self.most = 0.0
        self.unsolved = ""

    @property
    def span(self) -> float:
        """How long was watched [s]."""
        return self.times[-1] - self.times[0] if self.times else 0.0

    def stride(self, steps: int) -> int:
        return max(1, steps // self.looks)

    def begin(self, sim: Any) -> None:
        self.times.append(sim.time)
        self.contacts.begin(sim)

    def step(self, sim: Any) -> None:
        self.times.append(sim.time)
        self._rows(sim)
        self.contacts.look(sim)
        self.joints.look(sim)
        self.actuators.look(sim)

    def _rows(self, sim: Any) -> None:
        residual = float(sim.residual)
        if residual > self.most:
            self.most, rows = residual, sim.rows
            self.unsolved = str(rows["name"][np.argmax(np.abs(rows["residual"]))])
        self.residuals.append(residual)
