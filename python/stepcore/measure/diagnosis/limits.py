"""Compute the largest stable dt: the stability of a step at given states, and the least limit."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore.engine.linear_maps import amplification
from stepcore.engine.model import Model
from stepcore.executors import checkpoint
from stepcore.measure.diagnosis.control import CLEAR, growth_when_held
from stepcore.measure.diagnosis.elements import first_softened
from stepcore.measure.diagnosis.growth import (
    FACTOR,
    FINE,
    SLOW_TURN,
    StepGrowth,
    bisected,
    eigenvalues,
    growth_beyond_motion,
    largest_stable,
    step_growth,
    worst_growth,
)
from stepcore.measure.diagnosis.linear_motion import LinearMotion, linear_motion
from stepcore.measure.diagnosis.linear_step import (
    VELOCITY_LAWS,
    State,
    rates_matrix,
    state_after,
    step_map,
    step_maps,
    without_rows,
)

# A function of (model, integrator, dt [s]).
Holds = Callable[[Model, str, float], bool]
# The shortest step tried, over the fastest time constant of the motion.
EARLIEST = 1e-4
# The number of shorter steps that show the motion within one step.
SHORTER = 4
# The most steps until a row begins to act, and the steps until a row that refsafe softens, to a
# time constant of 2 dt, is at rest.
MEETINGS, SETTLING = 3, 30


@dataclass(frozen=True)
class StepStability:
    """A model at the states at which its step is linearised.

    model: the model.
    states: the states.
    rates: the eigenvalues of J at each state [1/s].
    horizon: see `growth` [s].
    softened: the least dt above which `refsafe` softens a row [s].
    holds: a function of (model, integrator, dt) that returns whether a run of the motion at this
        step neither explodes nor chatters; None if no motion was run.
    """

    model: Model
    states: Sequence[State]
    rates: Sequence[Any]
    horizon: float
    softened: float
    holds: Holds | None = None
    _motions: dict[int, LinearMotion | None] = field(
        default_factory=dict, repr=False, compare=False
    )
    _seen: dict[tuple[str, float, int], tuple[State, StepGrowth]] = field(
        default_factory=dict, repr=False, compare=False
    )

    def motion(self, state: State, dt: float | None = None) -> LinearMotion | None:
        """Return the linearised motion at a state, or None if its accelerations are not finite.

        state: the state.
        dt: a step [s], whose softness of the rows is used; None: the softness of the scene.
        """
        as_asked = dt is None or not (self._softened(state, dt) or self._on_velocities(state))
        index = next((k for k, own in enumerate(self.states) if own is state), None)
        if not as_asked or index is None:
            return linear_motion(self.model, state, dt)
        if index not in self._motions:
            self._motions[index] = linear_motion(self.model, state, None)
        return self._motions[index]

    def stable(self, integrator: str, dt: float) -> bool:
        """Return whether a step is stable at every state, and a run of the motion confirms it."""
        every = range(len(self.states))
        if not all(self.growth(integrator, dt, k).stable for k in every):
            return False
        return self.holds is None or self.holds(self.model, integrator, dt)

    def of(self, model: Model) -> StepStability:
        """Return the stability of a changed model at the same states."""
        return step_stability(model, self.states, self.horizon, self.holds)

    def growth(self, integrator: str, dt: float, state: int) -> StepGrowth:
        """Return the worst growth of a step at one state."""
        return self.growth_where_seen(integrator, dt, state)[1]

    def growth_where_seen(self, integrator: str, dt: float, state: int) -> tuple[State, StepGrowth]:
        """Return the state at which the worst growth of a step appears, and that growth.

        Rows that begin to act within the step are judged at the later state where they act, because
        the transition itself is no growth. Rows that `refsafe` softens with dt come to rest
        elsewhere. If they seem unstable, they are judged again after some steps of this dt.
        """
        at = (integrator, dt, state)
        if at not in self._seen:
            checkpoint()
            self._seen[at] = self._worse_when_held(*at, *self._find_growth(integrator, dt, state))
        return self._seen[at]

    def _worse_when_held(
        self, integrator: str, dt: float, state: int, seen: State, growth: StepGrowth
    ) -> tuple[State, StepGrowth]:
        """Return the growth over a control period of several steps, if worse than the step's."""
        own, rates = self.states[state], self.rates[state]
        held = growth_when_held(self.model_at(own), own, rates, integrator, dt, self.horizon)
        if held is None or held.excess <= growth.excess:
            return seen, growth
        return own, held

    def _find_growth(self, integrator: str, dt: float, state: int) -> tuple[State, StepGrowth]:
        here = self.states[state]
        growth = self._growth_at(integrator, dt, here, self.rates[state])
        for _ in range(MEETINGS):
            after = None if growth.stable else state_after(self.model, here, integrator, dt, 1)
            if after is None or after[1] <= set(here.rows):
                break
            here, growth = after[0], self._growth_at(integrator, dt, after[0])
        if growth.stable or not self._softened(here, dt):
            return here, growth
        rest = state_after(self.model, here, integrator, dt, SETTLING)
        if rest is None:
            return here, growth
        return rest[0], self._growth_at(integrator, dt, rest[0])

    def _growth_at(self, integrator: str, dt: float, state: State, rates: Any = None) -> StepGrowth:
        """Return the worst growth at a state.

        rates: the rates of the motion there [1/s], if known.
        """
        model = self.model_at(state)
        matrix = step_map(model, state, integrator, dt)
        softened = self._softened(state, dt)
        if softened or rates is None:
            # The rates are those of rows as soft as at this dt.
            own = rates_matrix(model, state, dt if softened else None)
            rates = eigenvalues(own)
        if rates is None:
            return step_growth(None, dt, np.zeros(1), self.horizon)
        growth = step_growth(matrix, dt, rates, self.horizon)
        if growth.stable or abs(growth.value) > CLEAR:
            return growth
        if self._on_velocities(state) and abs(cmath.phase(growth.value)) < SLOW_TURN:
            # The motion without its rows does not show the motion along them.
            return replace(growth, excess=-math.inf)
        opened = self._opened(integrator, dt, state)
        if opened is not None:
            # Growth belongs to the switch unless it persists after the row has ceased to act.
            after = self._growth_at(integrator, dt, opened)
            return replace(growth, excess=-math.inf) if after.stable else after
        # If the state moves within the step, or a row begins or ceases to act, the rates at its
        # start do not decide. Shorter steps over the same time do.
        shorter = step_maps(model, state, integrator, dt, SHORTER)
        return (
            growth if shorter is None else growth_beyond_motion(growth, shorter, dt, self.horizon)
        )

    def _opened(self, integrator: str, dt: float, state: State) -> State | None:
        """Return the state in which a row has ceased to act within the time of the step, or None.

        The row must cease in shorter steps too. A map from one side of a switch to the other is no
        step that could be repeated.
        """
        if not state.rows or self._softened(state, dt):
            return None
        here = state
        for _ in range(SHORTER):
            after = state_after(self.model, here, integrator, dt / SHORTER, 1)
            if after is None:
                return None
            here = after[0]
            if not set(state.rows) <= set(here.rows):
                return here
        return None

    def model_at(self, state: State) -> Model:
        """Return the model, without constraint rows if none acts at the state.

        A row that only begins to act within the step belongs to the states where it acts.
        """
        return without_rows(self.model) if self.without_rows(state) else self.model

    def without_rows(self, state: State) -> bool:
        """Return whether no row and no contact acts at a state."""
        return not state.rows and self.model.settings.law != "penalty"

    def _on_velocities(self, state: State) -> bool:
        """Return whether rows of stiffness 1/dt² act at a state."""
        return self.model.settings.law in VELOCITY_LAWS and bool(state.rows)

    def _softened(self, state: State, dt: float) -> bool:
        """Return whether `refsafe` softens rows that act at a state."""
        return dt > self.softened and not state.slipping.issuperset(state.rows)

    def shortest(self, state: int) -> float:
        """Return the shortest step [s] of the search for a state's limit."""
        fastest = float(np.abs(self.rates[state]).max(initial=0.0))
        return EARLIEST / max(fastest, 1.0)


