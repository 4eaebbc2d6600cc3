"""Linearise the step of the midpoint rule without rows, from one linearised acceleration.

With h = dt/2, v_m = (v + v⁺)/2 and q_m = q ⊕ h v_m, the step is v⁺ = v + dt a(q_m, v_m),
q⁺ = q ⊕ dt v_m. Its derivative is the solution of one linear system,

    (1 − h² a_q T − h a_v) δv_m = δv + h a_q E δq,

where a_q and a_v are the derivatives of the acceleration at (q_m, v_m). A change δu of the controls
adds h a_u δu to the right-hand side. The derivative of q ⊕ h v is E δq + h T δv. E and T are 1
except for rotations, whose T is the right Jacobian of SO(3). `Sim.linearize` iterates instead, and
takes longer the nearer the step is to divergence of the iteration.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.coordinates import Coordinates

# The explicit step [s] from which the derivative of the acceleration is read; it is linear in dt.
SHORT = 1e-7


def midpoint_map(sim: Sim) -> tuple[Floats, Floats]:
    """Return A and B of the midpoint step of a Sim, shapes (2 nv, 2 nv) and (2 nv, nu).

    sim: a Sim without rows.

    Raises SimulationError if the iteration of the step does not converge.
    """
    n, h = sim.model.nv, sim.settings.dt / 2
    dofs = Coordinates(sim.model)
    qpos, qvel = np.array(sim.qpos), np.array(sim.qvel)
    stepped = _at(sim, qpos, qvel)
    stepped.step()
    mean = (qvel + np.array(stepped.qvel)) / 2
    middle = _at(sim, dofs.moved(qpos, h * mean), mean, integrator="explicit", dt=SHORT)
    linear = middle.linearize()
    # Activations are constant.
    slopes = (linear.A[: 2 * n, : 2 * n] - np.eye(2 * n))[n:] / SHORT
    by_position, by_velocity = slopes[:, :n], slopes[:, n:]
    by_control = linear.B[n : 2 * n] / SHORT
    turn, gain = _displacement_maps(dofs, h * mean)
    system = np.eye(n) - h * h * by_position @ gain - h * by_velocity
    known = np.hstack([h * by_position @ turn, np.eye(n), h * by_control])
    mean_by, mean_by_control = np.split(np.linalg.solve(system, known), [2 * n], axis=1)
    turn, gain = _displacement_maps(dofs, 2 * h * mean)
    whole = np.vstack([2 * h * gain @ mean_by, 2 * mean_by])
    whole[:n, :n] += turn
    whole[n:, n:] -= np.eye(n)
    return whole, np.vstack([2 * h * gain @ mean_by_control, 2 * mean_by_control])


def _at(sim: Sim, qpos: Floats, qvel: Floats, **settings: Any) -> Sim:
    """Return a Sim of the same model and controls at this state."""
    moved = unwatched(Sim(sim.model.with_settings(**settings)))
    moved.qpos[:], moved.qvel[:], moved.ctrl[:], moved.act[:] = qpos, qvel, sim.ctrl, sim.act
    return moved


def _displacement_maps(dofs: Coordinates, change: Floats) -> tuple[Floats, Floats]:
    """Return E and T, the derivatives of q ⊕ change by q and by the change, shape (nv, nv) each."""
    turn, gain = np.eye(dofs.nv), np.eye(dofs.nv)
    for kind, _, first, _ in dofs.joints:
        if kind not in ("free", "ball"):
            continue
        start = first + (3 if kind == "free" else 0)
        at = slice(start, start + 3)
        axis = cross_matrix(change[at])
        square = axis @ axis
        # sin x / x, (1 - cos x) / x² and (1 - sin x / x) / x², without cancellation.
        x = float(np.linalg.norm(change[at]))
        half = _sinc(x / 2)
        third = 1 / 6 - x * x / 120 if x < 1e-2 else (1 - _sinc(x)) / (x * x)
        turn[at, at] += -_sinc(x) * axis + half * half / 2 * square
        gain[at, at] += -half * half / 2 * axis + third * square
    return turn, gain


def _sinc(x: float) -> float:
    return math.sin(x) / x if x else 1.0


def cross_matrix(v: Floats) -> Floats:
    """Return the matrix of v × ·, shape (3, 3)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
