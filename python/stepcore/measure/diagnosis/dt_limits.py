"""The largest stable dt of a model under an integrator, over all states looked at."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore.engine.linear_maps import amplification
from stepcore.engine.model import Model
from stepcore.measure.diagnosis import growth
from stepcore.measure.diagnosis.growth import Growth
from stepcore.measure.diagnosis.linear_motion import LinearMotion, parts
from stepcore.measure.diagnosis.linear_step import (
    ON_GUESS,
    State,
    flow,
    later,
    rates_matrix,
    step_map,
    without_rows,
)
from stepcore.measure.diagnosis.solref import first_softened

# The longest step tried [s], and the shortest in units of the motion's fastest time.
LONGEST, SHORTEST = 1.0, 1e-4
# How finely a state's limit is told until it is known to be the least.
COARSE = 0.03
# How finely the motion's own rates tell it, and how close beside it an unstable step must be.
GUESSED, TIGHT = 1e-4, 1 + 2 * growth.FINE
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
    _parts: dict[int, LinearMotion | None] = field(default_factory=dict, repr=False, compare=False)
    _seen: dict[tuple[str, float, int], tuple[State, Growth]] = field(
        default_factory=dict, repr=False, compare=False
    )

    def parts(self, state: State, dt: float | None = None) -> LinearMotion | None:
        """The elements at a state, with rows as soft as they are at this step (None: as the scene
        asks); None where its accelerations are not finite."""
        as_asked = dt is None or not (self._soft(state, dt) or self._on_guess(state))
        index = next((k for k, own in enumerate(self.states) if own is state), None)
        if not as_asked or index is None:
            return parts(self.model, state, dt)
        if index not in self._parts:
            self._parts[index] = parts(self.model, state, None)
        return self._parts[index]

    def _on_guess(self, state: State) -> bool:
        """Whether rows act there that are as stiff as the step is short."""
        return self.model.settings.law in ON_GUESS and bool(state.rows)

    def grown(self, integrator: str, dt: float, state: int) -> Growth:
        """The worst growth of a step at one state."""
        return self.seen(integrator, dt, state)[1]

    def seen(self, integrator: str, dt: float, state: int) -> tuple[State, Growth]:
        """The worst growth of a step at one state, and where it was seen.

        Rows that begin to act within the step are looked at once they do: meeting them is no
        growth. Rows that `refsafe` softens with dt come to rest elsewhere: where they seem
        unstable they are looked at again after some steps of this dt.
        """
        at = (integrator, dt, state)
        if at not in self._seen:
            self._seen[at] = self._look(integrator, dt, state)
        return self._seen[at]

    def _look(self, integrator: str, dt: float, state: int) -> tuple[State, Growth]:
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

    def model_at(self, state: State) -> Model:
        """The model without its rows where none acts: one that only begins to act within the step
        belongs to the states where it acts."""
        return without_rows(self.model) if self._smooth(state) else self.model

    def _smooth(self, state: State) -> bool:
        """Whether no row and no contact acts there."""
        return not state.rows and self.model.settings.law != "penalty"

    def _soft(self, state: State, dt: float) -> bool:
        """Whether `refsafe` makes rows that act there softer than the scene."""
        return dt > self.softened and bool(state.rows)

    def _growth(self, integrator: str, dt: float, state: State, rates: Any = None) -> Growth:
        """At a state whose rates of the motion are these, or are found here."""
        model = self.model_at(state)
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
        if self._on_guess(state) and abs(cmath.phase(found.value)) < growth.SLOW_TURN:
            # What the motion does along its rows is not known from the motion without them.
            return replace(found, excess=-math.inf)
        if self._opens(integrator, dt, state):
            return replace(found, excess=-math.inf)
        # Where the state itself moves within the step, or a row begins or ends to act, the rates
        # at its start do not tell: the same time in shorter steps does.
        shorter = flow(model, state, integrator, dt, SHORTER)
        return found if shorter is None else growth.beyond(found, shorter, dt, self.horizon)

    def _opens(self, integrator: str, dt: float, state: State) -> bool:
        """Whether a row ends to act within the time of the step, in shorter steps too: a map from
        one side of a switch to the other is no step that could be repeated."""
        if not state.rows or self._soft(state, dt):
            return False
        here = state
        for _ in range(SHORTER):
            after = later(self.model, here, integrator, dt / SHORTER, 1)
            if after is None:
                return False
            here = after[0]
            if not set(state.rows) <= set(here.rows):
                return True
        return False

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

        if worst >= 0 and least > 0 and stable(least * TIGHT):
            near = least * (1 + COARSE)
            if not stable(near):
                least = growth.between(stable, least * TIGHT, near)
        return Limit(integrator, least, worst, longest)

    def _coarse(self, integrator: str, state: int, high: float) -> float:
        """A state's largest stable step to a few parts in a hundred; inf where it is not below
        `high`."""

        def stable(dt: float) -> bool:
            return self.grown(integrator, dt, state).stable

        def far(limit: float) -> bool:
            return all(stable(limit * part) for part in BELOW if limit * part > low)

        low = self.shortest(state)
        guess = self._guess(integrator, state, low, high)
        if guess is None:
            others = state > 0 and high < LONGEST
            if others and far(high):
                return math.inf
            return growth.largest_stable(stable, low, high, COARSE)
        # What the rates do not know (the state moves within the step) is looked for downwards.
        bound = min(guess, high)
        while bound > low and not far(bound):
            bound /= growth.FACTOR
        if bound == high:
            return math.inf
        if bound > low:
            low = bound * BELOW[0]
        if bound == guess and not stable(low * TIGHT):
            return low
        return growth.largest_stable(stable, low, high, COARSE)

    def _guess(self, integrator: str, state: int, low: float, high: float) -> float | None:
        """The limit that the rates of the motion give where no row acts, without linearising a
        step; None of other states and integrators."""
        rates, here = self.rates[state], self.states[state]
        if not self._smooth(here) or amplification(integrator, low * rates) is None:
            return None
        model = without_rows(self.model)

        def stable(dt: float) -> bool:
            values = amplification(integrator, dt * rates)
            if not growth.worst_of(values, dt, rates, self.horizon).stable:
                return False
            # An iteration may not converge.
            return later(model, here, integrator, dt, 1) is not None

        return growth.largest_stable(stable, low, high, GUESSED)

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
