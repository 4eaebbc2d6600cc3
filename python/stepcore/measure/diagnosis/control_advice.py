"""Search for changes of a control function that limits dt: its gains, its period, or a servo.

A gain of a black box is changed about the state: the advised function adds the gain's derivative
times the displacement from the state to the function's answer. Every change leaves a margin of the
step or of the control period. A run of the real step confirms each change, as in `advice`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control, fresh
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.coordinates import Coordinates
from stepcore.measure.diagnosis.advice import FINE, MARGIN, Advice
from stepcore.measure.diagnosis.changes import NewValue, ratio, rounded, text_of
from stepcore.measure.diagnosis.control import KIND, growth_when_held
from stepcore.measure.diagnosis.growth import FINE as PERIOD_FINE
from stepcore.measure.diagnosis.growth import bisected
from stepcore.measure.diagnosis.limits import StepStability, step_stability
from stepcore.measure.diagnosis.linear_step import State
from stepcore.measure.diagnosis.motion_runs import stays_bounded
from stepcore.report.units import seconds, unit_of
from stepcore.scene.layout import Layout

# The range of gain factors in octaves: down, and up for a single gain.
LESS, GREATER = 12, 6
# A control acts as a servo of its joint if its gains elsewhere are below this share.
ELSEWHERE = 0.05
# Whether each change scales the gain on position and that on velocity.
WAYS = {
    "gains": (True, True),
    "gain on position": (True, False),
    "gain on velocity": (False, True),
}


def advise_control(
    here: StepStability, elements: Sequence[Element], wanted: float, worst: int
) -> list[Advice]:
    """Return changes of the controls that make the wanted dt [s] stable, and those that fail.

    here: the stability of the unchanged model.
    elements: the elements that limit dt; those of kind "control" are changed.
    wanted: the wanted dt [s].
    worst: the index of the state that decides.
    """
    controls = [element for element in elements if element.kind == KIND]
    search = _ControlSearch(here, controls, wanted, max(worst, 0))
    gains = [search.gain(what) for what in WAYS]
    if any(advice.met for advice in gains[1:]):
        # A single sufficient gain is a smaller change than both gains.
        gains = gains[1:]
    return [*gains, *search.period(), *search.servo()]


def longest_period(here: StepStability, integrator: str, dt: float, longest: float) -> float:
    """Return the longest control period [s] that is stable at every state in steps of about dt [s].

    The result is 0 if a single step is too long, and inf if every period up to `longest` [s] is
    stable.
    """
    stable = partial(_held, here, integrator, dt)
    if not stable(dt):
        return 0.0
    period = dt
    while 2 * period < longest:
        if not stable(2 * period):
            return bisected(stable, period, 2 * period, PERIOD_FINE)
        period *= 2
    return math.inf


def _held(here: StepStability, integrator: str, dt: float, period: float) -> bool:
    """Return whether controls can be held for a period [s] in steps of at most dt [s]."""
    for state, rates in zip(here.states, here.rates, strict=True):
        model = here.model_at(state)
        growth = growth_when_held(model, state, rates, integrator, dt, here.horizon, period)
        if growth is not None and not growth.stable:
            return False
    return True


@dataclass
class _ControlSearch:
    """A search for changes of the controls of some actuators.

    wanted: the wanted dt [s].
    worst: the index of the state that decides.
    """

    here: StepStability
    elements: Sequence[Element]
    wanted: float
    worst: int

    def __post_init__(self) -> None:
        periods = [s.feedback.period for s in self.here.states if s.feedback is not None]
        # The control period [s]; None if controls are sampled at every step.
        self.asked = periods[0] if periods else None
        self.rows = [element.index for element in self.elements]

    def stable(self, states: Sequence[State], model: Model) -> bool:
        """Return whether states with changed controls are stable, with a margin."""
        made, own = step_stability(model, states, self.here.horizon), model.settings.integrator
        if not made.stable(own, self.wanted):
            return False
        if self.asked is not None and self.asked > self.wanted:
            return _held(made, own, self.wanted, MARGIN * self.asked)
        return made.stable(own, MARGIN * self.wanted)

    def bounded(self, states: Sequence[State], model: Model) -> bool:
        """Return whether runs from the first state and the worst one stay bounded."""
        own, horizon = model.settings.integrator, self.here.horizon
        starts = [states[k] for k in {0, self.worst} if k < len(states)]
        return all(stays_bounded(model, s, own, self.wanted, horizon) for s in starts)

    def gain(self, what: str) -> Advice:
        """Return the least sufficient change of some gains."""
        model, (position, velocity) = self.here.model, WAYS[what]

        def scaled(x: float) -> list[State]:
            by = x if position else 1.0, x if velocity else 1.0
            return [_rescaled(model, state, self.rows, by) for state in self.here.states]

        def stable(x: float) -> bool:
            return self.stable(scaled(x), model)

        downs = [2.0**-k for k in range(1, LESS + 1)]
        ups = [2.0**k for k in range(1, GREATER + 1)] if what != "gains" else []
        for x in sorted([*downs, *ups], key=lambda x: abs(math.log(x))):
            if stable(x):
                before = min(2 * x, 1.0) if x < 1 else max(x / 2, 1.0)
                for least in dict.fromkeys((bisected(stable, x, before, FINE), x)):
                    if self.bounded(scaled(least), model):
                        return self._gain(what, least)
        return Advice(f"control {what}", (), {}, False, f"{what} of the control")

    def _gain(self, what: str, x: float) -> Advice:
        """Return the advice, with the gains on each joint's own position and velocity."""
        values = []
        for element in self.elements:
            servo = _servo_gains(self.here, element) or (0.0, 0.0)
            for old, name, field, changes in zip(
                servo,
                ("kp", "kv"),
                ("gain on position", "gain on velocity"),
                WAYS[what],
                strict=True,
            ):
                if changes and old > 0:
                    new, unit = rounded(old * x, up=x > 1), unit_of(name, self._angular(element))
                    values.append(NewValue(element, field, (old,), (new,), unit, ratio(old, new)))
        names = " and ".join(element.name for element in self.elements)
        text = text_of(values) if values else f"multiply the {what} of {names} by {x:.3g}"
        return Advice(f"control {what}", tuple(values), {}, True, text, abs(math.log(x)))

    def period(self) -> Iterator[Advice]:
        """Yield a shorter control period, if the present one is longer than a step."""
        asked, wanted = self.asked, self.wanted
        if asked is None or asked <= wanted:
            return
        limit = longest_period(self.here, self.here.model.settings.integrator, wanted, asked)
        count = math.floor(min(limit / MARGIN, asked) / wanted * (1 + 1e-9))
        if count < 1:
            yield Advice("control_dt", (), {}, False, "a shorter control period")
            return
        text = f"sample the control every {seconds(count * wanted)} in place of "
        text += f"{seconds(asked)}, stable up to {seconds(limit)}"
        yield Advice("control_dt", (), {}, True, text, ratio(asked, count * wanted))

    def servo(self) -> Iterator[Advice]:
        """Yield a servo in place of the control, whose damping `implicitfast` treats implicitly."""
        found = [_servo_gains(self.here, element) for element in self.elements]
        if not found or any(gains is None or not gains[0] > 0 for gains in found):
            return
        model = self.here.model
        scene = copy.deepcopy(model.scene)
        layout, values, texts = Layout(scene), [], []
        for element, gains in zip(self.elements, found, strict=True):
            assert gains is not None
            kp, kv = (float(f"{gain:.6g}") for gain in gains)
            servo, actuator = (
                scene.actuators[element.index],
                Element.of(model, "actuator", element.index),
            )
            gear = abs(servo.gear[0])
            if servo.forcerange is not None:
                low, high = servo.forcerange
                servo.forcerange = (low * gear, high * gear)
            servo.type, servo.gear, servo.ctrlrange = "position", (1.0, 0, 0, 0, 0, 0), None
            servo.kp, servo.kv = kp, max(kv, 0.0)
            units = [unit_of(field, self._angular(element)) for field in ("kp", "kv")]
            joint = model.element_name("joint", layout.joints.index(servo.target[1]))
            texts.append(
                f"a position servo on {joint} with kp {kp:.4g} {units[0]} and kv {kv:.4g} "
                f"{units[1]} in place of the control of {actuator.name}"
            )
            values.append(NewValue(actuator, "kp", (), (kp,), units[0]))
            values.append(NewValue(actuator, "kv", (), (kv,), units[1]))
        states = [_as_servo(model, state, self.rows) for state in self.here.states]
        own = model.settings.integrator
        for integrator in dict.fromkeys((own, "implicitfast")):
            changed = Model(scene, model.settings.replace(integrator=integrator))
            if self.stable(states, changed) and self.bounded(states, changed):
                under = "" if integrator == own else f", under {integrator}"
                text = f"use {' and '.join(texts)}{under}"
                settings = {} if integrator == own else {"integrator": integrator}
                yield Advice("servo", tuple(values), settings, True, text, math.log(2))
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


