"""Search for the least changes of a model that make the wanted dt stable, and verify each.

For each way to change the limiting elements, the search finds the least change that leaves a margin
at the wanted dt. It works in both directions, on copies of the model and at every state. A run of
the real step confirms the change. Where one element is not enough, the elements that limit dt next
are changed by the same factor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from stepcore._core import Settings
from stepcore.engine.element import Element, Elements
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.changes import (
    ARMATURE,
    CHAIN,
    CHANGES,
    GAINS,
    LESS,
    Change,
    NewValue,
    changed,
    ratio,
    rounded,
    text_of,
)
from stepcore.measure.diagnosis.growth import bisected
from stepcore.measure.diagnosis.isolated import ElementLimits
from stepcore.measure.diagnosis.limits import LONGEST, Limit, StepStability, step_stability
from stepcore.measure.diagnosis.linear_motion import linear_motion
from stepcore.measure.diagnosis.linear_step import step_map
from stepcore.measure.diagnosis.motion_runs import stays_bounded
from stepcore.measure.diagnosis.saturation import settles
from stepcore.measure.diagnosis.shares import step_shares
from stepcore.report.units import seconds

# The stability margin of every change: the largest stable dt over the wanted one.
MARGIN = 1.5
# The most elements that one advice changes, and the relative resolution of its factor.
TOGETHER, FINE = 8, 0.01


@dataclass(frozen=True)
class Advice:
    """One way to make the wanted dt stable, with a stability margin of `MARGIN`.

    what: the name of the change, such as "kp" or "integrator".
    values: the new values of the scene.
    settings: the new settings.
    met: whether the change, made on the model, makes dt stable at every state. False means that no
        change of this kind is enough; the text says so.
    text: the change in words.
    size: how much the model changes: root sum of squares of |log| of the factors of its values; 0
        for settings.
    """

    what: str
    values: tuple[NewValue, ...]
    settings: dict[str, Any]
    met: bool
    text: str
    size: float = 0.0


def advise(
    now: StepStability,
    limits: dict[str, Limit],
    elements: dict[Element, ElementLimits],
    wanted: float,
    stiffest: Sequence[Element],
) -> list[Advice]:
    """Return the changes that work, the smallest change of the model first, then those that fail.

    now: the stability of the unchanged model.
    limits: the limits by integrator.
    elements: each element on its own.
    wanted: the wanted dt [s].
    stiffest: the elements, of one kind, that limit the model's own integrator.
    """
    settings = now.model.settings
    own = limits[settings.integrator]
    search = _Search(now, elements, own.integrator, wanted, own.state, bool(own.outcome))
    if own.outcome:
        search.servos = [element.index for element in stiffest if element.kind == "actuator"]
    tried = [search.least(change, stiffest) for change in CHANGES.get(stiffest[0].kind, ())]
    if settings.law == "penalty" and stiffest[0].kind == "contact":
        tried.append(search.softer_penalty())
    advice = [*_settings(now, limits, settings, wanted), *(a for a in tried if a is not None)]
    met = {a.what: a for a in advice if a.met}
    if "kp" in met or "kv" in met:
        # A single sufficient gain is a smaller change than both gains.
        advice = [a for a in advice if a.what != GAINS.what]
    if _owners(met.get(ARMATURE.what)) == _owners(met.get(CHAIN.what)):
        advice = [a for a in advice if a.what != CHAIN.what]
    return sorted(advice, key=lambda a: (not a.met, a.size))


def _owners(advice: Advice | None) -> set[str]:
    return {value.owner for value in advice.values} if advice else set()


def _settings(
    now: StepStability, limits: dict[str, Limit], settings: Settings, wanted: float
) -> Iterator[Advice]:
    for name, limit in limits.items():
        if name == settings.integrator or limit.dt < wanted:
            continue
        dt = f"up to {seconds(limit.dt)}"
        if math.isinf(limit.dt):
            short = limit.longest < LONGEST
            dt = f"at every dt tried, up to {seconds(limit.longest)}" if short else "at any dt"
        met = limit.dt >= MARGIN * wanted and _bounded(now, now.model, name, wanted, limit.state)
        text = f"use integrator {name}, stable {dt}" if met else f"integrator {name} (stable {dt})"
        yield Advice("integrator", (), {"integrator": name}, met, text)
    if settings.law == "solref" and not settings.refsafe:
        safe = step_stability(now.model.with_settings(refsafe=True), now.states, now.horizon)
        if all(safe.stable(settings.integrator, dt) for dt in (wanted, MARGIN * wanted)):
            text = "use refsafe=True, which softens rows that are too stiff for the step"
            yield Advice("refsafe", (), {"refsafe": True}, True, text)


def _bounded(now: StepStability, model: Model, name: str, dt: float, worst: int) -> bool:
    """Return whether the motion holds, and runs from the first and the worst state stay bounded."""
    if now.holds is not None and not now.holds(model, name, dt):
        return False
    states = dict.fromkeys((0, max(worst, 0)))
    return all(stays_bounded(model, now.states[k], name, dt, now.horizon) for k in states)


@dataclass
class _Search:
    """A search for the least change that is stable at the wanted dt.

    now: the stability of the unchanged model.
    elements: each element on its own.
    integrator: the integrator.
    wanted: the wanted dt [s].
    worst: the index of the state that decides so far.
    by_motion: whether the limit comes from a run of the motion, which then also judges every
        change.
    servos: the actuators that limit dt in that run, and must come to rest.
    nearest: the least excess growth found so far [1/s], and its x.
    """

    now: StepStability
    elements: dict[Element, ElementLimits]
    integrator: str
    wanted: float
    worst: int
    by_motion: bool = False
    servos: Sequence[int] = ()
    nearest: tuple[float, float] = field(default=(math.inf, 1.0))

    def least(self, change: Change, first: Sequence[Element]) -> Advice | None:
        """Return the least change of the limiting elements, extended to the next ones if needed.

        The result is None if the change applies to no element. If no value is stable, the advice
        says that the change fails.
        """
        group = [self.elements[element] for element in first if element in self.elements]
        if not group or not any(self._made(group, change, x)[1] for x in change.xs[:2]):
            return None
        while (x := self._enough(group, change)) is None:
            following = self._next(group, change)
            if following is None or len(group) >= max(TOGETHER, len(first)):
                return _not_enough(change, group[len(first) :])
            group.append(following)
        values = tuple(self._made(group, change, x)[1])
        size = math.sqrt(sum(value.size**2 for value in values))
        text = _chain_text(values, x) if change is CHAIN else text_of(values)
        return Advice(change.what, values, {}, True, text, size)

    def softer_penalty(self) -> Advice | None:
        """Return the stiffest contact spring of the law `penalty` that is stable, or None."""
        old = self.now.model.settings.penalty_stiffness

        def softer(factor: float) -> Model:
            stiffness = rounded(old * factor, up=False)
            return self.now.model.with_settings(penalty_stiffness=stiffness)

        def stable(factor: float) -> bool:
            return self._excess(softer(factor), self.now.states) <= 0

        for x in LESS.xs:
            if not stable(x):
                continue
            model = softer(bisected(stable, x, LESS.before(x), FINE))
            if _bounded(self.now, model, self.integrator, self.wanted, self.worst):
                new = model.settings.penalty_stiffness
                text = f"use penalty_stiffness={new:g} in place of {old:g} N/m"
                setting = {"penalty_stiffness": new}
                return Advice("penalty_stiffness", (), setting, True, text, ratio(old, new))
        return None

    def _made(
        self, group: Sequence[ElementLimits], change: Change, x: float
    ) -> tuple[Model, list[NewValue]]:
        """Return the model with the change made, and its new values."""
        scene, values = changed(self.now.model, group, change, x, MARGIN * self.wanted)
        return Model(scene, self.now.model.settings), values

    def _stable(self, group: Sequence[ElementLimits], change: Change, x: float) -> bool:
        """Return whether every state is stable at the wanted dt and at the margin beyond it."""
        try:
            model, values = self._made(group, change, x)
        except (ValueError, ArithmeticError):
            # The scene refuses the value.
            return False
        if not values:
            return False
        # The worst state is checked first, because it is unstable most often.
        worst = self.now.states[self.worst]
        if self._excess(model, [worst], x) > 0 or self._excess(model, self.now.states) > 0:
            return False
        return not self.by_motion or self._holds(model)

    def _holds(self, model: Model) -> bool:
        """Return whether the motion holds and the servos settle at the margin's step."""
        beyond, begin = MARGIN * self.wanted, self.now.states[0]
        return _bounded(self.now, model, self.integrator, beyond, self.worst) and all(
            settles(model, begin, self.integrator, dt, servo)
            for servo in self.servos
            for dt in (self.wanted, beyond)
        )

    def _excess(self, model: Model, states: Sequence[Any], x: float | None = None) -> float:
        """Return the largest excess growth [1/s] at the wanted dt and at its margin."""
        try:
            made = step_stability(model, states, self.now.horizon)
        except ValueError:
            return math.inf
        largest = -math.inf
        for dt in (MARGIN * self.wanted, self.wanted):
            for k in range(len(made.states)):
                largest = max(largest, made.growth(self.integrator, dt, k).excess)
                if largest > 0:
                    break
        if x is not None:
            self.nearest = min(self.nearest, (largest, x))
        return largest

    def _enough(self, group: Sequence[ElementLimits], change: Change) -> float | None:
        """Return the x nearest to no change that is stable, refined by bisection, or None."""
        self.nearest = (math.inf, change.xs[0])
        for x in change.xs:
            if not self._stable(group, change, x):
                continue
            stable = partial(self._stable, group, change)
            for least in dict.fromkeys((bisected(stable, x, change.before(x), FINE), x)):
                model, _ = self._made(group, change, least)
                if _bounded(self.now, model, self.integrator, self.wanted, self.worst):
                    return least
        return None

    def _next(self, group: Sequence[ElementLimits], change: Change) -> ElementLimits | None:
        """Return the element that limits dt after the group's most effective change, or None."""
        model, _ = self._made(group, change, self.nearest[1])
        made = step_stability(model, self.now.states, self.now.horizon)
        dt = MARGIN * self.wanted
        every = range(len(made.states))
        growths = [made.growth(self.integrator, dt, k) for k in every]
        worst = max(every, key=lambda k: growths[k].excess)
        state = made.states[worst]
        motion = linear_motion(made.model, state, dt)
        matrix = step_map(made.model, state, self.integrator, dt)
        if motion is None or matrix is None or growths[worst].stable:
            return None
        value = growths[worst].value
        shares = step_shares(motion, self.integrator, dt, matrix, value)
        have = {limits.element for limits in group}
        for element in sorted(shares, key=lambda element: -shares[element]):
            if shares[element] > 0.1 and element in self.elements and element not in have:
                possible = change in CHANGES.get(element.kind, ())
                return self.elements[element] if possible else None
        return None


def _not_enough(change: Change, more: Sequence[ElementLimits]) -> Advice:
    """Return the advice that a change fails.

    more: the elements that were changed in addition to those that limit dt.
    """
    names = Elements(limits.element for limits in more).name
    text = f"{change.what} (of {names} too)" if more else change.what
    return Advice(change.what, (), {}, False, text)


def _chain_text(values: Sequence[NewValue], x: float) -> str:
    joints = Elements(value.element for value in values).name
    low, high = min(v.after[0] for v in values), max(v.after[0] for v in values)
    unit = values[0].unit if len({value.unit for value in values}) == 1 else ""
    return (
        f"add armature to {joints}: {x:.3g} times the inertia that each moves, "
        f"which makes the armature {low:.3g} to {high:.3g} {unit}".rstrip()
    )
