"""The largest stable dt of a model under an integrator: the least over all states."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stepcore.engine.linear_maps import amplification
from stepcore.measure.diagnosis.growth import FACTOR, FINE, bisected, largest_stable, worst_growth
from stepcore.measure.diagnosis.linear_step import state_after, without_rows
from stepcore.measure.diagnosis.step_stability import StepStability

# The longest and the shortest step tried [s]: a scene that is unstable below that has another
# question to answer than its time step.
LONGEST, SHORTEST = 1.0, 1e-6
# Relative resolution of a state's limit until it is known to be the least.
COARSE = 0.03
# Relative resolution of a limit from the motion's rates, and how close beside it a step must be
# unstable.
FROM_RATES, TIGHT = 1e-4, 1 + 2 * FINE
# Parts of a limit at which a step must be stable too.
BELOW = (0.999, 0.7, 0.5, 0.25, 0.1)


@dataclass(frozen=True)
class Limit:
    """The largest stable dt of an integrator.

    dt: [s], inf where no step up to `longest` [s] is unstable, 0 where every step tried down to
    `shortest` [s] is. state: the index of the state that decides, -1 where none does. outcome:
    what the motion itself does beyond it, "explodes" or "chatters", where a run of the real step
    moved the limit; else "".
    """

    integrator: str
    dt: float
    state: int
    longest: float = LONGEST
    shortest: float = SHORTEST
    outcome: str = ""


def dt_limit(
    here: StepStability, integrator: str, longest: float = LONGEST, shortest: float = SHORTEST
) -> Limit:
    """The least of all states' largest stable steps, between `shortest` and `longest` [s]."""
    least, worst = math.inf, -1
    for k in range(len(here.states)):
        coarse = _coarse_limit(here, integrator, k, shortest, min(least, longest))
        if coarse < least:
            least, worst = coarse, k
        if least <= shortest:
            # One state is enough: nothing shorter is tried.
            least = 0.0
            break

    def stable(dt: float) -> bool:
        return here.growth(integrator, dt, worst).stable

    if worst >= 0 and least > 0 and stable(least * TIGHT):
        near = least * (1 + COARSE)
        if not stable(near):
            least = bisected(stable, least * TIGHT, near)
    return Limit(integrator, least, worst, longest, shortest)


def _coarse_limit(
    here: StepStability, integrator: str, state: int, shortest: float, high: float
) -> float:
    """A state's largest stable step [s] to a few per cent; inf where it is not below `high`."""

    def stable(dt: float) -> bool:
        return here.growth(integrator, dt, state).stable

    def stable_below(limit: float) -> bool:
        return all(stable(limit * part) for part in BELOW if limit * part > low)

    low = min(max(here.shortest(state), shortest), high / FACTOR)
    guess = _limit_from_rates(here, integrator, state, low, high)
    if guess is None:
        others = state > 0 and high < LONGEST
        if others and stable_below(high):
            return math.inf
        return largest_stable(stable, low, high, COARSE)
    # The rates do not show everything (the state moves within the step): look downwards.
    bound = min(guess, high)
    while bound > low and not stable_below(bound):
        bound /= FACTOR
    if bound == high:
        return math.inf
    if bound > low:
        low = bound * BELOW[0]
    if bound == guess and not stable(low * TIGHT):
        return low
    return largest_stable(stable, low, high, COARSE)


def _limit_from_rates(
    here: StepStability, integrator: str, state: int, low: float, high: float
) -> float | None:
    """The limit [s] that the rates of the motion give where no row acts, without a linearised step.

    None for states with rows or a control function, and for integrators whose step is not a
    function of dt·J.
    """
    rates, start = here.rates[state], here.states[state]
    if start.feedback is not None or not here.without_rows(start):
        return None
    if amplification(integrator, low * rates) is None:
        return None
    model = without_rows(here.model)

    def stable(dt: float) -> bool:
        values = amplification(integrator, dt * rates)
        if not worst_growth(values, dt, rates, here.horizon).stable:
            return False
        # The iteration of the midpoint rule may not converge.
        return state_after(model, start, integrator, dt, 1) is not None

    return largest_stable(stable, low, high, FROM_RATES)
