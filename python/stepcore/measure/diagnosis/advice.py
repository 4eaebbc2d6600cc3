"""Changes that make the wanted dt stable: values searched on the model itself, and verified.

For each way to change the limiting elements the least change that is stable at the wanted dt is
searched for, on copies of the model and at every state. Where one element is not enough, those
that limit dt next are changed by the same factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.changes import (
    CHANGES,
    DAMPING,
    GAINS,
    Change,
    NewValue,
    changed,
)
from stepcore.measure.diagnosis.dt_limits import Limit
from stepcore.measure.diagnosis.element_id import ElementId
from stepcore.measure.diagnosis.element_limits import ElementLimits
from stepcore.measure.diagnosis.linear_motion import linear_motion
from stepcore.measure.diagnosis.linear_step import step_map
from stepcore.measure.diagnosis.shares import step_shares
from stepcore.measure.diagnosis.step_stability import StepStability, step_stability
from stepcore.report.units import seconds

# The most elements that one piece of advice changes, and the relative resolution of its factor.
TOGETHER, FINE = 8, 1.01


@dataclass(frozen=True)
class Advice:
    """One way to make the wanted dt stable.

    what: what is changed, such as "kp" or "integrator". values: the new values of the scene;
    settings: or the new settings. met: it was made on the model, and the dt is stable at every
    state; where no change of its kind is enough it is False, and the text says so.
    """

    what: str
    values: tuple[NewValue, ...]
    settings: dict[str, Any]
    met: bool
    text: str


def advise(
    now: StepStability,
    limits: dict[str, Limit],
    elements: dict[ElementId, ElementLimits],
    wanted: float,
    stiffest: Sequence[ElementId],
) -> list[Advice]:
    """All ways that were found, values first, then settings.

    limits: by integrator. wanted: the dt [s]. stiffest: what limits the model's own integrator, of
    one kind.
    """
    settings = now.model.settings
    search = _Search(now, elements, settings.integrator, wanted, limits[settings.integrator].state)
    tried = [search.least(change, stiffest) for change in CHANGES.get(stiffest[0].kind, ())]
    advice = [a for a in tried if a is not None]
    if any(a.met for a in advice if a.what in ("kp", "kv")):
        # One gain is enough: both together is more change than is needed.
        advice = [a for a in advice if a.what != GAINS.what]
    return advice + _settings(now, limits, settings, wanted)


def _settings(
    now: StepStability, limits: dict[str, Limit], settings: Settings, wanted: float
) -> list[Advice]:
    advice = []
    for name, limit in limits.items():
        if name != settings.integrator and limit.dt >= wanted:
            dt = "at any dt" if math.isinf(limit.dt) else f"up to {seconds(limit.dt)}"
            text = f"use integrator {name}, stable {dt}"
            advice.append(Advice("integrator", (), {"integrator": name}, True, text))
    if settings.law == "solref" and not settings.refsafe:
        safe = step_stability(now.model.with_settings(refsafe=True), now.states, now.horizon)
        if safe.stable(settings.integrator, wanted):
            text = "use refsafe=True, which softens rows that are too stiff for the step"
            advice.append(Advice("refsafe", (), {"refsafe": True}, True, text))
    return advice


@dataclass
class _Search:
    """The least change that is stable at the wanted dt. worst: the state that decides so far."""

    now: StepStability
    elements: dict[ElementId, ElementLimits]
    integrator: str
    wanted: float
    worst: int

    def least(self, change: Change, first: Sequence[ElementId]) -> Advice | None:
        """Changes the limiting elements, and what limits dt next, as little as is enough."""
        group = [self.elements[element] for element in first if element in self.elements]
        if not group or not self._made(group, change, change.xs[-1])[1]:
            return None
        while (x := self._factor(group, change)) is None:
            following = self._next(group, change)
            if following is None or len(group) >= TOGETHER:
                return _not_enough(change, group)
            group.append(following)
        values = tuple(self._made(group, change, x)[1])
        text = ", ".join(value.text for value in values)
        return Advice(change.what, values, {}, True, text)

    def _made(
        self, group: Sequence[ElementLimits], change: Change, x: float
    ) -> tuple[StepStability, list[NewValue]]:
        """The model with the change made, at the same states."""
        scene, values = changed(self.now.model, group, change, x)
        model = Model(scene, self.now.model.settings)
        return step_stability(model, self.now.states, self.now.horizon), values

    def _stable(self, group: Sequence[ElementLimits], change: Change, x: float) -> bool:
        try:
            made, _ = self._made(group, change, x)
        except ValueError:
            # A value that the scene refuses.
            return False
        # The state that decides first: it is unstable most often.
        if (
            self.worst < len(made.states)
            and not made.growth(self.integrator, self.wanted, self.worst).stable
        ):
            return False
        return made.stable(self.integrator, self.wanted)

    def _factor(self, group: Sequence[ElementLimits], change: Change) -> float | None:
        """The first x that is enough, refined by bisection; None where none is."""
        enough = self._first(group, change)
        if enough is None:
            return None
        good = change.xs[enough]
        bad = change.xs[enough - 1] if enough else (1.0 if good < 1 else good / 2)
        while max(good / bad, bad / good) > FINE:
            middle = math.sqrt(good * bad)
            good, bad = (middle, bad) if self._stable(group, change, middle) else (good, middle)
        return good

    def _first(self, group: Sequence[ElementLimits], change: Change) -> int | None:
        """The index of the first x that is enough."""
        xs = change.xs
        if change is DAMPING:
            # Explicit damping beyond what is enough is unstable again.
            return next((k for k, x in enumerate(xs) if self._stable(group, change, x)), None)
        low, high = -1, len(xs) - 1
        if not self._stable(group, change, xs[high]):
            return None
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self._stable(group, change, xs[middle]) else (middle, high)
        return high

    def _next(self, group: Sequence[ElementLimits], change: Change) -> ElementLimits | None:
        """The element that limits dt once these are changed by as much as is tried."""
        made, _ = self._made(group, change, change.xs[-1])
        every = range(len(made.states))
        growths = [made.growth(self.integrator, self.wanted, k) for k in every]
        worst = max(every, key=lambda k: growths[k].excess)
        state = made.states[worst]
        motion = linear_motion(made.model, state, self.wanted)
        matrix = step_map(made.model, state, self.integrator, self.wanted)
        if motion is None or matrix is None or growths[worst].stable:
            return None
        value = growths[worst].value
        shares = step_shares(motion, self.integrator, self.wanted, matrix, value)
        have = {limits.element for limits in group}
        for element in sorted(shares, key=lambda element: -shares[element]):
            if shares[element] > 0.1 and element in self.elements and element not in have:
                possible = change in CHANGES.get(element.kind, ())
                return self.elements[element] if possible else None
        return None


def _not_enough(change: Change, group: Sequence[ElementLimits]) -> Advice:
    names = " and ".join(limits.name for limits in group)
    return Advice(change.what, (), {}, False, f"change {change.what} of {names} alone")
