"""Linearise the step of a model at a state, and derive the rates of the motion from dt → 0.

A step maps x = [dq, dv] (dq in the coordinates of qvel) to A x. The limit dt → 0 is read from the
explicit integrator, whose A is 1 + dt·J exactly: positions move by the old velocity, velocities by
the acceleration at the old state. The eigenvalues of J are the rates [1/s] at which the motion
itself grows, decays and oscillates.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control, controls, fresh
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.run_settings import converged_settings
from stepcore.engine.sim import Sim, unwatched
from stepcore.executors import checkpoint
from stepcore.measure.diagnosis.elements import (
    acting_elements,
    penalised_contacts,
    slipping_elements,
)
from stepcore.measure.diagnosis.feedback import Feedback
from stepcore.measure.diagnosis.midpoint_map import midpoint_map

# The step from which J is read [s]. A free rotation turns by dt·v, which causes an error of this
# size.
TINY_STEP = 1e-7
# Residual of the rows at which a solve ends [m/s].
TOLERANCE = 1e-14
# The largest way in a step that a double resolves, as an angle [rad].
RESOLVED = 1 / float(np.finfo(float).eps)
# Laws whose rows act on velocities: the rows have the stiffness 1/dt² in every scene.
VELOCITY_LAWS = ("lesson", "relaxed", "rigid")


@dataclass(frozen=True)
class State:
    """A state at which the step is linearised.

    label: the place of the state in the motion.
    time: the time in the motion [s].
    qpos: shape (nq,).
    qvel: shape (nv,).
    ctrl: shape (nu,).
    rows: the elements whose rows act at the state.
    touching: the contacts that overlap and have no row, those of the law `penalty`.
    slipping: the friction losses that give their full force, which softness does not change.
    feedback: the linearised control function, if the controls depend on the state.
    act: shape (na,), empty for zeros; activations are constant.
    control: the user's control function with its memory at this state.
    """

    label: str
    time: float
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    rows: tuple[Element, ...] = ()
    touching: tuple[Element, ...] = ()
    slipping: frozenset[Element] = frozenset()
    feedback: Feedback | None = None
    act: Floats = field(default_factory=lambda: np.zeros(0))
    control: Control | None = field(default=None, repr=False)


def with_converged_rows(model: Model) -> Model:
    """Return the model in double precision, with rows solved to rounding, and without sleep.

    Rows are solved to rounding where the law allows it. The limit then belongs to the integrator
    alone, without the effects of an unfinished solve.
    """
    s = model.settings
    count = 200 if s.sweeps == "auto" else max(s.sweeps, 200)
    converged = converged_settings(s, sweeps=count, tolerance=TOLERANCE)
    if s.sweeps == "auto":
        converged = converged.replace(sweeps="auto")
    return model.with_settings(converged.replace(sleep=False))


def state_of(sim: Sim, label: str, time: float) -> State:
    """Return the present state of a Sim whose rows were solved at that state."""
    return dataclasses.replace(
        state_now(sim, label, time),
        rows=acting_elements(sim),
        touching=penalised_contacts(sim),
        slipping=slipping_elements(sim),
    )


def state_now(sim: Sim, label: str, time: float) -> State:
    """Return the present state of a Sim, without the elements that act there."""
    qpos, qvel, ctrl, act = (np.array(x) for x in (sim.qpos, sim.qvel, sim.ctrl, sim.act))
    return State(label, time, qpos, qvel, ctrl, act=act)


def sim_at(model: Model, state: State, **settings: Any) -> Sim:
    """Return a Sim at a state, with some settings replaced."""
    sim = unwatched(Sim(model.with_settings(**settings)))
    sim.qpos[:], sim.qvel[:], sim.ctrl[:] = state.qpos, state.qvel, state.ctrl
    sim.act[:] = state.act if len(state.act) else 0.0
    return sim


def state_after(
    model: Model, state: State, integrator: str, dt: float, count: int
) -> tuple[State, set[Element]] | None:
    """Return the state `count` steps later, and the elements with acting rows.

    The rows are those that act in the last step or after it. The result is None if the steps do not
    stay finite.
    """
    sim = sim_at(model, state, integrator=integrator, dt=dt)
    try:
        _stepped(sim, state, count)
        met = set(acting_elements(sim))
        sim.forward()
    except SimulationError:
        return None
    if not _resolved(sim):
        return None
    steps = "a step" if count == 1 else f"{count} steps"
    label = f"{state.label} and {steps} of {dt:.3g} s"
    after = state_of(sim, label, state.time + count * dt)
    after = dataclasses.replace(after, feedback=state.feedback)
    return after, met | set(after.rows)


def _resolved(sim: Sim) -> bool:
    """Return whether a double still resolves the way of a step, as an angle.

    Beyond 1/ε radians in a step nothing is left of an angle. A worm that had exploded to 2e27 rad/s
    took more than a minute to linearise.
    """
    return float(np.abs(sim.qvel).max(initial=0.0)) * sim.settings.dt < RESOLVED


def _stepped(sim: Sim, state: State, count: int) -> None:
    """Take steps, and call a control function before each step but the first.

    A control function with memory is not called, because its memory would belong to another past.
    """
    if state.feedback is None:
        sim.step(count)
        return
    function = fresh(state.feedback.function)
    for step in range(count):
        if step and not state.feedback.order:
            ask_control(sim, function)
        sim.step()


def ask_control(sim: Sim, function: Control | None) -> None:
    """Set the controls that a control function returns now, if there is one."""
    if function is not None:
        with contextlib.suppress(ValueError):
            sim.ctrl[:] = controls(function, sim)


def step_map(model: Model, state: State, integrator: str, dt: float) -> Floats | None:
    """Return A of one step, shape (2 nv, 2 nv), or None if the step or A is not finite.

    Where controls depend on the state, A is that of the closed loop, sampled at the step. The
    memory of a control function is appended to x.
    """
    return step_maps(model, state, integrator, dt, 1)


def step_maps(model: Model, state: State, integrator: str, dt: float, count: int) -> Floats | None:
    """Return the product of A over `count` steps that make up dt [s]; None as in `step_map`."""
    checkpoint()
    sim = sim_at(model, state, integrator=integrator, dt=dt / count)
    if not _resolved(sim):
        return None
    product, feedback = None, state.feedback
    function = None if feedback is None or feedback.order else fresh(feedback.function)
    try:
        for k in range(count):
            matrix = closed_step(sim, feedback)
            product = matrix if product is None else matrix @ product
            if k < count - 1:
                sim.step()
                ask_control(sim, function)
    except (SimulationError, ValueError):
        return None
    return product if product is not None and np.isfinite(product).all() else None


def closed_step(sim: Sim, feedback: Feedback | None, hold: int = 1) -> Floats:
    """Return A of the next `hold` steps of a Sim, with the controls of the first step held.

    The Sim stays at its state.
    """
    if sim.settings.integrator == "midpoint" and not sim.model.scene.features.constraint:
        step, inputs = midpoint_map(sim)
    else:
        linear, n = sim.linearize(), 2 * sim.model.nv
        # Activations are constant.
        step, inputs = linear.A[:n, :n], linear.B[:n]
    return step if feedback is None else feedback.closed(step, inputs, hold)


def rates_matrix(model: Model, state: State, dt: float | None = None) -> Floats | None:
    """Return J of the motion, x' = J x, shape (2 nv, 2 nv) [1/s], or None if it is not finite.

    dt: a step [s], to which `refsafe` adapts the rows; None: rows as the scene defines them. None
        also omits the rows of laws that act on velocities, whose stiffness is 1/dt².
    """
    if dt is None and model.settings.law in VELOCITY_LAWS:
        model = without_rows(model)
    if state.feedback is not None:
        # Continuous controls, without a hold.
        state = dataclasses.replace(state, feedback=state.feedback.prompt)
    matrix = step_map(model.with_settings(refsafe=False), state, "explicit", TINY_STEP)
    if matrix is None:
        return None
    rates = (matrix - np.eye(len(matrix))) / TINY_STEP
    if dt is not None:
        # Velocities change by exactly dt times the acceleration; positions rotate, with an error.
        matrix = step_map(model, state, "explicit", dt)
        if matrix is None:
            return None
        n = model.nv
        rates[n:] = (matrix - np.eye(2 * n))[n:] / dt
    return rates


@functools.lru_cache(maxsize=4)
def without_rows(model: Model) -> Model:
    """Return the model without contacts, limits, friction losses and equalities."""
    # The model copies its scene, so a shallow copy with new features is enough.
    scene = copy.copy(model.scene)
    scene.features = dataclasses.replace(scene.features, constraint=False)
    return Model(scene, model.settings)
