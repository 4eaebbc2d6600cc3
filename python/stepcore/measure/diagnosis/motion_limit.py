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

from stepcore.engine.element import INERTIAL
from stepcore.measure.diagnosis.growth import bisected
from stepcore.measure.diagnosis.limits import Limit, StepStability, step_stability
from stepcore.measure.diagnosis.linear_step import sim_at, state_of
from stepcore.measure.diagnosis.motion_check import Judge, Outcome
from stepcore.measure.diagnosis.servo_range import crossing_dt
from stepcore.measure.diagnosis.shares import Shares, limiting_shares

# Relative resolution of a limit that the motion decides.
FINE = 0.02
# The fraction of the linear limit at which the motion must be stable.
BELOW = 0.97
# The rates of a steady motion differ by less than this fraction of the fastest.
STEADY = 0.05
# The factor between successive steps in the search for chatter.
NEXT = 1.25
# Fractions of a limit found by bisection at which the motion must be stable too. Failure is not
# monotonic in dt: the balls of cup.xml under midpoint fail at 12.2 ms and are stable at 14.3 ms.
SHORTER_PARTS = (0.93, 0.86, 0.79, 0.7, 0.6)


def judged_limit(
    here: StepStability, judge: Judge | None, wanted: float, limit: Limit
) -> tuple[Limit, Shares]:
    """Return the limit of an integrator, corrected by the motion, and the elements' shares in it.

    here: the linearised step at the states.
    judge: the runs of the motion; None for no correction.
    wanted: the wanted dt [s].
    limit: the limit of the linearised step.
    """
    shares = limiting_shares(here, limit)
    if math.isfinite(limit.dt) and not any(shares.values()):
        shares = _spinning(here, limit) or shares
    if judge is None:
        return limit, shares
    search = _Search(judge, limit.integrator, min(limit.longest, judge.longest))
    dt = search.limit(limit.dt, wanted, decisive=not _moving(here, shares))
    if dt == limit.dt or not search.outcomes:
        return limit, shares
    failed = [dt for dt, outcome in search.outcomes.items() if not outcome.holds]
    if not failed:
        return replace(limit, dt=dt, state=-1, longest=search.longest), shares
    beyond, outcome = min(failed), search.outcomes[min(failed)]
    if outcome.element is not None:
        alone = crossing_dt(here.model, judge.real.start.qpos, outcome.element.index)
        dt = first_failing(search.holds, alone, beyond)
        return replace(limit, dt=dt, state=0, outcome=outcome.kind), {outcome.element: 1.0}
    moved = replace(limit, dt=dt, state=0, outcome=outcome.kind)
    return moved, _shares_of_run(here, judge, limit.integrator, beyond) or shares


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

    def limit(self, linear: float, wanted: float, decisive: bool) -> float:
        """Return the limit [s], which is the linear one if the motion agrees.

        linear: the limit of the linearised step [s].
        wanted: the wanted dt [s].
        decisive: whether the linear limit can only be lowered.
        """
        fine = self.judge.fine.dt
        if decisive:
            if linear <= fine:
                return linear
            self.linear = linear
        top = max(BELOW * linear, min(fine, self.longest)) if math.isfinite(linear) else wanted
        top = min(top, self.longest)
        failed = [dt for dt in (top, min(wanted, top), top / 2) if not self.holds(dt)]
        if failed:
            bad = min(failed)
            good = bad / 2
            while good > fine and not self.holds(good):
                bad, good = good, good / 2
            return self._below(bisected(self.holds, max(good, fine), bad, FINE))
        if decisive and math.isfinite(linear):
            return linear
        while top < self.longest:
            longer = min(2 * top, self.longest)
            if not self.holds(longer):
                return self._below(bisected(self.holds, top, longer, FINE))
            top = longer
        return math.inf

    def _below(self, limit: float) -> float:
        """Return the limit [s], lowered if some shorter steps fail."""
        for part in SHORTER_PARTS:
            if not self.holds(part * limit):
                low = part * limit / NEXT
                while low > self.judge.fine.dt and not self.holds(low):
                    low /= NEXT
                return self._below(bisected(self.holds, low, part * limit, FINE))
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
    """Return the elements' shares in the growth of a run that explodes, at the onset of growth."""
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
    return limiting_shares(there, Limit(integrator, dt, 0))
