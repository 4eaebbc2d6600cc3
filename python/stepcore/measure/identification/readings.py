"""Readings of a model's sensors at many states, and their derivatives by finite differences.

Sensors have no analytic derivatives; for steps there is `Sim.linearize`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from stepcore import checks
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch, unwatched
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.model import Model
from stepcore.engine.parameters import AROUND, SPACING, Column, models_around
from stepcore.engine.run_settings import converged_settings
from stepcore.executors import checkpoint
from stepcore.experiment.change import Change

# Sensors whose readings are not smooth functions of the state and the parameters.
STEPPED = ("contact", "insidesite", "user", "clock")
# The number of worlds that are read at once: they fit in a processor's cache.
WORLDS = 256
# Central differences of the fourth order at `AROUND` (Fornberg 1988).
FOURTH = np.array([1 / 12, -2 / 3, 2 / 3, -1 / 12])


class Readings:
    """The sensors of a model, with rows solved to rounding error, as in `Sim.linearize`.

    states: arrays by name ("qpos", "qvel", "act", "ctrl"), one row per state.
    """

    def __init__(self, model: Model, states: Mapping[str, Floats]) -> None:
        self.model, self.states = model, states
        self.count = len(states["qpos"])
        solved = converged_settings(model.settings, tolerance=1e-14, sleep=False)
        worlds = min(WORLDS, len(AROUND) * self.count)
        solved_model = Change.between(solved, model.settings).of(model)
        self.batch = unwatched(Batch(solved_model, worlds, threads=1, on_failure="go on"))

    def values(self) -> Floats:
        """Return the readings at each state, shape (n, m)."""
        return self._read(self.states, [self.model.core])

    def _read(self, states: Mapping[str, Floats], models: Sequence[object]) -> Floats:
        """Return the readings at states; state k has model k modulo their number."""
        worlds, count, parts = len(self.batch), len(states["qpos"]), []
        self.batch._core.set_models(list(models), [k % len(models) for k in range(worlds)])
        for first in range(0, count, worlds):
            checkpoint()
            rows = np.minimum(np.arange(first, first + worlds), count - 1)
            for name, table in states.items():
                getattr(self.batch, name)[...] = table[rows]
            # Forget the previous states.
            self.batch._core.forget(list(range(worlds)))
            self.batch.forward()
            parts.append(np.array(self.batch.sensordata)[: count - first])
        return np.concatenate(parts)

    def slopes(self, ways: Floats, pushes: Floats, by: Sequence[Column | None]) -> Floats:
        """Return the derivatives at each state by some numbers, shape (n, m, numbers).

        ways: derivatives of the states by each number, (n, 2 nv + na, numbers). pushes: of the
        controls, (n, nu, numbers). by: the parameter of the model for each number, or None.
        """
        moved, nv, derivatives = Coordinates(self.model), self.model.nv, []
        for k, column in enumerate(by):
            way, push = ways[..., k], pushes[..., k]
            size = np.abs(np.concatenate([way, push], axis=1)).max(axis=1)
            apart = np.full(self.count, column.spacing if column else SPACING)
            apart /= 1.0 if column else np.where(size > 0, size, 1.0)
            much = (apart[:, None] * AROUND).reshape(-1, 1)
            change, drive = (much * np.repeat(part, len(AROUND), axis=0) for part in (way, push))
            near = {name: np.repeat(rows, len(AROUND), 0) for name, rows in self.states.items()}
            near["qpos"] = moved.nudged(near["qpos"], change[:, :nv])
            near["qvel"] = near["qvel"] + change[:, nv : 2 * nv]
            near["act"] = near["act"] + change[:, 2 * nv :]
            near["ctrl"] = near["ctrl"] + drive
            models = models_around(self.model, [column])[0] if column else [self.model.core]
            values = self._read(near, models).reshape(self.count, len(AROUND), -1)
            derivatives.append(np.einsum("nkm,k->nm", values, FOURTH) / apart[:, None])
        return np.stack(derivatives, axis=-1)


def check_smooth(model: Model, readings: Iterable[int]) -> None:
    """Raise ValueError for a reading that no least-squares method can follow."""
    sensor = np.repeat(np.arange(len(model.sensor_dim)), model.sensor_dim)
    for nth in sensor[list(readings)].tolist():
        kind = model.sensor_type[nth]
        if kind in STEPPED:
            name = checks.quoted(model.called("sensor")[nth])
            raise ValueError(
                f"logs: sensor {name} is a {kind}: identify has no derivative of it; leave it out"
            )
