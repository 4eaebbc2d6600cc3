"""Derivatives of rollouts of many worlds, forward and backward, from the exact one of each step."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.arrays import INPUTS, STATE, Floats, numbers
from stepcore.engine.linear_steps import LinearSteps, LinearWorlds
from stepcore.engine.linearization import Linearization, named
from stepcore.engine.parameter_columns import columns, split_entry
from stepcore.engine.rollout import Rollout
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.tangents import Tangents
from stepcore.engine.world import World

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch

# A gradient that grows more than this on its way back says nothing beyond the next step or two.
GROWTH = 1e6
# Steps of a world that are linearised together, and as many numbers of matrices as are in memory
# at once: 64 MiB.
BLOCK, ROOM = 64, 2**23
TINY = np.finfo(float).tiny


class GradientWarning(UserWarning):
    """A gradient grows without bound over a rollout; the text names the world, step and impact."""


class Gradients(NamedTuple):
    """What `Batch.vjp` returns: the rollout, and the gradient of each world.

    rollout: the states after each step.
    qpos, qvel, act: by the initial state, shapes (n, nq), (n, nv), (n, na). That of a quaternion
        keeps its length.
    ctrl: by the controls, shape (n, steps, nu).
    parameters: by each parameter, by its label, shape (n,).
    growth: how much the gradient grew on its way back at most, shape (n,).
    one_sided: (world, step, element) where a row is exactly at its switch.
    """

    rollout: Rollout
    qpos: Floats
    qvel: Floats
    act: Floats
    ctrl: Floats
    parameters: dict[str, Floats]
    growth: Floats
    one_sided: list[tuple[int, int, str]]


def _check_late(batch: Batch) -> None:
    if batch._arrays["ctrl_history"].size:
        raise ValueError("ctrl: gradients of scenes with late controls are not built yet")


def _put(sim: Sim, arrays: Mapping[str, Floats], world: int) -> None:
    """Give a Sim the row of a world of these arrays."""
    for name, rows in arrays.items():
        getattr(sim, name)[...] = rows[world]


def _rows(
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

    def __init__(self, batch: Batch, ctrl: ArrayLike, parameters: Sequence[str]) -> None:
        _check_late(batch)
        self.labels = [column.label for column in columns(batch.model, parameters)]
        self.batch = batch
        self.ctrl, self.n = np.array(numbers("ctrl", ctrl)), len(batch)
        if self.ctrl.ndim != 3 or self.ctrl.shape[::2] != (self.n, batch.model.nu):
            limit = f"({self.n}, steps, {batch.model.nu})"
            raise ValueError(f"ctrl has shape {self.ctrl.shape}: must be {limit}")
        self.count = self.ctrl.shape[1]
        self.tangents = Tangents(batch.model)

    def sizes(self, *rows: int) -> dict[str, tuple[int, ...]]:
        """The shapes of arrays with so many rows for each world's state."""
        model = self.batch.model
        widths = (model.nq, model.nv, model.na)
        return {name: (self.n, *rows, width) for name, width in zip(STATE, widths, strict=True)}

    def roll(self) -> Steps:
        """Step the batch."""
        batch = self.batch
        self.models = [batch._model_of(world) for world in range(self.n)]
        self.held = {name: np.array(getattr(batch, name)) for name in INPUTS[1:]}
        self.start = {name: np.array(getattr(batch, name)) for name in STATE}
        self.time = batch.time
        self.rollout = batch.rollout(self.ctrl)
        return self

    def sim(self, world: int) -> Sim:
        """A Sim of a world, with the inputs that do not change."""
        sim = unwatched(Sim(self.models[world]))
        _put(sim, self.held, world)
        return sim

    def states(self, world: int, name: str) -> Floats:
        """An array of a world's states, from the first to that after the last step."""
        states: Floats = np.concatenate(
            [self.start[name][world][None], getattr(self.rollout, name)[world]]
        )
        return states

    def put(self, sim: Sim, world: int, step: int) -> None:
        """Let a Sim stand where a step began."""
        for name in STATE:
            before = self.start[name][world]
            if step:
                before = getattr(self.rollout, name)[world, step - 1]
            getattr(sim, name)[...] = before
        sim.ctrl[...] = self.ctrl[world, step]

    def share(self, worlds: Sequence[int]) -> Share:
        """Some of the worlds, whose steps are linearised together."""
        return Share(self, worlds)

    def shares(self) -> Iterator[Share]:
        """All worlds, as many at a time as `ROOM` holds the steps of a block of."""
        size = self.batch.model.nv * 2 + self.batch.model.na
        block = BLOCK * size * (size + self.batch.model.nu + len(self.labels))
        most = max(1, ROOM // max(1, block))
        return (self.share(range(k, min(k + most, self.n))) for k in range(0, self.n, most))

    def blocks(self) -> list[range]:
        """All steps, as many at a time as are linearised together."""
        return [range(k, min(k + BLOCK, self.count)) for k in range(0, self.count, BLOCK)]

    def touching(self, sim: Sim, world: int, step: int) -> dict[tuple[str, str], float]:
        """The pairs of geoms that touch where a step begins, with the force between them [N]."""
        self.put(sim, world, step)
        sim.forward()
        forces = dict[tuple[str, str], float]()
        for contact in sim.contacts:
            pair = str(contact["name1"]), str(contact["name2"])
            forces[pair] = forces.get(pair, 0.0) + float(np.linalg.norm(contact["force"]))
        return {pair: force for pair, force in forces.items() if force > 0}

    def dofs(self, given: Mapping[str, Floats]) -> Floats:
        """The gradients by the states after each step as those of x, (n, steps, 2 nv + na)."""
        return np.concatenate(
            [self.tangents.to_dofs(self.rollout.qpos, given["qpos"]), given["qvel"], given["act"]],
            axis=-1,
        )


class Share:
    """Some worlds of a rollout, whose steps are linearised together."""

    def __init__(self, steps: Steps, worlds: Sequence[int]) -> None:
        self.steps, self.worlds = steps, list(worlds)
        models = [steps.models[world] for world in worlds]
        self.linear_worlds = LinearWorlds(models, steps.batch._threads)

    def linear(
        self, steps: Sequence[int] | NDArray[np.int_], by: Sequence[str] | None = None
    ) -> LinearSteps:
        """Linearise some steps, by their parameters or these: of shape (worlds, steps, …)."""
        of, mine = self.steps, self.worlds
        states = {
            name: np.array([of.states(world, name)[:-1][steps] for world in mine]) for name in STATE
        }
        states["ctrl"] = of.ctrl[mine][:, steps]
        states |= {
            name: np.repeat(rows[mine][:, None], len(steps), 1) for name, rows in of.held.items()
        }
        return self.linear_worlds.linear(states, of.labels if by is None else by)


def linearizations(batch: Batch, parameters: Sequence[str]) -> list[Linearization]:
    """See `Batch.linearize`."""
    _check_late(batch)
    models = [batch._model_of(world) for world in range(len(batch))]
    if not batch._linear_worlds or not batch._linear_worlds.is_of(models):
        batch._linear_worlds = LinearWorlds(models, batch._threads)
    states = {name: np.array(getattr(batch, name))[:, None] for name in (*STATE, *INPUTS)}
    return named(batch.model, batch._linear_worlds.linear(states, parameters), parameters)


def vjp(
    batch: Batch,
    ctrl: ArrayLike,
    given: Mapping[str, ArrayLike | None],
    parameters: Sequence[str],
) -> Gradients:
    """See `Batch.vjp`."""
    steps = Steps(batch, ctrl, parameters)
    weights = _rows(given, steps.sizes(steps.count))
    return pulled(steps.roll(), weights)


def pulled(steps: Steps, given: Mapping[str, Floats]) -> Gradients:
    """Return the gradient of the rollout that was made."""
    weights, model, count = steps.dofs(given), steps.batch.model, steps.count
    split = (model.nv, 2 * model.nv)

    n, size = len(steps.batch), weights.shape[-1]
    first, by_ctrl = np.zeros((n, size)), np.zeros((n, count, model.nu))
    values = np.zeros((n, len(steps.labels)))
    sizes, factors = np.zeros((n, count)), np.ones((n, count))
    sided = list[tuple[int, int, str]]()
    for share in steps.shares():
        own, adjoint = share.worlds, np.zeros((len(share.worlds), size))
        for block in reversed(steps.blocks()):
            linear = share.linear(block)
            sided += [
                (own[world], block[k], model.element_name(*element))
                for world, k, element in linear.degenerate
            ]
            for k in reversed(range(len(block))):
                step = block[k]
                adjoint = adjoint + weights[own, step]
                before = np.linalg.norm(adjoint, axis=1)
                A, B, P = (one[:, k] for one in linear[:3])
                by_ctrl[own, step] = _pulled(adjoint, B)
                values[own] += _pulled(adjoint, P)
                adjoint = _pulled(adjoint, A)
                sizes[own, step] = after = np.linalg.norm(adjoint, axis=1)
                factors[own, step] = np.where(before > 0, after / np.maximum(before, TINY), 1.0)
        first[own] = adjoint
    asked = np.linalg.norm(weights, axis=-1).sum(axis=1)
    growth = sizes.max(axis=1, initial=0.0) / np.where(asked > 0, asked, np.inf)
    for world in np.flatnonzero(growth > GROWTH)[:1]:
        text = _grown(steps, int(world), float(growth[world]), int(factors[world].argmax()))
        warnings.warn(GradientWarning(text), stacklevel=4)
    return Gradients(
        steps.rollout,
        steps.tangents.gradient(steps.start["qpos"], first[:, : split[0]]),
        first[:, split[0] : split[1]],
        first[:, split[1] :],
        by_ctrl,
        {label: values[:, k] for k, label in enumerate(steps.labels)},
        growth,
        sorted(sided, key=lambda entry: entry[:2]),
    )


def _pulled(rows: Floats, matrices: Floats) -> Floats:
    """Rows of worlds, each times its matrix."""
    out: Floats = np.matmul(rows[:, None], matrices)[:, 0]
    return out


def _grown(steps: Steps, world: int, growth: float, step: int) -> str:
    """Say that a gradient has grown, most in this step, and name the contact that began there."""
    sim, dt = steps.sim(world), steps.batch.settings.dt
    pairs = steps.touching(sim, world, step)
    where = ""
    if pairs:
        pair = max(pairs, key=lambda names: pairs[names])
        began = step
        while began and pair in steps.touching(sim, world, began - 1):
            began -= 1
        known = "contact" if began == 0 else "impact"
        names = " with ".join(f"`{checks.cut(name, 60)}`" for name in pair)
        time = steps.time + began * dt
        where = f", at the {known} of {names}" + f" at {time:.4g} s" * (known == "impact")
    return (
        f"the gradient of world {world} grows {growth:.0e} times over {steps.count} steps, most in "
        f"step {step} [{steps.time + step * dt:.4g} s]{where}: before it, the gradient holds only "
        "for changes that are as much smaller; begin after it, or sample instead"
    )


class Tape:
    """A rollout from given states and values of parameters, for other packages' gradients.

    qpos, qvel, ctrl: as in `Batch.vjp`. values: of the parameters, each of shape (n,). What else
    the worlds have is as at the call.

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
        limit = f"of shape ({len(batch)},), a value for each world"
        labels, changed = [], dict[str, Floats]()
        for name, value in zip(parameters, values, strict=True):
            if np.shape(value) != (len(batch),):
                raise ValueError(f"parameters: {name} has shape {np.shape(value)}: must be {limit}")
            path, entry = split_entry(name)
            rows = changed.setdefault(path, np.array(batch.param[path]))
            if rows.ndim > 1:
                rows[:, entry or 0] = value
                labels.append(f"{path}[{entry or 0}]")
            else:
                rows[:] = value
                labels.append(path)
        self.labels, self.steps = labels, Steps(batch, ctrl, labels)
        sizes = self.steps.sizes()
        state = _rows({"qpos": qpos, "qvel": qvel}, sizes)
        if changed:
            batch.param.update(changed)
        batch.qpos, batch.qvel = state["qpos"], state["qvel"]
        batch._core.forget(list(range(len(batch))))
        self.rollout = self.steps.roll().rollout

    def gradient(self, qpos: Floats, qvel: Floats) -> tuple[Floats, ...]:
        """Return the gradient by qpos, qvel, ctrl and each parameter, of one by the states."""
        sizes = self.steps.sizes(self.steps.count)
        found = pulled(self.steps, _rows({"qpos": qpos, "qvel": qvel, "act": None}, sizes))
        by = (found.parameters[label] for label in self.labels)
        return (found.qpos, found.qvel, found.ctrl, *by)


def jvp(
    batch: Batch,
    ctrl: ArrayLike,
    given: Mapping[str, ArrayLike | None],
    ctrl_change: ArrayLike | None,
    parameters: Mapping[str, ArrayLike],
) -> tuple[Rollout, Rollout]:
    """See `Batch.jvp`."""
    steps = Steps(batch, ctrl, tuple(parameters))
    changes = _rows(
        {**given, "ctrl_change": ctrl_change}, steps.sizes() | {"ctrl_change": steps.ctrl.shape}
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
    first = np.concatenate([changes[name] for name in STATE], axis=-1)

    rows = np.zeros((steps.n, steps.count, first.shape[1]))
    for share in steps.shares():
        own = share.worlds
        x = first[own]
        for block in steps.blocks():
            linear = share.linear(block)
            for k, step in enumerate(block):
                ways = zip(linear[:3], (x, moved[own, step], values[:, own].T), strict=True)
                x = sum(np.matmul(one[:, k], way[..., None])[..., 0] for one, way in ways)
                rows[own, step] = x
    nv = batch.model.nv
    qpos = steps.tangents.of_dofs(steps.rollout.qpos, rows[..., :nv])
    return steps.rollout, Rollout(qpos, rows[..., nv : 2 * nv], rows[..., 2 * nv :])


class Differentiable(World):
    """Worlds whose steps and rollouts have derivatives."""

    def linearize(self: Any, parameters: Sequence[str] = ()) -> list[Linearization]:
        """Linearise the next step of every world about its state, without taking the step.

        parameters: paths as in `Sim.linearize`, whose errors it raises.

        Worlds share the batch's threads. The states of a trajectory, one to a world, are linearised
        in one call. The solver starts from no impulses, as after a reset; one that converges
        forgets its start.

        >>> from stepcore import Batch, lesson
        >>> batch = Batch(lesson.spring(), 3, dt=0.01, integrator="semi-implicit")
        >>> [linear.A.shape for linear in batch.linearize()]
        [(2, 2), (2, 2), (2, 2)]
        """
        return linearizations(self, parameters)

    def vjp(
        self: Any,
        ctrl: ArrayLike,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
        act: ArrayLike | None = None,
        parameters: Sequence[str] = (),
    ) -> Gradients:
        """Step with given controls, and return the gradient of a sum of the states, backward.

        ctrl: shape (n, steps, nu), as in `rollout`.
        qpos, qvel, act: the gradient of a number by the states after each step, shapes
            (n, steps, nq), …; None for zero.
        parameters: paths as in `Sim.linearize`.

        Each step is differentiated exactly where it began, its rows solved to rounding; see
        `Sim.linearize`. Kept are the states alone. Worlds share the batch's threads, and the batch
        ends where the rollout ends. Warns (`GradientWarning`) where a gradient grows without bound.

        >>> import numpy as np
        >>> from stepcore import Batch, lesson
        >>> batch = Batch(lesson.spring(), 1, dt=0.01, integrator="semi-implicit")
        >>> batch.reset("start")
        >>> ends = np.zeros((1, 50, 1))
        >>> ends[0, -1] = 1.0
        >>> found = batch.vjp(np.zeros((1, 50, 0)), ends, parameters=["joint/spring/stiffness"])
        >>> list(found.parameters), found.qvel.shape
        (['joint/spring/stiffness'], (1, 1))
        """
        return vjp(self, ctrl, {"qpos": qpos, "qvel": qvel, "act": act}, parameters)

    def jvp(
        self: Any,
        ctrl: ArrayLike,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
        act: ArrayLike | None = None,
        ctrl_change: ArrayLike | None = None,
        parameters: Mapping[str, ArrayLike] = MappingProxyType({}),
    ) -> tuple[Rollout, Rollout]:
        """Step with given controls; return the states, and how they change with their causes.

        ctrl: shape (n, steps, nu), as in `rollout`.
        qpos, qvel, act: changes of the initial state, shapes (n, nq), (n, nv), (n, na).
        ctrl_change: changes of the controls, shape (n, steps, nu).
        parameters: changes of parameters by label, numbers or of shape (n,); see `vjp`.
        """
        given = {"qpos": qpos, "qvel": qvel, "act": act}
        return jvp(self, ctrl, given, ctrl_change, parameters)
