"""Gradients of rollouts on their way back through the steps, and what makes them say nothing."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.arrays import STATE, Floats, numbers, refuse_late
from stepcore.engine.parameters import split_entry
from stepcore.engine.rollout_steps import Steps, rows_of
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.trajectory import Rollout

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch

# A gradient that grows more than this on its way back says nothing beyond the next step or two.
GROWTH = 1e6
# One that is another by this share of itself in steps half as long says nothing either.
APART = 0.5
TINY = np.finfo(float).tiny
# Of what is asked: a share below which nothing is said of the initial state.
LEFT = 1e-6
# Steps before and after one, in which its contact is looked for.
NEAR = 50


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


class Adjoints(NamedTuple):
    """A gradient by the states, from the last to the first.

    rows: by the state where each step begins, and after the last: shape (n, steps + 1, size of x).
    after: by the state after each step, with what is asked of that itself, (n, steps, size of x).
    ctrl: by the controls, (n, steps, nu). values: by the parameters, (n, parameters).
    ctrl_terms: the sum of the sizes of what those by the controls are sums of, (n,).
    sizes: of a row, (n, steps). factors: by how much each step makes it larger.
    sided: (world, step, element) where a row is exactly at its switch.
    """

    rows: Floats
    after: Floats
    ctrl: Floats
    values: Floats
    ctrl_terms: Floats
    sizes: Floats
    factors: Floats
    sided: list[tuple[int, int, str]]


def adjoints(steps: Steps, weights: Floats) -> Adjoints:
    """Go back through a rollout.

    weights: the gradient by the state after each step, (n, steps, size of x).
    """
    model, (n, count, size) = steps.batch.model, weights.shape
    rows, after = np.zeros((n, count + 1, size)), np.array(weights)
    ctrl, ctrl_terms = np.zeros((n, count, model.nu)), np.zeros(n)
    values = np.zeros((n, len(steps.by)))
    sided = list[tuple[int, int, str]]()
    for share in steps.shares():
        own = share.own
        for block in reversed(steps.blocks()):
            A, B, P, degenerate = share.linear(block)
            sided += [
                (share.worlds[world], block[k], model.element_name(*element))
                for world, k, element in degenerate
            ]
            for k in reversed(range(len(block))):
                step = block[k]
                after[own, step] += rows[own, step + 1]
                rows[own, step] = np.matmul(after[own, step, None], A[:, k])[:, 0]
            some = slice(block[0], block[-1] + 1)
            each = after[own, some, None]
            ctrl[own, some] = np.matmul(each, B)[:, :, 0]
            ctrl_terms[own] += np.matmul(np.abs(each), np.abs(B)).sum(axis=(1, 2, 3))
            values[own] += np.matmul(each, P)[:, :, 0].sum(axis=1)
    sizes = np.linalg.norm(rows[:, :-1], axis=2)
    asked = np.linalg.norm(after, axis=2)
    factors = np.where(asked > 0, sizes / np.maximum(asked, TINY), 1.0)
    sided.sort(key=lambda one: one[:2])
    return Adjoints(rows, after, ctrl, values, ctrl_terms, sizes, factors, sided)


def spread(rows: Floats) -> Floats:
    """What is asked of each state, asked after the second of two steps; (n, steps, …)."""
    out = np.zeros((rows.shape[0], 2 * rows.shape[1], *rows.shape[2:]))
    out[:, 1::2] = rows
    return out


def apart(back: Adjoints, finer: Adjoints, steps: Steps, asked: Floats) -> dict[str, Floats]:
    """How far each part of a gradient is from that in steps half as long, as a share of it, (n,).

    Below these sizes a part is nothing: a share of what the gradient was by any state; of what the
    controls' is a sum of; for a change of a parameter by itself, of what all steps change.
    asked: the size of the gradient that was given, (n,).
    """
    most = np.maximum(asked, back.sizes.max(axis=1, initial=0.0))
    both = finer.ctrl[:, ::2] + finer.ctrl[:, 1::2]
    parts = {
        "the initial state": _distance(back.rows[:, 0], finer.rows[:, 0], LEFT * most),
        "the controls": _distance(back.ctrl, both, LEFT * back.ctrl_terms),
    }
    changes = np.sum(np.abs(back.after * steps.changes()), axis=(1, 2))
    for k, column in enumerate(steps.by):
        least = LEFT * changes / abs(column.value)
        parts[f"`{column.label}`"] = _distance(back.values[:, k], finer.values[:, k], least)
    return parts


def _distance(one: Floats, other: Floats, least: Floats | float = 0.0) -> Floats:
    """Of rows of worlds, as a share of the larger."""
    off, *sizes = (
        np.linalg.norm(rows.reshape(len(rows), -1), axis=1) for rows in (one - other, one, other)
    )
    return off / np.maximum(np.maximum(*sizes), np.maximum(least, TINY))


def grown(steps: Steps, world: int, growth: float, step: int) -> str:
    """Say that a gradient has grown, most in this step, and name the contact that began there."""
    time = steps.time + step * steps.batch.settings.dt
    return (
        f"the gradient of world {world} grows {growth:.0e} times over {steps.count} steps, most in "
        f"step {step} [{time:.4g} s]{_impact(steps, world, step)}: before it, the gradient holds "
        "only for changes that are as much smaller; begin after it, or sample instead"
    )


def parted(steps: Steps, world: int, of: str, error: float, back: Adjoints, finer: Adjoints) -> str:
    """Say where the gradient becomes another one than in steps half as long.

    of: the part that changes most.
    """
    each = _distance(back.rows[world], finer.rows[world, ::2])
    time = steps.time + np.arange(steps.count + 1) * steps.batch.settings.dt
    # Before it the gradient by the states has parted, whatever it is asked by.
    parts = np.flatnonzero(each >= min(error, 1.0) / 2)
    where = ""
    if parts.size:
        step = min(int(parts[-1]), steps.count - 1)
        where = (
            f", from step {step} [{time[step]:.4g} s] on its way back{_impact(steps, world, step)}"
        )
    return (
        f"the gradient of world {world} by {of} changes by {100 * error:.0f} % in steps half as "
        f"long{where}: take shorter steps or a softer contact, or begin after it"
    )


def _impact(steps: Steps, world: int, step: int) -> str:
    """Name the contact that pushes most near where a step begins, with the time when it began."""
    touches, dt = _Touches(steps, world), steps.batch.settings.dt
    # In steps half as long an impact of few steps may be over before, or still to come.
    near = sorted(
        range(max(0, step - NEAR), min(step + NEAR, steps.count)), key=lambda k: abs(k - step)
    )
    for k in near:
        if pairs := touches.at(k):
            break
    else:
        return ""
    pair, began = max(pairs, key=lambda names: pairs[names]), k
    while began and pair in touches.at(began - 1):
        began -= 1
    known = "contact" if began == 0 else "impact"
    names = " with ".join(f"`{checks.cut(name, 60)}`" for name in pair)
    time = steps.time + began * dt
    return f", at the {known} of {names}" + f" at {time:.4g} s" * (known == "impact")


class _Touches:
    """What touches in a world where its steps begin."""

    def __init__(self, steps: Steps, world: int) -> None:
        self.sim, self.steps, self.world = unwatched(Sim(steps.models[world])), steps, world
        for name, rows in steps.held.items():
            getattr(self.sim, name)[...] = rows[world]

    def at(self, step: int) -> dict[tuple[str, str], float]:
        """The pairs of geoms that touch there, with the force between them [N]."""
        sim, steps, world = self.sim, self.steps, self.world
        for name, rows in steps.states.items():
            getattr(sim, name)[...] = rows[world, step]
        sim.ctrl[...] = steps.ctrl[world, step]
        sim.forward()
        forces = dict[tuple[str, str], float]()
        for contact in sim.contacts:
            pair = str(contact["name1"]), str(contact["name2"])
            forces[pair] = forces.get(pair, 0.0) + float(np.linalg.norm(contact["force"]))
        return {pair: force for pair, force in forces.items() if force > 0}
