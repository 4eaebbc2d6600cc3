"""What to change about a user's control function that limits dt: its gains, its period, a servo.

A gain of a black box is changed about the state: what the function returns, plus so much of its own
derivative times the way from there. Every change leaves a margin of the step, or of the period that
was asked for, and a run of the real step confirms it, as in `advice`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control, fresh
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates
from stepcore.measure.diagnosis.advice import MARGIN, Advice
from stepcore.measure.diagnosis.changes import NewValue, ratio, rounded, text_of
from stepcore.measure.diagnosis.control import KIND, growth_when_held
from stepcore.measure.diagnosis.feedback import Feedback
from stepcore.measure.diagnosis.growth import FINE, bisected
from stepcore.measure.diagnosis.limits import StepStability, step_stability
from stepcore.measure.diagnosis.linear_step import State
from stepcore.measure.diagnosis.motion_runs import stays_bounded
from stepcore.report.units import seconds, unit_of
from stepcore.scene.layout import Layout

# How far gains are changed, in octaves: down, and up where one gain is changed alone; and the
# relative resolution of the factor.
LESS, GREATER, CLOSE = 12, 6, 0.01
# A control is a servo of its own joint if all it does elsewhere is below this share.
ELSEWHERE = 0.05
# Of the ways to change gains: which of the gains on position and velocity, by x.
WAYS = {
    "gains": (True, True),
    "gain on position": (True, False),
    "gain on velocity": (False, True),
}


def advise_control(
    here: StepStability, elements: Sequence[Element], wanted: float, worst: int
) -> list[Advice]:
    """Ways to make the wanted dt [s] stable where controls limit it.

    elements: those that limit dt, of kind "control". worst: the state that decides.
    """
    search = _ControlSearch(here, [e for e in elements if e.kind == KIND], wanted, max(worst, 0))
    gains = [search.gain(what) for what in WAYS]
    if any(a.met for a in gains[1:]):
        # One gain is less change than both.
        gains = gains[1:]
    return [*gains, *search.period(), *search.servo()]


def longest_period(here: StepStability, integrator: str, dt: float, longest: float) -> float:
    """The longest control period [s] that is stable at every state in steps of about dt [s].

    0 where one step is too long, inf beyond `longest` [s].
    """

    def stable(period: float) -> bool:
        return _held(here, integrator, dt, period)

    if not stable(dt):
        return 0.0
    period = dt
    while 2 * period < longest:
        if not stable(2 * period):
            return bisected(stable, period, 2 * period, FINE)
        period *= 2
    return math.inf


def _held(here: StepStability, integrator: str, dt: float, period: float) -> bool:
    """Whether controls can be held for a period [s] in steps of at most dt [s]."""
    for k, state in enumerate(here.states):
        model, rates = here.model_at(state), here.rates[k]
        growth = growth_when_held(model, state, rates, integrator, dt, here.horizon, period)
        if growth is not None and not growth.stable:
            return False
    return True


@dataclass
class _ControlSearch:
    """Changes of the controls of some actuators. wanted [s]; worst: the state that decides."""

    here: StepStability
    elements: Sequence[Element]
    wanted: float
    worst: int

    @property
    def own(self) -> str:
        return str(self.here.model.settings.integrator)

    @property
    def asked(self) -> float | None:
        """The control period that was asked for [s]."""
        some = (s.feedback.period for s in self.here.states if s.feedback is not None)
        return next(some, None)

    def stable(self, states: Sequence[State], model: Model | None = None) -> bool:
        """Whether states with changed controls are stable, with a margin."""
        made = step_stability(model or self.here.model, states, self.here.horizon)
        period = self.asked
        if not made.stable(self.own, self.wanted):
            return False
        if period is not None and period > self.wanted:
            return _held(made, self.own, self.wanted, MARGIN * period)
        return made.stable(self.own, MARGIN * self.wanted)

    def bounded(self, states: Sequence[State], model: Model | None = None) -> bool:
        """Whether runs of the real step from the first state and the worst one stay bounded."""
        model, horizon = model or self.here.model, self.here.horizon
        some = {k: states[k] for k in (0, self.worst) if k < len(states)}
        return all(stays_bounded(model, s, self.own, self.wanted, horizon) for s in some.values())

    def gain(self, what: str) -> Advice:
        """The least change of some gains that is enough."""
        downs = [2.0**-k for k in range(1, LESS + 1)]
        ups = [2.0**k for k in range(1, GREATER + 1)] if what != "gains" else []
        tried = sorted([*downs, *ups], key=lambda x: abs(math.log(x)))
        for x in tried:
            if self.stable(self._scaled(what, x)):
                none = min(2 * x, 1.0) if x < 1 else max(x / 2, 1.0)
                least = bisected(lambda y: self.stable(self._scaled(what, y)), x, none, CLOSE)
                for good in dict.fromkeys((least, x)):
                    if self.bounded(self._scaled(what, good)):
                        return self._gain(what, good)
        return Advice(f"control {what}", (), {}, False, f"{what} of the control")

    def _scaled(self, what: str, x: float) -> list[State]:
        """The states with some gains of the limiting controls multiplied by x."""
        rows = [element.index for element in self.elements]
        position, velocity = WAYS[what]
        by = x if position else 1.0, x if velocity else 1.0
        return [
            s if s.feedback is None else replace(s, feedback=rescaled(self.here.model, s, rows, by))
            for s in self.here.states
        ]

    def _gain(self, what: str, x: float) -> Advice:
        """The change in words: the gains on each joint's own position and velocity."""
        values = []
        for element in self.elements:
            for column, field in enumerate(("gain on position", "gain on velocity")):
                servo = _servo_gains(self.here, element)
                old = servo[column] if servo else 0.0
                if WAYS[what][column] and old > 0:
                    new = rounded(old * x, up=x > 1)
                    unit = unit_of(("kp", "kv")[column], self._angular(element))
                    size = ratio(old, new)
                    values.append(NewValue(element, field, (old,), (new,), unit, size))
        size = abs(math.log(x))
        if values:
            text = text_of(values)
        else:
            names = " and ".join(element.name for element in self.elements)
            text = f"multiply the {what} of {names} by {x:.3g}"
        return Advice(f"control {what}", tuple(values), {}, True, text, size)

    def period(self) -> Iterator[Advice]:
        """A shorter control period, where one was asked for that is longer than a step."""
        asked = self.asked
        if asked is None or asked <= self.wanted:
            return
        limit = longest_period(self.here, self.own, self.wanted, asked)
        count = math.floor(min(limit / MARGIN, asked) / self.wanted * (1 + 1e-9))
        if count < 1:
            yield Advice("control_dt", (), {}, False, "a shorter control period")
            return
        text = f"sample the control every {seconds(count * self.wanted)} in place of "
        text += f"{seconds(asked)}, stable up to {seconds(limit)}"
        yield Advice("control_dt", (), {}, True, text, ratio(asked, count * self.wanted))

    def servo(self) -> Iterator[Advice]:
        """A servo in place of the control, whose damping `implicitfast` treats implicitly."""
        found = [_servo_gains(self.here, element) for element in self.elements]
        if not found or not all(gains and gains[0] > 0 for gains in found):
            return
        scene = copy.deepcopy(self.here.model.scene)
        layout, values, texts = Layout(scene), [], []
        for element, gains in zip(self.elements, found, strict=True):
            assert gains is not None
            servo = scene.actuators[element.index]
            kp, kv = (float(f"{gain:.6g}") for gain in gains)
            gear = abs(servo.gear[0])
            if servo.forcerange is not None:
                low, high = servo.forcerange
                servo.forcerange = (low * gear, high * gear)
            servo.type, servo.gear, servo.ctrlrange = "position", (1.0, 0, 0, 0, 0, 0), None
            servo.kp, servo.kv = kp, max(kv, 0.0)
            angular = self._angular(element)
            units = unit_of("kp", angular), unit_of("kv", angular)
            joint = self.here.model.element_name("joint", layout.joints.index(servo.target[1]))
            actuator = Element.of(self.here.model, "actuator", element.index)
            texts.append(
                f"a position servo on {joint} with kp {kp:.4g} {units[0]} and kv {kv:.4g} "
                f"{units[1]} in place of the control of {actuator.name}"
            )
            values.append(NewValue(actuator, "kp", (), (kp,), units[0]))
            values.append(NewValue(actuator, "kv", (), (kv,), units[1]))
        rows = [element.index for element in self.elements]
        states = [_as_servo(self.here.model, s, rows) for s in self.here.states]
        for integrator in dict.fromkeys((self.own, "implicitfast")):
            settings = self.here.model.settings.replace(integrator=integrator)
            model = Model(scene, settings)
            other = replace(self, here=replace(self.here, model=model, states=states))
            if other.stable(states, model) and other.bounded(states, model):
                under = "" if integrator == self.own else f", under {integrator}"
                text = f"use {' and '.join(texts)}{under}"
                changed = {} if integrator == self.own else {"integrator": integrator}
                yield Advice("servo", tuple(values), changed, True, text, math.log(2))
                return
        yield Advice("servo", (), {}, False, "a servo in place of the control")

    def _angular(self, element: Element) -> bool:
        model = self.here.model
        joint = int(model.actuator_joint[element.index])
        return joint >= 0 and model.jnt_type[joint] == "hinge"


