"""Correct the largest stable dt by runs of the motion, where the linearised step does not decide.

A limit is moved to the largest step at which the motion neither explodes nor chatters
(`motion_check`). If the state that limits dt is steady, the linearised step alone decides. If
inertial forces limit dt at a state that changes, the motion alone decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stepcore.engine.element import INERTIAL, Element
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.growth import bisected
from stepcore.measure.diagnosis.limits import Limit, StepStability, step_stability
from stepcore.measure.diagnosis.linear_step import State, sim_at, state_of
from stepcore.measure.diagnosis.motion_check import Judge, Outcome
from stepcore.measure.diagnosis.servo_range import crossing_dt
from stepcore.measure.diagnosis.shares import Shares, limiters, limiting_shares

# Relative resolution of a limit that the motion decides.
FINE = 0.02
# The fraction of the linear limit at which the motion must be stable.
BELOW = 0.97
# The rates of a steady motion differ by less than this fraction of the fastest.
STEADY = 0.05
# The share of the steps in which the force of a servo that begins to chatter goes from end to end.
# It grows with dt, with a scatter of 0.05 between neighbouring steps: Panda under sines 0.11 at
# 2 ms, 0.2 at 2.9 ms, 0.3 at 3.8 ms (not at 4.6 ms), 0.5 at 7.5 ms; UR5e 0.2 at 2.7 ms, and 0.3
# from 3 to 4.9 ms.
BEGINS, SCATTER = 0.2, 0.05
# The factor between successive steps in a search for failures, the number of steps at this factor
# (shorter ones are halved), and the fewest steps.
NEXT, DENSE, FEWEST_STEPS = 1.25, 10, 4
# Fractions of a limit found by bisection at which the motion must be stable too. Failure is not
# monotonic in dt: the balls of cup.xml under midpoint fail at 12.2 ms and are stable at 14.3 ms.
SHORTER_PARTS = (0.93, 0.86, 0.79, 0.7, 0.6)


def judged_limit(
    here: StepStability, judge: Judge | None, wanted: float, limit: Limit
) -> tuple[Limit, Shares]:
    """Return the limit of an integrator, corrected by the motion, and the elements' shares in it.

    A body that spins freely and limits dt does so from half a turn in a step at the latest: beyond,
    its orientation at the steps no longer shows which way it turns.

    here: the linearised step at the states.
    judge: the runs of the motion; None for no correction.
    wanted: the wanted dt [s].
    limit: the limit of the linearised step.
    """
    limit, shares = _judged(here, judge, wanted, limit)
    spinning = _spin(shares)
    if not math.isfinite(limit.dt) or spinning is None:
        return limit, shares
    decides = [here.states[limit.state]] if limit.state >= 0 and not limit.outcome else here.states
    speed = max(_speed(here.model, state, spinning.index) for state in decides)
    limit = replace(limit, speed=speed)
    half = math.pi / max(speed, 1e-300)
    if half < limit.dt and _spins_freely(here.model, spinning.index):
        limit = replace(limit, dt=half, outcome="turns")
    return limit, shares


def _spin(shares: Shares) -> Element | None:
    """Return the spin with the largest share, if spins and inertial forces lead the shares."""
    by_share = sorted(shares, key=lambda element: -shares[element])
    while by_share and by_share[0] == INERTIAL:
        by_share = by_share[1:]
    first = by_share[0] if by_share else INERTIAL
    return first if first.kind == "spin" and shares[first] > 0 else None


def _speed(model: Model, state: State, body: int) -> float:
    """Return the angular speed of a body at a state [rad/s]."""
    return float(np.linalg.norm(sim_at(model, state).cvel[body, :3]))


def _spins_freely(model: Model, body: int) -> bool:
    """Return whether a body hangs on a free or a ball joint."""
    joints = np.flatnonzero(model.jnt_body == body).tolist()
    return any(model.jnt_type[joint] in ("free", "ball") for joint in joints)


def _judged(
    here: StepStability, judge: Judge | None, wanted: float, limit: Limit
) -> tuple[Limit, Shares]:
    """Return the limit and the shares of `judged_limit`, from the step and the motion alone."""
    shares = limiting_shares(here, limit)
    if math.isfinite(limit.dt) and not any(shares.values()):
        shares = _spinning(here, limit) or shares
    if judge is None:
        return limit, shares
    search = _Search(judge, limit.integrator, min(limit.longest, judge.longest))
    dt = search.limit(limit.dt, wanted, decisive=not _moving(here, shares))
    if dt == limit.dt or not search.outcomes:
        if math.isinf(dt):
            limit = replace(limit, longest=search.longest)
        return limit, shares
    failed = [dt for dt, outcome in search.outcomes.items() if not outcome.holds]
    if not failed:
        return replace(limit, dt=dt, state=-1, longest=search.longest), shares
    beyond, outcome = min(failed), search.outcomes[min(failed)]
    if outcome.kind == "chatters":
        # Whichever servo chatters here, another one may begin to at a shorter step.
        servos, qpos = range(here.model.nu), judge.real.start.qpos
        alone = min(crossing_dt(here.model, qpos, servo) for servo in servos)
        dt = first_failing(search.calm, max(alone, judge.fine.dt), beyond)
        dt = search.below(dt, search.nearly_calm)
        failed = [dt for dt, outcome in search.outcomes.items() if not outcome.holds]
        outcome = search.outcomes[min(failed)]
    if outcome.element is not None:
        return replace(limit, dt=dt, state=0, outcome=outcome.kind), {outcome.element: 1.0}
    moved = replace(limit, dt=dt, state=0, outcome=outcome.kind)
    return moved, _shares_of_run(here, judge, limit.integrator, beyond)


def first_failing(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return the step [s] up to which all steps pass.

    Steps from `low` on are tried at small intervals, because chatter begins at a step and may die
    out by chance at longer ones.

    holds: whether a step passes.
    low: a step [s] at which chatter may begin; inf if unknown.
    high: a step [s] that fails.
    """
    low = min(low, high)
    good = low / NEXT
    while not holds(good) and good > low / 100:
        good /= 2
    while good * NEXT < high and holds(good * NEXT):
        good *= NEXT
    return bisected(holds, good, min(good * NEXT, high), FINE)


