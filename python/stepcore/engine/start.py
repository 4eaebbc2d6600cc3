"""`Start`: an initial state of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore.engine.world import World


@dataclass(frozen=True)
class Start:
    """One initial state.

    qpos: shape (nq,). qvel: shape (nv,). act: shape (na,), None for zeros.
    mocap: positions [m] and quaternions of the mocap bodies, (nmocap, 3) and (nmocap, 4); None for
        the poses in the scene.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray | None = None
    mocap: tuple[np.ndarray, np.ndarray] | None = None

    def put(self, sim: World, world: Any = ...) -> None:
        """Set a Sim, or a world of a Batch, to this state; time and controls do not change."""
        self.write(sim._arrays, world)

    def write(self, arrays: Mapping[str, np.ndarray], world: Any) -> None:
        """Write this state into the arrays of a world."""
        arrays["qpos"][world], arrays["qvel"][world] = self.qpos, self.qvel
        arrays["act"][world] = 0.0 if self.act is None else self.act
        if self.mocap is not None:
            arrays["mocap_pos"][world], arrays["mocap_quat"][world] = self.mocap
