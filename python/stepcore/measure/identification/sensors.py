"""Readings of a model's sensors at many states, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.model import Model
from stepcore.engine.parameters import AROUND, columns
from stepcore.measure.identification.worlds import States, Worlds, differences

# Readings that no change of state or of a parameter moves smoothly.
STEPPED = ("contact", "insidesite", "user", "clock")
# Distance of the states around one [m or rad, and by second]: its fourth power is 6e-14.
APART = 2.0**-11
Changed = dict[str, Floats]


class Readings:
    """The sensors of a model, read at states.

    labels: parameters, by which they are differentiated too.
    """

    def __init__(self, model: Model, labels: Sequence[str]) -> None:
        self.model, self.columns = model, columns(model, labels)

    def at(self, states: States) -> Floats:
        """Return the readings at each state, shape (n, m)."""
        return Worlds(self.model, _read).values(states)[:, 0]

    def slopes(self, states: States, push: Floats) -> tuple[Floats, Floats, Floats]:
        """Return their derivatives at each state by x, (n, m, 2 nv + na), by the parameters, and
        by a change `push` of the controls, (n, nu).

        Differences of the fourth order: there are no formulas for all types of sensors.
        """
        worlds = Worlds.solved(self.model, _read)
        ways = range(2 * self.model.nv + self.model.na)
        by_x = np.stack([_by(worlds, states, _moved(self.model, way)) for way in ways], axis=-1)

        def pushed(around: States, moved: Floats) -> Changed:
            return {"ctrl": around["ctrl"] + moved[:, None] * np.repeat(push, len(AROUND), axis=0)}

        by_push = _by(worlds, states, pushed) if push.any() else np.zeros(by_x.shape[:2])
        if not self.columns:
            return by_x, by_x[..., :0], by_push
        by_values = Worlds.solved(self.model, _read, self.columns).slopes(states)
        return by_x, by_values, by_push


def _by(worlds: Worlds, states: States, change: Callable[[States, Floats], Changed]) -> Floats:
    """Return the derivatives by a change of the states, of which `change` makes so much."""
    count = len(states["qpos"])
    around = {name: np.repeat(rows, len(AROUND), axis=0) for name, rows in states.items()}
    moved = APART * np.tile(np.array(AROUND, float), count)
    values = worlds.values(around | change(around, moved))
    return differences(values.reshape(count, len(AROUND), -1), APART)


def _moved(model: Model, way: int) -> Callable[[States, Floats], Changed]:
    """Return the change of states by one entry of x."""
    nv = model.nv

    def changed(around: States, moved: Floats) -> Changed:
        name = ("qpos", "qvel", "act")[min(way // nv, 2)]
        change = np.zeros((len(moved), nv if name == "qpos" else around[name].shape[1]))
        change[:, way - min(way // nv, 2) * nv] = moved
        if name == "qpos":
            return {name: Coordinates(model).nudged(around[name], change)}
        return {name: around[name] + change}

    return changed


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
