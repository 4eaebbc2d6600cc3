"""Fixes: the least change that leaves the wanted margin, made and run before it is printed.

A change has one number x: a gain is multiplied by x, an armature grows by x times the inertia that
the joint moves, a damping by x times the critical damping of the element, and a solref becomes
slower by 1/x. The least x is searched for with the linearised step if this has the limit of the
runs, else with runs. Then the change is made, and runs of the changed model are compared with its
converged motion. If the change leaves less than the margin, a larger margin is searched for.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.element import EQUALITIES, Element, Elements, SceneField
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.judge import Judge
from stepcore.experiment.pairs import Loop
from stepcore.measure.diagnosis.limits import FAILS, FINE, HOLDS, STEP, Limit, run_limit
from stepcore.measure.diagnosis.linear import Held, State, bisected, solref_of
from stepcore.measure.diagnosis.naming import (
    Figures,
    Knob,
    figures,
    knobs,
    linear_limiters,
    path_of,
    scaled,
)
from stepcore.report.units import kind_unit, rounded, seconds
from stepcore.scene.layout import Layout

# The stability margin of every change: the largest stable dt over the wanted one.
MARGIN = 1.5
# The octaves of x that are tried: all of them down, a third up; for added values, a third on each
# side of 1. The servo of ur3e.xml at kp 1e6 needs 20.
OCTAVES = 24
# The number of searches for the margin, the factor by which each raises it (the uncertainty of two
# limits), and the most elements of one change.
SEARCHES, SURPLUS, TOGETHER = 3, STEP * STEP, 8
# The most integrators that are proposed.
INTEGRATORS = 3
# The part of the critical damping at which a gain of zero starts; also the least damping ratio with
# which added damping is compared.
FROM_NOTHING = 1 / 64
# Changes of the robot's hardware; they are proposed last.
ARMATURE, CHAIN, DAMPING = "armature", "armature of the whole chain", "more damping"
HARDWARE = (ARMATURE, CHAIN, DAMPING)
SOLREF, ROW_DAMPING, STANDARD = "solref", "damping of solref", "standard form of solref"
GAINS, LOOP_GAIN, PERIOD = "kp and kv", "control gain", "control_dt"
# The possible changes, by kind of element.
WAYS: dict[str, tuple[str, ...]] = {
    "spring": ("stiffness", *HARDWARE),
    "damper": ("damping", ARMATURE, CHAIN),
    "actuator": ("kp", "kv", GAINS, *HARDWARE),
    "control": (LOOP_GAIN, PERIOD, ARMATURE, CHAIN),
    "tendon spring": ("stiffness",),
    "tendon damper": ("damping",),
    **dict.fromkeys(
        ("contact", "limit", "tendon limit", "friction loss", "tendon friction loss", *EQUALITIES),
        (SOLREF, ROW_DAMPING, STANDARD),
    ),
}


@dataclass(frozen=True)
class NewValue:
    """A value of the scene before and after a change.

    element: the changed element. field: as in `Scene`. before, after: the numbers, in `unit`.
    size: |log| of the factor by which the change multiplies the gain, the inertia or the damping.
    gain: in a row of parameters, the name of the changed gain, and the gain before and after.
    """

    element: Element = dataclasses.field(repr=False)
    field: str
    before: tuple[float, ...]
    after: tuple[float, ...]
    unit: str = ""
    size: float = 0.0
    gain: tuple[str, float, float] | None = None
    owner: str = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "owner", self.element.name)

    @property
    def name(self) -> str:
        return self.field if self.gain is None else self.gain[0]

    @property
    def way(self) -> str:
        sides = (self.before, self.after)
        if self.gain is not None:
            sides = (self.gain[1],), (self.gain[2],)
        old, new = (" ".join(f"{x:.6g}" for x in side) for side in sides)
        return f"from {old} to {new} {self.unit}".rstrip()


@dataclass(frozen=True)
class Advice:
    """One way to make the wanted dt stable, with a stability margin of `MARGIN`.

    what: the name of the change, such as "kp" or "integrator". values: the new values of the scene.
    settings: the new settings. change: both as a `Change`; empty for a change of the control.
    met: whether the change, made and run, leaves the margin. text: the change in words.
    size: how much the model changes: root sum of squares of |log| of the factors of its values.
    limit: the largest stable dt [s] with the change made; inf if nothing limits it.
    """

    what: str
    values: tuple[NewValue, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    met: bool = False
    text: str = ""
    size: float = 0.0
    limit: float | None = None
    change: Change = field(default_factory=Change, repr=False)

    @property
    def hardware(self) -> bool:
        """Whether the change is one of the robot's hardware: inertia or damping of its joints."""
        return self.what in HARDWARE

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """The sort key of advice: changes that work first, hardware last, small changes first."""
        return not self.met, self.hardware, self.size


