"""Servos at the ends of their force ranges, where kv has no effect, and what the motion does.

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

from dataclasses import dataclass, field, replace

import numpy as np

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.failure import LARGE
from stepcore.measure.diagnosis.limits import Limit
from stepcore.measure.diagnosis.linear_step import State
from stepcore.measure.diagnosis.motion_check import (
    CHATTER,
    Judge,
    Outcome,
    Runaway,
    first_failing,
)
from stepcore.measure.diagnosis.motion_runs import MotionRun, largest_speeds
from stepcore.measure.diagnosis.servo_range import (
    crossing_dt,
    driven_dof,
    largest_force,
    reaching_speed,
    swinging_dt,
)
from stepcore.measure.diagnosis.shares import Shares

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
    range, without a kick. severe: whether the chatter has more energy than the kick, by `LARGE`
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
class Observation:
    """What was seen of the motion at the wanted step.

    limit, shares: of the scene's integrator, after it. outcome: what the motion did; None where
    the step is too long to tell. saturations: servos that chatter. lasting: see `Judge.lasting`.
    runaway: where the motion blows up at every step.
    """

    limit: Limit
    shares: Shares
    outcome: Outcome | None = None
    saturations: list[Saturation] = field(default_factory=list)
    lasting: float | None = None
    runaway: Runaway | None = None


def look(judge: Judge | Runaway | None, limit: Limit, shares: Shares, wanted: float) -> Observation:
    """Runs the motion at the wanted step [s], and after kicks beyond the servos' force ranges.

    limit, shares: of the scene's integrator so far.
    """
    if isinstance(judge, Runaway):
        return Observation(limit, shares, runaway=judge)
    if judge is None or wanted > judge.longest:
        return Observation(limit, shares)
    run = judge.run(limit.integrator, wanted)
    outcome = judge.judged(run)
    if limit.dt >= wanted and outcome.kind == "explodes":
        # Driven near its limit, the motion swings wider than the fine run's.
        outcome = replace(outcome, kind="holds")
    if limit.dt < wanted:
        chatter = []
        if limit.outcome == "chatters":
            servo = max(shares, key=lambda element: shares[element])
            chatter = [_described(judge, servo, run, limit.dt, True, run.peak > judge.bound)]
        return Observation(limit, shares, outcome, chatter)
    limit, shares, chatter = kicked(judge, limit, shares, wanted)
    lasting = judge.lasting(limit.integrator, wanted) if outcome.holds else None
    return Observation(limit, shares, outcome, chatter, lasting)


def kicked(
    judge: Judge, limit: Limit, shares: Shares, wanted: float
) -> tuple[Limit, Shares, list[Saturation]]:
    """A limit and its shares after kicks of the servos, and those that chatter at the wanted dt [s]
    then, the worst first."""
    chatter = []
    for kick in _kicks(judge, limit.integrator, wanted):
        run = kick.run(wanted)
        if not kick.rests(run):
            chatter.append(kick.saturation(run))
    chatter.sort(key=lambda servo: (not servo.severe, servo.dt))
    if chatter and chatter[0].severe:
        limit = replace(limit, dt=chatter[0].dt, state=0, outcome="chatters")
        shares = {chatter[0].element: 1.0}
    return limit, shares, chatter


def holds_when_kicked(judge: Judge, model: Model, integrator: str, dt: float) -> bool:
    """As `Judge.holds`, after a kick beyond the servos' force ranges too."""
    if not judge.holds(model, integrator, dt):
        return False
    changed = replace(judge, real=replace(judge.real, model=model))
    for kick in _kicks(changed, integrator, dt):
        run = kick.run(dt)
        if not kick.rests(run) and kick.severe(run):
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
    state = replace(state, feedback=None)
    speeds = largest_speeds(model, state, integrator, dt, BRIEF, push)
    return speeds is not None and bool(speeds[dof] <= RESTS * abs(state.qvel[dof] + kick))


