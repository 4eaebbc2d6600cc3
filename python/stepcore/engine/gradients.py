"""Derivatives of rollouts of many worlds, forward and backward, from the exact one of each step."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.arrays import Floats, numbers
from stepcore.engine.linearization import Linearization
from stepcore.engine.parameter_columns import columns, split_entry
from stepcore.engine.rollout import Rollout
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.world import World

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch
    from stepcore.engine.model import Model

STATE = ("qpos", "qvel", "act")
HELD = ("qfrc_applied", "xfrc_applied", "eq_active", "mocap_pos", "mocap_quat")
# A gradient that grows more than this on its way back says nothing beyond the next step or two.
GROWTH = 1e6


class GradientWarning(UserWarning):
    """A gradient grows without bound over a rollout; the text names the world, step and contact."""


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

    def _turns(self, qpos: Floats, q: int) -> Floats:
        """The change of a quaternion by a turn about each body axis, over a half, (…, 3, 4)."""
        w, x, y, z = np.moveaxis(qpos[..., q : q + 4], -1, 0)
        rows = [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]
        turns: Floats = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
        return turns

    def of_dofs(self, qpos: Floats, change: Floats) -> Floats:
        """A change of dofs, or a gradient by them, as one of qpos; (…, nv) to (…, nq)."""
        out = np.zeros(qpos.shape)
        out[..., self.q] = change[..., self.v]
        for q, v in self.quats:
            turns = self._turns(qpos, q) / 2
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
        out = self.of_dofs(qpos, change)
        for q, _ in self.quats:
            square = (qpos[..., q : q + 4] ** 2).sum(-1, keepdims=True)
            out[..., q : q + 4] *= 4 / square
        return out

    def to_dofs(self, qpos: Floats, gradient: Floats) -> Floats:
        """A gradient by qpos as one by the dofs; (…, nq) to (…, nv)."""
        out = np.zeros((*qpos.shape[:-1], self.nv))
        out[..., self.v] = gradient[..., self.q]
        for q, v in self.quats:
            turns = self._turns(qpos, q) / 2
            part = np.einsum("...k,...ak->...a", gradient[..., q : q + 4], turns)
            out[..., v : v + 3] = part
        return out

    def changed(self, qpos: Floats, change: Floats) -> Floats:
        """A change of qpos as one of the dofs; (…, nq) to (…, nv)."""
        out = self.to_dofs(qpos, change)
        for q, v in self.quats:
            square = (qpos[..., q : q + 4] ** 2).sum(-1, keepdims=True)
            out[..., v : v + 3] *= 4 / square
        return out


class Steps:
    """The steps of a rollout of a batch, each to be linearised where it began."""

    def __init__(self, batch: Batch, ctrl: ArrayLike, parameters: Sequence[str]) -> None:
        if batch._arrays["ctrl_history"].size:
            raise ValueError("ctrl: gradients of scenes with late controls are not built yet")
        self.labels = [column.label for column in columns(batch.model, parameters)]
        self.batch, self.parameters = batch, parameters
        self.held = {name: np.array(getattr(batch, name)) for name in HELD}
        self.start = {name: np.array(getattr(batch, name)) for name in STATE}
        self.ctrl = np.array(numbers("ctrl", ctrl))
        self.models = [batch._model_of(world) for world in range(len(batch))]
        self.rollout = batch.rollout(self.ctrl)
        self.n, self.count = self.ctrl.shape[:2]
        self.tangents = Tangents(batch.model)

    def sim(self, world: int) -> Sim:
        """A Sim of a world, with the inputs that do not change."""
        sim = unwatched(Sim(self.models[world]))
        for name, rows in self.held.items():
            getattr(sim, name)[...] = rows[world]
        return sim

    def before(self, world: int) -> dict[str, Floats]:
        """The states where the steps of a world begin, each of shape (steps, …)."""
        return {
            name: np.concatenate([rows[world][None], getattr(self.rollout, name)[world, :-1]])
            for name, rows in self.start.items()
        }

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

    def each(self, job: Callable[[int], Any]) -> list[Any]:
        """Do a job for every world, on the batch's threads."""
        with ThreadPoolExecutor(min(self.batch._threads, self.n)) as pool:
            return list(pool.map(job, range(self.n)))

    def dofs(self, given: Mapping[str, ArrayLike | None]) -> Floats:
        """The gradients by the states after each step as those of x, (n, steps, 2 nv + na)."""
        parts = []
        for name, value in given.items():
            own = getattr(self.rollout, name)
            array = np.zeros(own.shape) if value is None else numbers(name, value)
            if array.shape != own.shape:
                raise ValueError(f"{name} has shape {array.shape}: must be {own.shape}")
            parts.append(self.tangents.to_dofs(own, array) if name == "qpos" else array)
        return np.concatenate(parts, axis=-1)


def vjp(
    batch: Batch,
    ctrl: ArrayLike,
    given: Mapping[str, ArrayLike | None],
    parameters: Sequence[str],
) -> Gradients:
    """See `Batch.vjp`."""
    steps = Steps(batch, ctrl, parameters)
    return pulled(steps, given)


