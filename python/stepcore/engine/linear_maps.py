"""What each integrator does, and the linear map of one step of it: x⁺ = A x for a motion x' = J x.

x = [dq, dv], shape (2n,) or a block of such columns; J is (2n, 2n) [1/s]. For a system of masses,
springs and dampers, M dv' = −K dq − D dv, J is [[0, 1], [−M⁻¹K, −M⁻¹D]]. The formulas of the maps
are the engine's: crates/stepcore/src/integrator/linear_map.rs.
"""

from __future__ import annotations

from typing import Any

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

    eulerdamp: whether damping of joints alone is treated so (MJCF's flag).
    """
    damping = INTEGRATORS[integrator]["damping"]
    if damping == "joints":
        return ("damper",) if eulerdamp else ()
    return ("damper", "tendon damper", "fluid", "actuator") if damping else ()


def amplification(integrator: str, z: Any) -> Any:
    """Return the factors by which one step multiplies modes of rate s, with z = dt·s.

    z is a number or an array of one dimension. The result is None for integrators whose step is not
    a function of dt·J.
    """
    return _core.amplification(integrator, np.atleast_1d(np.asarray(z, complex)))


def stepped(
    integrator: str,
    dt: float,
    rates: Floats,
    x: Any,
    mass: Floats,
    implicit: Floats,
    stiff: Floats,
    after: Floats | None = None,
    push: Floats | None = None,
) -> Any:
    """Compute A x of one step of dt [s]; the result has the shape of x.

    rates: J. mass: M, shape (n, n). implicit: D̂ of the integrators in `DAMPING_IMPLICIT`, shape
    (n, n), and stiff: K̂ of those in `STIFFNESS_IMPLICIT`; ignored by the others. after: the part of
    J, shape (n, 2n), whose accelerations `midpoint` adds to the velocities explicitly after its
    implicit step (rows of the law `solref`); half of the added velocity moves the positions.
    push: accelerations beside those of J that last through the step, shape (n, …).

    Raises LinAlgError for a singular matrix.
    """
    complex_ = np.iscomplexobj(x)

    def columns(block: Any) -> Floats:
        block = np.reshape(block, (len(block), -1))
        return np.concatenate([block.real, block.imag], axis=1) if complex_ else block

    late = None if push is None else columns(push)
    made = _core.linear_step(integrator, dt, columns(x), rates, mass, implicit, stiff, after, late)
    if made is None:
        raise np.linalg.LinAlgError("Singular matrix")
    if complex_:
        made = made[:, : made.shape[1] // 2] + 1j * made[:, made.shape[1] // 2 :]
    return made.reshape(np.shape(x))


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
    implicitly.
    """
    n = len(mass)
    pull = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    flow = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), pull])
    return np.asarray(stepped(integrator, dt, flow, np.eye(2 * n), mass, implicit, stiffness))