def ratio(before: float, after: float) -> float:
    """Return |log| of the factor between two numbers; 0 if either is zero."""
    return abs(math.log(abs(after)) - math.log(abs(before))) if before and after else 0.0


@dataclass
class Making:
    """The new values of changes of one model.

    model: the model. held: the state at which elements are compared. beyond: the step that must
    become stable [s].
    """

    model: Model
    held: Held
    beyond: float

    def values(self, group: Sequence[Element], what: str, x: float) -> dict[str, Any]:
        """Return the new values by path; `listed` describes them."""
        return {path: value for path, (value, _) in self._made(group, what, x).items()}

    def listed(self, group: Sequence[Element], what: str, x: float) -> tuple[NewValue, ...]:
        """Return the new values, each row of parameters and each pair of geoms once."""
        named: dict[tuple[Element, str], NewValue] = {}
        for _, one in self._made(group, what, x).values():
            if one is not None:
                named.setdefault((one.element, one.field), one)
        return tuple(named.values())

    def _made(
        self, group: Sequence[Element], what: str, x: float
    ) -> dict[str, tuple[Any, NewValue | None]]:
        made: dict[str, tuple[Any, NewValue | None]] = {}
        for element in group:
            if what not in WAYS.get(element.kind, ()):
                continue
            if what in (SOLREF, ROW_DAMPING, STANDARD):
                made |= self._solref(element, what, x)
            elif what in HARDWARE:
                for path, one in self._added(element, what, x).items():
                    made.setdefault(path, one)
            else:
                for name in ("kp", "kv") if what == GAINS else (what,):
                    made |= self._scaled(element, name, x, made)
        if what == CHAIN and len(made) < 2:
            # A chain of one joint is the same change as its armature.
            return {}
        return made

    def _scaled(
        self, element: Element, name: str, x: float, made: Mapping[str, Any]
    ) -> dict[str, tuple[Any, NewValue | None]]:
        knob = next((k for k in knobs(self.model, element) if k.name == name), None)
        fields = {f.name: f for f in element.fields(self.model)}
        ratio_ = fields.get("dampratio")
        if name == "kv" and ratio_ is not None and ratio_.value:
            knob = Knob(element, ratio_, "dampratio")
        if knob is None:
            return self._from_nothing(element, fields, x) if name == "kv" else {}
        old, unit = knob.value, knob.field.unit
        new = rounded(old * x, up=x > 1)
        values = scaled(self.model, knob, new / old)
        whole = values[knob.path]
        if knob.part < 0:
            one = NewValue(element, knob.field.name, (old,), (new,), unit, ratio(old, new))
            return {knob.path: (new, one)}
        joint = self._joint(element)
        if joint is not None:
            unit = kind_unit(name, Layout(self.model.scene).joints[joint].type in ("hinge", "ball"))
        if knob.path in made:
            # kp and kv are in one row.
            row = list(made[knob.path][0])
            row[knob.part] = whole[knob.part]
            whole = tuple(row)
        before = tuple(float(v) for v in knob.field.value)
        gain = name, old, new
        one = NewValue(element, "biasprm", before, whole, unit, ratio(old, new), gain)
        return {path: (v, None) for path, v in values.items()} | {knob.path: (whole, one)}

    def _from_nothing(
        self, element: Element, fields: Mapping[str, SceneField], x: float
    ) -> dict[str, tuple[Any, NewValue | None]]:
        """Return a kv for a servo without one, as a part of the critical damping."""
        kv, joint, (omega, _) = fields.get("kv"), self._joint(element), self.figures(element)
        if kv is None or kv.value or x <= 1 or joint is None or omega <= 0:
            return {}
        square = float(np.square(self.model.actuator_gear[element.index]).sum())
        new = rounded(FROM_NOTHING * x * 2 * self._mass(joint) * omega / square, up=True)
        one = NewValue(element, "kv", (0.0,), (new,), kv.unit, math.log1p(x))
        return {path_of(kv): (new, one)}

    def _added(
        self, element: Element, what: str, x: float
    ) -> dict[str, tuple[Any, NewValue | None]]:
        """Return armature or damping added to the joint of an element, or to all its tree."""
        own, (omega, damped) = self._joint(element), self.figures(element)
        layout, made = Layout(self.model.scene), dict[str, tuple[Any, NewValue | None]]()
        if own is None:
            return {}
        name = "damping" if what == DAMPING else ARMATURE
        for j in self._tree(own) if what == CHAIN else [own]:
            joint, mass = layout.joints[j], self._mass(j)
            added = x * mass * (2 * omega if what == DAMPING else 1.0)
            if added <= 0:
                continue
            old = float(np.ravel(getattr(joint, name))[0])
            new = rounded(old + added, up=True)
            least = max(damped, FROM_NOTHING)
            size = math.log1p(x / least) if what == DAMPING else math.log1p(x)
            unit = kind_unit(name, joint.type in ("hinge", "ball"))
            owner = Element.of(self.model, "joint", j)
            made[f"joint/#{j}/{name}"] = new, NewValue(owner, name, (old,), (new,), unit, size)
        return made

    def _solref(
        self, element: Element, what: str, x: float
    ) -> dict[str, tuple[Any, NewValue | None]]:
        old = solref_of(self.model, element)
        new = None if old is None else new_solref(what, (old[0], old[1]), x, 2 * self.beyond)
        fields = [f for f in element.fields(self.model) if f.name.startswith("solref")]
        if old is None or new is None or not fields:
            return {}
        owner = element
        if fields[0].kind == "pair":
            name = str(self.model.scene.pairs[fields[0].index])
            owner = Element("pair", fields[0].index, -1, name)
        elif element.kind == "contact":
            owner = replace(element, kind="geoms", name=f"both geoms of {element.name}")
        (k, b), (stiffer, damped) = _direct(old), _direct(new)
        size = max(ratio(k, stiffer), ratio(b, damped))
        one = NewValue(owner, fields[0].name, (old[0], old[1]), new, size=size)
        return {path_of(f): (new, one) for f in fields}

    def figures(self, element: Element) -> tuple[float, float]:
        """Return ω [rad/s] and the damping ratio of an element by itself; 0 if unknown."""
        own = self._known.get(element)
        return (0.0, 0.0) if own is None else (own.omega, np.nan_to_num(own.ratio))

    @functools.cached_property
    def _known(self) -> dict[Element, Figures]:
        return figures(self.held)

    def _joint(self, element: Element) -> int | None:
        joint = element.index
        if element.kind in ("actuator", "control"):
            joint = int(self.model.actuator_joint[element.index])
        elif element.kind not in ("spring", "damper"):
            return None
        single = joint >= 0 and self.model.jnt_type[joint] in ("hinge", "slide", "ball")
        return joint if single else None

    def _tree(self, joint: int) -> list[int]:
        roots = [self.model.root(int(body)) for body in self.model.jnt_body]
        types = self.model.jnt_type
        return [
            j
            for j, root in enumerate(roots)
            if root == roots[joint] and types[j] in ("hinge", "slide")
        ]

    def _mass(self, joint: int) -> float:
        """Return the inertia that a force on a joint moves [kg·m² or kg], other joints free."""
        weight = float(self.model.dof_invweight0[self.model.jnt_dofadr[joint]])
        return 1 / weight if weight > 0 else 0.0