@dataclass(frozen=True)
class _Adjusted:
    """A user's control function whose answer is adjusted; a copy has its own memory."""

    function: Control
    adjust: Callable[[Floats, Sim], Floats]

    def __call__(self, time: float, sim: Sim) -> ArrayLike:
        return self.adjust(np.array(self.function(time, sim), float).reshape(-1), sim)

    def __deepcopy__(self, memo: Any) -> _Adjusted:
        return _Adjusted(fresh(self.function), self.adjust)


def rescaled(model: Model, state: State, rows: Sequence[int], by: tuple[float, float]) -> Feedback:
    """The feedback of a state with gains of some actuators on position and velocity multiplied."""
    old, n, coordinates = state.feedback, model.nv, Coordinates(model)
    assert old is not None
    factors = np.ones_like(old.gain)
    factors[rows, :n], factors[rows, n:] = by
    settled = old.settled * factors
    more = old.settled * (factors - 1)

    def adjust(ctrl: Floats, sim: Sim) -> Floats:
        way = np.concatenate([coordinates.change(state.qpos, sim.qpos), sim.qvel - state.qvel])
        return ctrl + more @ way

    # What is remembered is one loop for all gains: it scales as the settled gain does.
    c = old.c.copy()
    if old.order:
        c[rows] *= by[0] if by[0] == by[1] else float(np.sqrt(by[0] * by[1]))
    return replace(
        old, function=_Adjusted(old.function, adjust), gain=old.gain * factors, settled=settled, c=c
    )


