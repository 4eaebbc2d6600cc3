"""Search for changes of a control function that limits dt: its gains, its period, or a servo.

The gains of a black box are changed by calls: f(q, v) − f(q, 0) is its answer to velocities, after
any delay or filter, and f(q, 0) the rest. Each is multiplied. Every change leaves a margin of the
step or of the control period; `confirmation` then makes it, with the changed function.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore.engine.arrays import Floats
from stepcore.engine.control import Control, controls, fresh
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.motion import Motion
from stepcore.measure.diagnosis.advice import FINE, TOGETHER, Advice, Cure, Way, failed
from stepcore.measure.diagnosis.changes import NewValue, ratio, text_of
from stepcore.measure.diagnosis.control import KIND, growth_when_held
from stepcore.measure.diagnosis.growth import FINE as PERIOD_FINE
from stepcore.measure.diagnosis.growth import bisected
from stepcore.measure.diagnosis.limits import StepStability, step_stability
from stepcore.measure.diagnosis.linear_step import State
from stepcore.report.units import rounded, seconds, unit_of
from stepcore.scene.layout import Layout

# The range of gain factors in octaves: down, and up for a single gain.
LESS, GREATER = 12, 6
# A control acts as a servo of its joint if its gains elsewhere are below this share.
ELSEWHERE = 0.05
# Decimals of a servo's target [rad or m].
DECIMALS = 9
# The powers of a factor by which each change multiplies the gain on position and that on velocity.
# Both gains together keep the damping ratio.
WAYS = {"gain on position": (1, 0), "gain on velocity": (0, 1), "gains": (2, 1)}


def control_ways(
    here: StepStability,
    limiting: Sequence[Element],
    elements: Sequence[Element],
    wanted: float,
    motion: Motion,
) -> Iterator[Way]:
    """Yield the ways to change the controls of the motion.

    here: the stability of the unchanged model.
    limiting: the elements that limit dt; those of kind "control" are changed first.
    elements: all elements, the stiffest first; further controls are changed where needed.
    wanted: the wanted dt [s].
    motion: the motion, with its control function.
    """
    if motion.control is None:
        return
    first = [element for element in limiting if element.kind == KIND]
    more = [element for element in elements if element.kind == KIND and element not in first]
    search = _ControlSearch(here, first, more, wanted, motion)
    for what in WAYS:
        yield partial(search.gain, what)
    yield search.period
    yield search.servo


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

    first: the controls that limit dt, which are changed first.
    more: the other controls, the stiffest first.
    wanted: the wanted dt [s].
    motion: the motion, with its control function.
    """

    here: StepStability
    first: Sequence[Element]
    more: Sequence[Element]
    wanted: float
    motion: Motion

    def __post_init__(self) -> None:
        laws = [s.feedback for s in self.here.states if s.feedback is not None]
        # The control period [s]; None if controls are sampled at every step.
        self.asked = laws[0].period if laws else None
        self.remembers = any(law.order for law in laws)

    @property
    def groups(self) -> Iterator[Sequence[Element]]:
        """The controls to change: those that limit dt, then one more at a time."""
        for count in range(min(len(self.more), max(0, TOGETHER - len(self.first))) + 1):
            yield [*self.first, *self.more[:count]]

    def stable(self, states: Sequence[State], model: Model, margin: float) -> bool:
        """Return whether states with changed controls are stable, with a margin."""
        made, own = step_stability(model, states, self.here.horizon), model.settings.integrator
        if not made.stable(own, self.wanted):
            return False
        if self.asked is not None and self.asked > self.wanted:
            return _held(made, own, self.wanted, margin * self.asked)
        return made.stable(own, margin * self.wanted)

    def gain(self, what: str, margin: float) -> Cure | Advice | None:
        """Return the least sufficient change of some gains."""
        function, powers = self.motion.control, WAYS[what]
        assert function is not None
        if self.remembers and fresh(function) is function:
            # A second call per sample would change the memory of a function without a copy.
            powers = (1, 1)
            if what != "gains":
                return None
        model = self.here.model
        downs = [2.0**-k for k in range(1, LESS + 1)]
        ups = [2.0**k for k in range(1, GREATER + 1)] if what != "gains" else []
        tries = sorted([*downs, *ups], key=lambda x: abs(math.log(x)))

        def gains(x: float, elements: Sequence[Element]) -> _Gains:
            return _Gains([element.index for element in elements], x ** powers[0], x ** powers[1])

        for elements in self.groups:

            def holds(x: float, elements: Sequence[Element] = elements) -> bool:
                law = gains(x, elements)
                states = [law.scaled(state) for state in self.here.states]
                return self.stable(states, model, margin)

            for x in tries:
                if holds(x):
                    before = min(2 * x, 1.0) if x < 1 else max(x / 2, 1.0)
                    least = bisected(holds, x, before, FINE)
                    law = gains(least, elements)
                    motion = replace(self.motion, control=_Regained(function, law))
                    return Cure(self._gain(what, law, elements), model, motion)
        return failed(f"control {what}")

    def _gain(self, what: str, law: _Gains, elements: Sequence[Element]) -> Advice:
        """Return the advice, with the gains on each joint's own position and velocity."""
        values = []
        for element in elements:
            servo = _servo_gains(self.here, element) or (0.0, 0.0)
            for old, name, label, x in zip(
                servo,
                ("kp", "kv"),
                ("gain on position", "gain on velocity"),
                (law.position, law.velocity),
                strict=True,
            ):
                if x != 1 and old > 0:
                    new, unit = rounded(old * x, up=x > 1), unit_of(name, self._angular(element))
                    values.append(NewValue(element, label, (old,), (new,), unit, ratio(old, new)))
        names = " and ".join(element.name for element in elements)
        factors = " and ".join(f"{x:.3g}" for x in (law.position, law.velocity) if x != 1)
        text = text_of(values) if values else f"multiply the {what} of {names} by {factors}"
        size = math.hypot(math.log(law.position), math.log(law.velocity)) * math.sqrt(len(elements))
        return Advice(f"control {what}", tuple(values), {}, True, text, size)

    def period(self, margin: float) -> Cure | Advice | None:
        """Return a shorter control period, if the present one is longer than a step."""
        asked, wanted, model = self.asked, self.wanted, self.here.model
        if asked is None or asked <= wanted:
            return None
        limit = longest_period(self.here, model.settings.integrator, wanted, asked)
        count = math.floor(min(limit / margin, asked) / wanted * (1 + 1e-9))
        if count < 1:
            return failed("control_dt")
        text = f"sample the control every {seconds(count * wanted)} in place of {seconds(asked)}"
        advice = Advice("control_dt", (), {}, True, text, ratio(asked, count * wanted))
        return Cure(advice, model, replace(self.motion, control_dt=count * wanted))

    def servo(self, margin: float) -> Cure | Advice | None:
        """Return servos in place of controls, whose damping `implicitfast` treats implicitly.

        A control with a delay, a filter or an integral is no servo.
        """
        if self.remembers:
            return None
        for elements in self.groups:
            gains = [_servo_gains(self.here, element) for element in elements]
            known = [pair for pair in gains if pair is not None and pair[0] > 0]
            if len(known) < len(elements):
                return None if elements == self.first else failed("servo")
            cure = self._servos(elements, known, margin)
            if cure is not None:
                return cure
        return failed("servo")

    def _servos(
        self, elements: Sequence[Element], gains: Sequence[tuple[float, float]], margin: float
    ) -> Cure | None:
        """Return servos with these gains in place of some controls, or None if not stable."""
        model, rows = self.here.model, [element.index for element in elements]
        scene = copy.deepcopy(model.scene)
        layout, values, texts = Layout(scene), [], []
        for element, pair in zip(elements, gains, strict=True):
            kp, kv = float(f"{pair[0]:.6g}"), max(float(f"{pair[1]:.6g}"), 0.0)
            servo, actuator = (
                scene.actuators[element.index],
                Element.of(model, "actuator", element.index),
            )
            gear = abs(servo.gear[0])
            if servo.forcerange is not None:
                low, high = servo.forcerange
                servo.forcerange = (low * gear, high * gear)
            servo.type, servo.gear, servo.ctrlrange = "position", (1.0, 0, 0, 0, 0, 0), None
            servo.kp, servo.kv = kp, kv
            units = [unit_of(field, self._angular(element)) for field in ("kp", "kv")]
            joint = model.element_name("joint", layout.joints.index(servo.target[1]))
            texts.append(
                f"on {joint} with kp {kp:.4g} {units[0]} and kv {kv:.4g} {units[1]} in place of "
                f"{actuator.name}"
            )
            values.append(NewValue(actuator, "kp", (), (kp,), units[0]))
            values.append(NewValue(actuator, "kv", (), (kv,), units[1]))
        assert self.motion.control is not None
        targets = partial(_Targets, rows=rows, gear=model.actuator_gear[rows, 0], gains=gains)
        states = [_as_servo(model, state, rows, targets) for state in self.here.states]
        own = model.settings.integrator
        for integrator in dict.fromkeys((own, "implicitfast")):
            changed = Model(scene, model.settings.replace(integrator=integrator))
            if self.stable(states, changed, margin):
                under = "" if integrator == own else f", under {integrator}"
                servos = "a position servo" if len(elements) == 1 else "position servos"
                text = f"use {servos} {', '.join(texts)}{under}"
                settings = {} if integrator == own else {"integrator": integrator}
                size = math.log(2) * math.sqrt(len(elements))
                motion = replace(self.motion, control=targets(self.motion.control))
                advice = Advice("servo", tuple(values), settings, True, text, size)
                return Cure(advice, changed, motion)
        return None

    def _angular(self, element: Element) -> bool:
        model = self.here.model
        joint = int(model.actuator_joint[element.index])
        return joint >= 0 and model.jnt_type[joint] == "hinge"