def new_solref(
    what: str, old: tuple[float, float], x: float, softest: float
) -> tuple[float, float] | None:
    """Return the solref after a change by x, or None if there is no such change.

    A solref of the standard form, (tc, ζ), has the stiffness 1/(tc ζ)² and the damping 2/tc of the
    direct form (−k, −b), both per inertia and for an impedance of 1. Sources: MuJoCo's
    documentation, "Solver parameters", and docs/method.md.

    softest: the time constant [s] below which `refsafe` would soften the row silently.
    """
    direct, up = old[0] <= 0, x > 1
    if what == SOLREF:
        if not direct:
            return rounded(old[0] / x, up=not up), old[1]
        return -rounded(-old[0] * x * x, up=up), -rounded(-old[1] * x, up=up)
    if what == ROW_DAMPING:
        if old[1] == 0:
            return None
        return old[0], math.copysign(rounded(abs(old[1]) * x, up=up), old[1])
    if not direct or old[0] == 0:
        return None
    # Critically damped, and as stiff as the step allows.
    fastest = min(1 / math.sqrt(-old[0]), 2 / -old[1] if old[1] < 0 else math.inf)
    return rounded(max(fastest, softest), up=True), 1.0


def _direct(solref: Sequence[float]) -> tuple[float, float]:
    """Return the stiffness [1/s²] and damping [1/s] of a solref, per inertia."""
    first, second = float(solref[0]), float(solref[1])
    if first <= 0:
        return -first, -second
    # Successive divisions avoid the overflow of a square.
    return 1 / first / first / second / second, 2 / first


