"""Returns of tasks as quantities, for `stepcore trade … --quantity examples/returns.py:NAME`."""

import numpy as np


def balance(qpos):
    """The return of gymnasium's InvertedPendulum: an action after another until the pole falls."""
    upright = np.abs(qpos[:, 1:, 1]) < 0.2
    return np.cumprod(upright, axis=1).sum(axis=1)


def effort(ctrl):
    """The mean square of the controls."""
    return np.square(ctrl[:, 1:]).mean(axis=(1, 2))
