"""The gyroscopic torques of spinning bodies, −ω × I ω, as forces on the dofs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim


def spinning_bodies(model: Model) -> list[int]:
    """The bodies whose spin makes a torque; one with isotropic inertia turns freely."""
    return [b for b in range(1, model.nbody) if not _isotropic(model.body_inertia[b])]


@dataclass(frozen=True)
class Spins:
    """Spinning bodies at a state, in world axes.

    turning: how they turn with qvel, shape (n, 3, nv). inertia [kg·m²]: shape (n, 3, 3). spin:
    their angular velocity ω [rad/s], shape (n, 3).
    """

    turning: Floats
    inertia: Floats
    spin: Floats

    @property
    def force(self) -> Floats:
        """Their generalised forces [N or N·m], shape (n, nv)."""
        moment = np.einsum("bij,bj->bi", self.inertia, self.spin)
        return np.einsum("bi,bin->bn", np.cross(moment, self.spin), self.turning)

    @property
    def damping(self) -> Floats:
        """Minus the derivatives of the forces by qvel, shape (n, nv, nv)."""
        moment = np.einsum("bij,bj->bi", self.inertia, self.spin)
        one = np.eye(3)
        # Column by column: ω × I e − (I ω) × e.
        across = np.cross(self.spin[:, None], self.inertia.transpose(0, 2, 1))
        across -= np.cross(moment[:, None], one[None])
        return self.turning.transpose(0, 2, 1) @ (across.transpose(0, 2, 1) @ self.turning)


def spins(sim: Sim, bodies: list[int]) -> Spins:
    """The spins of some bodies at the present state of a Sim."""
    sim.forward()
    n, nv = len(bodies), sim.model.nv
    turning = np.array([sim.jacobian(body)[3:] for body in bodies]).reshape(n, 3, nv)
    axes = sim.xmat[bodies].reshape(n, 3, 3)
    own = np.array([sim.model.body_inertia[body] for body in bodies]).reshape(n, 3, 3)
    return Spins(turning, axes @ own @ axes.transpose(0, 2, 1), turning @ sim.qvel)


def _isotropic(inertia: Floats) -> bool:
    size = float(np.trace(inertia)) / 3
    return bool(np.abs(inertia - size * np.eye(3)).max() <= 1e-12 * size)
