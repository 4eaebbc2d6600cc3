"""Readings of a model's sensors at many states, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.gradients import Tangents
from stepcore.engine.model import Model
from stepcore.engine.parameter_columns import AROUND, columns
from stepcore.engine.parameter_slopes import States, Worlds, differences

# Readings that no change of state or of a parameter moves smoothly.
STEPPED = ("contact", "insidesite", "user", "clock")
# Distance of the states around one [m or rad, and by second]: its eighth power is below rounding.
APART = 2.0**-12


class Readings:
    """The sensors of a model, read at states.

    labels: parameters, by which they are differentiated too.
    """

    def __init__(self, model: Model, labels: Sequence[str]) -> None:
        self.model, self.columns = model, columns(model, labels)

    def at(self, states: States) -> Floats:
        """Return the readings at each state, shape (n, m)."""
        return Worlds(self.model, _read).values(states)[:, 0]

    def slopes(self, states: States) -> tuple[Floats, Floats]:
        """Return their derivatives at each state by x, (n, m, 2 nv + na), and by the parameters.

        Differences of the eighth order: there are no formulas for all types of sensors.
        """
        worlds = Worlds.solved(self.model, _read)
        ways = range(2 * self.model.nv + self.model.na)
        by_x = np.stack([self._by(worlds, states, way) for way in ways], axis=-1)
        if not self.columns:
            return by_x, by_x[..., :0]
        return by_x, Worlds.solved(self.model, _read, self.columns).slopes(states)[0]

    def _by(self, worlds: Worlds, states: States, way: int) -> Floats:
        """Return the derivatives by one entry of x."""
        nv, count = self.model.nv, len(states["qpos"])
        around = {name: np.repeat(rows, len(AROUND), axis=0) for name, rows in states.items()}
        moved = APART * np.tile(np.array(AROUND, float), count)
        if way < nv:
            change = np.zeros((len(moved), nv))
            change[:, way] = moved
            around["qpos"] += Tangents(self.model).of_dofs(around["qpos"], change)
        elif way < 2 * nv:
            around["qvel"][:, way - nv] += moved
        else:
            around["act"][:, way - 2 * nv] += moved
        values = worlds.values(around)
        return differences(values.reshape(count, len(AROUND), -1), APART)[0]


def check_smooth(model: Model, readings: Sequence[int]) -> None:
    """Raise ValueError for a reading that no least-squares method can follow."""
    sensor = np.repeat(np.arange(len(model.sensor_dim)), model.sensor_dim)
    for reading in readings:
        nth = int(sensor[reading])
        kind = model.sensor_type[nth]
        if kind in STEPPED:
            name = checks.quoted(model.called("sensor")[nth])
            raise ValueError(
                f"logs: sensor {name} is a {kind}: identify has no derivative of it; leave it out"
            )


def _read(batch: Batch) -> Floats:
    batch.forward()
    return np.array(batch.sensordata)
