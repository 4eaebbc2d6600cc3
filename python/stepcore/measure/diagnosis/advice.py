"""What to change so that a wanted dt is stable: values found on the model itself, and verified.

For each way to change the stiff elements the least change that is stable at the wanted dt is
looked for, on copies of the model and at every state looked at. Where one element is not enough,
those that limit next are changed by the same factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.changes import CHANGES, DAMPING, GAINS, Change, Value, changed
from stepcore.measure.diagnosis.dt_limits import Limit, Situation, situation
from stepcore.measure.diagnosis.element_forces import Key
from stepcore.measure.diagnosis.element_limits import ElementLimits
from stepcore.measure.diagnosis.linear_motion import parts
from stepcore.measure.diagnosis.linear_step import step_map
from stepcore.report.units import seconds

# The most elements that one piece of advice changes, and how finely its factor is told.
TOGETHER, FINE = 8, 1.01


@dataclass(frozen=True)
class Advice:
    """One way to a wanted dt. values: what it changes; settings: or which settings.

    met: it was made on the model and is stable at that dt at all states. Where nothing of its
    kind is enough it is not, and the text says so.
    """

    what: str
    values: tuple[Value, ...]
    settings: dict[str, Any]
    met: bool
    text: str


def advise(
    now: Situation,
    limits: dict[str, Limit],
    elements: dict[Key, ElementLimits],
    wanted: float,
    stiffest: Key,
) -> list[Advice]:
    """All ways found, values first, then settings. stiffest: what limits the model's integrator."""
    settings = now.model.settings
    search = _Search(now, elements, settings.integrator, wanted, limits[settings.integrator].state)
    found = [search.least(change, stiffest) for change in CHANGES.get(stiffest.kind, ())]
    told = [a for a in found if a is not None]
    if any(a.met for a in told if a.what in ("kp", "kv")):
        # One gain is enough: both together is more change than is needed.
        told = [a for a in told if a.what != GAINS.what]
    return told + _settings(now, limits, settings, wanted)


def _settings(
    now: Situation, limits: dict[str, Limit], settings: Settings, wanted: float
) -> list[Advice]:
    found = []
    for name, limit in limits.items():
        if name != settings.integrator and limit.dt >= wanted:
            least = "nothing limits it" if math.isinf(limit.dt) else f"{seconds(limit.dt)}"
            text = f"integrator {name} ({least})"
            found.append(Advice("integrator", (), {"integrator": name}, True, text))
    if settings.law == "solref" and not settings.refsafe:
        safe = situation(now.model.with_settings(refsafe=True), now.states, now.horizon)
        if safe.stable(settings.integrator, wanted):
            text = "refsafe=True (softens what is too stiff for the step)"
            found.append(Advice("refsafe", (), {"refsafe": True}, True, text))
    return found


@dataclass
class _Search:
    """The least change that is stable at the wanted dt."""

    now: Situation
    elements: dict[Key, ElementLimits]
    integrator: str
    wanted: float
    worst: int

    def least(self, change: Change, first: Key) -> Advice | None:
        """Changes the stiffest element, and what limits next, as little as is enough."""
        group = [self.elements[first]] if first in self.elements else []
        if not group or not self._made(group, change, change.xs[-1])[1]:
            return None
        while True:
            found = self._factor(group, change)
            if found is not None:
                break
            after = self._next(group, change)
            if after is None or len(group) >= TOGETHER:
                return self._missed(change, group, after)
            group.append(after)
        values = tuple(self._made(group, change, found)[1])
        text = ", ".join(value.text for value in values)
        return Advice(change.what, values, {}, True, text)

    def _made(
        self, group: Sequence[ElementLimits], change: Change, x: float
    ) -> tuple[Situation, list[Value]]:
        """The model with the change made, at the same states."""
        scene, values = changed(self.now.model, group, change, x)
        model = Model(scene, self.now.model.settings)
        return situation(model, self.now.states, self.now.horizon), values

    def _stable(self, group: Sequence[ElementLimits], change: Change, x: float) -> bool:
        try:
            made, _ = self._made(group, change, x)
        except ValueError:
            # A value that the scene refuses.
            return False
        # The state that decides first: it refuses most.
        if (
            self.worst < len(made.states)
            and not made.grown(self.integrator, self.wanted, self.worst).stable
        ):
            return False
        return made.stable(self.integrator, self.wanted)

    def _factor(self, group: Sequence[ElementLimits], change: Change) -> float | None:
        """The first x that is enough, told finely; None where none is."""
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
            # More than enough damping is too much where it is explicit.
            return next((k for k, x in enumerate(xs) if self._stable(group, change, x)), None)
        low, high = -1, len(xs) - 1
        if not self._stable(group, change, xs[high]):
            return None
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self._stable(group, change, xs[middle]) else (middle, high)
        return high

    def _next(self, group: Sequence[ElementLimits], change: Change) -> ElementLimits | None:
        """What limits once these are changed by a lot."""
        made, _ = self._made(group, change, change.xs[-1])
        every = range(len(made.states))
        grown = [made.grown(self.integrator, self.wanted, k) for k in every]
        worst = max(every, key=lambda k: grown[k].excess)
        state = made.states[worst]
        motion = parts(made.model, state, self.wanted)
        matrix = step_map(made.model, state, self.integrator, self.wanted)
        if motion is None or matrix is None or grown[worst].stable:
            return None
        shares = motion.shares(self.integrator, self.wanted, matrix, grown[worst].value)
        have = {figure.key for figure in group}
        for key in sorted(shares, key=lambda key: -shares[key]):
            if shares[key] > 0.1 and key in self.elements and key not in have:
                possible = change in CHANGES.get(key.kind, ())
                return self.elements[key] if possible else None
        return None

    def _missed(
        self, change: Change, group: Sequence[ElementLimits], after: ElementLimits | None
    ) -> Advice:
        names = " and ".join(figure.key.label for figure in group)
        text = f"{change.what} of {names} alone does not meet it"
        return Advice(change.what, (), {}, False, text)
