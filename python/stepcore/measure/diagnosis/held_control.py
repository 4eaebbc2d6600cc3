"""Growth that comes of holding controls over a period of several steps.

With a period T that was asked for, a step dt < T is stable if the step itself is, with the controls
sampled at every step, and if the map over T is, with its controls held: as many equal steps of at
most dt as T takes. The motion itself has the controls at every instant, so what grows because they
are held belongs to the control.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.experiment.schedule import Schedule
from stepcore.measure.diagnosis.growth import StepGrowth, growth_beyond_motion, step_growth
from stepcore.measure.diagnosis.linear_step import State, closed_step, sim_at

# An eigenvalue of this size is an explosion whatever the motion does.
CLEAR = 1.5


def steps_held(state: State, dt: float) -> tuple[int, float]:
    """How many steps of at most dt [s] a control of a state is held for, and how long they are.

    (1, dt) where the control is sampled at every step.
    """
    period = state.feedback.period if state.feedback is not None else None
    if period is None or dt >= period * (1 - 1e-9):
        return 1, dt
    count = math.ceil(period / dt * (1 - 1e-9))
    return count, period / count


def folded(rates: Any, period: float) -> Any:
    """Rates [1/s] as they are seen once a period [s]: turns by whole circles are not."""
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
    """The worst growth over a control period at a state; None where controls are held for a step.

    rates: those of the motion there [1/s]. period: [s], in place of the one that was asked for.
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
        matrix = often = np.full((1, 1), np.inf)
    if not np.isfinite(matrix).all():
        return step_growth(None, span, rates, horizon)
    growth = step_growth(matrix, span, folded(rates, span), horizon)
    if growth.stable or abs(growth.value) > CLEAR or not np.isfinite(often).all():
        return growth
    return growth_beyond_motion(growth, often, span, horizon)


def held_for(state: State, period: float | None) -> State:
    """The state with its control function held for a period [s]; None: for a step."""
    if state.feedback is None:
        return state
    return replace(state, feedback=replace(state.feedback, period=period))


def sampled_often(schedule: Schedule, dt: float) -> Schedule:
    """The schedule with a control period of at most dt [s]."""
    count = max(1, math.ceil(schedule.period / dt * (1 - 1e-9)))
    return replace(
        schedule,
        period=schedule.period / count,
        periods=schedule.periods * count,
        every=schedule.every * count,
    )
