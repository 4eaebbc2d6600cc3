"""Ends a run that explodes, before its last steps cost more than all those before them.

Bodies that are thrown far beyond the scene all overlap in the rounding of their positions: each of
the few steps that are left until the numbers overflow then solves thousands of contacts, and so
does the search for what caused it. What moves so far in a single step has failed already.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates
from stepcore.scene.assets import half_size
from stepcore.scene.scene import Scene

# So many times the scene's size, or radians, are not moved in a step that follows any motion.
MOST = 1e4
# With fewer pairs of geoms no step is dear, and looking after each would be.
PAIRS = 200


class Exploded(SimulationError):
    """A run that was ended because it explodes."""


class Explosion:
    """Looks after each step whether a motion explodes. watches: whether the model is worth it."""

    def __init__(self, model: Model, coordinates: Coordinates) -> None:
        self.watches = model.npair >= PAIRS
        self.model, self.joints = model, coordinates.joints
        size = build(model.scene) or 1.0
        self.reach = coordinates.scaled(np.full(model.nv, MOST), size, 1.0)

    def beyond(self, qvel: np.ndarray, dt: float) -> np.ndarray:
        """Where worlds move further in a step of dt [s] than any motion does, by dof."""
        # NaN compares as False: it is the engine's to tell.
        found: np.ndarray = np.abs(qvel) * dt > self.reach
        return found

    def reason(self, qvel: np.ndarray, dt: float, time: float) -> str | None:
        """Why a world explodes, None where it does not; qvel: its own, time: now [s]."""
        over = np.flatnonzero(self.beyond(qvel, dt))
        if not len(over):
            return None
        dof, step = int(over[0]), float(np.abs(qvel[over[0]])) * dt
        k = max(k for k, (_, _, first, _) in enumerate(self.joints) if first <= dof)
        kind, _, first, _ = self.joints[k]
        slides = dof < first + {"free": 3, "slide": 1}.get(kind, 0)
        much = f"{step:.0e} {'m' if slides else 'rad'}"
        joint = self.model.element_name("joint", k)
        return f"exploded at time {time:.6f} s: {joint} moves {much} in a step"

    def guarded(self, sim: Sim) -> Callable[[int], None]:
        """`sim.step` that raises Exploded after the step in which the motion explodes."""

        def step(count: int) -> None:
            dt = sim.settings.dt
            for _ in range(count):
                sim.step(1)
                text = self.reason(sim.qvel, dt, sim.time)
                if text is not None:
                    raise Exploded(text)

        return step


def build(scene: Scene) -> float:
    """How large the scene is as it is built [m]: its longest arm and its largest geom."""
    long = max((float(np.linalg.norm(body.pos)) for body in scene.bodies), default=0.0)
    return long + max((half_size(geom) for geom in scene.geoms), default=0.0)
