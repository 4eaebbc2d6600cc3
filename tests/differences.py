"""The linearised step by central differences of the real one: the oracle of `Sim.linearize`."""

from __future__ import annotations

import numpy as np

import stepcore as sc
from stepcore.trade.dofs import Dofs


def central(sim: sc.Sim, size: float = 1e-6) -> np.ndarray:
    """A of x = [dq, dv], shape (2 nv, 2 nv), at the state of `sim`, which does not move."""
    model = sc.Model(sim._model.scene, sim.settings)
    dofs, n = Dofs(model.scene), model.nv
    qpos, qvel = np.array(sim.qpos), np.array(sim.qvel)

    def after(dq: np.ndarray, dv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        other = sc.Sim(model)
        other.qpos[:], other.qvel[:] = dofs.moved(qpos, dq), qvel + dv
        other.ctrl[:] = sim.ctrl
        other.step()
        return np.array(other.qpos), np.array(other.qvel)

    still = np.zeros(n)
    base = after(still, still)
    columns = []
    for k in range(2 * n):
        change = np.zeros(2 * n)
        change[k] = size
        ends = []
        for sign in (1, -1):
            moved = after(sign * change[:n], sign * change[n:])
            ends.append(np.concatenate([dofs.change(base[0], moved[0]), moved[1] - base[1]]))
        columns.append((ends[0] - ends[1]) / (2 * size))
    return np.array(columns).T
