"""Find servos that chatter at the ends of their force ranges, where kv has no effect.

A clamped force is independent of velocity. Its derivative is zero, so an integrator that treats the
servo's damping implicitly takes an explicit step there. With gain kv, force range ±F and moved
inertia I, the force is clamped above the speed F/kv, and a step changes the speed by F·dt/I. If
this change exceeds 2F/kv, that is for dt > 2I/kv, a step jumps from one end of the range to the
other, and the servo chatters permanently. Runs of the real step test for chatter: in the motion
itself, and after a kick beyond F/kv.

A servo's own oscillation may be unstable at a step although friction or the force range holds the
servo still in every linearised state. Once pushed, such a servo goes from end to end too
(`swinging_dt`).
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
)
from stepcore.measure.diagnosis.motion_limit import first_failing
from stepcore.measure.diagnosis.motion_runs import MotionRun, largest_speeds
from stepcore.measure.diagnosis.servo_range import (
    crossing_dt,
    driven_dof,
    largest_force,
    reaching_speed,
    swinging_dt,
)
from stepcore.measure.diagnosis.shares import Shares

# The kick over the speed at which the range is reached, and the most servos to kick.
KICK, SERVOS = 1.5, 6
# The fastest kick, unless the motion itself is faster: [rad/s] and [m/s].
FASTEST, FASTEST_SLIDE = 30.0, 3.0
# The steps of a kicked run, and of a run from a state: chatter begins at once.
STEPS, BRIEF = 1000, 500
# The largest ratio of thrown to kicked speed for a servo that comes to rest.
RESTS = 1.2


@dataclass(frozen=True)
class Saturation:
    """A servo that chatters at the ends of its force range.

    element: the servo.
    joint: the name of its joint.
    angular: whether the joint rotates.
    force: the end of the range [N·m or N].
    speed: the speed of the joint at which the range is reached [rad/s or m/s].
    thrown: the largest speed of the joint at the wanted dt [rad/s or m/s].
    usual: the largest speed of the joint in the motion at a fine step [rad/s or m/s].
    dt: the largest step at which the servo comes to rest [s].
    reached: whether the motion itself reaches the range, without a kick.
    severe: whether the chatter has `LARGE` times more energy than the kick, or is an unstable
        oscillation.
    swinging: whether the chatter is an unstable oscillation.
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
    """The observations of the motion at the wanted step.

    limit, shares: those of the scene's integrator, corrected by the motion.
    outcome: the outcome of the motion; None if the step is too long to judge.
    saturations: servos that chatter.
    lasting: see `Judge.lasting`.
    runaway: how the motion blows up at every step; None if it does not.
    gained: the energy that the integrator adds to a motion that nothing drives, over the largest
        kinetic energy of a fine run.
    """

    limit: Limit
    shares: Shares
    outcome: Outcome | None = None
    saturations: list[Saturation] = field(default_factory=list)
    lasting: float | None = None
    runaway: Runaway | None = None
    gained: float = 0.0


def look(judge: Judge | Runaway | None, limit: Limit, shares: Shares, wanted: float) -> Observation:
    """Run the motion at the wanted step, and after kicks beyond the servos' force ranges.

    judge: the runs of the motion.
    limit, shares: the present ones of the scene's integrator.
    wanted: the wanted step [s].
    """
    if isinstance(judge, Runaway):
        return Observation(limit, shares, runaway=judge)
    if judge is None or wanted > judge.longest:
        return Observation(limit, shares)
    run = judge.run(limit.integrator, wanted)
    outcome = judge.judged(run)
    if limit.dt >= wanted and outcome.kind == "explodes":
        # Near its limit a driven motion swings wider than in the fine run.
        outcome = replace(outcome, kind="holds")
    if limit.dt < wanted:
        chatter = []
        if limit.outcome == "chatters":
            servo = max(shares, key=lambda element: shares[element])
            chatter = [
                _described(judge, servo, run, limit.dt, True, run.peak > judge.bound_at(wanted))
            ]
        return Observation(limit, shares, outcome, chatter)
    limit, shares, chatter = kicked(judge, limit, shares, wanted)
    lasting = judge.lasting(limit.integrator, wanted) if outcome.holds else None
    return Observation(limit, shares, outcome, chatter, lasting, gained=judge.gained(run))


def kicked(
    judge: Judge, limit: Limit, shares: Shares, wanted: float
) -> tuple[Limit, Shares, list[Saturation]]:
    """Return limit and shares after kicks of the servos, and the servos that then chatter.

    A motion at rest says nothing of its servos, so a kick stands for the motion and moves the
    limit, at whatever step it chatters severely. Other motions have the limit of their own, and
    the servos that chatter at the wanted step after a kick are told.

    judge: the runs of the motion.
    limit, shares: the present ones of an integrator.
    wanted: the wanted step [s]; the worst servos at this step come first.
    """
    if judge.rests:
        found = _limiting_kick(judge, limit)
        if found is not None:
            dt, servo = found
            limit = replace(limit, dt=dt, state=0, outcome="chatters")
            shares = {servo: 1.0}
    chatter = []
    for kick in _kicks(judge, limit.integrator, wanted):
        run = kick.run(wanted)
        if not kick.rests(run):
            chatter.append(kick.saturation(run))
    chatter.sort(key=lambda servo: (not servo.severe, servo.dt))
    return limit, shares, chatter


