"""Servos at the ends of their force ranges, where their damping is gone.

A force that is clamped no longer depends on the velocity: its derivative is zero, and an integrator
that treats the servo's damping implicitly takes an explicit step there. With gain kv, force range
±F and moved inertia I the force is clamped beyond the speed F/kv, and a step changes the speed by
F·dt/I: where that is more than 2F/kv, a step of dt > 2I/kv jumps from one end of the range to the
other, and the servo chatters for good. Whether it does is looked at on the real step: in the motion
itself, and after a kick beyond F/kv.

A servo whose oscillation by itself is unstable at a step, and which friction or its range holds in
every state that is linearised, goes from end to end too once it is pushed (`swinging_dt`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.judgement import CHATTER, EXPLODED, Judge, first_failing
from stepcore.measure.diagnosis.linear_step import State
from stepcore.measure.diagnosis.motion_runs import MotionRun, largest_speeds
from stepcore.measure.diagnosis.servo_range import (
    crossing_dt,
    driven_dof,
    largest_force,
    reaching_speed,
    swinging_dt,
)

# The kick over the speed at which the range is reached; the most servos that are kicked.
KICK, SERVOS = 1.5, 6
# The fastest kick, where the motion itself is no faster: [rad/s] and [m/s].
FASTEST, FASTEST_SLIDE = 30.0, 3.0
# The steps of a kicked run, and of one from a state: chatter shows at once.
STEPS, BRIEF = 1000, 500
# A servo that comes to rest throws its kicked joint no faster than by this factor.
RESTS = 1.2


@dataclass(frozen=True)
class Saturation:
    """A servo that chatters at the ends of its force range.

    element: which one. joint: its name. angular: whether that turns. force: the end of the range
    [N·m or N]. speed: of the joint, from which the range is reached [rad/s or m/s]. thrown: the
    largest speed of the joint at the wanted dt; usual: that of the motion at a fine step. dt: the
    largest step at which it comes to rest [s]. reached: whether the motion itself reaches the
    range, without a kick. severe: whether the chatter has more energy than the kick, by `EXPLODED`
    times, or is that of an oscillation which is unstable. swinging: whether it is that.
    """

    element: Element
    joint: str
    angular: bool
    force: float
    speed: float
    thrown: float
    usual: float
    dt: float
    reached: bool
    severe: bool
    swinging: bool = False


@dataclass(frozen=True)
class _Candidate:
    """A servo that a step may throw across its range.

    alone [s]: from which step on, by closed form. speed [rad/s or m/s]: at which the range is
    reached. swinging: see `Saturation`.
    """

    servo: Element
    alone: float
    speed: float
    swinging: bool


def saturations(judge: Judge, integrator: str, wanted: float) -> list[Saturation]:
    """The servos that chatter at the wanted dt [s] once they are kicked, the worst first."""
    found = []
    for candidate in _candidates(judge, integrator, wanted):
        kicked = _Kicked(judge, integrator, candidate)
        if not kicked.rests(kicked.run(wanted)):
            found.append(kicked.saturation(wanted))
    return sorted(found, key=lambda one: (not one.severe, one.dt))


def holds_when_kicked(judge: Judge, model: Model, integrator: str, dt: float) -> bool:
    """As `Judge.holds`, after a kick beyond the servos' force ranges too."""
    if not judge.holds(model, integrator, dt):
        return False
    changed = replace(judge, real=replace(judge.real, model=model))
    for candidate in _candidates(changed, integrator, dt):
        kicked = _Kicked(changed, integrator, candidate)
        run = kicked.run(dt)
        if not kicked.rests(run) and kicked.severe(run):
            return False
    return True


def settles(model: Model, state: State, integrator: str, dt: float, servo: int) -> bool:
    """Whether a servo that is kicked beyond its force range throws its joint no faster.

    Its control is held; in fine steps it comes to rest. A kick that is faster than any motion of
    use is not made. dt [s].
    """
    if model.actuator_joint[servo] < 0:
        # Not along one joint, which alone could be kicked.
        return True
    dof, kick = driven_dof(model, servo), KICK * reaching_speed(model, servo)
    if not kick <= _fastest(model, servo):
        return True
    push = np.zeros(model.nv)
    push[dof] = kick
    begun = abs(float(state.qvel[dof] + kick))
    state = replace(state, feedback=None)
    speeds = largest_speeds(model, state, integrator, dt, BRIEF, push)
    return speeds is not None and bool(speeds[dof] <= RESTS * begun)