def step_stability(
    model: Model, states: Sequence[State], horizon: float, holds: Holds | None = None
) -> StepStability:
    """Return the stability of a model's step at those states where the motion has a derivative.

    horizon: see `growth` [s].
    holds: see `StepStability`.

    Raises ValueError if the motion has no derivative at any of the states.
    """
    kept, rates = [], []
    for state in states:
        values = eigenvalues(rates_matrix(model, state))
        if values is not None:
            kept.append(state)
            rates.append(values)
    if not kept:
        raise ValueError("the scene cannot be linearised: its accelerations are not finite")
    return StepStability(model, kept, rates, horizon, first_softened(model), holds)


# The longest and the shortest step tried [s]. A scene that is unstable below the shortest has
# another problem than its time step.
LONGEST, SHORTEST = 1.0, 1e-6
# Relative resolution of a state's limit, before that limit is known to be the least.
COARSE = 0.03
# Relative resolution of a limit from the motion's rates, and the factor above a limit at which a
# step must be unstable.
FROM_RATES, TIGHT = 1e-4, 1 + 2 * FINE
# Fractions of a limit at which a step must be stable too.
BELOW = (0.999, 0.7, 0.5, 0.25, 0.1)


@dataclass(frozen=True)
class Limit:
    """The largest stable dt of an integrator.

    integrator: the integrator.
    dt: the limit [s]: inf if no step up to `longest` is unstable, 0 if every step tried down to
        `shortest` is unstable.
    state: the index of the state that decides, -1 if none does.
    longest, shortest: the range of the steps tried [s].
    outcome: what the motion itself does beyond dt, "explodes", "passes" (a body through another
        one) or "chatters", if a run of the real step moved the limit; "turns" if a spinning body
        makes more than half a turn in a longer step; else "".
    speed: the angular speed of the spinning body that limits dt [rad/s]; None for other limits.
    """

    integrator: str
    dt: float
    state: int
    longest: float = LONGEST
    shortest: float = SHORTEST
    outcome: str = ""
    speed: float | None = None


def dt_limit(
    here: StepStability, integrator: str, longest: float = LONGEST, shortest: float = SHORTEST
) -> Limit:
    """Return the least of all states' largest stable steps, within `shortest` to `longest` [s]."""
    least, worst = math.inf, -1
    for k in range(len(here.states)):
        coarse = _coarse_limit(here, integrator, k, shortest, min(least, longest))
        if coarse < least:
            least, worst = coarse, k
        if least <= shortest:
            # Nothing shorter is tried, so the other states cannot lower the limit.
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
    """Return a state's largest stable step [s] to a few per cent; inf if it is not below `high`."""

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
    # The rates do not show everything, because the state moves within the step: try shorter steps.
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
    """Return the limit [s] from the rates of the motion, without a linearised step, or None.

    The result is None for states with rows or a control function, and for integrators whose step is
    not a function of dt·J.
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