def _fastest(model: Model, servo: int) -> float:
    """The fastest kick of a servo's joint, where the motion itself is no faster."""
    turns = model.jnt_type[int(model.actuator_joint[servo])] != "slide"
    return FASTEST if turns else FASTEST_SLIDE


@dataclass(frozen=True)
class _Kick:
    """The motion after a kick of a servo's joint beyond its force range.

    alone [s]: the step from which on it may be thrown across the range, by closed form. speed
    [rad/s or m/s]: at which the range is reached. swinging: see `Saturation`.
    """

    judge: Judge
    integrator: str
    servo: Element
    alone: float
    speed: float
    swinging: bool

    def run(self, dt: float) -> MotionRun:
        """The kicked motion at a step."""
        real = self.judge.real
        kick = np.zeros(real.model.nv)
        kick[driven_dof(real.model, self.servo.index)] = KICK * self.speed
        horizon = min(STEPS * dt, self.judge.fine.reached)
        return real.run(self.integrator, dt, horizon=horizon, kick=kick)

    def rests(self, run: MotionRun) -> bool:
        """Whether the servo does not chatter in a run."""
        return run.finite and float(run.swings[self.servo.index]) <= CHATTER

    def severe(self, run: MotionRun) -> bool:
        """Whether a run has much more energy than the kick and the motion, or swings for good."""
        begun = max(float(run.energies[0]), self.judge.fine.peak, self.judge.floor)
        lasting = self.swinging and float(run.jumps[self.servo.index]) > CHATTER
        return not run.finite or run.peak > LARGE * begun or lasting

    def saturation(self, run: MotionRun) -> Saturation:
        """What it does in a run at the wanted step."""
        limit = first_failing(lambda dt: self.rests(self.run(dt)), self.alone, run.dt)
        if self.swinging:
            # At some longer steps friction catches this kick, and not another one.
            limit = min(limit, self.alone)
        servo = _described(self.judge, self.servo, run, limit, False, self.severe(run))
        return replace(servo, speed=self.speed, swinging=self.swinging)


def _kicks(judge: Judge, integrator: str, wanted: float) -> list[_Kick]:
    """Kicks of the servos that a step of `wanted` [s] may throw across, the worst first."""
    model, qpos = judge.real.model, judge.real.start.qpos
    kicks: list[_Kick] = []
    for i in range(model.nu if model.scene.features.actuation else 0):
        if model.actuator_joint[i] < 0:
            # Not along one joint, which alone could be kicked.
            continue
        usual = max(_fastest(model, i), judge.fine.speeds[driven_dof(model, i)])
        servo, speed = Element.of(model, "actuator", i), reaching_speed(model, i)
        limit, swing = swinging_dt(model, qpos, i, integrator)
        may = [
            _Kick(judge, integrator, servo, crossing_dt(model, qpos, i), speed, False),
            _Kick(judge, integrator, servo, limit, min(speed, swing), True),
        ]
        kicks += [kick for kick in may if KICK * kick.speed <= usual and kick.alone < wanted][:1]
    return sorted(kicks, key=lambda kick: kick.alone)[:SERVOS]


def _described(
    judge: Judge, servo: Element, run: MotionRun, dt: float, reached: bool, severe: bool
) -> Saturation:
    """What a servo does in a run at the wanted step; dt [s]: the largest at which it rests."""
    model = judge.real.model
    dof, joint = driven_dof(model, servo.index), int(model.actuator_joint[servo.index])
    return Saturation(
        element=servo,
        joint=model.element_name("joint", joint),
        angular=model.jnt_type[joint] != "slide",
        force=largest_force(model, servo.index),
        speed=reaching_speed(model, servo.index),
        thrown=float(run.speeds[dof]),
        usual=float(judge.fine.speeds[dof]),
        dt=dt,
        reached=reached,
        severe=severe,
    )