def _rescaled(model: Model, state: State, rows: Sequence[int], by: tuple[float, float]) -> State:
    """Return the state with the position and velocity gains of some actuators multiplied."""
    old, n, coordinates = state.feedback, model.nv, Coordinates(model)
    if old is None:
        return state
    factors = np.ones_like(old.gain)
    factors[rows, :n], factors[rows, n:] = by
    settled, more = old.settled * factors, old.settled * (factors - 1)

    def adjust(ctrl: Floats, sim: Sim) -> Floats:
        way = np.concatenate([coordinates.change(state.qpos, sim.qpos), sim.qvel - state.qvel])
        return ctrl + more @ way

    # One memory serves all gains, so a single factor scales its output.
    c = old.c.copy()
    if old.order:
        c[rows] *= by[0] if by[0] == by[1] else float(np.sqrt(by[0] * by[1]))
    function = _Adjusted(old.function, adjust)
    changed = replace(old, function=function, gain=old.gain * factors, settled=settled, c=c)
    return replace(state, feedback=changed)


def _as_servo(model: Model, state: State, rows: Sequence[int]) -> State:
    """Return the state with the controls of some actuators replaced by servos at rest."""
    old = state.feedback
    if old is None:
        return state
    ctrl = state.ctrl.copy()
    ctrl[rows] = state.qpos[model.jnt_qposadr[model.actuator_joint[rows]]]

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
    """Return kp and kv [SI, at the joint] of a control that acts as a servo of its hinge or slide.

    The gains are those at the state where the control is stiffest. The result is None for any other
    control.
    """
    model = here.model
    joint = int(model.actuator_joint[element.index])
    if joint < 0 or model.jnt_type[joint] not in ("hinge", "slide"):
        return None
    dof, gains = int(model.jnt_dofadr[joint]), []
    for state in here.states:
        motion = here.motion(state)
        slopes = motion.elements.get(element) if motion is not None else None
        if slopes is None:
            continue
        for matrix in (slopes.stiffness, slopes.damping):
            rest = matrix.copy()
            rest[dof, dof] = 0.0
            if np.abs(rest).max() > ELSEWHERE * abs(matrix[dof, dof]):
                return None
        gains.append((float(slopes.stiffness[dof, dof]), float(slopes.damping[dof, dof])))
    return max(gains, key=lambda pair: pair[0], default=None)