@dataclass(frozen=True)
class _Gains:
    """Factors of the gains of some controls.

    rows: the actuators.
    position, velocity: the factors of the answers to positions and to velocities.
    """

    rows: Sequence[int]
    position: float
    velocity: float

    def scaled(self, state: State) -> State:
        """Return the state with the gains of its linear law multiplied.

        Memory is driven by the same factors, which is exact for delays and filters. Where only some
        actuators are changed, the others keep a memory of their own.
        """
        old = state.feedback
        if old is None:
            return state
        n = old.gain.shape[1] // 2
        by = np.repeat([self.position, self.velocity], n)
        factors = np.ones_like(old.gain)
        factors[self.rows] = by
        others = np.ones(len(old.gain), bool)
        others[self.rows] = False
        # The memory of the changed rows, and that of the other rows.
        a, b = np.zeros((2 * old.order,) * 2), np.vstack([old.b * by, old.b])
        a[: old.order, : old.order] = a[old.order :, old.order :] = old.a
        c = np.hstack([old.c * ~others[:, None], old.c * others[:, None]])
        if not others.any():
            a, b, c = old.a, old.b * by, old.c
        law = replace(
            old,
            function=_Regained(old.function, self),
            gain=old.gain * factors,
            settled=old.settled * factors,
            a=a,
            b=b,
            c=c,
        )
        return replace(state, feedback=law)


