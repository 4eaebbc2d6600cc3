"""Derivatives of rollouts of many worlds, forward and backward, from the exact one of each step."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.arrays import INPUTS, STATE, Floats, numbers
from stepcore.engine.linearization import Linearization
from stepcore.engine.parameter_columns import columns, split_entry
from stepcore.engine.rollout import Rollout
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.world import World

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch
    from stepcore.engine.model import Model

Part = TypeVar("Part")
# A gradient that grows more than this on its way back says nothing beyond the next step or two.
GROWTH = 1e6


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


class Tangents:
    """Maps between changes of qpos and those of the dofs, where these differ: quaternions."""

    def __init__(self, model: Model) -> None:
        self.nv = model.nv
        pairs: list[tuple[int, int]] = []
        self.quats: list[tuple[int, int]] = []
        for joint, kind in enumerate(model.jnt_type):
            q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            if kind in ("slide", "hinge"):
                pairs.append((q, v))
            elif kind == "free":
                pairs += [(q + k, v + k) for k in range(3)]
            if kind in ("ball", "free"):
                shift = 3 * (kind == "free")
                self.quats.append((q + shift, v + shift))
        self.q, self.v = (np.array([pair[k] for pair in pairs], int) for k in (0, 1))

    def _turns(self, qpos: Floats, q: int, inverse: bool) -> Floats:
        """The change of a quaternion by a turn about each body axis, (…, 3, 4).

        inverse: its pseudo-inverse, transposed. The rows are at right angles, each |q|/2 long.
        """
        quat = qpos[..., q : q + 4]
        w, x, y, z = np.moveaxis(quat, -1, 0)
        rows = [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]
        turns: Floats = np.moveaxis(np.array(rows), (0, 1), (-2, -1)) / 2
        return turns * (4 / (quat**2).sum(-1))[..., None, None] if inverse else turns

    def of_dofs(self, qpos: Floats, change: Floats, inverse: bool = False) -> Floats:
        """A change of dofs as one of qpos; (…, nv) to (…, nq)."""
        out = np.zeros(qpos.shape)
        out[..., self.q] = change[..., self.v]
        for q, v in self.quats:
            turns = self._turns(qpos, q, inverse)
            out[..., q : q + 4] = np.einsum("...a,...ak->...k", change[..., v : v + 3], turns)
        return out

    def moved(self, qpos: Floats, change: Floats) -> Floats:
        """A qpos moved by a change of dofs, to first order; quaternions keep their length."""
        out: Floats = qpos + self.of_dofs(qpos, change)
        for q, _ in self.quats:
            before, after = qpos[..., q : q + 4], out[..., q : q + 4]
            after *= np.sqrt((before**2).sum(-1, keepdims=True) / (after**2).sum(-1, keepdims=True))
        return out

    def gradient(self, qpos: Floats, change: Floats) -> Floats:
        """A gradient by the dofs as one by qpos, of which quaternions are made unit."""
        return self.of_dofs(qpos, change, inverse=True)

    def to_dofs(self, qpos: Floats, gradient: Floats, inverse: bool = False) -> Floats:
        """A gradient by qpos as one by the dofs; (…, nq) to (…, nv)."""
        out = np.zeros((*qpos.shape[:-1], self.nv))
        out[..., self.v] = gradient[..., self.q]
        for q, v in self.quats:
            turns = self._turns(qpos, q, inverse)
            part = np.einsum("...k,...ak->...a", gradient[..., q : q + 4], turns)
            out[..., v : v + 3] = part
        return out

    def changed(self, qpos: Floats, change: Floats) -> Floats:
        """A change of qpos as one of the dofs; (…, nq) to (…, nv)."""
        return self.to_dofs(qpos, change, inverse=True)


def _check_late(batch: Batch) -> None:
    if batch._arrays["ctrl_history"].size:
        raise ValueError("ctrl: gradients of scenes with late controls are not built yet")


def _each(batch: Batch, job: Callable[[Part], Any], parts: Sequence[Part]) -> list[Any]:
    """Do a job for every part, on the batch's threads; one alone is this thread."""
    threads = min(batch._threads, len(parts))
    if threads == 1:
        return [job(part) for part in parts]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(job, parts))


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
        self.batch, self.parameters = batch, parameters
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

    def linear(self, sim: Sim, world: int, step: int) -> Linearization:
        """Linearise a step."""
        self.put(sim, world, step)
        return sim.linearize(self.parameters)

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


def linearizations(batch: Batch, parameters: Sequence[str]) -> list[Linearization]:
    """See `Batch.linearize`."""
    _check_late(batch)
    columns(batch.model, parameters)
    arrays = {name: np.array(getattr(batch, name)) for name in (*STATE, *INPUTS)}
    arrays = {name: rows for name, rows in arrays.items() if rows.size}

    def share(worlds: range) -> list[Linearization]:
        # A Sim costs as much as its linearisation; worlds of one model share it.
        made, last = list[Linearization](), None
        for world in worlds:
            model = batch._model_of(world)
            if model is not last:
                last, sim = model, unwatched(Sim(model))
            _put(sim, arrays, world)
            made.append(sim.linearize(parameters))
        return made

    n, threads = len(batch), batch._threads
    shares = [range(k * n // threads, (k + 1) * n // threads) for k in range(threads)]
    return [linear for made in _each(batch, share, shares) for linear in made]


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

    def back(world: int) -> tuple[Floats, Floats, Floats, Floats, Floats, list[Any]]:
        sim, adjoint = steps.sim(world), np.zeros(weights.shape[-1])
        by_ctrl, by_values = np.zeros((count, model.nu)), np.zeros(len(steps.labels))
        sizes, factors, sided = np.zeros(count), np.ones(count), []
        for step in range(count - 1, -1, -1):
            adjoint = adjoint + weights[world, step]
            before = np.linalg.norm(adjoint)
            linear = steps.linear(sim, world, step)
            sided += [(world, step, name) for name in linear.degenerate]
            by_ctrl[step] = linear.B.T @ adjoint
            by_values += linear.P.T @ adjoint
            adjoint = linear.A.T @ adjoint
            sizes[step] = np.linalg.norm(adjoint)
            factors[step] = sizes[step] / before if before > 0 else 1.0
        return adjoint, by_ctrl, by_values, sizes, factors, sided

    made = _each(steps.batch, back, range(steps.n))
    first, by_ctrl, values, sizes, factors = (
        np.array([one[k] for one in made]).reshape(steps.n, *shape)
        for k, shape in enumerate(((-1,), (count, -1), (-1,), (count,), (count,)))
    )
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
        [entry for one in made for entry in one[5][::-1]],
    )


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

    def along(world: int) -> Floats:
        sim, x = steps.sim(world), first[world]
        out = np.zeros((steps.count, len(x)))
        for step in range(steps.count):
            linear = steps.linear(sim, world, step)
            x = linear.A @ x + linear.B @ moved[world, step]
            if steps.labels:
                x = x + linear.P @ values[:, world]
            out[step] = x
        return out

    rows = np.array(_each(batch, along, range(steps.n))).reshape(steps.n, steps.count, -1)
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
