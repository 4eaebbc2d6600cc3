"""Gains and load with which a PD controller of motors holds the pose of a start.

The gains of joint j are kp = ω² I and kd = 2 ω I, where 1/I is entry jj of the inverse mass matrix;
where the start has contacts, of the mass matrix with these points fixed, which a robot has as long
as it stands. ω is at most 30 rad/s, and small enough for the control period T: with μ the largest
eigenvalue of M⁻¹I, kd changes a velocity by the factor 1 − 2 ω μ T in a period, and ω ≤ 0.35/(μT)
leaves a stability margin of 3. T is at least four time steps, the longest that is tried by default.

The load is what the motors must exert at rest, M⁻¹ aside: bias − passive − Jᵀf, where f are the
contact forces of least norm that balance the dofs without a motor.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stepcore.engine.actuator import actuators, inertias, loads
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.drives import Drives
from stepcore.experiment.point_to_point import JointGains

# The largest bandwidth [rad/s], and the largest 2 μ ω T.
OMEGA, SAMPLED = 30.0, 0.7
# The time steps that are tried by default are at most this multiple of the shipped one.
LONGEST = 4
# The weight of fixed points relative to the largest entry of the mass matrix.
FIXED = 1e6


def gains_of(
    model: Model,
    drives: Drives,
    motors: Sequence[int],
    pose: np.ndarray,
    stands: Start,
    contacts: np.ndarray,
    period: float,
    fixed: bool,
) -> JointGains:
    """Return the gains of motors that hold a pose.

    pose: the pose, (nq,). stands: the state in which the machine stands in this pose.
    contacts: the Jacobian of its contacts, (3 contacts, nv). period: the control period [s].
    fixed: whether the gains are those of the inertia with the contact points fixed.
    """
    every = actuators(model)
    chosen = [every[k] for k in motors]
    dofs, at = (np.array([getattr(a, name) for a in chosen]) for name in ("dof", "qposadr"))
    sim = Sim(model)
    stands.put(sim)
    mass = sim.mass_matrix()
    if fixed and len(contacts):
        mass = mass + FIXED * mass.max() * contacts.T @ contacts
    inertia = inertias(mass)[dofs]
    inverse = np.linalg.inv(mass)[np.ix_(dofs, dofs)]
    largest = float(np.abs(np.linalg.eigvals(inverse * inertia)).max())
    sampled = max(period, LONGEST * model.settings.dt)
    omega = min(OMEGA, SAMPLED / (2 * largest * sampled))
    low, high = np.array([actuator.ctrlrange for actuator in chosen]).T
    # Several motors on a joint share its force.
    shared = np.array([list(dofs).count(dof) for dof in dofs])
    return JointGains(
        tuple(motors),
        at,
        dofs,
        np.array([actuator.gear * actuator.gain for actuator in chosen]),
        pose[at],
        load(sim, dofs, contacts) / shared,
        omega**2 * inertia / shared,
        2 * omega * inertia / shared,
        low,
        high,
    )


def load(sim: Sim, dofs: np.ndarray, contacts: np.ndarray) -> np.ndarray:
    """Return the force on each of some dofs that a Sim's pose needs at rest [N or N·m]."""
    need = loads(sim)
    if len(contacts):
        others = np.setdiff1d(np.arange(sim.model.nv), dofs)
        push = np.linalg.lstsq(contacts[:, others].T, need[others], rcond=1e-8)[0]
        need = need - contacts.T @ push
    force: np.ndarray = need[dofs]
    return force