def text_of(what: str, values: Sequence[NewValue], x: float) -> str:
    """Return a change in words; equal changes are merged, and at most three written out."""
    hardware = "hardware: " if what in HARDWARE else ""
    low, high = min(v.after[-1] for v in values), max(v.after[-1] for v in values)
    unit = values[0].unit if len({value.unit for value in values}) == 1 else ""
    owners = Elements(dict.fromkeys(value.element for value in values)).name
    if what == CHAIN:
        return (
            f"{hardware}add armature to {owners}: {x:.3g} times the inertia that each moves, which "
            f"makes the armature {low:.3g} to {high:.3g} {unit}".rstrip()
        )
    alike: dict[tuple[str, str], list[Element]] = {}
    for value in values:
        alike.setdefault((value.name, value.way), []).append(value.element)
    if len(alike) > 3:
        fields = " and ".join(dict.fromkeys(value.name for value in values))
        return f"{hardware}change {fields} of {owners}, to {low:.3g} to {high:.3g} {unit}".rstrip()
    texts = [f"change {f} of {Elements(own).name} {w}" for (f, w), own in alike.items()]
    text = hardware + ", ".join(texts)
    if what == STANDARD:
        old, new = (_direct(side)[0] for side in (values[0].before, values[0].after))
        text += f" (stiffness {new:.3g}/s² times the inertia, in place of {old:.3g}/s²)"
    return text