def pulled(steps: Steps, given: Mapping[str, ArrayLike | None]) -> Gradients:
    """Return the gradient of the rollout that was made."""
    weights, parameters = steps.dofs(given), steps.parameters
    model, count = steps.models[0], steps.count
    split = (model.nv, 2 * model.nv)

    def back(world: int) -> tuple[Floats, Floats, Floats, tuple[str, ...], Floats, list[Any]]:
        sim, adjoint = steps.sim(world), np.zeros(weights.shape[-1])
        by_ctrl, by_values = np.zeros((count, model.nu)), np.zeros(0)
        labels: tuple[str, ...] = ()
        sizes, sided = np.zeros(count + 1), []
        for step in range(count - 1, -1, -1):
            adjoint = adjoint + weights[world, step]
            sizes[step + 1] = np.linalg.norm(adjoint)
            linear = steps.linear(sim, world, step)
            sided += [(world, step, name) for name in linear.degenerate]
            by_ctrl[step], labels = linear.B.T @ adjoint, linear.parameters
            by_values = (by_values if len(by_values) else 0.0) + linear.P.T @ adjoint
            adjoint = linear.A.T @ adjoint
        sizes[0] = np.linalg.norm(adjoint)
        return adjoint, by_ctrl, by_values, labels, sizes, sided

    made = steps.each(back)
    first = np.array([one[0] for one in made]).reshape(steps.n, -1)
    growth = np.array([_growth(one[4], weights[world]) for world, one in enumerate(made)])
    for world in np.flatnonzero(growth > GROWTH)[:1]:
        warnings.warn(GradientWarning(_grown(steps, int(world), made[world][4])), stacklevel=3)
    labels = made[0][3] or tuple(column.label for column in columns(model, parameters))
    values = np.array([one[2] if len(one[2]) else np.zeros(len(labels)) for one in made])
    return Gradients(
        steps.rollout,
        steps.tangents.gradient(steps.start["qpos"], first[:, : split[0]]),
        first[:, split[0] : split[1]],
        first[:, split[1] :],
        np.array([one[1] for one in made]),
        {label: values[:, k] for k, label in enumerate(labels)},
        growth,
        [entry for one in made for entry in one[5][::-1]],
    )


def _growth(sizes: Floats, weights: Floats) -> float:
    asked = float(np.linalg.norm(weights, axis=-1).sum())
    return float(sizes.max() / asked) if asked > 0 else 0.0


def _grown(steps: Steps, world: int, sizes: Floats) -> str:
    """Say at which step the gradient of a world grew most, and what touches there."""
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.nan_to_num(sizes[:-1] / sizes[1:], posinf=0.0)
    step, sim = int(factors.argmax()), steps.sim(world)
    steps.put(sim, world, step)
    sim.step()
    pairs = [f"{c['name1']} and {c['name2']}" for c in sim.contacts]
    what = f", with contacts of {checks.cut(', '.join(pairs), 120)}" if pairs else ""
    return (
        f"the gradient of world {world} grows {sizes.max() / sizes[-1]:.0e} times over "
        f"{steps.count} steps, most in step {step} ({factors[step]:.0e} times{what}): beyond it, "
        "the gradient says nothing about changes that are not as small; a shorter rollout does"
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
        labels, changed = [], dict[str, Floats]()
        for name, value in zip(parameters, values, strict=True):
            path, entry = split_entry(name)
            rows = changed.get(path, np.array(batch.param[path]))
            if np.shape(value) != (len(batch),):
                limit = f"of shape ({len(batch)},), a value for each world"
                raise ValueError(f"parameters: {name} has shape {np.shape(value)}: must be {limit}")
            if rows.ndim > 1:
                rows[:, entry or 0] = value
                labels.append(f"{path}[{entry or 0}]")
            else:
                rows[:] = value
                labels.append(path)
            changed[path] = rows
        if changed:
            batch.param.update(changed)
        batch.qpos, batch.qvel = qpos, qvel
        batch._core.forget(list(range(len(batch))))
        self.labels = labels
        self.steps = Steps(batch, ctrl, labels)
        self.rollout = self.steps.rollout

    def gradient(self, qpos: Floats, qvel: Floats) -> tuple[Floats, ...]:
        """Return the gradient by qpos, qvel, ctrl and each parameter, of one by the states."""
        found = pulled(self.steps, {"qpos": qpos, "qvel": qvel, "act": None})
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
    model, count = batch.model, steps.count
    parts = []
    for name, value in given.items():
        own = steps.start[name]
        array = np.zeros(own.shape) if value is None else numbers(name, value)
        if array.shape != own.shape:
            raise ValueError(f"{name} has shape {array.shape}: must be {own.shape}")
        parts.append(steps.tangents.changed(own, array) if name == "qpos" else array)
    first = np.concatenate(parts, axis=-1)
    moved = np.zeros(steps.ctrl.shape) if ctrl_change is None else numbers("ctrl", ctrl_change)
    if moved.shape != steps.ctrl.shape:
        raise ValueError(f"ctrl_change has shape {moved.shape}: must be {steps.ctrl.shape}")
    labels = [column.label for column in columns(model, tuple(parameters))]
    missing = [label for label in labels if label not in parameters]
    if missing:
        raise ValueError(f"parameters: {missing[0]} must be given by its own label")
    values = np.array([np.broadcast_to(parameters[label], steps.n) for label in labels])

    def along(world: int) -> Floats:
        sim, x = steps.sim(world), first[world]
        out = np.zeros((count, len(x)))
        for step in range(count):
            linear = steps.linear(sim, world, step)
            x = linear.A @ x + linear.B @ moved[world, step]
            if labels:
                x = x + linear.P @ values[:, world]
            out[step] = x
        return out

    rows = np.array(steps.each(along)).reshape(steps.n, count, -1)
    nv = model.nv
    qpos = steps.tangents.of_dofs(steps.rollout.qpos, rows[..., :nv])
    return steps.rollout, Rollout(qpos, rows[..., nv : 2 * nv], rows[..., 2 * nv :])


class Differentiable(World):
    """Worlds whose rollouts have derivatives."""

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