class _Search:
    """A search, with few runs, for the step at which a motion begins to fail."""

    def __init__(self, judge: Judge, integrator: str, longest: float) -> None:
        self.judge, self.integrator, self.longest = judge, integrator, longest
        self.outcomes: dict[float, Outcome] = {}
        self.linear = math.inf

    def holds(self, dt: float) -> bool:
        """Return whether the motion neither explodes nor chatters at a step."""
        if dt not in self.outcomes:
            # A driven motion below its limit swings wider the nearer the limit is, without
            # exploding.
            more = (1 - (dt / self.linear) ** 2) ** -2 if dt < self.linear else 1.0
            self.outcomes[dt] = self.judge.outcome(self.integrator, dt, more)
        return self.outcomes[dt].holds

    def calm(self, dt: float) -> bool:
        """Return whether the motion holds at a step, and no servo begins to chatter there."""
        return self.holds(dt) and self.outcomes[dt].jumps <= BEGINS

    def nearly_calm(self, dt: float) -> bool:
        """Return whether the motion is calm at a step, or chatters no more than by scatter."""
        return self.holds(dt) and self.outcomes[dt].jumps <= BEGINS + SCATTER

    def limit(self, linear: float, wanted: float, decisive: bool) -> float:
        """Return the limit [s], which is the linear one if the motion agrees.

        linear: the limit of the linearised step [s].
        wanted: the wanted dt [s], tried besides the steps that are tried in any case.
        decisive: whether the linear limit can only be lowered.
        """
        fine, top = self.judge.fine.dt, self.longest
        if decisive and linear <= fine:
            return linear
        if decisive and math.isfinite(linear):
            self.linear = linear
            top = min(BELOW * linear, top)
        bad = self._lowest(top)
        limit = self._edge(bad) if bad else linear if decisive else math.inf
        if wanted < min(limit, top) and not self.holds(wanted):
            limit = self._edge(self._lowest(wanted) or wanted)
        return limit

    def _lowest(self, top: float) -> float | None:
        """Return the shortest step [s] that fails of those tried from the longest down, or None.

        Longer steps may hold by luck: a body that spins at 300 rad/s fails at 20 ms and is stable
        at 62 and 125 ms, where it turns by whole turns in a step. The runs at the longest steps
        have together about as many steps as one run.
        """
        dt, lowest, left, steps = top, None, DENSE, 0.0
        while dt >= self.judge.fine.dt:
            steps += self.judge.fine.reached / dt
            if left <= DENSE - FEWEST_STEPS and steps > self.judge.real.most:
                break
            if self.holds(dt):
                dt /= NEXT if left > 0 else 2
                left -= 1
            elif self.outcomes[dt].kind == "chatters":
                # The step from which servos chatter is found from below.
                return dt
            else:
                lowest, left, steps = dt, DENSE // 2, 0.0
                dt /= NEXT
        return lowest

    def _edge(self, bad: float) -> float:
        """Return the limit [s] just below a step that fails."""
        if self.outcomes[bad].kind == "chatters":
            return bad
        good = bad / NEXT
        while good > self.judge.fine.dt and not self.holds(good):
            bad, good = good, good / NEXT
        limit = bisected(self.holds, max(good, self.judge.fine.dt), bad, FINE)
        return self.below(limit, self.holds)

    def below(self, limit: float, holds: Callable[[float], bool]) -> float:
        """Return the limit [s], lowered if some shorter steps fail.

        holds: whether a step passes.
        """
        for part in SHORTER_PARTS:
            if not holds(part * limit):
                low = part * limit / NEXT
                while low > self.judge.fine.dt and not holds(low):
                    low /= NEXT
                return self.below(bisected(holds, low, part * limit, FINE), holds)
        return limit