def _as_servo(model: Model, state: State, rows: Sequence[int]) -> State:
    """The state with the controls of some actuators constant: those of servos at rest there."""
    old = state.feedback
    if old is None:
        return state
    ctrl = state.ctrl.copy()
    for row in rows:
        ctrl[row] = state.qpos[model.jnt_qposadr[int(model.actuator_joint[row])]]

    def adjust(values: Floats, sim: Sim) -> Floats:
        values[rows] = ctrl[rows]
        return values

    parts: dict[str, Any] = {}
    for name in ("gain", "settled", "c"):
        parts[name] = getattr(old, name).copy()
        parts[name][rows] = 0.0
    feedback = replace(old, function=_Adjusted(old.function, adjust), **parts)
    return replace(state, ctrl=ctrl, feedback=feedback if np.any(feedback.gain) else None)


def _servo_gains(here: StepStability, element: Element) -> tuple[float, float] | None:
    """kp and kv [SI, at the joint] of a control that is a servo of its own hinge or slide.

    At the state where it is stiffest; None for a control of another form.
    """
    model, best = here.model, None
    joint = int(model.actuator_joint[element.index])
    if joint < 0 or model.jnt_type[joint] not in ("hinge", "slide"):
        return None
    dof = int(model.jnt_dofadr[joint])
    for state in here.states:
        motion = here.motion(state)
        matrices = motion.elements.get(element) if motion is not None else None
        if matrices is None:
            continue
        gains = []
        for matrix in (matrices.stiffness, matrices.damping):
            rest = matrix.copy()
            rest[dof, dof] = 0.0
            if np.abs(rest).max() > ELSEWHERE * abs(matrix[dof, dof]):
                return None
            gains.append(float(matrix[dof, dof]))
        if best is None or gains[0] > best[0]:
            best = gains[0], gains[1]
    return best
