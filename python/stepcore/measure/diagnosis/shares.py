"""Who it is: the elements' shares in the mode that sets a limit."""

from __future__ import annotations

import math

import numpy as np

from stepcore.measure.diagnosis.dt_limits import Limit, Situation
from stepcore.measure.diagnosis.growth import growth
from stepcore.measure.diagnosis.linear_motion import Shares
from stepcore.measure.diagnosis.linear_step import step_map

# Past a limit an eigenvalue has left its partner: there it tells what drives it.
BEYOND = 1.05


def shares_at(here: Situation, limit: Limit) -> Shares:
    """What each element has in the eigenvalue that sets a limit, or in the fastest motion."""
    if math.isinf(limit.dt):
        every = range(len(here.rates))
        return _fastest(here, max(every, key=lambda k: abs(here.rates[k]).max(initial=0.0)))
    dt = max(limit.dt, here.shortest(limit.state)) * BEYOND
    state, worst = here.seen(limit.integrator, dt, limit.state)
    motion = here.parts(state, dt)
    if motion is None:
        return _fastest(here, limit.state)
    # The elements' own step, where it tells of the same: what it leaves out is no element's.
    with np.errstate(over="ignore", invalid="ignore"):
        made = motion.step(limit.integrator, dt)
    if not np.all(np.isfinite(made)):
        # So long a step leaves for a state where nothing can be told.
        return _fastest(here, limit.state)
    same = growth(made, dt, np.linalg.eigvals(motion.rates), here.horizon)
    if not same.stable:
        return motion.shares(limit.integrator, dt, made, same.value)
    if math.isinf(worst.rate):
        # A step that does not stay finite, or an iteration that does not converge.
        return _fastest(here, limit.state)
    matrix = step_map(here.model_at(state), state, limit.integrator, dt)
    if matrix is None:
        return _fastest(here, limit.state)
    return motion.shares(limit.integrator, dt, matrix, worst.value)


def _fastest(here: Situation, state: int) -> Shares:
    motion = here.parts(here.states[state])
    return {} if motion is None else motion.fastest()