@dataclass
class Search:
    """The search for changes that make a wanted step stable.

    judge: runs of the unchanged model. limit: its limit. held: the state that shows this limit, or
    the held end. linear: whether the linearised step there has the limit of the runs.
    wanted: the step [s]. elements: the limiting ones. every: all that act at some state.
    """

    judge: Judge
    limit: Limit
    held: Held
    linear: bool
    wanted: float
    elements: Sequence[Element]
    every: Sequence[Element]
    states: Sequence[State]

    @property
    def model(self) -> Model:
        return self.judge.motions.of(Change())

    def candidates(self) -> dict[str, Callable[[], Advice | None]]:
        """Return the kinds of changes to try, each with a function that finds the least one."""
        settings, found = self.model.settings, dict[str, Callable[[], Advice | None]]()
        if settings.law == "solref" and not settings.refsafe:
            words = "use refsafe=True, which softens rows that are too stiff"
            found["refsafe"] = lambda: self._set(words, refsafe=True)
        first = self.elements[0] if self.elements else None
        if first is None or (first.kind == "control" and self.judge.motions.users is None):
            return found
        if settings.law == "penalty" and first.kind == "contact":
            found["penalty_stiffness"] = self._softer_penalty
        met = list[Advice]()

        def new(what: str) -> Advice | None:
            one = self._loop(what) if what in (LOOP_GAIN, PERIOD) else self._least(what)
            if one is None or _repeats(one, met):
                return None
            met.append(one)
            return one

        return found | {w: functools.partial(new, w) for w in WAYS.get(first.kind, ())}

    def _set(self, words: str, size: float = 0.0, **settings: Any) -> Advice:
        ((name, _),), change = settings.items(), Change(**settings)
        limit = self.confirmed(change)
        met = self._leaves(limit)
        text = f"{words}: {stable(limit)}" if met else name
        return Advice(name, (), settings, met, text, size, limit[0], change)

    def _softer_penalty(self) -> Advice:
        """Return the stiffest contact spring of the law `penalty` that is stable."""
        old, name, made = self.model.settings.penalty_stiffness, "penalty_stiffness", None
        for margin in self._margins():

            def holds(x: float, margin: float = margin) -> bool:
                return self._holds(Change(penalty_stiffness=rounded(old * x, up=False)), margin)

            x = self._enough(holds, _octaves(True, False))
            if x is None:
                break
            new = rounded(old * x, up=False)
            words = f"use {name}={new:g} in place of {old:g} N/m"
            made = self._set(words, ratio(old, new), penalty_stiffness=new)
            if made.met:
                return made
        return made or Advice(name, text=name)

    def _margins(self) -> Iterator[float]:
        """Yield the margins to search for, in order; the caller stops when runs confirm one."""
        return (MARGIN * SURPLUS**k for k in range(SEARCHES))

    def _least(self, what: str) -> Advice | None:
        """Return the least change of the limiting elements, extended to more elements if needed."""
        group, failed = list(self.elements), Advice(what, text=what)
        for margin in self._margins():
            made = Making(self.model, self.held, margin * self.wanted)
            if what == STANDARD:
                group = self._alike(group)
            if not any(made.values(group, what, x) for x in (0.5, 2.0)):
                return None
            x = self._search(made, group, what, margin)
            while x is None and len(group) < TOGETHER:
                following = self._next(made, group, what)
                if following is None:
                    more = Elements(group[len(self.elements) :]).name
                    return replace(failed, text=f"{what} (of {more} too)") if more else failed
                group.append(following)
                x = self._search(made, group, what, margin)
            if x is None:
                return failed
            change = Change(made.values(group, what, x))
            limit = self.confirmed(change)
            if self._leaves(limit):
                values = made.listed(group, what, x)
                size = math.sqrt(sum(value.size**2 for value in values))
                text = f"{text_of(what, values, x)}: {stable(limit)}"
                return Advice(what, values, {}, True, text, size, limit[0], change)
        return failed

    def _search(
        self, made: Making, group: Sequence[Element], what: str, margin: float
    ) -> float | None:
        def holds(x: float) -> bool:
            try:
                values = made.values(group, what, x)
                return bool(values) and self._holds(Change(values), margin)
            except (ValueError, ArithmeticError):
                # The scene refuses the value.
                return False

        if what == STANDARD:
            return 1.0
        adds = what in HARDWARE
        return self._enough(holds, _octaves(not adds, what != "stiffness"), adds)

    def _enough(
        self, holds: Callable[[float], bool], xs: Sequence[float], adds: bool = False
    ) -> float | None:
        """Return the stable x nearest to no change, refined by bisection, or None."""
        if not self.linear:
            # Runs cost more: try every second octave.
            xs = xs[1::2] if adds else [x for x in xs if math.log2(x) % 2 == 0]
        jump = 2.0 if self.linear else 4.0
        for x in xs:
            if holds(x):
                nearer = x / jump if adds or x > 1 else x * jump
                return bisected(holds, x, nearer, FINE if self.linear else FAILS - 1)
        return None

    def _holds(self, change: Change, margin: float) -> bool:
        integrator = self.limit.integrator
        steps = (margin * self.wanted, self.wanted)
        if not self.linear:
            own = change.also(Change(integrator=integrator))
            return all(self.judge.outcome(own, dt).holds for dt in steps)
        try:
            softer = Held(change.of(self.model), self.held.state, self.held.horizon)
        except (ValueError, ArithmeticError):
            return False
        return all(softer.stable(integrator, dt) for dt in steps)

    def confirmed(self, change: Change, integrator: str | None = None) -> tuple[float, float]:
        """Return the limit of the changed model by its runs, and the longest step tried [s].

        The limit is 0 if the motion blows up, or a run at the wanted step fails.
        """
        own = Change(integrator=integrator or self.limit.integrator)
        try:
            motions = self.judge.motions.changed(change)
            judge = Judge.of(motions, min(self.judge.fine.dt, self.wanted), self.judge.loop)
            guesses = []
            for state in (self.states[-1], self.held.state):
                held = Held(motions.of(Change()), state, motions.horizon)
                guesses.append(held.limit(self.limit.integrator, MARGIN * self.wanted))
            found = run_limit(judge, own, guesses)
            return found if judge.outcome(own, self.wanted).holds else (0.0, found[1])
        except (SimulationError, ValueError, ArithmeticError):
            return 0.0, 0.0

    def _leaves(self, limit: tuple[float, float]) -> bool:
        return min(limit) >= HOLDS * MARGIN * self.wanted

    def _alike(self, group: Sequence[Element]) -> list[Element]:
        """Return a group of rows, and all others with the kind and the solref of its first.

        Such rows take their solref from one default, and are changed there.
        """
        first, model = group[0], self.model
        like, every = solref_of(model, first), [e for e in self.every if e.kind == first.kind]
        if first.kind == "limit":
            # A limit that is never reached may be reached in the changed motion.
            joints = Layout(model.scene).joints
            limited = [j for j, joint in enumerate(joints) if joint.range is not None]
            every = [Element.of(model, "limit", joint) for joint in limited]
        more = [e for e in every if e not in group and solref_of(model, e) == like]
        return [*group, *more]

    def _next(self, made: Making, group: Sequence[Element], what: str) -> Element | None:
        """Return the element that limits dt after the largest change of a group, or None."""
        if not self.linear:
            return None
        x = _octaves(False, False)[-1] if what in HARDWARE else 2.0 ** -(OCTAVES // 3)
        try:
            softer = Change(made.values(group, what, x)).of(self.model)
            held = Held(softer, self.held.state, self.held.horizon)
        except (ValueError, ArithmeticError):
            return None
        integrator = self.limit.integrator
        limit = held.limit(integrator, self.wanted)
        for element in linear_limiters(softer, held, integrator, limit) if limit else ():
            if element not in group and what in WAYS.get(element.kind, ()):
                return element
        return None

    # --- a user's control function ----------------------------------------------------------------

    def _loop(self, what: str) -> Advice | None:
        """Return the largest gain, or the longest period, of the control that leaves the margin."""
        motions, own = self.judge.motions, Change(integrator=self.limit.integrator)
        # A rounded gain still leaves the margin.
        beyond = SURPLUS * MARGIN * self.wanted

        def holds(x: float) -> bool:
            loop = Loop(gain=x) if what == LOOP_GAIN else Loop(period=x)
            steps = (beyond, self.wanted) if what == LOOP_GAIN else (self.wanted,)
            return all(self.judge.outcome(own, dt, loop).holds for dt in steps)

        if what == LOOP_GAIN:
            x = next((x for x in (0.5, 0.25, 0.125, 1 / 16, 1 / 32, 1 / 64) if holds(x)), None)
            if x is None:
                return Advice(what, text="a lower gain of the control")
            x = rounded(bisected(holds, x, 2 * x, FINE), 2, up=False)
            limit = run_limit(self.judge, own, (), Loop(gain=x))
            text = f"lower the gains of the control to {x:.2g} times: {stable(limit)}"
            return Advice(what, (), {}, self._leaves(limit), text, -math.log(x), limit[0])
        if motions.period is None:
            return None
        longest = longest_period(self.judge, own, self.wanted)
        if not 0 < longest < MARGIN * motions.period:
            return None
        period = self.wanted * max(1, math.floor(longest / MARGIN / self.wanted + 1e-9))
        if period > longest / MARGIN * (1 + 1e-9):
            return None
        text = f"sample the control every {seconds(period)}: stable up to {seconds(longest)}"
        size = ratio(motions.period, period)
        return Advice(what, (), {"control_dt": period}, True, text, size, longest)


def longest_period(judge: Judge, change: Change, dt: float) -> float:
    """Return the longest control period at which a step is stable [s]; inf beyond the horizon."""
    motions = judge.motions
    most = max(1, math.floor(motions.horizon / dt))

    def holds(count: int) -> bool:
        return judge.outcome(change, dt, Loop(period=count * dt)).holds

    good, bad = 0, 1
    while holds(bad):
        good, bad = bad, 2 * bad
        if good >= most:
            return math.inf
    while bad - good > max(1, FINE * good):
        middle = (good + bad) // 2
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good * dt


def other_integrators(search: Search, limits: Mapping[str, Limit]) -> Iterator[Advice]:
    """Yield other integrators whose runs leave the margin, the largest limit first.

    The explicit integrator is excluded: it adds energy at every dt.
    """
    own, left = search.limit.integrator, INTEGRATORS
    others = [limit for name, limit in limits.items() if name not in (own, "explicit")]
    if others and all(limit.dt < search.wanted for limit in others):
        name = f"integrator {others[0].integrator}" if len(others) == 1 else "another integrator"
        yield Advice("integrator", text=name)
    for limit in sorted(others, key=lambda limit: -limit.dt):
        found, name = (limit.dt, limit.longest), limit.integrator
        if limit.dt >= search.wanted and left:
            met = search._leaves(found)
            left -= met
            text = f"use integrator {name}, {stable(found)}" if met else f"integrator {name}"
            change = Change(integrator=name)
            yield Advice("integrator", (), {"integrator": name}, met, text, 0.0, limit.dt, change)


def _octaves(down: bool, both: bool) -> list[float]:
    third = OCTAVES // 3
    if not down:
        return [2.0**k for k in range(-third, third + 1)]
    every = range(1, OCTAVES + 1)
    return [2.0**k for n in every for k in ((-n, n) if both and n <= third else (-n,))]


def _repeats(advice: Advice, met: Sequence[Advice]) -> bool:
    smaller = {a.what: a for a in met if a.met}
    if advice.what == GAINS:
        return "kp" in smaller or "kv" in smaller
    single, owners = smaller.get(ARMATURE), {value.owner for value in advice.values}
    alike = single is not None and owners == {value.owner for value in single.values}
    return advice.what == CHAIN and alike


def stable(limit: tuple[float, float]) -> str:
    """Describe up to which dt a changed model is stable. limit: it, and the longest dt tried."""
    if not math.isinf(limit[0]):
        return f"stable up to {seconds(limit[0])}"
    return f"stable at every dt tried, up to {seconds(limit[1])}"
