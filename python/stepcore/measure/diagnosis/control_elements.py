"""The control of each actuator as an element: its stiffness and damping, and the step it closes.

A control u = D x (+ C z) of an actuator with the force b u on the dofs is an element with
K = −b D_q and D = −b D_v, "control of motor `ankle`". Unlike a spring it is held: in every stage of
a step, and in all steps of a control period, its force is that of the sample.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.linear_maps import DAMPING_IMPLICIT, stepped
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.element_id import ElementId
from stepcore.measure.diagnosis.element_matrices import ElementMatrices
from stepcore.measure.diagnosis.feedback import Feedback
from stepcore.measure.diagnosis.growth import largest_stable, worst_growth
from stepcore.measure.diagnosis.linear_step import TINY_STEP, State, sim_at

KIND = "control"


def control_inputs(model: Model, state: State, mass: Floats) -> Floats:
    """The force on the dofs of a unit of each control, shape (nv, nu)."""
    sim = sim_at(model, state, integrator="explicit", dt=TINY_STEP, refsafe=False)
    inputs: Floats = mass @ sim.linearize().B[model.nv : 2 * model.nv] / TINY_STEP
    return inputs


def control_matrices(
    model: Model, feedback: Feedback, inputs: Floats
) -> dict[ElementId, ElementMatrices]:
    """Stiffness and damping of every control that depends on the state, its delays over."""
    n = model.nv
    matrices = {}
    for actuator, gain in enumerate(feedback.settled):
        force = inputs[:, actuator]
        if np.any(force) and (np.any(feedback.gain[actuator]) or np.any(gain)):
            pulls = -np.outer(force, gain)
            element = ElementId.of(model, KIND, actuator)
            matrices[element] = ElementMatrices(pulls[:, :n], pulls[:, n:])
    return matrices


def held_step(
    integrator: str,
    dt: float,
    hold: int,
    rates: Callable[[Any], Any],
    block: Any,
    mass: Floats,
    late: tuple[Floats, Floats],
    smooth: Callable[[Any], Any] | None,
    feedback: Feedback,
    inputs: Floats,
) -> Any:
    """The map of (x, z) over `hold` steps of dt [s] times a block, the controls of the first held.

    rates: J without the controls, times a block. late: implicit damping and stiffness. smooth:
    rates without the accelerations that `midpoint` adds after its implicit step, or None without
    those. inputs: force of each control, shape (nv, nu).
    """
    n, (implicit, stiff) = len(mass), late
    x, z = block[: 2 * n], block[2 * n :]
    push = np.zeros_like(x)
    push[n:] = np.linalg.solve(mass, inputs @ feedback.controls(x, z))
    remembered = feedback.remembered(x, z)
    for _ in range(hold):
        if integrator == "midpoint":
            whole = np.eye(2 * n)
            within = (smooth or rates)(whole)
            after = None if smooth is None else lambda y: (rates(y) - smooth(y))[n:]
            x = stepped(integrator, dt, rates, x, mass, implicit, after)
            x = x + np.linalg.solve(whole - dt / 2 * within, dt * push)
        else:
            pushed = lambda y: rates(y) + push  # noqa: E731
            x = stepped(integrator, dt, pushed, x, mass, implicit, stiff=stiff)
    return np.concatenate([x, remembered])


def control_dt(
    omega: float, damping: float, implicit: float, integrator: str, horizon: float, longest: float
) -> float:
    """The largest stable period [s] of a control alone on a unit mass, one step a period.

    omega² and damping: its gains on position [1/s²] and velocity [1/s]. implicit: damping of the
    joint that the integrator treats implicitly [1/s]. With p = dt ω² and d = dt c the z-map is

        explicit             v⁺ = v − p q − d v,                        q⁺ = q + dt v
        midpoint, rk4        v⁺ = v − p q − d v,                        q⁺ = q + dt (v + v⁺)/2
        all others           v⁺ = v − (p q + d v + dt i v)/(1 + dt i),  q⁺ = q + dt v⁺

    The second is exact: it is stable for dt < 2/c and dt < 2 c/ω².
    """
    rates = np.linalg.eigvals(np.array([[0.0, 1.0], [-omega * omega, -damping]]))

    hidden = implicit if integrator in DAMPING_IMPLICIT else 0.0
    rest, velocity = np.eye(2)

    def stable(dt: float) -> bool:
        pull = np.array([omega * omega, damping + hidden]) / (1 + dt * hidden)
        after = velocity - dt * pull
        moving = {"explicit": velocity, "midpoint": (velocity + after) / 2}
        moving["rk4"] = moving["midpoint"]
        step = np.array([rest + dt * moving.get(integrator, after), after])
        return worst_growth(np.linalg.eigvals(step), dt, rates, horizon).stable

    fastest = max(omega, damping)
    if fastest <= 0:
        return float("inf")
    return largest_stable(stable, min(1e-3 / fastest, longest / 2), longest)
