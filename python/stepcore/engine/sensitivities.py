"""Derivatives of the states of a rollout by parameters, controls and the initial state, forward."""

from __future__ import annotations

import numpy as np

from stepcore.engine.arrays import STATE, Floats
from stepcore.engine.gradients import Steps
from stepcore.engine.parameter_columns import columns
from stepcore.engine.parameter_slopes import Worlds, after_step


def sensitivities(steps: Steps, world: int = 0, changes: Floats | None = None) -> Floats:
    """Return the derivatives of a world's states by numbers, then by its first x.

    changes: of the controls by further numbers, shape (steps, nu, further).

    Shape (steps + 1, 2 nv + na, parameters + further + 2 nv + na); the first row is the initial
    state.
    """
    model, share = steps.models[world], steps.share([world])
    size, by = 2 * model.nv + model.na, parameter_slopes(steps, world)
    pushes = np.zeros((steps.count, model.nu, 0)) if changes is None else changes
    count = by.shape[2] + pushes.shape[2]
    slopes = np.concatenate([np.zeros((size, count)), np.eye(size)], axis=1)
    out = [slopes]
    for block in steps.blocks():
        linear = share.linear(block, ())
        for step, A, B in zip(block, linear.A[0], linear.B[0], strict=True):
            slopes = A @ slopes
            slopes[:, :count] += np.concatenate([by[step], B @ pushes[step]], axis=1)
            out.append(slopes)
    return np.array(out)


def parameter_slopes(steps: Steps, world: int) -> Floats:
    """Return the derivatives of a world's steps by the parameters, (steps, 2 nv + na, parameters).

    Each is P of `Sim.linearize`: by differences in a batch where these are as good.
    """
    model, share = steps.models[world], steps.share([world])
    out = np.zeros((steps.count, 2 * model.nv + model.na, len(steps.labels)))
    if not steps.labels or not steps.count:
        return out
    # It refuses what steps do not read as a number.
    share.linear([0])
    states = {name: steps.states(world, name)[:-1] for name in STATE}
    states["ctrl"] = steps.ctrl[world]
    states |= {
        name: np.repeat(rows[world][None], steps.count, 0) for name, rows in steps.held.items()
    }
    after, split = steps.rollout.qpos[world], (model.nq, model.nq + model.nv)
    doubtful = np.ones(steps.count, bool)
    # Another solver's rows are those of another problem, or not solved to rounding.
    if model.settings.solver == "newton":
        worlds = Worlds.solved(model, after_step, columns(model, steps.labels))
        slopes, doubtful = worlds.slopes(states)
        ways = np.moveaxis(slopes[:, : split[0]], -1, 0)
        change = [steps.tangents.changed(after, way) for way in ways]
        out = np.concatenate([np.stack(change, axis=-1), slopes[:, split[0] :]], axis=1)
    left = np.flatnonzero(doubtful)
    if len(left):
        out[left] = share.linear(left).P[0]
    return out