def _moving(here: StepStability, shares: Shares) -> bool:
    """Return whether inertial forces limit dt at changing states, where the motion decides."""
    most = max(shares, key=lambda element: shares[element], default=INERTIAL)
    if most != INERTIAL and most.kind != "spin":
        return False
    rates = [np.sort(np.abs(rates)) for rates in here.rates]
    size = max(float(r[-1]) for r in rates)
    return any(bool(np.abs(r - rates[0]).max() > STEADY * size) for r in rates)


def _spinning(here: StepStability, limit: Limit) -> Shares:
    """Return the whole share for the fastest spin at the state of a limit; {} if nothing spins."""
    motion = here.motion(here.states[limit.state])
    parts = {} if motion is None else motion.elements
    sizes = {
        element: float(np.abs(matrices.damping).max(initial=0.0))
        for element, matrices in parts.items()
        if element.kind == "spin"
    }
    return {max(sizes, key=lambda element: sizes[element]): 1.0} if any(sizes.values()) else {}


def _shares_of_run(here: StepStability, judge: Judge, integrator: str, dt: float) -> Shares:
    """Return equal shares for the elements that limit dt at the onset of growth of a run, or {}."""
    calm = judge.run(integrator, dt).calm
    if calm is None:
        return {}
    sim = sim_at(here.model, calm)
    sim.forward()
    state = state_of(sim, f"t = {calm.time:.3g} s", calm.time)
    try:
        there = step_stability(here.model, [state], here.horizon)
    except ValueError:
        return {}
    if there.growth(integrator, dt, 0).stable:
        return {}
    at = Limit(integrator, dt, 0)
    elements = limiters(there, at, limiting_shares(there, at))
    return dict.fromkeys(elements, 1 / max(len(elements), 1))
