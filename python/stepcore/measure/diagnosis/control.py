"""Linearise a user's control function: its law, its elements, and steps with held controls.

The law is found by calling the function, which is a black box and may have memory. The probe
changes each position and velocity for one sample and reads the responses over the samples that
follow. The memory is realised from this impulse response by the method of Ho and Kalman (1966), a
singular value decomposition of the response's Hankel matrix. A function without memory has a
response of zero after the first sample, which two random changes show. Its gain is then the central
difference of two calls.

A function may count its calls or read the time between them. Every response therefore begins with
the memory that the function has at the state, and with equally many calls without a change, at
times one period apart. The response is the difference to the last of these calls. Memory that no
copy reaches, such as an integral in a closure, cancels in the difference of both signs.

A control u = D x (+ C z) of an actuator with the force b u on the dofs is an element with
K = −b D_q and D = −b D_v, "control of motor `ankle`". Unlike a spring it is held: in every stage
of a step, and in all steps of a control period, its force is that of the sample. With a control
period T, a step dt < T is stable if two maps are stable: the step with controls sampled at every
step, and the map over T with controls held. The motion itself has continuous controls, so growth
that is due to the hold belongs to the control.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control, controls, fresh
from stepcore.engine.element import Element, ElementSlopes
from stepcore.engine.linear_maps import DAMPING_IMPLICIT, stepped
from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Coordinates
from stepcore.measure.diagnosis.feedback import Feedback
from stepcore.measure.diagnosis.growth import (
    StepGrowth,
    growth_beyond_motion,
    largest_stable,
    step_growth,
    worst_growth,
)
from stepcore.measure.diagnosis.linear_step import TINY_STEP, State, closed_step, sim_at

KIND = "control"
# Changes of a position or velocity. The larger one serves functions whose answers are coarse, such
# as a network in single precision: answers to both changes then differ by more than this share.
SMALL, LARGE, COARSE = 1e-5, 1e-3, 1e-2
# Samples of a response; delays of up to half this number are found.
SAMPLES = 32
# A smaller part of a response, or a smaller singular value, counts as rounding.
NOTHING = 1e-4
# Models with more dofs have the memory found at the first state at every state.
MOST_DOFS = 10
# An eigenvalue of this size is an explosion, even where the motion itself grows.
CLEAR = 1.5


# --- the linear law -------------------------------------------------------------------------------


def with_feedback(
    model: Model,
    states: Sequence[State],
    control: Control,
    dt: float,
    horizon: float,
    period: float | None = None,
) -> list[State]:
    """Return the states with the control function linearised at each, and its controls there.

    control: the user's control function.
    dt: the time between two calls [s].
    horizon: the length of the motion [s]; the function is never called at or beyond this time.
    period: the control period [s] of each `Feedback`; None for one step.
    """
    made: list[State] = []
    first: Feedback | None = None
    for state in states:
        # The run's copy has the memory of that moment. Without a copy the function is as at the
        # start.
        control = control if state.control is None else state.control
        probe = _Probe(model, state, control, dt, horizon)
        if first is None or (first.order and model.nv <= MOST_DOFS):
            feedback = probe.feedback()
        elif first.order:
            feedback = first
        else:
            feedback = Feedback.prompt_law(control, probe.gain())
        first = first or feedback
        held = replace(feedback, period=period) if feedback.acts else None
        made.append(replace(state, ctrl=probe.now(), feedback=held))
    return made


class _Probe:
    """A control function, called at changed states."""

    def __init__(
        self, model: Model, state: State, control: Control, dt: float, horizon: float
    ) -> None:
        self.model, self.state, self.dt = model, state, dt
        self.begun = self.control = control
        self.last = max(0.0, horizon - dt)
        # The samples around this time lie within the motion.
        around = SAMPLES * dt
        self.middle = max(min(state.time, self.last - around), around)
        self.sim = sim_at(model, state)
        self.coordinates = Coordinates(model)
        self.small = SMALL

    def answer(self, change: Floats | None, sample: int | None = None) -> Floats:
        """Return the controls at the state changed by [dq, dv].

        change: shape (2 nv,); None for no change.
        sample: the index in a response, 0 in its middle; None for the state's own time.
        """
        sim, n = self.sim, self.model.nv
        qpos, qvel = self.state.qpos, self.state.qvel
        if change is not None:
            qpos, qvel = self.coordinates.moved(qpos, change[:n]), qvel + change[n:]
        sim.qpos[:], sim.qvel[:], sim.ctrl[:] = qpos, qvel, self.state.ctrl
        time = self.state.time if sample is None else self.middle + sample * self.dt
        sim.time = min(max(time, 0.0), self.last)
        sim.forward()
        return controls(self.control, sim)

    def now(self) -> Floats:
        """Return the controls at the state."""
        self.control = fresh(self.begun)
        return self.answer(None)

    def slope(self, answer: Callable[[Floats], Floats], direction: Floats) -> Floats:
        """Return the derivative of an answer along a change."""
        change, answers = self.small * direction, []
        for signed in (change, -change):
            # Both signs begin with the same memory.
            self.control = fresh(self.begun)
            answers.append(answer(signed))
        slope: Floats = (answers[0] - answers[1]) / (2 * self.small)
        return slope

    def gain(self) -> Floats:
        """Return D of a function without memory, shape (nu, 2 nv)."""
        columns = [self.slope(self.answer, unit) for unit in np.eye(2 * self.model.nv)]
        return np.array(columns).T.reshape(self.model.nu, 2 * self.model.nv)

    def response(self, change: Floats) -> Floats:
        """Return the answers to a change of one sample, shape (SAMPLES, nu).

        The last answer before the change is subtracted.
        """
        for sample in range(-SAMPLES, 0):
            before = self.answer(None, sample)
        answers = [self.answer(change, 0)]
        answers += [self.answer(None, sample) for sample in range(1, SAMPLES)]
        return np.array(answers) - before

    def feedback(self) -> Feedback:
        """Return the linearised function with its memory."""
        rng = np.random.default_rng(0)
        directions = rng.choice([-1.0, 1.0], (2, 2 * self.model.nv))
        fine = [self.slope(self.response, direction) for direction in directions]
        self.small = LARGE
        coarse = [self.slope(self.response, direction) for direction in directions]
        apart = max(float(np.abs(a - b).max()) for a, b in zip(fine, coarse, strict=True))
        if apart <= COARSE * max(float(np.abs(b).max()) for b in coarse):
            self.small, coarse = SMALL, fine
        size = max(float(np.abs(some).max()) for some in coarse)
        if all(float(np.abs(some[1:]).max()) <= NOTHING * size for some in coarse):
            return Feedback.prompt_law(self.begun, self.gain())
        columns = [self.slope(self.response, unit) for unit in np.eye(2 * self.model.nv)]
        return realised(self.begun, np.array(columns).transpose(1, 2, 0))


def realised(control: Control, response: Floats) -> Feedback:
    """Return the feedback of least memory with this impulse response, shape (samples, nu, 2 nv)."""
    count, nu, width = response.shape
    half = count // 2
    later = response[1:]
    hankel, shifted = (
        np.block([[later[i + j + shift] for j in range(half - 1)] for i in range(half)])
        for shift in (0, 1)
    )
    left, sizes, right = np.linalg.svd(hankel, full_matrices=False)
    order = int(np.sum(sizes > NOTHING * sizes[0])) if sizes.size and sizes[0] > 0 else 0
    root = np.sqrt(sizes[:order])
    left, right = left[:, :order], right[:order]
    a = (left.T @ shifted @ right.T) / root[:, None] / root[None, :]
    b = root[:, None] * right[:, :width]
    c = left[:nu] * root[None, :]
    # An integral keeps its value for ever and is no delay.
    kept = response[-1] if np.any(np.abs(np.linalg.eigvals(a)) > 0.99) else 0.0 * response[-1]
    settled = response[0] - kept + (later - kept).sum(axis=0)
    return Feedback(control, None, response[0], settled, a, b, c)


# --- elements -------------------------------------------------------------------------------------


def control_inputs(model: Model, state: State, mass: Floats) -> Floats:
    """Return the force on the dofs per unit of each control, shape (nv, nu)."""
    sim = sim_at(model, state, integrator="explicit", dt=TINY_STEP, refsafe=False)
    inputs: Floats = mass @ sim.linearize().B[model.nv : 2 * model.nv] / TINY_STEP
    return inputs


def control_matrices(
    model: Model, feedback: Feedback, inputs: Floats
) -> dict[Element, ElementSlopes]:
    """Return stiffness and damping of every control that depends on the state, after its delays."""
    n = model.nv
    matrices = {}
    for actuator, gain in enumerate(feedback.settled):
        force = inputs[:, actuator]
        if np.any(force) and (np.any(feedback.gain[actuator]) or np.any(gain)):
            pulls = -np.outer(force, gain)
            element = Element.of(model, KIND, actuator)
            matrices[element] = ElementSlopes.of(pulls[:, :n], pulls[:, n:])
    return matrices


def held_step(
    integrator: str,
    dt: float,
    hold: int,
    block: Any,
    rates: Floats,
    after: Floats | None,
    mass: Floats,
    implicit: Floats,
    stiff: Floats,
    feedback: Feedback,
    inputs: Floats,
) -> Any:
    """Return the map of (x, z) over `hold` steps times a block, the first step's controls held.

    integrator, dt: the integrator and its step [s].
    hold: the number of steps.
    block: the block of (x, z), shape (2 nv + m, …).
    rates: J without the controls.
    after: the accelerations in J that `midpoint` adds after its implicit step, shape (nv, 2 nv).
    mass: the mass matrix, shape (nv, nv).
    implicit, stiff: implicit damping and stiffness, shape (nv, nv) each.
    feedback: the control law.
    inputs: the force of each control, shape (nv, nu).
    """
    n = len(mass)
    x, z = block[: 2 * n], block[2 * n :]
    push = np.linalg.solve(mass, inputs @ feedback.controls(x, z))
    remembered = feedback.remembered(x, z)
    for _ in range(hold):
        x = stepped(integrator, dt, rates, x, mass, implicit, stiff, after, push)
    return np.concatenate([x, remembered])


def control_dt(
    omega: float, damping: float, implicit: float, integrator: str, horizon: float, longest: float
) -> float:
    """Return the largest stable period [s] of a control alone on a unit mass, one step a period.

    omega, damping: the square root of the gain on position [rad/s], and the gain on velocity [1/s].
    implicit: damping of the joint that the integrator treats implicitly [1/s].
    integrator: the integrator.
    horizon: see `growth` [s].
    longest: the longest period to try [s].
    """
    pull = np.array([[-omega * omega, -damping]])
    rates = np.linalg.eigvals(np.vstack([[0.0, 1.0], pull]))
    hidden = implicit if integrator in DAMPING_IMPLICIT else 0.0
    free, unit = np.array([[0.0, 1.0], [0.0, -hidden]]), np.eye(1)
    law = Feedback.prompt_law(lambda time, sim: (), pull)

    def stable(dt: float) -> bool:
        step = held_step(
            *(integrator, dt, 1, np.eye(2), free, None, unit, hidden * unit, 0 * unit, law, unit)
        )
        return worst_growth(np.linalg.eigvals(step), dt, rates, horizon).stable

    fastest = max(omega, damping)
    if fastest <= 0:
        return float("inf")
    return largest_stable(stable, min(1e-3 / fastest, longest / 2), longest)


# --- controls held over several steps -------------------------------------------------------------


def steps_held(state: State, dt: float) -> tuple[int, float]:
    """Return the number and size [s] of the steps, of at most dt [s], over which a control is held.

    The result is (1, dt) if the control is sampled at every step.
    """
    period = state.feedback.period if state.feedback is not None else None
    if period is None or dt >= period * (1 - 1e-9):
        return 1, dt
    count = math.ceil(period / dt * (1 - 1e-9))
    return count, period / count


def folded(rates: Any, period: float) -> Any:
    """Return rates [1/s] as sampled once a period [s]: frequencies are folded, as in aliasing."""
    turns = np.round(rates.imag * period / (2 * math.pi))
    return rates - 2j * math.pi * turns / period


def growth_when_held(
    model: Model,
    state: State,
    rates: Any,
    integrator: str,
    dt: float,
    horizon: float,
    period: float | None = None,
) -> StepGrowth | None:
    """Return the worst growth over a control period at a state, or None for single steps.

    model, state, integrator, dt: the step.
    rates: the rates of the motion there [1/s].
    horizon: see `growth` [s].
    period: a control period [s] in place of the state's own.
    """
    if state.feedback is None:
        return None
    if period is not None:
        state = replace(state, feedback=replace(state.feedback, period=period))
    count, step = steps_held(state, dt)
    if count == 1 and period is None:
        return None
    span = count * step
    sim = sim_at(model, state, integrator=integrator, dt=step)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = closed_step(sim, state.feedback, count)
            often = np.linalg.matrix_power(closed_step(sim, state.feedback), count)
    except (SimulationError, ValueError):
        return step_growth(None, span, rates, horizon)
    if not np.isfinite(matrix).all():
        return step_growth(None, span, rates, horizon)
    growth = step_growth(matrix, span, folded(rates, span), horizon)
    if growth.stable or abs(growth.value) > CLEAR or not np.isfinite(often).all():
        return growth
    return growth_beyond_motion(growth, often, span, horizon)
