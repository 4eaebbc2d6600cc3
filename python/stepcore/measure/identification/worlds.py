"""A batch's worlds at many states, with the models around values of parameters: differences.

For readings of sensors, which have no formula for each type; steps have `Sim.linearize`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch, unwatched
from stepcore.engine.parameters import Column, models_around
from stepcore.engine.run_settings import converged_settings

if TYPE_CHECKING:
    from stepcore.engine.model import Model

FOURTH = np.array([1 / 12, -2 / 3, 2 / 3, -1 / 12])
# Worlds that step at once: as many as stay in a processor's cache.
WORLDS = 256
States = Mapping[str, Floats]


class Worlds:
    """Worlds of a batch that stand at many states, one chunk after another.

    model: the model. read: what the batch gives at its states, shape (worlds, m).
    columns: parameters; the worlds have the models around their values, each in turn.
    """

    def __init__(
        self, model: Model, read: Callable[[Batch], Floats], columns: Sequence[Column] = ()
    ) -> None:
        self.read, self.columns = read, columns
        models = [one for around in models_around(model, columns) for one in around]
        models = models or [model.core]
        self.chunk = max(1, WORLDS // len(models))
        worlds = self.chunk * len(models)
        self.batch = unwatched(Batch(model, worlds, threads=1, on_failure="go on"))
        if columns:
            self.batch._core.set_models(models, list(range(len(models))) * self.chunk)

    @classmethod
    def solved(
        cls, model: Model, read: Callable[[Batch], Floats], columns: Sequence[Column] = ()
    ) -> Worlds:
        """Return worlds whose rows are solved to rounding, as in `Sim.linearize`."""
        settings = converged_settings(model.settings, tolerance=1e-14, sleep=False)
        return cls(model.with_settings(settings), read, columns)

    def values(self, states: States) -> Floats:
        """Return what `read` gives at each state, shape (n, models, m).

        states: arrays of the worlds by name, each with a row for each state.
        """
        count, models = len(next(iter(states.values()))), len(self.batch) // self.chunk
        parts = []
        for first in range(0, count, self.chunk):
            rows = np.minimum(np.arange(first, first + self.chunk), count - 1)
            for name, table in states.items():
                getattr(self.batch, name)[...] = np.repeat(table[rows], models, axis=0)
            # Without a memory of other states.
            self.batch._core.forget(list(range(len(self.batch))))
            values = np.array(self.read(self.batch)).reshape(self.chunk, models, -1)
            parts.append(values[: count - first])
        return np.concatenate(parts)

    def slopes(self, states: States) -> Floats:
        """Return the derivatives at each state by the columns, shape (n, m, columns)."""
        each = np.split(self.values(states), len(self.columns), axis=1)
        pairs = zip(each, self.columns, strict=True)
        return np.stack([differences(around, column.apart) for around, column in pairs], axis=-1)


def differences(values: Floats, apart: float) -> Floats:
    """Return central differences of the fourth order (Fornberg 1988), shape (n, m).

    values: at the distances `AROUND`, shape (n, 4, m). apart: the distance of two.
    """
    found: Floats = np.einsum("nkm,k->nm", values, FOURTH) / apart
    return found
