"""Derivatives of rollouts of many worlds, forward and backward, from the exact one of each step."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.adjoints import Adjoints, adjoints, apart, grown, parted, spread
from stepcore.engine.arrays import INPUTS, STATE, Floats, numbers, refuse_late
from stepcore.engine.linearization import Linearizations
from stepcore.engine.parameter_columns import columns, split_entry
from stepcore.engine.rollout import Rollout
from stepcore.engine.rollout_steps import Steps, X, linear_worlds, rows_of
from stepcore.engine.world import World

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch

# A gradient that grows more than this on its way back says nothing beyond the next step or two.
GROWTH = 1e6
# One that is another by this share of itself in steps half as long says nothing either.
APART = 0.5


class GradientWarning(UserWarning):
    """A gradient says nothing over a rollout; the text names the world, the time and the impact.

    It grows without bound or, as its error bar tells, is another one in shorter steps.
    """


class Gradients(NamedTuple):
    """What `Batch.vjp` returns: the rollout, and the gradient of each world.

    rollout: the states after each step.
    qpos, qvel, act: by the initial state, shapes (n, nq), (n, nv), (n, na). That of a quaternion
        keeps its length.
    ctrl: by the controls, shape (n, steps, nu).
    parameters: by each parameter, by its label, shape (n,).
    growth: how much the gradient grew on its way back at most, shape (n,).
    one_sided: (world, step, element) where a row is exactly at its switch.
    error: with `error_bar`, how far it is from that in steps half as long, as a share of it, shape
        (n,), infinite where these fail; else None.
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


def linearizations(batch: Batch, parameters: Sequence[str]) -> Linearizations:
    """See `Batch.linearize`."""
    by = columns(batch.model, parameters)
    states = {name: np.array(getattr(batch, name))[:, None] for name in (*X, *INPUTS)}
    return Linearizations(batch.model, linear_worlds(batch).linear(states, by), by)


def vjp(
    batch: Batch,
    ctrl: ArrayLike,
    given: Mapping[str, ArrayLike | None],
    parameters: Sequence[str],
    error_bar: bool = False,
) -> Gradients:
    """See `Batch.vjp`."""
    checks.one_of(True, False)("vjp", "error_bar", error_bar)
    steps = Steps(batch, ctrl, parameters)
    weights = rows_of(given, steps.sizes(steps.count))
    if error_bar:
        refuse_late("error_bar", batch)
    steps.roll()
    return pulled(steps, weights, steps.halved() if error_bar else None)


def pulled(steps: Steps, given: Mapping[str, Floats], halved: Steps | None = None) -> Gradients:
    """Return the gradient of the rollout that was made.

    halved: the same rollout in steps half as long, for the error.
    """
    weights, nv = steps.dofs(given), steps.batch.model.nv
    back = adjoints(steps, weights)
    asked = np.linalg.norm(weights, axis=-1).sum(axis=1)
    growth = back.sizes.max(axis=1, initial=0.0) / np.where(asked > 0, asked, np.inf)
    texts = [
        grown(steps, int(world), float(growth[world]), int(back.factors[world].argmax()))
        for world in np.flatnonzero(growth > GROWTH)[:1]
    ]
    error = None
    if halved is not None:
        finer = adjoints(halved, halved.dofs({name: spread(rows) for name, rows in given.items()}))
        error, doubts = _error(steps, back, halved, finer, asked, told=growth > GROWTH)
        texts += doubts
    for text in texts:
        # In the name of who calls `Batch.vjp`.
        warnings.warn(GradientWarning(text), stacklevel=4)
    first = back.rows[:, 0]
    return Gradients(
        steps.rollout,
        steps.tangents.gradient(steps.start["qpos"], first[:, :nv]),
        first[:, nv : 2 * nv],
        first[:, 2 * nv : 2 * nv + steps.batch.model.na],
        back.ctrl,
        {label: back.values[:, k] for k, label in enumerate(steps.labels)},
        growth,
        back.sided,
        error,
    )