def _limiting_kick(judge: Judge, limit: Limit) -> tuple[float, Element] | None:
    """Return the step [s] from which a kicked servo chatters severely, with the servo, or None."""
    found: tuple[float, Element] | None = None
    top = min(limit.dt, judge.longest)
    for kick in _kicks(judge, limit.integrator, top):
        dt = kick.severe_from(top if found is None else found[0])
        if dt is not None:
            found = dt, kick.servo
    return found


def holds_when_kicked(judge: Judge, model: Model, integrator: str, dt: float) -> bool:
    """Return the result of `Judge.holds`; at rest also after kicks beyond the force ranges."""
    if not judge.holds(model, integrator, dt):
        return False
    if not judge.rests:
        return True
    changed = replace(judge, real=replace(judge.real, model=model))
    for kick in _kicks(changed, integrator, dt):
        run = kick.run(dt)
        if not kick.rests(run) and kick.severe(run):
            return False
    return True


def settles(model: Model, state: State, integrator: str, dt: float, servo: int) -> bool:
    """Return whether a servo, kicked beyond its force range, throws its joint no faster.

    The servo's control is constant, so that in fine steps the servo comes to rest. A servo whose
    kick would be faster than any practical motion passes without a run.

    integrator, dt: the integrator and its step [s].
    servo: the index of the actuator.
    """
    if model.actuator_joint[servo] < 0:
        # Only an actuator of a single joint can be kicked.
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
    """Return the largest kick of a servo's joint, unless the motion itself is faster."""
    turns = model.jnt_type[int(model.actuator_joint[servo])] != "slide"
    return FASTEST if turns else FASTEST_SLIDE


@dataclass(frozen=True)
class _Kick:
    """The motion after a kick of a servo's joint beyond its force range.

    alone: the step above which the servo may be thrown across its range, in closed form [s].
    speed: the speed at which the range is reached [rad/s or m/s].
    swinging: see `Saturation`.
    """

    judge: Judge
    integrator: str
    servo: Element
    alone: float
    speed: float
    swinging: bool

    def run(self, dt: float) -> MotionRun:
        """Return the run of the kicked motion at a step."""
        real = self.judge.real
        kick = np.zeros(real.model.nv)
        kick[driven_dof(real.model, self.servo.index)] = KICK * self.speed
        horizon = min(STEPS * dt, self.judge.fine.reached)
        return real.run(self.integrator, dt, horizon=horizon, kick=kick)

    def rests(self, run: MotionRun) -> bool:
        """Return whether the servo does not chatter in a run."""
        return run.finite and float(run.swings[self.servo.index]) <= CHATTER

    def severe(self, run: MotionRun) -> bool:
        """Return whether a run far exceeds the energy of kick and motion, or swings permanently."""
        begun = max(float(run.energies[0]), self.judge.fine.peak, self.judge.floor)
        lasting = self.swinging and float(run.jumps[self.servo.index]) > CHATTER
        return not run.finite or run.peak > LARGE * begun or lasting

    def severe_from(self, top: float) -> float | None:
        """Return the step [s] from which severe chatter begins; None if not below `top` [s]."""
        dt = self.alone
        while dt < top:
            dt = min(2 * dt, top)
            run = self.run(dt)
            if not self.rests(run) and self.severe(run):
                return self.rests_to(dt)
        return None

    def rests_to(self, chatters: float) -> float:
        """Return the step [s] up to which the servo comes to rest, below one where it does not."""
        limit = first_failing(lambda dt: self.rests(self.run(dt)), self.alone, chatters)
        # At some longer steps friction stops this kick, but may not stop another one.
        return min(limit, self.alone) if self.swinging else limit

    def saturation(self, run: MotionRun) -> Saturation:
        """Return the servo's chatter in a run at the wanted step."""
        limit = self.rests_to(run.dt)
        servo = _described(self.judge, self.servo, run, limit, False, self.severe(run))
        return replace(servo, speed=self.speed, swinging=self.swinging)


def _kicks(judge: Judge, integrator: str, wanted: float) -> list[_Kick]:
    """Return kicks of the servos that a wanted step [s] may throw across, the worst first."""
    model, qpos = judge.real.model, judge.real.start.qpos
    kicks: list[_Kick] = []
    for i in range(model.nu if model.scene.features.actuation else 0):
        if model.actuator_joint[i] < 0:
            # Only an actuator of a single joint can be kicked.
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
    """Return the description of a servo's chatter in a run at the wanted step.

    dt: the largest step at which the servo comes to rest [s].
    """
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
