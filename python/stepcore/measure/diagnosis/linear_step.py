"""The linearised step of a model at a state, and the motion's own rates: its limit for dt → 0.

A step maps x = [dq, dv] (dq as qvel integrates) to A x. Its limit for dt → 0 is read from the
explicit integrator, whose A is I + dt·J exactly: positions move by the old velocity, velocities
by the acceleration at the old state. The eigenvalues of J are the rates [1/s] at which the motion
itself grows, decays and turns.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.measure.diagnosis.midpoint_map import midpoint_map

# The step from which J is read [s]: free rotations, which turn by dt·v, leave an error of its size.
TINY_STEP = 1e-7
# Laws whose rows act on velocities: their stiffness is 1/dt², whatever the scene.
ON_GUESS = ("lesson", "relaxed", "rigid")


@dataclass(frozen=True)
class State:
    """Where the step is linearised. qpos (nq,), qvel (nv,), ctrl (nu,); time [s] of the motion.

    rows: the elements whose rows act there.
    """

    label: str
    time: float
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    rows: tuple[str, ...] = ()


def exact(model: Model) -> Model:
    """The model computed in double precision, and its rows to rounding where that is possible.

    A limit is the integrator's: what an unfinished solve adds is another question.
    """
    s = model.settings
    solver = s.solver if s.law in ON_GUESS else "newton"
    return model.with_settings(
        precision="f64",
        solver=solver,
        sweeps="auto" if s.sweeps == "auto" else max(s.sweeps, 200),
        acceleration="none",
        tolerance=1e-14,
    )


def placed(model: Model, state: State, **settings: Any) -> Sim:
    """A Sim in this state, with some settings of its own."""
    sim = Sim(model.with_settings(**settings))
    sim.qpos[:] = state.qpos
    sim.qvel[:] = state.qvel
    sim.ctrl[:] = state.ctrl
    return sim


def later(
    model: Model, state: State, integrator: str, dt: float, count: int
) -> tuple[State, set[str]] | None:
    """The state `count` steps later, and the elements whose rows pushed in the last of them or
    push there; None where they do not stay finite."""
    sim = placed(model, state, integrator=integrator, dt=dt)
    try:
        sim.step(count)
        met = set(acting(sim))
        sim.forward()
    except SimulationError:
        return None
    steps = "a step" if count == 1 else f"{count} steps"
    label = f"{state.label} and {steps} of {dt:.3g} s"
    qpos, qvel = np.array(sim.qpos), np.array(sim.qvel)
    now = State(label, state.time + count * dt, qpos, qvel, state.ctrl, acting(sim))
    return now, met | set(now.rows)


def acting(sim: Sim) -> tuple[str, ...]:
    """The elements whose rows act: all connects and friction losses, and what pushes."""
    rows = sim.rows
    both_ways = (rows["kind"] == "connect") | (rows["kind"] == "friction loss")
    found = rows["name"][both_ways | (rows["impulse"] != 0)]
    return tuple(dict.fromkeys(found.tolist()))


def step_map(model: Model, state: State, integrator: str, dt: float) -> Floats | None:
    """A of one step, shape (2 nv, 2 nv); None where the step does not stay finite."""
    sim = placed(model, state, integrator=integrator, dt=dt)
    try:
        matrix = tangent(sim)
    except (SimulationError, ValueError):
        # The step leaves the finite numbers, or its derivative does.
        return None
    return matrix if np.isfinite(matrix).all() else None


def tangent(sim: Sim) -> Floats:
    """A of the next step of a Sim, which stays where it is."""
    if sim.settings.integrator == "midpoint" and not sim.model.scene.features.constraint:
        return midpoint_map(sim)
    return sim.linearize().A


def flow(model: Model, state: State, integrator: str, dt: float, count: int) -> Floats | None:
    """The linearised motion over dt in `count` shorter steps of the same rule; None as above."""
    sim = placed(model, state, integrator=integrator, dt=dt / count)
    whole = np.eye(2 * model.nv)
    try:
        for _ in range(count):
            whole = tangent(sim) @ whole
            sim.step()
    except (SimulationError, ValueError):
        return None
    return whole if np.isfinite(whole).all() else None


def rates_matrix(model: Model, state: State, dt: float | None = None) -> Floats | None:
    """J, shape (2 nv, 2 nv) [1/s]: x' = J x of the motion itself.

    dt: rows as soft as `refsafe` makes them at this step; None: as soft as the scene asks. Under
    the laws on velocities, whose rows are as stiff as the step is short, None leaves them out.
    """
    if dt is None and model.settings.law in ON_GUESS:
        model = without_rows(model)
    matrix = step_map(model.with_settings(refsafe=False), state, "explicit", TINY_STEP)
    if matrix is None:
        return None
    rates = (matrix - np.eye(len(matrix))) / TINY_STEP
    if dt is not None:
        # Velocities change by dt times the acceleration, exactly; positions turn, with an error.
        matrix = step_map(model, state, "explicit", dt)
        if matrix is None:
            return None
        n = model.nv
        rates[n:] = (matrix - np.eye(2 * n))[n:] / dt
    return rates


@functools.lru_cache(maxsize=4)
def without_rows(model: Model) -> Model:
    """The model without contacts, limits, friction losses and connects."""
    # The model copies its scene, all else of which is the same.
    scene = copy.copy(model.scene)
    scene.features = dataclasses.replace(scene.features, constraint=False)
    return Model(scene, model.settings)
