"""Derivatives of the states of a rollout by parameters, controls and the initial state, forward."""

from __future__ import annotations

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.rollout_steps import Steps


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
