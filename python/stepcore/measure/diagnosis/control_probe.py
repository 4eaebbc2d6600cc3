"""Finds the linear law of a control function by calling it: a black box, with what it remembers.

Its answers to a change of each position and velocity, for one sample, are read over the samples
that follow. From this impulse response the memory is realised as by Ho and Kalman (1966): the
Hankel matrix of the response is split by its singular values. A function that remembers nothing
has the response zero after the first sample, which two random changes show; its gain is then the
central difference of one call each.

A function may count its calls or look at the time between them. So every response begins with the
memory that the function has at the state, and with as many calls without a change, at times one
period apart; it is read as a difference to the last of them. What no copy reaches, such as an
integral in a closure, falls out of the difference of both signs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control, controls, fresh
from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Coordinates
from stepcore.measure.diagnosis.feedback import Feedback
from stepcore.measure.diagnosis.linear_step import State, sim_at

# Changes of a position or velocity: the smaller, unless the answers are too coarse for it (a
# network in single precision); they are if the answers to both differ by more than this share.
SMALL, LARGE, COARSE = 1e-5, 1e-3, 1e-2
# Samples of a response. Delays of up to half as many are found.
SAMPLES = 32
# Of the response: a smaller part, or singular value, is rounding.
NOTHING = 1e-4
# Models of more dofs have the memory that is found at the first state at every state.
MOST_DOFS = 10


def with_feedback(
    model: Model, states: list[State], control: Control, dt: float, horizon: float
) -> list[State]:
    """The states with the control function linearised at each, and its controls there.

    dt: the time between two calls [s]. horizon: of the motion [s]; the function is not asked at it
    or beyond. The period of each `Feedback` is None.
    """
    made: list[State] = []
    first: Feedback | None = None
    for state in states:
        # As it was when the run came by; before the first sample, as it begins.
        control = control if state.control is None else state.control
        probe = _Probe(model, state, control, dt, horizon)
        if first is None or (first.order and model.nv <= MOST_DOFS):
            feedback = probe.feedback()
        elif first.order:
            feedback = first
        else:
            feedback = _prompt(control, probe.gain())
        first = first or feedback
        own = feedback if feedback.acts else None
        made.append(replace(state, ctrl=probe.now(), feedback=own))
    return made


def _prompt(control: Control, gain: Floats) -> Feedback:
    """The feedback of a function that remembers nothing."""
    nu, width = gain.shape
    none = np.zeros((0, 0)), np.zeros((0, width)), np.zeros((nu, 0))
    return Feedback(control, None, gain, gain, *none)


class _Probe:
    """Calls a control function at changed states."""

    def __init__(
        self, model: Model, state: State, control: Control, dt: float, horizon: float
    ) -> None:
        self.model, self.state, self.dt = model, state, dt
        self.begun = self.control = control
        self.last = max(0.0, horizon - dt)
        # Where the samples around it lie within the motion.
        around = SAMPLES * dt
        self.middle = max(min(state.time, self.last - around), around)
        self.sim = sim_at(model, state)
        self.coordinates = Coordinates(model)
        self.small = SMALL

    def answer(self, change: Floats | None, sample: int | None = None) -> Floats:
        """The controls at the state changed by [dq, dv]; sample: of a response, 0 in its middle."""
        sim, n = self.sim, self.model.nv
        qpos, qvel = self.state.qpos, self.state.qvel
        if change is not None:
            qpos, qvel = self.coordinates.moved(qpos, change[:n]), qvel + change[n:]
        sim.qpos[:], sim.qvel[:], sim.ctrl[:] = qpos, qvel, self.state.ctrl
        time = self.state.time if sample is None else self.middle + sample * self.dt
        sim.time = min(max(time, 0.0), self.last)
        sim.forward()
        return controls(self.control, sim)

    def slope(self, answer: Callable[[Floats], Floats], direction: Floats) -> Floats:
        """The derivative of an answer along a change."""
        change, answers = self.small * direction, []
        for signed in (change, -change):
            # Both begin with the same memory.
            self.control = fresh(self.begun)
            answers.append(answer(signed))
        slope: Floats = (answers[0] - answers[1]) / (2 * self.small)
        return slope

    def now(self) -> Floats:
        """The controls at the state."""
        self.control = fresh(self.begun)
        return self.answer(None)

    def gain(self) -> Floats:
        """D of a function that remembers nothing, shape (nu, 2 nv)."""
        columns = [self.slope(self.answer, unit) for unit in np.eye(2 * self.model.nv)]
        return np.array(columns).T.reshape(self.model.nu, 2 * self.model.nv)

    def response(self, change: Floats) -> Floats:
        """Answers to a change of one sample, less the last before it, shape (SAMPLES, nu)."""
        for sample in range(-SAMPLES, 0):
            before = self.answer(None, sample)
        answers = [self.answer(change, 0)]
        answers += [self.answer(None, sample) for sample in range(1, SAMPLES)]
        return np.array(answers) - before

    def feedback(self) -> Feedback:
        """The function with what it remembers."""
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
            return _prompt(self.begun, self.gain())
        columns = [self.slope(self.response, unit) for unit in np.eye(2 * self.model.nv)]
        return realised(self.begun, np.array(columns).transpose(1, 2, 0))


def realised(control: Control, response: Floats) -> Feedback:
    """The least memory that has an impulse response, shape (samples, nu, 2 nv)."""
    count, nu, width = response.shape
    half = count // 2
    later = response[1:]
    blocks = [[later[i + j] for j in range(half - 1)] for i in range(half)]
    hankel = np.block(blocks)
    shifted = np.block([[later[i + j + 1] for j in range(half - 1)] for i in range(half)])
    left, sizes, right = np.linalg.svd(hankel, full_matrices=False)
    order = int(np.sum(sizes > NOTHING * sizes[0])) if sizes.size and sizes[0] > 0 else 0
    root = np.sqrt(sizes[:order])
    left, right = left[:, :order], right[:order]
    a = (left.T @ shifted @ right.T) / root[:, None] / root[None, :]
    b = root[:, None] * right[:, :width]
    c = left[:nu] * root[None, :]
    # What an integral keeps for ever is no delay.
    kept = response[-1] if np.any(np.abs(np.linalg.eigvals(a)) > 0.99) else 0.0 * response[-1]
    settled = response[0] - kept + (later - kept).sum(axis=0)
    return Feedback(control, None, response[0], settled, a, b, c)
