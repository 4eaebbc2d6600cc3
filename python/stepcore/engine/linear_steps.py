"""Steps of many worlds linearised together, for `Linearization` and for gradients of rollouts."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stepcore import _core
from stepcore.engine.arrays import Floats
from stepcore.engine.parameter_columns import Column, columns, models_around

if TYPE_CHECKING:
    from stepcore.engine.model import Model


class LinearSteps(NamedTuple):
    """Linearised steps of worlds: A, B and P, each of shape (worlds, steps, size of x, …).

    degenerate: where these are one-sided: a world's and a step's number, and the element.
    """

    A: Floats
    B: Floats
    P: Floats
    degenerate: list[tuple[int, int, tuple[str, int, int]]]


def linear_step(model: Model, core: Any, by: Sequence[Column]) -> LinearSteps:
    """Linearise the next step of a `_core.Sim`, by these parameters too."""
    around = models_around(model, by)
    with _named_parameters(by):
        numbers, degenerate = core.linearize(around)
    apart = np.array([column.apart for column in by])
    return _split(numbers[None, None], apart, [(0, 0, element) for element in degenerate])


@contextmanager
def _named_parameters(by: Sequence[Column]) -> Iterator[None]:
    """Name parameters in errors of the core, which knows their numbers."""
    try:
        yield
    except ValueError as error:
        found = re.match(r"parameter = (\d+): (.*)", str(error))
        if found is None:
            raise
        raise ValueError(f"parameters: {by[int(found[1])].label}: {found[2]}") from None


def _split(numbers: Floats, apart: Floats, degenerate: list[tuple[int, int, Any]]) -> LinearSteps:
    split = numbers.shape[-2]
    last = numbers.shape[-1] - apart.shape[-1]
    by_values = numbers[..., last:] / apart
    return LinearSteps(numbers[..., :split], numbers[..., split:last], by_values, degenerate)


class LinearWorlds:
    """Worlds whose steps are linearised together, on several threads.

    models: of each world; they differ in numbers. first: the first world's number, in errors.
    """

    def __init__(self, models: Sequence[Model], threads: int, first: int = 0) -> None:
        self.models, self.first = models, first
        different = {id(model): model for model in self.models}
        self.different = list(different.values())
        number = {key: k for k, key in enumerate(different)}
        self.of = [number[id(model)] for model in self.models]
        cores = [model.core for model in self.different]
        settings = self.models[0].settings
        self.core = _core.Linearizers(cores, self.of, settings, threads, first)
        self._by: tuple[list[str], list[Any], Floats] | None = None

    def _around(self, by: Sequence[Column]) -> tuple[list[Any], Floats]:
        """The models around parameters, by model; and how far apart their values are, by world."""
        labels = [column.label for column in by]
        if self._by is None or self._by[0] != labels:
            around, apart = [], np.zeros((len(self.different), len(by)))
            for k, model in enumerate(self.different):
                try:
                    own = columns(model, labels)
                except ValueError as error:
                    world = self.first + self.of.index(k)
                    raise ValueError(f"{error} (world {world})") from None
                around.append(models_around(model, own))
                apart[k] = [column.apart for column in own]
            self._by = labels, around, apart[self.of]
        return self._by[1:]

    def linear(self, states: Mapping[str, Floats], by: Sequence[Column]) -> LinearSteps:
        """Linearise a step at each of these states, arrays of shape (worlds, steps, …)."""
        around, apart = self._around(by)
        whole = {name: np.ascontiguousarray(rows) for name, rows in states.items()}
        with _named_parameters(by):
            numbers, degenerate = self.core.linearize(around, whole)
        steps = numbers.shape[1]
        sided = [(*divmod(nth, steps), element) for nth, element in degenerate]
        return _split(numbers, apart[:, None, None], sided)
