"""Rollouts of many worlds whose steps are linearised where they began; derivatives forward."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from stepcore.engine.arrays import INPUTS, STATE, Floats, numbers
from stepcore.engine.linearization import LinearSteps, LinearWorlds
from stepcore.engine.parameters import columns
from stepcore.engine.trajectory import Rollout

if TYPE_CHECKING:
    from stepcore.engine.batch import Batch
    from stepcore.engine.model import Model
    from stepcore.report.progress import Choice

# Steps of a world that are linearised together, and as many numbers of matrices as are in memory
# at once: 64 MiB.
BLOCK, ROOM = 64, 2**23

# What x is made of.
X = (*STATE, "ctrl_history")


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
            self.linear_worlds = steps.batch._linearised_worlds()
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


def sensitivities(steps: Steps, world: int = 0, changes: Floats | None = None) -> Floats:
    """Return the derivatives of a world's states by numbers, then by its first x.

    changes: of the controls by further numbers, shape (steps, nu, further).

    Shape (steps + 1, size of x, parameters + further + size of x); the first row is the initial
    state.
    """
    model, share = steps.models[world], steps.share([world])
    size, labels = steps.size, len(steps.labels)
    pushes = np.zeros((steps.count, model.nu, 0)) if changes is None else changes
    count = labels + pushes.shape[2]
    # The numbers stand below the state as what stays: each step is one product.
    slopes = np.zeros((steps.count + 1, size + count, count + size))
    slopes[0, :size, count:] = np.eye(size)
    slopes[:, size:, :count] = np.eye(count)
    for block in steps.blocks():
        A, B, P = (one[0] for one in share.linear(block)[:3])
        each = np.concatenate([A, P, B @ pushes[block]], axis=2)
        own = slopes[block[0] : block[-1] + 2]
        for step, before, after in zip(each, own, own[1:, :size], strict=False):
            np.matmul(step, before, out=after)
    return slopes[:, :size]