@dataclass
class _Regained:
    """A user's control function with some gains multiplied; a copy has its own memory.

    at_rest: the same function with its own memory, called at velocities of zero.
    """

    function: Control
    gains: _Gains
    at_rest: Control | None = None
    _still: Sim | None = field(default=None, repr=False)

    def __call__(self, time: float, sim: Sim) -> ArrayLike:
        gains = self.gains
        ctrl = np.array(controls(self.function, sim))
        if gains.position == gains.velocity:
            ctrl[gains.rows] *= gains.position
            return ctrl
        if self.at_rest is None:
            self.at_rest = fresh(self.function)
        rest = controls(self.at_rest, self._stopped(sim))[gains.rows]
        moving = ctrl[gains.rows] - rest
        ctrl[gains.rows] = gains.position * rest + gains.velocity * moving
        return ctrl

    def _stopped(self, sim: Sim) -> Sim:
        """Return another Sim at the same positions, with velocities of zero."""
        if self._still is None or self._still.model is not sim.model:
            self._still = unwatched(Sim(sim.model))
        still = self._still
        still.qpos[:], still.qvel[:], still.ctrl[:] = sim.qpos, 0.0, sim.ctrl
        still.act[:], still.time = sim.act, sim.time
        still.forward()
        return still

    def __deepcopy__(self, memo: Any) -> _Regained:
        at_rest = None if self.at_rest is None else fresh(self.at_rest)
        return _Regained(fresh(self.function), self.gains, at_rest)


@dataclass(frozen=True)
class _Targets:
    """A user's control function for servos in place of some controls: the targets of those servos.

    A control that acts as a servo, gear · u = kp (target − q) − kv q̇, has that target. It is
    rounded, because the rounding error of q would be read as feedback.

    rows: the actuators.
    gear: their gears as motors.
    gains: kp and kv of the servos, for each row.
    """

    function: Control
    rows: Sequence[int]
    gear: Floats
    gains: Sequence[tuple[float, float]]

    def __call__(self, time: float, sim: Sim) -> ArrayLike:
        model, ctrl = sim.model, np.array(controls(self.function, sim))
        joints = model.actuator_joint[self.rows]
        q, v = sim.qpos[model.jnt_qposadr[joints]], sim.qvel[model.jnt_dofadr[joints]]
        kp, kv = np.array(self.gains).T
        ctrl[self.rows] = np.round(q + (self.gear * ctrl[self.rows] + kv * v) / kp, DECIMALS)
        return ctrl

    def __deepcopy__(self, memo: Any) -> _Targets:
        return _Targets(fresh(self.function), self.rows, self.gear, self.gains)


def _as_servo(
    model: Model, state: State, rows: Sequence[int], targets: Callable[[Control], Control]
) -> State:
    """Return the state with the controls of some actuators replaced by servos at rest."""
    old = state.feedback
    if old is None:
        return state
    ctrl = state.ctrl.copy()
    ctrl[rows] = state.qpos[model.jnt_qposadr[model.actuator_joint[rows]]]
    gain = old.gain.copy()
    gain[rows] = 0.0
    law = replace(old, function=targets(old.function), gain=gain, settled=gain)
    return replace(state, ctrl=ctrl, feedback=law if np.any(gain) else None)


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