def _fastest(model: Model, servo: int) -> float:
    """The fastest kick of a servo's joint, where the motion itself is no faster."""
    turns = model.jnt_type[int(model.actuator_joint[servo])] != "slide"
    return FASTEST if turns else FASTEST_SLIDE


def saturation_of(judge: Judge, element: Element, run: MotionRun, dt: float) -> Saturation:
    """What a servo does that chatters in the motion itself.

    run: at the wanted step. dt [s]: the largest step at which it does not.
    """
    return _described(judge, element, run, dt, True, run.peak > judge.bound)


def _candidates(judge: Judge, integrator: str, wanted: float) -> list[_Candidate]:
    """Servos that a step of `wanted` [s] may throw across, worst first."""
    model, qpos = judge.real.model, judge.real.start.qpos
    if not model.nu or not model.scene.features.actuation:
        return []
    found = []
    for i in range(model.nu):
        if model.actuator_joint[i] < 0:
            # Not along one joint, which alone could be kicked.
            continue
        usual = max(_fastest(model, i), judge.fine.speeds[driven_dof(model, i)])
        servo, speed = Element.of(model, "actuator", i), reaching_speed(model, i)
        limit, swing = swinging_dt(model, qpos, i, integrator)
        ways = [
            _Candidate(servo, crossing_dt(model, qpos, i), speed, False),
            _Candidate(servo, limit, min(speed, swing), True),
        ]
        may = [way for way in ways if KICK * way.speed <= usual and way.alone < wanted]
        found += may[:1]
    return sorted(found, key=lambda candidate: candidate.alone)[:SERVOS]


@dataclass(frozen=True)
class _Kicked:
    """The motion after a kick of a servo's joint beyond its force range."""

    judge: Judge
    integrator: str
    candidate: _Candidate

    @property
    def index(self) -> int:
        """The servo's."""
        return self.candidate.servo.index

    def run(self, dt: float) -> MotionRun:
        """The kicked motion at a step."""
        model = self.judge.real.model
        kick = np.zeros(model.nv)
        kick[driven_dof(model, self.index)] = KICK * self.candidate.speed
        horizon = min(STEPS * dt, self.judge.fine.reached)
        return self.judge.real.run(self.integrator, dt, horizon=horizon, kick=kick)

    def rests(self, run: MotionRun) -> bool:
        """Whether the servo does not chatter in a run."""
        return run.finite and float(run.swings[self.index]) <= CHATTER

    def severe(self, run: MotionRun) -> bool:
        """Whether a run has much more energy than the kick and the motion, or swings for good."""
        begun = max(float(run.energies[0]), self.judge.fine.peak, self.judge.floor)
        lasting = self.candidate.swinging and float(run.jumps[self.index]) > CHATTER
        return not run.finite or run.peak > EXPLODED * begun or lasting

    def saturation(self, wanted: float) -> Saturation:
        """What it does at the wanted step."""
        alone = self.candidate.alone
        limit = first_failing(lambda dt: self.rests(self.run(dt)), alone, wanted)
        if self.candidate.swinging:
            # At some longer steps friction catches this kick, and not another one.
            limit = min(limit, alone)
        run = self.run(wanted)
        found = _described(self.judge, self.candidate.servo, run, limit, False, self.severe(run))
        return replace(found, speed=self.candidate.speed, swinging=self.candidate.swinging)


def _described(
    judge: Judge, servo: Element, run: MotionRun, dt: float, reached: bool, severe: bool
) -> Saturation:
    model = judge.real.model
    usual = float(judge.fine.speeds[driven_dof(model, servo.index)])
    joint = int(model.actuator_joint[servo.index])
    return Saturation(
        element=servo,
        joint=model.element_name("joint", joint),
        angular=model.jnt_type[joint] != "slide",
        force=largest_force(model, servo.index),
        speed=reaching_speed(model, servo.index),
        thrown=float(run.speeds[driven_dof(model, servo.index)]),
        usual=usual,
        dt=dt,
        reached=reached,
        severe=severe,
    )
