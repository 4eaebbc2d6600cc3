"""Closed-form motions, which replace the reference and are checked against the converged runs.

Two kinds of motion have a closed form while no constraint row is active. A scene may combine them:

- slides and hinges whose accelerations are affine in their coordinates, velocities and controls:
  masses on springs and dampers, motors and servos, a hinge without gravity torque. With z = (q, v)
  and constant controls, z' = F z + g, so z(t) = e^{Ft} z(0) + ∫e^{Fs}ds g. This is exact over every
  control period.
- single free bodies with isotropic inertia: the centre of mass falls freely, and the angular
  velocity is constant.

A test decides whether a scene is of these kinds: at both ends of every control period, the engine's
accelerations must agree with those of the closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.converged import MEASURES, Known
from stepcore.experiment.coordinates import product, rotated, rotation
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner

# The largest difference of accelerations between engine and closed form, relative to the largest
# acceleration: a generous bound on rounding.
AGREES = 1e-9
# The reported error, relative to the largest difference between computations.
CAUTION = 4.0
# The relative rounding error of the entries of F, which are differences of accelerations.
ROUNDED = 4 * np.finfo(float).eps
# Terms of the Taylor series at norm 1/2: the first left out is 2^-18/18! < 1e-21.
TERMS = 18
# Limit of balancing rounds; balancing usually converges after a few.
BALANCINGS = 50


@dataclass(frozen=True)
class Exact:
    """The motion in closed form.

    runs: one run for each start.
    error [m], angle [rad]: the errors of the matrix exponential and of its entries; see `closed`.
    check: the distance to the converged runs, measured like an error [m].
    """

    runs: list[Run]
    error: float
    angle: float
    check: float = np.nan

    @property
    def known(self) -> Known:
        """Error in all measures."""
        measures = dict.fromkeys(MEASURES, self.error) | {"angle": self.angle}
        bases = dict.fromkeys(MEASURES, "closed form")
        each = (self.error,) * len(self.runs)
        return Known(**measures, each=each, orders=dict.fromkeys(MEASURES), bases=bases)


class Unfit(Exception):
    """Raised if the scene has no closed form."""


def closed(runner: Runner, runs: Sequence[Run]) -> Exact | None:
    """Return the closed form of a runner's motion, or None if it has none.

    The error is the largest difference to two other computations: one in thirds of a period (halves
    would repeat the same squarings), and one with every entry of F changed by its rounding error.
    Squarings and thousands of oscillations amplify these differences.

    runs: the converged runs.
    """
    schedule = runner.schedule
    servos = schedule.controls.servos
    if servos or schedule.control or schedule.log or any(run.rows for run in runs):
        return None
    if any(joint[0] == "ball" for joint in runner.coordinates.joints):
        return None
    try:
        form = _Form(runner)
        exact, error, angle = [], 0.0, 0.0
        for start in range(len(runner.schedule.starts)):
            whole = form.motion(start)
            a = runner.bodies.states(*whole)
            for again in (form.motion(start, parts=3), form.motion(start, rounded=True)):
                b = runner.bodies.states(*again)
                error = max(error, float(np.abs(a.com - b.com).max(initial=0.0)))
                angle = max(angle, float(np.abs(whole[0] - again[0]).max(initial=0.0)))
            exact.append(runner.bodies.run(*whole))
    except (Unfit, ValueError, SimulationError):
        return None
    size = max(float(np.abs(run.com).max(initial=0.0)) for run in exact)
    return Exact(exact, CAUTION * error + 1e-15 * size, CAUTION * angle + 1e-15)


class _Free(NamedTuple):
    """A single free body.

    q, v: the indices of the first coordinate and the first dof. c: centre of mass in the body frame
    [m], (3,). fall: acceleration of the centre of mass [m/s²], (3,).
    """

    q: int
    v: int
    c: np.ndarray
    fall: np.ndarray


class _Form:
    """The matrix F and the free bodies of a scene. Raises Unfit for other scenes."""

    def __init__(self, runner: Runner) -> None:
        self.runner = runner
        settings = runner.model.settings.replace(precision="f64", integrator="rk4", sleep=False)
        self.sim = runner.sim(settings)
        kinds = runner.coordinates.joints
        self.q = np.array([q for kind, q, _, _ in kinds if kind != "free"], int)
        self.v = np.array([v for kind, _, v, _ in kinds if kind != "free"], int)
        self.largest = 1e-300
        begin = runner.schedule.starts[0]
        self.frees = [self._alone(begin, q, v) for kind, q, v, _ in kinds if kind == "free"]
        n = len(self.q)
        whole = np.zeros((3 * n, 3 * n))
        whole[:n, n : 2 * n] = np.eye(n)
        whole[n : 2 * n, : 2 * n] = self._slopes(begin)
        whole[n : 2 * n, 2 * n :] = np.eye(n)
        self.whole = whole

    def motion(
        self, start: int, parts: int = 1, rounded: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute qpos and qvel at time 0 and at the samples.

        parts: steps per period. rounded: whether to change the entries of F by their rounding
        error.
        """
        schedule, n = self.runner.schedule, len(self.q)
        whole = self.whole * (1 + ROUNDED) if rounded else self.whole
        step = expm(whole * (schedule.period / parts))[: 2 * n]
        begin = schedule.starts[start]
        state = np.concatenate([begin.qpos[self.q], begin.qvel[self.v]])
        qpos, qvel = [begin.qpos], [begin.qvel]
        slopes = self.whole[n : 2 * n, : 2 * n]
        for period in range(schedule.periods):
            ctrl = None if schedule.ctrl is None else schedule.ctrl[start][period]
            time = period * schedule.period
            push = self._qacc(self._at(begin, state, time), ctrl)[self.v] - slopes @ state
            for _ in range(parts):
                state = step @ np.concatenate([state, push])
            here = self._at(begin, state, time + schedule.period)
            self._agree(self._qacc(here, ctrl), slopes @ state + push, here)
            if (period + 1) % schedule.every == 0:
                qpos.append(here.qpos)
                qvel.append(here.qvel)
        return np.array(qpos), np.array(qvel)

    def _at(self, begin: Start, state: np.ndarray, time: float) -> Start:
        """Return the state of the scene at a time [s]; state: (q, v) of the slides and hinges."""
        n = len(self.q)
        qpos, qvel = np.array(begin.qpos), np.array(begin.qvel)
        qpos[self.q], qvel[self.v] = state[:n], state[n:]
        for q, v, c, fall in self.frees:
            before, spin = begin.qpos[q + 3 : q + 7], begin.qvel[v + 3 : v + 6]
            speed = begin.qvel[v : v + 3] + rotated(before, np.cross(spin, c))
            centre = begin.qpos[q : q + 3] + rotated(before, c)
            turn = product(before, rotation(spin * time))
            centre = centre + speed * time + fall * time**2 / 2
            qpos[q : q + 3] = centre - rotated(turn, c)
            qpos[q + 3 : q + 7] = turn / np.linalg.norm(turn)
            qvel[v : v + 3] = speed + fall * time - rotated(turn, np.cross(spin, c))
        return Start(qpos, qvel)

    def _agree(self, qacc: np.ndarray, wanted: np.ndarray, here: Start) -> None:
        """Raise Unfit if the engine's accelerations differ from those of the closed form."""
        wrong = np.abs(qacc[self.v] - wanted).max(initial=0.0)
        for free in self.frees:
            fall, turn = _fall(free, here, qacc)
            wrong = max(wrong, np.abs(fall - free.fall).max(), np.abs(turn).max())
        self.largest = max(self.largest, float(np.abs(qacc).max(initial=0.0)))
        if not wrong <= AGREES * self.largest:
            raise Unfit

    def _qacc(self, here: Start, ctrl: np.ndarray | None) -> np.ndarray:
        """Return the engine's accelerations; raise Unfit if a row is active."""
        sim: Sim = self.sim
        sim.qpos, sim.qvel = here.qpos, here.qvel
        if ctrl is not None:
            sim.ctrl[:] = ctrl
        sim.forward()
        if len(sim.rows):
            raise Unfit
        return np.array(sim.qacc)

    def _slopes(self, begin: Start) -> np.ndarray:
        """Return the derivatives of accelerations by coordinates and velocities, (n, 2n)."""
        ctrl = None if self.runner.schedule.ctrl is None else self.runner.schedule.ctrl[0][0]
        base = self._qacc(begin, ctrl)[self.v]
        columns = []
        for k in range(2 * len(self.q)):
            # For an affine law, the largest step without active rows is the most accurate.
            for step in 2.0 ** -np.arange(0, 12, 2):
                moved = Start(np.array(begin.qpos), np.array(begin.qvel))
                if k < len(self.q):
                    moved.qpos[self.q[k]] += step
                else:
                    moved.qvel[self.v[k - len(self.q)]] += step
                try:
                    columns.append((self._qacc(moved, ctrl)[self.v] - base) / step)
                    break
                except Unfit:
                    continue
            else:
                raise Unfit
        return np.array(columns).T.reshape(len(self.q), 2 * len(self.q))

    def _alone(self, begin: Start, q: int, v: int) -> _Free:
        """Return the free body of a joint; raise Unfit if its motion has no closed form.

        The body must have no moving parent, carry no moving bodies, and have isotropic inertia.
        With the orientation R and the centre of mass c, the body's block of the mass matrix is
        [m, -m R [c]×; m [c]× Rᵀ, I]. I is the inertia about the body's origin, in body axes.
        """
        at = slice(v, v + 6)
        self.sim.qpos, self.sim.qvel = begin.qpos, begin.qvel
        mass = self.sim.mass_matrix()
        block, rest = mass[at, at], np.delete(mass[at], np.s_[at], axis=1)
        m = block[0, 0]
        back = begin.qpos[q + 3 : q + 7] * np.array([1.0, -1.0, -1.0, -1.0])
        lever = -np.array([rotated(back, column) for column in block[:3, 3:].T]).T / m
        c = np.array([lever[2, 1], lever[0, 2], lever[1, 0]])
        about = block[3:, 3:] - m * (c @ c * np.eye(3) - np.outer(c, c))
        spread = np.abs(about - np.trace(about) / 3 * np.eye(3)).max()
        linear = np.abs(block[:3, :3] - m * np.eye(3)).max()
        if np.abs(rest).max(initial=0.0) > 0 or spread > 1e-12 * np.trace(about):
            raise Unfit
        if linear > 1e-12 * m:
            raise Unfit
        free = _Free(q, v, c, np.zeros(3))
        fall, _ = _fall(free, begin, self._qacc(begin, None))
        return free._replace(fall=fall)


