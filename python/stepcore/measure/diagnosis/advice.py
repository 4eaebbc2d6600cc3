"""Search for the least changes of a model that make the wanted dt stable.

For each way to change the limiting elements, the search finds the least change that leaves a margin
at the wanted dt. It works in both directions, on copies of the model and on the linearised step at
every state. Where one element is not enough, the elements that limit dt next are changed by the
same factor. `confirmation` then makes each change and diagnoses the motion again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from stepcore.engine.element import Element, Elements
from stepcore.engine.model import Model
from stepcore.experiment.motion import Motion
from stepcore.measure.diagnosis.changes import (
    ARMATURE,
    CHAIN,
    CHANGES,
    DAMPING,
    GAINS,
    LESS,
    STANDARD,
    Change,
    NewValue,
    changed,
    ratio,
    softened_to,
    text_of,
)
from stepcore.measure.diagnosis.elements import solref_of
from stepcore.measure.diagnosis.growth import bisected
from stepcore.measure.diagnosis.isolated import ElementLimits
from stepcore.measure.diagnosis.limits import Limit, StepStability, step_stability
from stepcore.measure.diagnosis.linear_motion import linear_motion
from stepcore.measure.diagnosis.linear_step import step_map
from stepcore.measure.diagnosis.motion_runs import stays_bounded
from stepcore.measure.diagnosis.saturation import settles
from stepcore.measure.diagnosis.shares import step_shares
from stepcore.report.units import rounded
from stepcore.scene.layout import Layout

# The stability margin of every change: the largest stable dt over the wanted one.
MARGIN = 1.5
# The most elements that one advice changes, and the relative resolution of its factor.
TOGETHER, FINE = 8, 0.01
# Changes of what a robot is built of; other changes are ranked before them.
HARDWARE = (ARMATURE.what, CHAIN.what, DAMPING.what)


# Names of changes in a list of those that fail, where they are not the name of the change.
SHORTLY = {
    "servo": "a servo in place of the control",
    "control_dt": "a shorter control period",
    "control gains": "gains of the control",
    "control gain on position": "gain on position of the control",
    "control gain on velocity": "gain on velocity of the control",
    "refsafe": "refsafe=True",
}


@dataclass(frozen=True)
class Advice:
    """One way to make the wanted dt stable, with a stability margin of `MARGIN`.

    what: the name of the change, such as "kp" or "integrator".
    values: the new values of the scene.
    settings: the new settings.
    met: whether the change, made on the model and diagnosed again, makes dt stable. False means
        that no change of this kind is enough; the text says so.
    text: the change in words.
    size: how much the model changes: root sum of squares of |log| of the factors of its values; 0
        for settings.
    limit: the largest stable dt [s] with the change made; inf if nothing limits it.
    """

    what: str
    values: tuple[NewValue, ...]
    settings: dict[str, Any]
    met: bool
    text: str
    size: float = 0.0
    limit: float | None = None

    @property
    def hardware(self) -> bool:
        """Whether the change is one of the robot itself: inertia or friction of its joints."""
        return self.what in HARDWARE

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """The order of a list of advice: what works first, hardware last, small changes first."""
        return not self.met, self.hardware, self.size


@dataclass(frozen=True)
class Cure:
    """A change that the linearised step shows to be enough, ready to be made.

    advice: the change.
    model: the model with the change made.
    motion: the motion under the change; None if it is the same.
    """

    advice: Advice
    model: Model
    motion: Motion | None = None


# A function of a stability margin that returns the least change that leaves it, or the advice that
# no such change is enough, or None if the change applies to nothing.
Way = Callable[[float], Cure | Advice | None]


def failed(what: str, text: str = "") -> Advice:
    """Return the advice that no change of this kind is enough.

    text: the change in a few words; "" for its name.
    """
    return Advice(what, (), {}, False, text or SHORTLY.get(what, what))


def ways(
    now: StepStability,
    limit: Limit,
    elements: dict[Element, ElementLimits],
    wanted: float,
    stiffest: Sequence[Element],
) -> Iterator[Way]:
    """Yield the ways to change the model's elements and settings, integrators excepted.

    now: the stability of the unchanged model.
    limit: the limit of the model's own integrator.
    elements: each element on its own.
    wanted: the wanted dt [s].
    stiffest: the elements, of one kind, that limit the model's own integrator; none if no single
        kind does.
    """
    settings = now.model.settings
    if not stiffest:
        return
    search = _Search(now, elements, limit.integrator, wanted, limit.state, bool(limit.outcome))
    if limit.outcome:
        search.servos = [element.index for element in stiffest if element.kind == "actuator"]
    if settings.law == "solref" and not settings.refsafe:
        yield search.refsafe
    if settings.law == "penalty" and stiffest[0].kind == "contact":
        yield search.softer_penalty
    for change in CHANGES.get(stiffest[0].kind, ()):
        yield partial(search.least, change, stiffest)


def repeats(advice: Advice, met: Sequence[Advice]) -> bool:
    """Return whether an advice contains a smaller change that works.

    met: the advice that works.
    """
    smaller = {a.what: a for a in met}
    if advice.what == GAINS.what:
        return "kp" in smaller or "kv" in smaller
    single = smaller.get(ARMATURE.what)
    return advice.what == CHAIN.what and _owners(single) == _owners(advice)


def _owners(advice: Advice | None) -> set[str]:
    return {value.owner for value in advice.values} if advice else set()


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
    margin: the stability margin that is searched for.
    nearest: the least excess growth found so far [1/s], and its x.
    """

    now: StepStability
    elements: dict[Element, ElementLimits]
    integrator: str
    wanted: float
    worst: int
    by_motion: bool = False
    servos: Sequence[int] = ()
    margin: float = MARGIN
    nearest: tuple[float, float] = field(default=(math.inf, 1.0))

    @property
    def beyond(self) -> float:
        """The step [s] at which a change must still be stable."""
        return self.margin * self.wanted

    def least(
        self, change: Change, first: Sequence[Element], margin: float
    ) -> Cure | Advice | None:
        """Return the least change of the limiting elements, extended to the next ones if needed.

        The result is None if the change applies to no element. If no value is stable, the advice
        says that the change fails.
        """
        return replace(self, margin=margin)._least(change, first)

    def _least(self, change: Change, first: Sequence[Element]) -> Cure | Advice | None:
        group = [self.elements[element] for element in first if element in self.elements]
        if not group or not any(self._made(group, change, x)[1] for x in change.xs[:2]):
            return None
        # The standard form with a time constant of 2 dt is stable wherever its rows act.
        group, x = (self._alike(group), 1.0) if change.what == STANDARD else (group, None)
        while x is None and (x := self._enough(group, change)) is None:
            following = self._next(group, change)
            if following is None or len(group) >= max(TOGETHER, len(first)):
                return _not_enough(change, group[len(first) :])
            group.append(following)
        model, values = self._made(group, change, x)
        size = math.sqrt(sum(value.size**2 for value in values))
        text = _chain_text(values, x) if change is CHAIN else text_of(values)
        if change.what == STANDARD:
            text += softened_to(values[0])
        text = f"hardware: {text}" if change.what in HARDWARE else text
        return Cure(Advice(change.what, tuple(values), {}, True, text, size), model)

    def softer_penalty(self, margin: float) -> Cure | Advice:
        """Return the stiffest contact spring of the law `penalty` that is stable."""
        search, old = replace(self, margin=margin), self.now.model.settings.penalty_stiffness

        def softer(factor: float) -> Model:
            stiffness = rounded(old * factor, up=False)
            return self.now.model.with_settings(penalty_stiffness=stiffness)

        def stable(factor: float) -> bool:
            return search._excess(softer(factor), self.now.states) <= 0

        name = "penalty_stiffness"
        for x in LESS.xs:
            if stable(x):
                model = softer(bisected(stable, x, LESS.before(x), FINE))
                new = model.settings.penalty_stiffness
                text = f"use {name}={new:g} in place of {old:g} N/m"
                return Cure(Advice(name, (), {name: new}, True, text, ratio(old, new)), model)
        return failed(name)

    def refsafe(self, margin: float) -> Cure | Advice:
        """Return the setting that softens rows with dt."""
        model = self.now.model.with_settings(refsafe=True)
        if replace(self, margin=margin)._excess(model, self.now.states) > 0:
            return failed("refsafe")
        text = "use refsafe=True, which softens rows that are too stiff for the step"
        return Cure(Advice("refsafe", (), {"refsafe": True}, True, text), model)

    def _made(
        self, group: Sequence[ElementLimits], change: Change, x: float
    ) -> tuple[Model, list[NewValue]]:
        """Return the model with the change made, and its new values."""
        scene, values = changed(self.now.model, group, change, x, self.beyond)
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
        beyond, begin = self.beyond, self.now.states[0]
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
        for dt in (self.beyond, self.wanted):
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
            return bisected(partial(self._stable, group, change), x, change.before(x), FINE)
        return None

    def _alike(self, group: Sequence[ElementLimits]) -> list[ElementLimits]:
        """Return a group of rows, and all others that have the kind and the solref of its first.

        Such rows have their solref from one default, and are changed there.
        """
        model, first = self.now.model, group[0]
        kind, like = first.element.kind, solref_of(model, first.element)
        every = [element for element in self.elements if element.kind == kind]
        if kind == "limit":
            # A limit that is never reached may be reached in the changed motion.
            joints = Layout(model.scene).joints
            limited = [j for j, joint in enumerate(joints) if joint.range is not None]
            every = [Element.of(model, kind, joint) for joint in limited]
        have = {limits.element for limits in group}
        more = (e for e in every if e not in have and solref_of(model, e) == like)
        return [*group, *(replace(first, element=element) for element in more)]

    def _next(self, group: Sequence[ElementLimits], change: Change) -> ElementLimits | None:
        """Return the element that limits dt after the group's most effective change, or None."""
        model, _ = self._made(group, change, self.nearest[1])
        made = step_stability(model, self.now.states, self.now.horizon)
        dt = self.beyond
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
    return failed(change.what, f"{change.what} (of {names} too)" if more else change.what)


def _chain_text(values: Sequence[NewValue], x: float) -> str:
    joints = Elements(value.element for value in values).name
    low, high = min(v.after[0] for v in values), max(v.after[0] for v in values)
    unit = values[0].unit if len({value.unit for value in values}) == 1 else ""
    return (
        f"add armature to {joints}: {x:.3g} times the inertia that each moves, "
        f"which makes the armature {low:.3g} to {high:.3g} {unit}".rstrip()
    )
