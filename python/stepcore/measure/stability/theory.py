"""The largest stable step of a linear system, M a = −K x − D v, under each integrator.

A step of an integrator is a matrix (`engine.linear_maps`); a motion stays bounded while its
spectral radius is at most 1.
"""

from __future__ import annotations

import numpy as np

from stepcore.engine.linear_maps import step_matrix
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.joint_gains import implicit_kinds, joint_dofs, joint_gains

# A larger radius counts as growth: rounding moves a double eigenvalue by its square root.
GROWS = 1.0 + 1e-6


def limit(
    integrator: str,
    mass: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    implicit: np.ndarray,
) -> float:
    """The dt [s] beyond which motion grows: 0 where it grows at any dt, inf where at none."""

    def grows(dt: float) -> bool:
        matrix = step_matrix(integrator, dt, mass, stiffness, damping, implicit)
        return bool(np.abs(np.linalg.eigvals(matrix)).max() > GROWS)

    rates = np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)))
    drags = np.abs(np.linalg.eigvals(np.linalg.solve(mass, damping)))
    fastest = max(float(np.sqrt(rates.max())), float(drags.max()))
    if fastest == 0.0:
        return np.inf
    steps = np.geomspace(2e-2, 1e3, 200) / fastest
    if grows(steps[0]):
        return 0.0
    first = next((k for k, dt in enumerate(steps) if grows(dt)), None)
    if first is None:
        return np.inf
    low, high = steps[first - 1], steps[first]
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if grows(middle) else (middle, high)
    return float(low)


def limit_of(model: Model, key: str | int | None, integrator: str) -> float | None:
    """The limit of a scene's joint springs, dampers and servos in its start pose [s].

    None where the scene has none of them. Contacts, limits, gravity and Coriolis terms are left
    out; the spring of a ball or free joint and polynomial coefficients are taken at rest.
    """
    stiffness, damping, implicit = np.zeros(model.nv), np.zeros(model.nv), np.zeros(model.nv)
    hidden = implicit_kinds(model, integrator)
    for gain in joint_gains(model):
        at = joint_dofs(model, gain.joint)
        stiffness[at] += gain.stiffness
        damping[at] += gain.damping
        implicit[at] += gain.damping * (gain.kind in hidden)
    if not (stiffness.any() or damping.any()):
        return None
    sim = unwatched(Sim(model))
    sim.reset(key=key)
    parts = (np.diag(stiffness), np.diag(damping), np.diag(implicit))
    return limit(integrator, sim.mass_matrix(), *parts)