def _fall(free: _Free, here: Start, qacc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a free body's acceleration of the centre of mass [m/s²] and rotation [rad/s²]."""
    q, v, c, _ = free
    spin, turn = here.qvel[v + 3 : v + 6], qacc[v + 3 : v + 6]
    about = np.cross(turn, c) + np.cross(spin, np.cross(spin, c))
    return qacc[v : v + 3] + rotated(here.qpos[q + 3 : q + 7], about), turn


def expm(matrix: np.ndarray) -> np.ndarray:
    """Compute e^A of a square matrix A, by scaling and squaring of the Taylor series.

    The series is evaluated for A/2^s, whose norm is at most 1/2, and squared s times. The error is
    about 2^s times rounding. A is therefore balanced first: for a spring of stiffness k and mass 1
    the norm is then √k and not k. Source: Moler and Van Loan, Nineteen Dubious Ways to Compute the
    Exponential of a Matrix, SIAM Review 45 (2003), method 3.

    >>> expm(np.array([[0.0, 1.0], [-1.0, 0.0]])).round(6).tolist()
    [[0.540302, 0.841471], [-0.841471, 0.540302]]
    """
    matrix, scale = _balanced(matrix)
    norm = float(np.abs(matrix).sum(axis=1).max(initial=0.0))
    squarings = max(0, int(np.ceil(np.log2(norm))) + 1) if norm > 0 else 0
    small = matrix / 2.0**squarings
    result = np.eye(len(matrix))
    term = np.eye(len(matrix))
    for k in range(1, TERMS + 1):
        term = term @ small / k
        result = result + term
    for _ in range(squarings):
        result = result @ result
    return result * scale[:, None] / scale[None, :]


def _balanced(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Balance a matrix A: return D⁻¹ A D and the diagonal of D, which has powers of two.

    The rows and columns of D⁻¹ A D have similar norms. Source: Osborne, On Pre-Conditioning of
    Matrices, Journal of the ACM 7 (1960).
    """
    matrix, scale = matrix.copy(), np.ones(len(matrix))
    for _ in range(BALANCINGS):
        before = scale.copy()
        for k in range(len(matrix)):
            own = abs(matrix[k, k])
            column, row = np.abs(matrix[:, k]).sum() - own, np.abs(matrix[k]).sum() - own
            if column > 0 and row > 0:
                factor = 2.0 ** np.round(np.log2(row / column) / 2)
                matrix[:, k] *= factor
                matrix[k] /= factor
                scale[k] *= factor
        if np.array_equal(scale, before):
            break
    return matrix, scale
