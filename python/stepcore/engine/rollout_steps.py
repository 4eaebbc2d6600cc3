"""The steps of rollouts of many worlds, each to be linearised where it began."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from stepcore.engine.arrays import INPUTS, STATE, Floats, numbers
from stepcore.engine.linear_steps import LinearSteps, LinearWorlds
from stepcore.engine.parameter_columns import columns
from stepcore.engine.rollout import Rollout
from stepcore.engine.tangents import Tangents

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch
    from stepcore.report.progress import Choice

# Steps of a world that are linearised together, and as many numbers of matrices as are in memory
# at once: 64 MiB.
BLOCK, ROOM = 64, 2**23

# What x is made of.
X = (*STATE, "ctrl_history")


def linear_worlds(batch: Batch) -> LinearWorlds:
    """The worlds of a batch, which keeps them until a parameter is set."""
    models = batch.param.models()
    if batch._linear_worlds is None or batch._linear_worlds.models is not models:
        batch._linear_worlds = LinearWorlds(models, batch._threads)
    return batch._linear_worlds


def rows_of(
    given: Mapping[str, ArrayLike | None], sizes: Mapping[str, tuple[int, ...]]
) -> dict[str, Floats]:
    """Arrays of these shapes; None is zero."""
    arrays = {}
    for name, value in given.items():
        array = np.zeros(sizes[name]) if value is None else numbers(name, value)
        if array.shape != sizes[name]:
            raise ValueError(f"{name} has shape {array.shape}: must be {sizes[name]}")
        arrays[name] = array
    return arrays


class Steps:
    """The steps of a rollout of a batch, each to be linearised where it began.

    Arguments are checked first; `roll` then steps the batch, once.
    """

    rollout: Rollout
    # Of each world, before the first step and after each.
    states: dict[str, Floats]

    def __init__(self, batch: Batch, ctrl: ArrayLike, parameters: Sequence[str]) -> None:
        # Refuses steps that cannot be linearised before one is taken.
        LinearWorlds([batch.model], 1)
        self.by = columns(batch.model, parameters)
        self.labels = [column.label for column in self.by]
        self.batch = batch
        self.ctrl, self.n = np.array(numbers("ctrl", ctrl)), len(batch)
        if self.ctrl.ndim != 3 or self.ctrl.shape[::2] != (self.n, batch.model.nu):
            limit = f"({self.n}, steps, {batch.model.nu})"
            raise ValueError(f"ctrl has shape {self.ctrl.shape}: must be {limit}")
        self.count = self.ctrl.shape[1]
        self.tangents = Tangents(batch.model)
        # Of x.
        self.size = 2 * batch.model.nv + batch.model.na + batch._arrays["ctrl_history"].shape[1]

    def sizes(self, *rows: int) -> dict[str, tuple[int, ...]]:
        """The shapes of arrays with so many rows for each world's state."""
        model = self.batch.model
        widths = (model.nq, model.nv, model.na)
        return {name: (self.n, *rows, width) for name, width in zip(STATE, widths, strict=True)}

    def roll(self, progress: Choice = None) -> Steps:
        """Step the batch."""
        batch = self.batch
        self.models = batch.param.models()
        self.held = {name: np.array(getattr(batch, name)) for name in INPUTS[1:]}
        self.start = {name: np.array(getattr(batch, name)) for name in X}
        self.time = batch.time
        past = [name for name in X[len(STATE) :] if self.start[name].size]
        self.rollout = batch.rollout(self.ctrl, past, progress=progress)
        after = {**self.rollout._asdict(), **self.rollout.recorded}
        # Scenes without late controls have no past.
        nothing = np.zeros((self.n, self.count, 0))
        self.states = {
            name: np.concatenate([first[:, None], after.get(name, nothing)], axis=1)
            for name, first in self.start.items()
        }
        return self

    def halved(self) -> Steps:
        """The same rollout in steps half as long, of a batch of its own that goes on."""
        batch = self.batch
        model = batch.model.with_settings(dt=batch.settings.dt / 2)
        own = type(batch)(model, self.n, threads=batch._threads, on_failure="go on")
        own._core.unwatch()
        own._residuals.told = True
        own.param.update(batch.param.columns())
        for name, rows in (self.start | self.held).items():
            getattr(own, name)[...] = rows
        steps = Steps(own, np.repeat(self.ctrl, 2, axis=1), self.labels).roll(progress=False)
        # Where a world fails is no state to be linearised at.
        failed = list(own.failures)
        for name, rows in steps.states.items():
            rows[failed] = steps.start[name][failed, None]
        return steps

    def share(self, worlds: Sequence[int]) -> Share:
        """Some of the worlds, whose steps are linearised together."""
        return Share(self, worlds)

    def shares(self) -> Iterator[Share]:
        """All worlds, as many at a time as `ROOM` holds the steps of a block of."""
        size = self.size
        block = BLOCK * size * (size + self.batch.model.nu + len(self.labels))
        most = max(1, ROOM // max(1, block))
        return (self.share(range(k, min(k + most, self.n))) for k in range(0, self.n, most))

    def blocks(self) -> list[range]:
        """All steps, as many at a time as are linearised together."""
        return [range(k, min(k + BLOCK, self.count)) for k in range(0, self.count, BLOCK)]

    def changes(self) -> Floats:
        """What each step changes of x, nearly, (n, steps, size)."""
        moved = self.batch.settings.dt * self.states["qvel"][:, 1:]
        others = (np.diff(self.states[name], axis=1) for name in X[1:])
        return np.concatenate([moved, *others], axis=-1)

    def dofs(self, given: Mapping[str, Floats]) -> Floats:
        """The gradients by the states after each step as those of x, (n, steps, size)."""
        dq = self.tangents.to_dofs(self.rollout.qpos, given["qpos"])
        return self.x([dq, given["qvel"], given["act"]])

    def x(self, parts: Sequence[Floats]) -> Floats:
        """Changes by dof, of velocities and activations as those of x; none of the past."""
        past = np.zeros((*parts[1].shape[:-1], self.batch._arrays["ctrl_history"].shape[1]))
        return np.concatenate([*parts, past], axis=-1)


class Share:
    """Some worlds of a rollout, one after the other, whose steps are linearised together."""

    def __init__(self, steps: Steps, worlds: Sequence[int]) -> None:
        self.steps, self.worlds = steps, list(worlds)
        self.own = slice(self.worlds[0], self.worlds[-1] + 1)
        if len(self.worlds) == steps.n and steps.models is steps.batch.param.models():
            self.linear_worlds = linear_worlds(steps.batch)
        else:
            models = [steps.models[world] for world in worlds]
            self.linear_worlds = LinearWorlds(models, steps.batch._threads, self.worlds[0])

    def linear(self, steps: Sequence[int]) -> LinearSteps:
        """Linearise some steps, one after the other: of shape (worlds, steps, …)."""
        of, mine, some = self.steps, self.own, slice(steps[0], steps[-1] + 1)
        states = {name: rows[mine, some] for name, rows in of.states.items()}
        states["ctrl"] = of.ctrl[mine, some]
        for name, rows in of.held.items():
            states[name] = np.repeat(rows[mine][:, None], len(steps), 1)
        return self.linear_worlds.linear(states, of.by)
