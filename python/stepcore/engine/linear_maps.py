"""The linear map of one step of each integrator: x⁺ = A x for a linear motion x' = J x.

x = [dq, dv], shape (2n,) or a block of such columns; J is (2n, 2n) [1/s]. For a system of masses,
springs and dampers, M dv' = −K dq − D dv, J is [[0, 1], [−M⁻¹K, −M⁻¹D]]. With h = dt:

    explicit                q⁺ = q + h J_q x, v⁺ = v + h J_v x: A = 1 + h J
    rk4                     A = 1 + z + z²/2 + z³/6 + z⁴/24, z = h J
    midpoint                A = (1 − z/2)⁻¹ (1 + z/2)
    semi-implicit           v⁺ = v + h J_v x, then q⁺ = q + h (J_qq q + J_qv v⁺)
    euler, implicitfast,
    implicit                the same with v⁺ = v + h (M + h D̂)⁻¹ M J_v x, D̂ the implicit damping
    discrete                the same with v⁺ = v + h (M + h D̂ + h² K̂)⁻¹ (M J_v x − h K̂ v), K̂ the
                            implicit stiffness

The first three are functions of h J, so that the eigenvalues of A are the same functions of those
of J (`amplification`). Source: the integrators' definitions in docs/method.md; Hairer and Wanner,
Solving Ordinary Differential Equations II, chapter IV.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats

INTEGRATORS = (
    *("explicit", "semi-implicit", "euler", "implicitfast"),
    *("implicit", "discrete", "midpoint", "rk4"),
)
# Integrators that treat (some) damping implicitly, and integrators that treat stiffness implicitly.
DAMPING_IMPLICIT = ("euler", "implicitfast", "implicit", "discrete")
STIFFNESS_IMPLICIT = ("discrete",)

# A matrix times a block of columns: both of shape (2n, any number).
Product = Callable[[Any], Any]


def implicit_kinds(integrator: str, eulerdamp: bool) -> tuple[str, ...]:
    """Return the kinds of elements whose damping an integrator treats implicitly.

    eulerdamp: whether `euler` treats damping implicitly (MJCF's flag).
    """
    if integrator == "euler":
        return ("damper",) if eulerdamp else ()
    if integrator not in DAMPING_IMPLICIT:
        return ()
    return ("damper", "tendon damper", "fluid", "actuator")


def amplification(integrator: str, z: Any) -> Any:
    """Return the factor by which one step multiplies a mode of rate s, with z = dt·s.

    z is a number or an array. The result is None for integrators whose step is not a function of
    dt·J.
    """
    if integrator == "explicit":
        return 1 + z
    if integrator == "midpoint":
        return (1 + z / 2) / (1 - z / 2)
    if integrator == "rk4":
        with np.errstate(all="ignore"):
            return 1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))
    return None


def stepped(
    integrator: str,
    dt: float,
    rates: Product,
    x: Any,
    mass: Floats,
    implicit: Floats,
    after: Product | None = None,
    stiff: Floats | None = None,
) -> Any:
    """Compute A x of one step of dt [s]; the result has the shape of x.

    rates: J times a block. mass: M, shape (n, n). implicit: D̂ of the integrators in
    `DAMPING_IMPLICIT`, shape (n, n), ignored by the others. after: the accelerations of a block,
    shape (n, …), that `midpoint` adds to the velocities explicitly after its implicit step (rows of
    the law `solref`); half of the added velocity moves the positions. These accelerations are part
    of `rates` too. stiff: K̂ of the integrators in `STIFFNESS_IMPLICIT`, shape (n, n); None means
    zero.
    """
    n = len(mass)
    if integrator == "explicit":
        return x + dt * rates(x)
    if integrator == "rk4":
        y = x
        for order in (4, 3, 2, 1):
            y = x + dt / order * rates(y)
        return y
    if integrator == "midpoint":
        return _midpoint(dt, rates, x, n, after)
    change = rates(x)
    inertia = mass + dt * implicit if integrator in DAMPING_IMPLICIT else mass
    force = mass @ change[n:]
    if stiff is not None and integrator in STIFFNESS_IMPLICIT:
        inertia = inertia + dt * dt * stiff
        force = force - dt * stiff @ x[n : 2 * n]
    new = x[n:] + dt * np.linalg.solve(inertia, force)
    # J_qq q + J_qv v⁺.
    moving = rates(np.concatenate([x[:n], new]))[:n]
    return np.concatenate([x[:n] + dt * moving, new])


def _midpoint(dt: float, rates: Product, x: Any, n: int, after: Product | None) -> Any:
    whole = np.eye(2 * n)
    if after is None:
        return np.linalg.solve(whole - dt / 2 * rates(whole), x + dt / 2 * rates(x))

    def smooth(y: Any) -> Any:
        change = rates(y)
        change[n:] -= after(y)
        return change

    made = np.linalg.solve(whole - dt / 2 * smooth(whole), x + dt / 2 * smooth(x))
    kick = dt * after(x)
    return made + np.concatenate([dt / 2 * kick, kick])


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
    whole = np.eye(2 * n)
    return np.asarray(
        stepped(integrator, dt, lambda y: flow @ y, whole, mass, implicit, stiff=stiffness)
    )
