"""`Start`: an initial state of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore.engine.world import World


@dataclass(frozen=True)
class Start:
    """One initial state.

    qpos: shape (nq,). qvel: shape (nv,). act: shape (na,), None for zeros.
    mocap: positions [m] and quaternions of the mocap bodies, (nmocap, 3) and (nmocap, 4); None for
        those of the scene.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray | None = None
    mocap: tuple[np.ndarray, np.ndarray] | None = None

    def put(self, sim: World, world: Any = ...) -> None:
        """Set a Sim, or a world of a Batch, to this state; time and controls do not change."""
        sim.qpos[world], sim.qvel[world] = self.qpos, self.qvel
        sim.act[world] = 0.0 if self.act is None else self.act
        if self.mocap is not None:
            sim.mocap_pos[world], sim.mocap_quat[world] = self.mocap
