"""Steps of many worlds linearised together, for `Linearization` and for gradients of rollouts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stepcore import _core
from stepcore.engine.arrays import Floats
from stepcore.engine.parameter_columns import columns, models_around

if TYPE_CHECKING:
    from stepcore.engine.model import Model

# As many worlds of their own models keep their working space.
KEPT = 64


class LinearSteps(NamedTuple):
    """Linearised steps of worlds: A, B and P, each of shape (worlds, steps, 2 nv + na, …).

    degenerate: where these are one-sided: a world's and a step's number, and the element.
    """

    A: Floats
    B: Floats
    P: Floats
    degenerate: list[tuple[int, int, tuple[str, int, int]]]


def linear_steps(
    model: Model,
    core: Any,
    parameters: Sequence[str],
    states: Mapping[str, Floats] | None = None,
    threads: int = 1,
) -> LinearSteps:
    """Linearise steps of a `_core.Sim`, by these parameters too.

    states: arrays of shape (worlds, steps, …); what is absent is as in the Sim. None: its state
    alone.
    """
    by = columns(model, parameters)
    around = models_around(model, by)
    shape, rows = (1, 1), None
    if states is not None:
        shape = states["qpos"].shape[:2]
        flat = shape[0] * shape[1]
        rows = {
            name: np.ascontiguousarray(array).reshape(flat, *array.shape[2:])
            for name, array in states.items()
        }
    try:
        numbers, degenerate = core.linearize(around, rows, threads)
    except ValueError as error:
        # The core knows parameters by their number.
        found = re.match(r"parameter = (\d+): (.*)", str(error))
        if found is None:
            raise
        raise ValueError(f"parameters: {by[int(found[1])].label}: {found[2]}") from None
    numbers = numbers.reshape(*shape, *numbers.shape[1:])
    split = 2 * model.nv + model.na
    last = split + model.nu
    by_values = numbers[..., last:] / np.array([column.apart for column in by])
    sided = [(*divmod(nth, shape[1]), element) for nth, element in degenerate]
    return LinearSteps(numbers[..., :split], numbers[..., split:last], by_values, sided)


class LinearWorlds:
    """Worlds, each with its model, whose steps are linearised together.

    models: of each world. threads: those of one model share the work.
    """

    def __init__(self, models: Sequence[Model], threads: int) -> None:
        self.models, self.threads = list(models), threads
        groups: dict[int, list[int]] = {}
        for world, model in enumerate(models):
            groups.setdefault(id(model), []).append(world)
        self.groups = list(groups.values())
        self.kept: dict[int, Any] = {}

    def is_of(self, models: Sequence[Model]) -> bool:
        """Whether these are the models of the worlds."""
        return all(own is model for own, model in zip(self.models, models, strict=True))

    def _core(self, group: int) -> Any:
        """A `_core.Sim` of a group's model."""
        core = self.kept.get(group)
        if core is None:
            model = self.models[self.groups[group][0]]
            core = _core.Sim(model.core, model.settings)
            core.unwatch()
            if len(self.groups) <= KEPT:
                self.kept[group] = core
        return core

    def linear(self, states: Mapping[str, Floats], parameters: Sequence[str]) -> LinearSteps:
        """Linearise a step at each of these states, arrays of shape (worlds, steps, …)."""
        made = []
        for group, worlds in enumerate(self.groups):
            alone = len(self.groups) == 1
            own = states if alone else {name: rows[worlds] for name, rows in states.items()}
            model, core = self.models[worlds[0]], self._core(group)
            made.append(linear_steps(model, core, parameters, own, self.threads))
        if len(made) == 1:
            return made[0]
        order = np.argsort(np.concatenate(self.groups))
        A, B, P = (np.concatenate([one[k] for one in made])[order] for k in range(3))
        sided = [
            (worlds[nth], step, element)
            for worlds, one in zip(self.groups, made, strict=True)
            for nth, step, element in one.degenerate
        ]
        return LinearSteps(A, B, P, sided)
