"""Properties of each integrator, and the linear map of its step: x⁺ = A x for x = [dq, dv].

The formulas of the maps are the engine's: crates/stepcore/src/integrator/linear_map.rs.
"""

from __future__ import annotations

import numpy as np

from stepcore import _core
from stepcore.engine.arrays import Floats

INTEGRATORS = _core.integrators()
# Integrators that treat (some) damping implicitly, and integrators that treat stiffness implicitly.
DAMPING_IMPLICIT = tuple(name for name, scheme in INTEGRATORS.items() if scheme["damping"])
STIFFNESS_IMPLICIT = tuple(name for name, scheme in INTEGRATORS.items() if scheme["stiffness"])
# Integrators that evaluate forces within the step.
STAGED = tuple(name for name, scheme in INTEGRATORS.items() if scheme["stages"] != "start")


def implicit_kinds(integrator: str, eulerdamp: bool) -> tuple[str, ...]:
    """Return the kinds of elements whose damping an integrator treats implicitly.

    eulerdamp: whether an integrator for joint damping alone treats it implicitly (MJCF's flag).
    """
    damping = INTEGRATORS[integrator]["damping"]
    if damping == "joints":
        return ("damper",) if eulerdamp else ()
    return ("damper", "tendon damper", "fluid", "actuator") if damping else ()


def step_matrix(
    integrator: str,
    dt: float,
    mass: Floats,
    stiffness: Floats,
    damping: Floats,
    implicit: Floats,
) -> Floats:
    """Compute A of a system M dv' = −K dq − D dv, shape (2n, 2n).

    mass, stiffness, damping: M, K and the whole of D, shape (n, n) each; implicit: the part of D
    that the integrators in `DAMPING_IMPLICIT` treat implicitly. `discrete` treats all of K
    implicitly. Raises LinAlgError for a singular matrix.
    """
    n = len(mass)
    pull = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    flow = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), pull])
    matrix = _core.linear_step(integrator, dt, np.eye(2 * n), flow, mass, implicit, stiffness)
    if matrix is None:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(matrix)
