"""The largest stable dt of a model under an integrator, over all states looked at."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stepcore.diagnose import growth
from stepcore.diagnose.growth import Growth
from stepcore.diagnose.linear import (
    ON_GUESS,
    State,
    flow,
    later,
    rates_matrix,
    step_map,
    without_rows,
)
from stepcore.diagnose.softness import first_softened
from stepcore.model import Model

# The longest step tried [s], and the shortest in units of the motion's fastest time.
LONGEST, SHORTEST = 1.0, 1e-4
# How finely a state's limit is told until it is known to be the least.
COARSE = 0.03
# Steps below a limit at which another state must be stable too.
BELOW = (0.999, 0.7, 0.5, 0.25, 0.1)
# An eigenvalue of this size is an explosion whatever the motion does.
CLEAR = 1.5
# How many shorter steps tell what a motion does within one.
SHORTER = 4
# Steps that a row may take to begin to act, and after which one that refsafe softens, to a time
# constant of 2 dt, is at rest.
MEETINGS, SETTLING = 3, 30


@dataclass(frozen=True)
class Limit:
    """The largest stable dt [s], inf where none up to `longest` is unstable, and who says so.

    state: the index of the state that decides, -1 where none does.
    """

    integrator: str
    dt: float
    state: int
    longest: float = LONGEST


@dataclass(frozen=True)
class Situation:
    """A model at the states looked at, with the rates of its own motion there.

    rates: the eigenvalues of J at each state [1/s]; horizon [s]: see `growth`. softened: the
    least dt from which `refsafe` softens a row [s].
    """

    model: Model
    states: Sequence[State]
    rates: Sequence[Any]
    horizon: float
    softened: float

    def grown(self, integrator: str, dt: float, state: int) -> Growth:
        """The worst growth of a step at one state."""
        return self.seen(integrator, dt, state)[1]

    def seen(self, integrator: str, dt: float, state: int) -> tuple[State, Growth]:
        """The worst growth of a step at one state, and where it was seen.

        Rows that begin to act within the step are looked at once they do: meeting them is no
        growth. Rows that `refsafe` softens with dt come to rest elsewhere: where they seem
        unstable they are looked at again after some steps of this dt.
        """
        here = self.states[state]
        found = self._growth(integrator, dt, here, self.rates[state])
        for _ in range(MEETINGS):
            after = None if found.stable else later(self.model, here, integrator, dt, 1)
            if after is None or after[1] <= set(here.rows):
                break
            here, found = after[0], self._growth(integrator, dt, after[0])
        if found.stable or not self._soft(here, dt):
            return here, found
        rest = later(self.model, here, integrator, dt, SETTLING)
        if rest is None:
            return here, found
        return rest[0], self._growth(integrator, dt, rest[0])

    def _soft(self, state: State, dt: float) -> bool:
        """Whether `refsafe` makes rows that act there softer than the scene."""
        return dt > self.softened and bool(state.rows)

    def _growth(self, integrator: str, dt: float, state: State, rates: Any = None) -> Growth:
        """At a state whose rates of the motion are these, or are found here."""
        model = self.model
        if not state.rows and model.settings.law != "penalty":
            # A row that only begins to act within the step belongs to the states where it acts.
            model = without_rows(model)
        matrix = step_map(model, state, integrator, dt)
        soft = self._soft(state, dt)
        if soft or rates is None:
            # Of rows as soft as they are at this dt.
            own = rates_matrix(model, state, dt if soft else None)
            if own is not None:
                rates = np.linalg.eigvals(own)
        if rates is None:
            return growth.growth(None, dt, np.zeros(1), self.horizon)
        found = growth.growth(matrix, dt, rates, self.horizon)
        if found.stable or abs(found.value) > CLEAR:
            return found
        on_guess = self.model.settings.law in ON_GUESS and bool(state.rows)
        if on_guess and abs(cmath.phase(found.value)) < growth.SLOW_TURN:
            # What the motion does along its rows is not known from the motion without them.
            return replace(found, excess=-math.inf)
        # Where the state itself moves within the step, or a row begins or ends to act, the rates
        # at its start do not tell: the same time in shorter steps does.
        shorter = flow(model, state, integrator, dt, SHORTER)
        return found if shorter is None else growth.beyond(found, shorter, dt, self.horizon)

    def stable(self, integrator: str, dt: float) -> bool:
        """Whether a step is stable at every state."""
        return all(self.grown(integrator, dt, k).stable for k in range(len(self.states)))

    def limit(self, integrator: str, longest: float = LONGEST) -> Limit:
        """The least of all states' largest stable steps."""
        least, worst = math.inf, -1
        for k in range(len(self.states)):
            here = self._coarse(integrator, k, min(least, longest))
            if here < least:
                least, worst = here, k

        def stable(dt: float) -> bool:
            return self.grown(integrator, dt, worst).stable

        if worst >= 0 and least > 0:
            near = least * (1 + COARSE)
            if not stable(near):
                least = growth.between(stable, least, near)
        return Limit(integrator, least, worst, longest)

    def _coarse(self, integrator: str, state: int, high: float) -> float:
        """A state's largest stable step to a few parts in a hundred; inf where it is not below
        `high`."""

        def stable(dt: float) -> bool:
            return self.grown(integrator, dt, state).stable

        low = self.shortest(state)
        others = state > 0 and high < LONGEST
        if others and all(stable(high * part) for part in BELOW if high * part > low):
            return math.inf
        return growth.largest_stable(stable, low, high, COARSE)

    def shortest(self, state: int) -> float:
        """Where the search for a state's limit begins [s]."""
        fastest = float(np.abs(self.rates[state]).max(initial=0.0))
        return SHORTEST / max(fastest, 1.0)


def situation(model: Model, states: Sequence[State], horizon: float) -> Situation:
    """The states at which the motion has a derivative; ValueError where the start has none."""
    kept, rates = [], []
    for state in states:
        matrix = rates_matrix(model, state)
        if matrix is not None:
            kept.append(state)
            rates.append(np.linalg.eigvals(matrix))
    if not kept:
        raise ValueError("the scene cannot be linearised: its accelerations are not finite")
    return Situation(model, kept, rates, horizon, first_softened(model))
