"""Derivatives of rollouts, step by step, in forward and reverse mode.

The module also detects gradients that are meaningless.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.arrays import INPUTS, STATE, Floats, numbers, refuse_late
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.linearization import LinearSteps, LinearWorlds
from stepcore.engine.parameters import columns, split_entry
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.trajectory import Rollout

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch
    from stepcore.report.progress import Choice

# A gradient that grows by more than this in the backward pass is valid for a step or two only; a
# part that is smaller by this factor is noise.
MAX_GROWTH = 1e6
TINY = np.finfo(float).tiny
# The number of steps before and after a step in which its contact is searched.
NEAR_STEPS = 50
# The number of steps of a world that are linearised together, and the largest number of matrix
# entries in memory: 64 MiB.
SLICE, ROOM = 64, 2**23
# The parts of x.
X = (*STATE, "ctrl_history")


class GradientWarning(UserWarning):
    """A gradient over a rollout is meaningless; the text names world, time and impact.

    It grows without bound or, by its error bar, changes in shorter steps.
    """


class Gradients(NamedTuple):
    """The rollout, and the gradient of each world; the result of `Batch.vjp`.

    rollout: the states after each step.
    qpos, qvel, act: by the initial state, shapes (n, nq), (n, nv), (n, na). A step along the
        gradient of a quaternion keeps its length.
    ctrl: by the controls, shape (n, steps, nu).
    parameters: by each parameter, by its label, shape (n,).
    growth: the largest growth of the gradient in the backward pass, shape (n,).
    one_sided: (world, step, element) for each state exactly at a corner of the element's law.
    error: with `error_bar`, the relative distance from the gradient in steps half as long, shape
        (n,), infinite if these steps fail; else None.
    """

    rollout: Rollout
    qpos: Floats
    qvel: Floats
    act: Floats
    ctrl: Floats
    parameters: dict[str, Floats]
    growth: Floats
    one_sided: list[tuple[int, int, str]]
    error: Floats | None = None


def rows_of(
    values: Mapping[str, ArrayLike | None], sizes: Mapping[str, tuple[int, ...]]
) -> dict[str, Floats]:
    """Return checked arrays of these shapes, with zeros for None."""
    arrays = {}
    for name, value in values.items():
        array = np.zeros(sizes[name]) if value is None else numbers(name, value)
        if array.shape != sizes[name]:
            raise ValueError(f"{name} has shape {array.shape}: must be {sizes[name]}")
        arrays[name] = array
    return arrays


class Steps:
    """The steps of a rollout of a batch, each to be linearised at the state where it starts.

    Arguments are checked first; `roll` then steps the batch, once.
    """

    rollout: Rollout
    # The states of each world, before the first step and after each step.
    states: dict[str, Floats]

    def __init__(self, batch: Batch, ctrl: ArrayLike, parameters: Sequence[str]) -> None:
        # Raise errors of steps that cannot be linearised before the first step.
        LinearWorlds([batch.model], 1)
        self.by = columns(batch.model, parameters)
        self.labels = [column.label for column in self.by]
        self.batch = batch
        self.ctrl, self.n = np.array(numbers("ctrl", ctrl)), len(batch)
        if self.ctrl.ndim != 3 or self.ctrl.shape[::2] != (self.n, batch.model.nu):
            limit = f"({self.n}, steps, {batch.model.nu})"
            raise ValueError(f"ctrl has shape {self.ctrl.shape}: must be {limit}")
        self.count = self.ctrl.shape[1]
        self.tangents = Coordinates(batch.model)
        self._linearised: tuple[range, LinearWorlds] | None = None
        # The size of x.
        self.size = 2 * batch.model.nv + batch.model.na + batch._arrays["ctrl_history"].shape[1]

    def sizes(self, *rows: int) -> dict[str, tuple[int, ...]]:
        """Return the shapes of arrays of states, with these leading rows for each world."""
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
        self.rollout = batch.rollout(self.ctrl, X[len(STATE) :], progress=progress)
        after = {**self.rollout._asdict(), **self.rollout.recorded}
        self.states = {
            name: np.concatenate([first[:, None], after[name]], axis=1)
            for name, first in self.start.items()
        }
        return self

    def halved(self) -> Steps:
        """Return the same rollout in steps half as long, in a new batch with on_failure="go on"."""
        batch = self.batch
        model = batch.model.with_settings(dt=batch.settings.dt / 2)
        finer = type(batch)(model, self.n, threads=batch._threads, on_failure="go on")
        finer._core.unwatch()
        finer._residuals.warned = True
        finer.param.update(batch.param.columns())
        for name, rows in (self.start | self.held).items():
            getattr(finer, name)[...] = rows
        steps = Steps(finer, np.repeat(self.ctrl, 2, axis=1), self.labels).roll(progress=False)
        # States of failed worlds cannot be linearised: use the initial state.
        failed = list(finer.failures)
        for name, rows in steps.states.items():
            rows[failed] = steps.start[name][failed, None]
        return steps

    def shares(self) -> list[range]:
        """Return ranges of worlds, each so small that a block of its steps fits in `ROOM`."""
        block = SLICE * self.size * (self.size + self.batch.model.nu + len(self.labels))
        most = max(1, ROOM // max(1, block))
        return [range(k, min(k + most, self.n)) for k in range(0, self.n, most)]

    def blocks(self) -> list[range]:
        """Return the ranges of steps that are linearised together."""
        return [range(k, min(k + SLICE, self.count)) for k in range(0, self.count, SLICE)]

    def changes(self) -> Floats:
        """Return the approximate change of x in each step, (n, steps, size)."""
        moved = self.batch.settings.dt * self.states["qvel"][:, 1:]
        changes = (np.diff(self.states[name], axis=1) for name in X[1:])
        return np.concatenate([moved, *changes], axis=-1)

    def dofs(self, gradients: Mapping[str, Floats]) -> Floats:
        """Convert gradients by the states after each step to gradients by x, (n, steps, size)."""
        dq = self.tangents.to_dofs(self.rollout.qpos, gradients["qpos"])
        return self.x([dq, gradients["qvel"], gradients["act"]])

    def x(self, parts: Sequence[Floats]) -> Floats:
        """Join parts for dofs, velocities and activations to x; past controls are zero."""
        past = np.zeros((*parts[1].shape[:-1], self.batch._arrays["ctrl_history"].shape[1]))
        return np.concatenate([*parts, past], axis=-1)

    def linear(self, worlds: range, steps: range) -> LinearSteps:
        """Linearise some steps of some worlds, shape (worlds, steps, …)."""
        of_worlds, of_steps = slice(worlds.start, worlds.stop), slice(steps.start, steps.stop)
        states = {name: rows[of_worlds, of_steps] for name, rows in self.states.items()}
        states["ctrl"] = self.ctrl[of_worlds, of_steps]
        for name, rows in self.held.items():
            states[name] = np.repeat(rows[of_worlds][:, None], len(steps), 1)
        if self._linearised is None or self._linearised[0] != worlds:
            if len(worlds) == self.n and self.models is self.batch.param.models():
                linearised = self.batch._linearised_worlds()
            else:
                models = [self.models[world] for world in worlds]
                linearised = LinearWorlds(models, self.batch._threads, worlds.start)
            self._linearised = worlds, linearised
        return self._linearised[1].linear(states, self.by)


def vjp(
    batch: Batch,
    ctrl: ArrayLike,
    cotangents: Mapping[str, ArrayLike | None],
    parameters: Sequence[str],
    error_bar: bool = False,
) -> Gradients:
    """See `Batch.vjp`."""
    checks.one_of(True, False)("vjp", "error_bar", error_bar)
    steps = Steps(batch, ctrl, parameters)
    weights = rows_of(cotangents, steps.sizes(steps.count))
    if error_bar:
        refuse_late("error_bar", batch)
    steps.roll()
    return pulled(steps, weights, steps.halved() if error_bar else None)


def pulled(
    steps: Steps, cotangents: Mapping[str, Floats], halved: Steps | None = None
) -> Gradients:
    """Return the gradient of a rollout.

    halved: the same rollout in steps half as long, for the error.
    """
    weights, nv = steps.dofs(cotangents), steps.batch.model.nv
    back = adjoints(steps, weights)
    given_size = np.linalg.norm(weights, axis=-1).sum(axis=1)
    growth = back.sizes.max(axis=1, initial=0.0) / np.where(given_size > 0, given_size, np.inf)
    grown = growth > MAX_GROWTH
    texts = [_grown(steps, int(k), float(growth[k]), back) for k in np.flatnonzero(grown)[:1]]
    error = None
    if halved is not None:
        finer = adjoints(
            halved, halved.dofs({name: _spread(rows) for name, rows in cotangents.items()})
        )
        parts, failed = _apart(back, finer, steps, given_size), halved.batch.failures
        error = np.max(list(parts.values()), axis=0)
        error[list(failed)] = np.inf
        texts += [
            f"the gradient of world {world} has no error bar, as in steps half as long the rollout "
            f"{checks.one_line(failed[world])}"
            for world in list(failed)[:1]
        ]
        # A gradient is meaningless if it changes by half in steps half as long.
        for world in np.flatnonzero(np.isfinite(error) & (error > 0.5) & ~grown)[:1]:
            largest = max(parts, key=lambda part: parts[part][world])
            texts.append(_parted(steps, int(world), largest, float(error[world]), back, finer))
    for text in texts:
        # The warning points to the caller of `Batch.vjp`.
        warnings.warn(GradientWarning(text), stacklevel=4)
    first = back.rows[:, 0]
    return Gradients(
        steps.rollout,
        steps.tangents.of_dofs(steps.start["qpos"], first[:, :nv], inverse=True),
        first[:, nv : 2 * nv],
        first[:, 2 * nv : 2 * nv + steps.batch.model.na],
        back.ctrl,
        {label: back.values[:, k] for k, label in enumerate(steps.labels)},
        growth,
        back.sided,
        error,
    )


class Tape:
    """A rollout from given states and values of parameters, for other packages' gradients.

    qpos, qvel, ctrl: as in `Batch.vjp`. values: values of the parameters, each of shape (n,). All
    other inputs of the worlds have their values at the call.

    rollout: the states after each step.
    """

    def __init__(
        self,
        batch: Batch,
        parameters: Sequence[str],
        qpos: Floats,
        qvel: Floats,
        ctrl: Floats,
        *values: Floats,
    ) -> None:
        labels, changed = list[str](), dict[str, Floats]()
        for name, value in zip(parameters, values, strict=True):
            if np.shape(value) != (len(batch),):
                limit = f"of shape ({len(batch)},), a value for each world"
                raise ValueError(f"parameters: {name} has shape {np.shape(value)}: must be {limit}")
            path, entry = split_entry(name)
            rows = changed.setdefault(path, np.array(batch.param[path]))
            vector = rows.ndim > 1
            rows[(slice(None), entry or 0) if vector else slice(None)] = value
            labels.append(f"{path}[{entry or 0}]" if vector else path)
        self.labels, self.steps = labels, Steps(batch, ctrl, labels)
        state = rows_of({"qpos": qpos, "qvel": qvel}, self.steps.sizes())
        if changed:
            batch.param.update(changed)
        batch.qpos, batch.qvel = state["qpos"], state["qvel"]
        batch._core.forget(list(range(len(batch))))
        self.rollout = self.steps.roll().rollout

    def gradient(self, qpos: Floats, qvel: Floats) -> tuple[Floats, ...]:
        """Return the gradient by qpos, qvel, ctrl and parameters, given one by the states."""
        sizes = self.steps.sizes(self.steps.count)
        gradients = pulled(self.steps, rows_of({"qpos": qpos, "qvel": qvel, "act": None}, sizes))
        by = (gradients.parameters[label] for label in self.labels)
        return (gradients.qpos, gradients.qvel, gradients.ctrl, *by)


def jvp(
    batch: Batch,
    ctrl: ArrayLike,
    tangents: Mapping[str, ArrayLike | None],
    ctrl_change: ArrayLike | None,
    parameters: Mapping[str, ArrayLike],
) -> tuple[Rollout, Rollout]:
    """See `Batch.jvp`."""
    steps = Steps(batch, ctrl, tuple(parameters))
    changes = rows_of(
        {**tangents, "ctrl_change": ctrl_change}, steps.sizes() | {"ctrl_change": steps.ctrl.shape}
    )
    missing = [label for label in steps.labels if label not in parameters]
    if missing:
        raise ValueError(f"parameters: {missing[0]} must be given by its own label")
    values = np.zeros((len(steps.labels), steps.n))
    for k, label in enumerate(steps.labels):
        value = numbers(f"parameters: {label}", parameters[label])
        if value.shape not in ((1,), (steps.n,)):
            raise ValueError(
                f"parameters: {label} has shape {value.shape}: must be a number or ({steps.n},)"
            )
        values[k] = value
    steps.roll()
    moved = changes.pop("ctrl_change")
    changes["qpos"] = steps.tangents.changed(steps.start["qpos"], changes["qpos"])
    first = steps.x([changes[name] for name in STATE])

    rows = np.zeros((steps.n, steps.count, first.shape[1]))
    for worlds in steps.shares():
        of_worlds = slice(worlds.start, worlds.stop)
        x = first[of_worlds]
        for block in steps.blocks():
            A, B, P, _ = steps.linear(worlds, block)
            by = (
                B @ moved[of_worlds, block[0] : block[-1] + 1, :, None]
                + P @ values.T[of_worlds, None, :, None]
            )
            for k, step in enumerate(block):
                x = (A[:, k] @ x[..., None] + by[:, k])[..., 0]
                rows[of_worlds, step] = x
    nv = batch.model.nv
    qpos = steps.tangents.of_dofs(steps.rollout.qpos, rows[..., :nv])
    dv, dw = rows[..., nv : 2 * nv], rows[..., 2 * nv : 2 * nv + batch.model.na]
    return steps.rollout, Rollout(qpos, dv, dw)


class Adjoints(NamedTuple):
    """Gradients of a backward pass, from the last state to the first.

    rows: by the state at the start of each step, and after the last, (n, steps + 1, size of x).
    after: by the state after each step, including its direct weight, (n, steps, size of x).
    ctrl: by the controls, (n, steps, nu). values: by the parameters, (n, parameters).
    ctrl_terms: the sum of the absolute terms of the gradient by the controls, (n,).
    sizes: the norm of each row, (n, steps).
    sided: as `Gradients.one_sided`.
    """

    rows: Floats
    after: Floats
    ctrl: Floats
    values: Floats
    ctrl_terms: Floats
    sizes: Floats
    sided: list[tuple[int, int, str]]


def adjoints(steps: Steps, weights: Floats) -> Adjoints:
    """Run the backward pass of a rollout.

    weights: the gradient by the state after each step, (n, steps, size of x).
    """
    model, (n, count, size) = steps.batch.model, weights.shape
    rows, after = np.zeros((n, count + 1, size)), np.array(weights)
    ctrl, ctrl_terms = np.zeros((n, count, model.nu)), np.zeros(n)
    values = np.zeros((n, len(steps.by)))
    sided = list[tuple[int, int, str]]()
    for worlds in steps.shares():
        of_worlds = slice(worlds.start, worlds.stop)
        for block in reversed(steps.blocks()):
            A, B, P, degenerate = steps.linear(worlds, block)
            sided += [
                (worlds[world], block[k], model.element_name(*element))
                for world, k, element in degenerate
            ]
            for k in reversed(range(len(block))):
                step = block[k]
                after[of_worlds, step] += rows[of_worlds, step + 1]
                rows[of_worlds, step] = np.matmul(after[of_worlds, step, None], A[:, k])[:, 0]
            some = slice(block[0], block[-1] + 1)
            each = after[of_worlds, some, None]
            ctrl[of_worlds, some] = np.matmul(each, B)[:, :, 0]
            ctrl_terms[of_worlds] += np.matmul(np.abs(each), np.abs(B)).sum(axis=(1, 2, 3))
            values[of_worlds] += np.matmul(each, P)[:, :, 0].sum(axis=1)
    sizes = np.linalg.norm(rows[:, :-1], axis=2)
    sided.sort(key=lambda entry: entry[:2])
    return Adjoints(rows, after, ctrl, values, ctrl_terms, sizes, sided)


def _spread(rows: Floats) -> Floats:
    """Return the weights of states for steps half as long, after every second step."""
    out = np.zeros((rows.shape[0], 2 * rows.shape[1], *rows.shape[2:]))
    out[:, 1::2] = rows
    return out


def _apart(back: Adjoints, finer: Adjoints, steps: Steps, given_size: Floats) -> dict[str, Floats]:
    """Return the relative distance of each part of a gradient from steps half as long, (n,).

    A part is negligible below 1/`MAX_GROWTH` of: the largest gradient by a state; for controls, the
    sum of its absolute terms; for the relative change of a parameter, the changes of all steps.
    given_size: the size of the given gradient, (n,).
    """
    most = np.maximum(given_size, back.sizes.max(axis=1, initial=0.0))
    both = finer.ctrl[:, ::2] + finer.ctrl[:, 1::2]
    parts = {
        "the initial state": _distance(back.rows[:, 0], finer.rows[:, 0], most / MAX_GROWTH),
        "the controls": _distance(back.ctrl, both, back.ctrl_terms / MAX_GROWTH),
    }
    changes = np.sum(np.abs(back.after * steps.changes()), axis=(1, 2))
    for k, column in enumerate(steps.by):
        least = changes / MAX_GROWTH / abs(column.value)
        parts[f"`{column.label}`"] = _distance(back.values[:, k], finer.values[:, k], least)
    return parts


def _distance(first: Floats, second: Floats, least: Floats | float = 0.0) -> Floats:
    """Return the distance of the rows of each world, relative to the larger."""
    off, *sizes = (
        np.linalg.norm(rows.reshape(len(rows), -1), axis=1)
        for rows in (first - second, first, second)
    )
    return off / np.maximum(np.maximum(*sizes), np.maximum(least, TINY))


def _grown(steps: Steps, world: int, growth: float, back: Adjoints) -> str:
    """Return the warning of a gradient that grows, with the step and the contact of its peak."""
    sizes, given_sizes = back.sizes[world], np.linalg.norm(back.after[world], axis=1)
    step = int(np.where(given_sizes > 0, sizes / np.maximum(given_sizes, TINY), 1.0).argmax())
    return (
        f"the gradient of world {world} grows {growth:.0e} times over {steps.count} steps, most in "
        f"{_at(steps, world, step)}: before it, the gradient holds only for changes that are as "
        "much smaller; begin after it, or sample instead"
    )


def _parted(
    steps: Steps, world: int, part: str, error: float, back: Adjoints, finer: Adjoints
) -> str:
    """Return the warning of a gradient that changes in steps half as long, and where that starts.

    part: the part that changes most.
    """
    each = _distance(back.rows[world], finer.rows[world, ::2])
    # Before this step the gradient by the states differs, whatever the weights.
    parts = np.flatnonzero(each >= min(error, 1.0) / 2)
    where = ""
    if parts.size:
        step = min(int(parts[-1]), steps.count - 1)
        where = f", from {_at(steps, world, step, back=True)}"
    return (
        f"the gradient of world {world} by {part} changes by {100 * error:.0f} % in steps half as "
        f"long{where}: take shorter steps or a softer contact, or begin after it"
    )


def _at(steps: Steps, world: int, step: int, back: bool = False) -> str:
    """Return a step in words, with the contact of largest force near its start."""
    dt = steps.batch.settings.dt
    words = f"step {step} [{steps.time + step * dt:.4g} s]" + " on its way back" * back
    touches = _touching(steps, world)
    # In steps half as long, an impact of a few steps may end earlier or start later.
    near = range(max(0, step - NEAR_STEPS), min(step + NEAR_STEPS, steps.count))
    k = next((k for k in sorted(near, key=lambda k: abs(k - step)) if touches(k)), None)
    if k is None:
        return words
    forces = touches(k)
    pair = max(forces, key=lambda names: forces[names])
    while k and pair in touches(k - 1):
        k -= 1
    names = " with ".join(f"`{checks.cut(name, 60)}`" for name in pair)
    # A contact that exists from the beginning had no impact.
    return f"{words}, at the " + (
        f"impact of {names} at {steps.time + k * dt:.4g} s" if k else f"contact of {names}"
    )


def _touching(steps: Steps, world: int) -> Callable[[int], dict[tuple[str, str], float]]:
    """Return a function of a step that returns the geoms in contact at its start and forces [N]."""
    sim = unwatched(Sim(steps.models[world]))
    for name, rows in steps.held.items():
        getattr(sim, name)[...] = rows[world]

    def at(step: int) -> dict[tuple[str, str], float]:
        for name, rows in steps.states.items():
            getattr(sim, name)[...] = rows[world, step]
        sim.ctrl[...] = steps.ctrl[world, step]
        sim.forward()
        forces = dict[tuple[str, str], float]()
        for contact in sim.contacts:
            pair = str(contact["name1"]), str(contact["name2"])
            forces[pair] = forces.get(pair, 0.0) + float(np.linalg.norm(contact["force"]))
        return {pair: force for pair, force in forces.items() if force > 0}

    return at


def sensitivities(steps: Steps, world: int = 0, changes: Floats | None = None) -> Floats:
    """Return the derivatives of a world's states by parameters, then by its initial x.

    changes: derivatives of the controls by further parameters, shape (steps, nu, further).

    Shape (steps + 1, size of x, parameters + further + size of x); the first row is the initial
    state.
    """
    model = steps.models[world]
    size, labels = steps.size, len(steps.labels)
    pushes = np.zeros((steps.count, model.nu, 0)) if changes is None else changes
    count = labels + pushes.shape[2]
    # The constant parameters extend the state, so that each step is one product.
    slopes = np.zeros((steps.count + 1, size + count, count + size))
    slopes[0, :size, count:] = np.eye(size)
    slopes[:, size:, :count] = np.eye(count)
    # Imported here because single steps need no executors.
    from stepcore.executors import checkpoint

    for block in steps.blocks():
        checkpoint()
        A, B, P = (matrix[0] for matrix in steps.linear(range(world, world + 1), block)[:3])
        each = np.concatenate([A, P, B @ pushes[block]], axis=2)
        chunk = slopes[block[0] : block[-1] + 2]
        for step, before, after in zip(each, chunk, chunk[1:, :size], strict=False):
            np.matmul(step, before, out=after)
    return slopes[:, :size]