def _error(
    steps: Steps,
    back: Adjoints,
    halved: Steps,
    finer: Adjoints,
    asked: Floats,
    told: NDArray[np.bool_],
) -> tuple[Floats, list[str]]:
    """How far a gradient is from that in steps half as long, and what is to be said of it.

    told: worlds of whose gradient more was said.
    """
    parts = apart(back, finer, steps, asked)
    error: Floats = np.max(list(parts.values()), axis=0)
    failed = halved.batch.failures
    texts = [
        f"the gradient of world {world} has no error bar, as in steps half as long the rollout "
        f"{checks.one_line(failed[world])}"
        for world in list(failed)[:1]
    ]
    error[list(failed)] = np.inf
    for world in np.flatnonzero(np.isfinite(error) & (error > APART) & ~told)[:1]:
        of = max(parts, key=lambda part: parts[part][world])
        texts.append(parted(steps, int(world), of, float(error[world]), back, finer))
    return error, texts


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
        labels, changed = list[str](), dict[str, Floats]()
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
        state = rows_of({"qpos": qpos, "qvel": qvel}, sizes)
        if changed:
            batch.param.update(changed)
        batch.qpos, batch.qvel = state["qpos"], state["qvel"]
        batch._core.forget(list(range(len(batch))))
        self.rollout = self.steps.roll().rollout

    def gradient(self, qpos: Floats, qvel: Floats) -> tuple[Floats, ...]:
        """Return the gradient by qpos, qvel, ctrl and each parameter, of one by the states."""
        sizes = self.steps.sizes(self.steps.count)
        found = pulled(self.steps, rows_of({"qpos": qpos, "qvel": qvel, "act": None}, sizes))
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
    changes = rows_of(
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
    first = steps.x([changes[name] for name in STATE])

    rows = np.zeros((steps.n, steps.count, first.shape[1]))
    for share in steps.shares():
        own = share.own
        x = first[own]
        for block in steps.blocks():
            A, B, P, _ = share.linear(block)
            by = (
                B @ moved[own, block[0] : block[-1] + 1, :, None] + P @ values.T[own, None, :, None]
            )
            for k, step in enumerate(block):
                x = (A[:, k] @ x[..., None] + by[:, k])[..., 0]
                rows[own, step] = x
    nv = batch.model.nv
    qpos = steps.tangents.of_dofs(steps.rollout.qpos, rows[..., :nv])
    dv, dw = rows[..., nv : 2 * nv], rows[..., 2 * nv : 2 * nv + batch.model.na]
    return steps.rollout, Rollout(qpos, dv, dw)


class Differentiable(World):
    """Worlds whose steps and rollouts have derivatives."""

    def linearize(self: Any, parameters: Sequence[str] = ()) -> Linearizations:
        """Linearise the next step of every world about its state, without taking the step.

        parameters: paths as in `Sim.linearize`, whose errors it raises.

        Worlds share the batch's threads. The states of a trajectory, one to a world, are linearised
        in one call. The solver starts from no impulses, as after a reset; one that converges
        forgets its start.

        >>> from stepcore import Batch, lesson
        >>> batch = Batch(lesson.spring(), 3, dt=0.01, integrator="semi-implicit")
        >>> batch.linearize().A.shape
        (3, 2, 2)
        """
        return linearizations(self, parameters)

    def vjp(
        self: Any,
        ctrl: ArrayLike,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
        act: ArrayLike | None = None,
        parameters: Sequence[str] = (),
        error_bar: bool = False,
    ) -> Gradients:
        """Step with given controls, and return the gradient of a sum of the states, backward.

        ctrl: shape (n, steps, nu), as in `rollout`.
        qpos, qvel, act: the gradient of a number by the states after each step, shapes
            (n, steps, nq), …; None for zero.
        parameters: paths as in `Sim.linearize`.
        error_bar: take the same gradient in steps half as long as well, which costs twice as much
            again: `error` is how far apart both are. Not of a scene with late controls.

        Each step is differentiated exactly where it began, its rows solved to rounding; see
        `Sim.linearize`. Kept are the states and the gradient by each. Worlds share the batch's
        threads, and the batch ends where the rollout ends. Warns (`GradientWarning`) where a
        gradient grows without bound, and where its error is more than half of it.

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
        given = {"qpos": qpos, "qvel": qvel, "act": act}
        return vjp(self, ctrl, given, parameters, error_bar)

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
