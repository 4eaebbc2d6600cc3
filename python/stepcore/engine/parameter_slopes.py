"""Derivatives by parameters at many states at once: differences of models around, in vector lanes.

`Sim.linearize` is exact at a row's switch too, and takes as long as some hundred steps. Here the
same eight models around a parameter's value step from each state, in the worlds of a batch, and the
derivative is their difference of the eighth order: at the distance of these models its truncation
is below rounding. Where a row switches between the models, the differences of the eighth and the
sixth order disagree; there the caller takes the exact derivative.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch, unwatched
from stepcore.engine.parameter_columns import Column, models_around
from stepcore.engine.run_settings import converged_settings

if TYPE_CHECKING:
    from stepcore.engine.model import Model

# Differences at the distances `AROUND` (Fornberg 1988), of the eighth and of the sixth order.
EIGHTH = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SIXTH = np.array([0, -1 / 60, 3 / 20, -3 / 4, 3 / 4, -3 / 20, 1 / 60, 0])
# Worlds that step at once: as many as stay in a processor's cache.
WORLDS = 256
# Differences of both orders agree to this share of the largest, besides rounding.
AGREE, ROUNDING = 1e-8, 64 * 2.0**-53
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
        models = [around for column in columns for around in models_around(model, column)]
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

    def slopes(self, states: States) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the derivatives at each state by the columns, (n, m, columns), and the doubtful.

        A state, of shape (n,), is doubtful where a row switches between the models.
        """
        values = self.values(states)
        each = np.split(values, len(self.columns), axis=1)
        pairs = zip(each, self.columns, strict=True)
        made = [differences(around, column.apart) for around, column in pairs]
        return np.stack([own for own, _ in made], axis=-1), np.any([bad for _, bad in made], axis=0)


def differences(values: Floats, apart: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Return differences of the eighth order, and where the sixth order disagrees.

    values: at the distances `AROUND`, shape (n, 8, m). apart: the distance of two.
    """
    eighth, sixth = (np.einsum("nkm,k->nm", values, each) / apart for each in (EIGHTH, SIXTH))
    most = AGREE * np.abs(eighth).max(axis=1, initial=0.0)
    most += ROUNDING * np.abs(values).max(axis=(1, 2), initial=0.0) / apart
    doubtful: NDArray[np.bool_] = ~(np.abs(eighth - sixth).max(axis=1, initial=0.0) <= most)
    return eighth, doubtful


def after_step(batch: Batch) -> Floats:
    """Step, and return the states side by side."""
    batch.step()
    return np.concatenate([batch.qpos, batch.qvel, batch.act], axis=1)
