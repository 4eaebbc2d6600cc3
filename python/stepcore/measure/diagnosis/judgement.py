"""The largest stable dt as the motion itself shows it, where the linearised step does not decide.

The motion is run with the real step (`motion_runs`) at the limit of the linearised step, and the
limit is moved to where the motion still holds. The linearised step alone decides where the state
that limits dt stays what it is; where inertial forces limit dt at a state that changes, the motion
alone does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepcore.engine.element import INERTIAL, Element
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.growth import bisected
from stepcore.measure.diagnosis.limits import Limit, StepStability, step_stability
from stepcore.measure.diagnosis.linear_motion import linear_motion
from stepcore.measure.diagnosis.linear_step import State, sim_at, state_of
from stepcore.measure.diagnosis.motion_runs import FEWEST, MotionRun, MotionRuns
from stepcore.measure.diagnosis.servo_range import crossing_dt
from stepcore.measure.diagnosis.shares import Shares, growing_shares, limiting_shares

# Kinetic energy over the largest of the fine run that counts as an explosion.
EXPLODED = 10.0
# A servo chatters whose force goes from one end of its range to the other in so many of the steps:
# every other one in a cycle of four.
CHATTER = 0.3
# Relative resolution of a limit that the motion decides.
FINE = 0.02
# The part of the linear limit at which the motion must hold.
BELOW = 0.97
# The rates of a steady motion differ by less than this, in parts of the fastest.
STEADY = 0.05
# The fine runs that are tried, until one agrees with the one before: integrator, and step over that
# of the states' run; and how far the energies of two that agree may be apart.
FINER = (
    ("implicitfast", 0.5),
    ("rk4", 0.5),
    ("implicitfast", 0.125),
    ("implicitfast", 0.03),
    ("implicitfast", 0.008),
)
REFINED = 1.5
# Energy over that of a slow motion from which a motion has blown up at any step; how far apart the
# times may be of two that blow up alike.
RUNAWAY, ALIKE = 1e16, 1.2
# A factor of the energy of an explosion for a model with a change made, whose masses may be others.
CHANGED = 1e3
# Energy over the first that exceeds the bound, up to which a saturated servo may throw.
THROWN = 1e9
# The factor between steps at which chatter is looked for.
NEXT = 1.25
# Parts of a limit found by bisection at which the motion must hold: it may fail, hold and fail.
SHORTER_PARTS = (0.93, 0.86, 0.79, 0.7, 0.6)
# The share of a run's steps in which a force jumps that is thrown far; a fine run has fewer.
SOME = 0.01
# Horizons over which a slow growth is looked for, at the step and at this part of it.
LONGER, SHORTER = 10, 4


@dataclass(frozen=True)
class Outcome:
    """What the motion did at a step.

    kind: "holds", "explodes" or "chatters". time [s]: when, or how far the run went. element: the
    servo that chatters. energy: the largest kinetic energy over that of the fine run.
    """

    kind: str
    time: float
    energy: float
    element: Element | None = None

    @property
    def holds(self) -> bool:
        """Whether the motion is that of the fine run, as far as energy shows."""
        return self.kind == "holds"


@dataclass(frozen=True)
class Judge:
    """Compares runs of the real step with a fine one.

    real: the motion. fine: its run at a fine step. confirmed: whether a finer step gave the same.
    """

    real: MotionRuns
    fine: MotionRun
    confirmed: bool
    floor: float

    @property
    def bound(self) -> float:
        """The kinetic energy [J] from which a run explodes."""
        return EXPLODED * max(self.fine.peak, self.floor)

    def run(self, integrator: str, dt: float, more: float = 1.0) -> MotionRun:
        """The motion at this step, as far as the fine run went; more: a factor of the bound."""
        run = self.real.run(integrator, dt, horizon=self.fine.reached, beyond=more * self.bound)
        if run.finite and run.peak > more * self.bound and bool(run.saturated.any()):
            # A servo at its force range throws far, and may stay finite.
            return self.real.run(
                integrator, dt, horizon=self.fine.reached, beyond=THROWN * run.peak
            )
        return run

    def outcome(self, integrator: str, dt: float, more: float = 1.0) -> Outcome:
        """What the motion does at this step; more: a factor of the energy of an explosion."""
        return self.judged(self.run(integrator, dt, more), more)

    def holds(self, model: Model, integrator: str, dt: float) -> bool:
        """Whether the motion holds at this step, of the model or of one with a change made.

        A step that is long beside the motion makes too few steps to tell: it holds.
        """
        if dt > self.longest:
            return True
        return (
            replace(self, real=replace(self.real, model=model))
            .outcome(integrator, dt, CHANGED)
            .holds
        )

    @property
    def longest(self) -> float:
        """The longest step of which a run tells something [s]."""
        return self.fine.reached / FEWEST

    def lasting(self, integrator: str, dt: float) -> float | None:
        """When a growth that is the integrator's exceeds the bound after the horizon [s].

        None where it does not in `LONGER` horizons, where a quarter of the step does the same, and
        with a control function, which need not know what to do after the horizon.
        """
        if dt > self.longest or self.real.schedule.control is not None:
            return None
        far = self.real.run(integrator, dt, horizon=LONGER * self.fine.reached, beyond=self.bound)
        if far.finite and far.peak <= self.bound:
            return None
        finer = self.real.run(integrator, dt / SHORTER, horizon=far.reached)
        alike = not finer.finite or finer.peak > self.bound / 2
        return None if alike or finer.reached < 0.9 * far.reached else far.reached

    def judged(self, run: MotionRun, more: float = 1.0) -> Outcome:
        """What a run showed; more: as in `outcome`."""
        times = run.peak / max(self.fine.peak, self.floor)
        often = (run.jumps > CHATTER) | (run.swings > CHATTER)
        if run.peak > self.bound:
            # Chatter that throws far may come to rest by luck.
            often |= run.swings > SOME
        jumping = np.flatnonzero(often & (self.fine.swings < CHATTER / 2))
        if run.finite and len(jumping):
            servo = Element.of(self.real.model, "actuator", int(jumping[0]))
            return Outcome("chatters", run.reached, times, servo)
        if not run.finite or run.peak > more * self.bound:
            return Outcome("explodes", run.reached, times)
        return Outcome("holds", run.reached, times)


@dataclass(frozen=True)
class Runaway:
    """A motion that blows up at every step that was tried.

    times, dts [s]: when, at the two shortest of them. alike: whether these agree: it is the motion
    that grows then, and no dt changes it. element: what grows, if one element does.
    """

    times: tuple[float, float]
    dts: tuple[float, float]
    alike: bool
    element: Element | None = None


def judge(real: MotionRuns, dt: float) -> Judge | Runaway | None:
    """A judge with a fine run of its own, at a part of `dt` [s], and confirmed by another.

    A Runaway where the finest runs blow up; None where only the last does not.
    """
    floor = real.least_energy()
    runs: list[MotionRun] = []
    for integrator, part in FINER:
        runs.append(real.run(integrator, part * dt, beyond=RUNAWAY * floor))
        if len(runs) > 1 and _same(runs[-2], runs[-1], floor):
            # The one that went on longer: both are fine enough.
            chosen = max(runs[-2:], key=lambda one: round(one.reached, 9))
            return Judge(real, chosen, True, floor)
        if len(runs) > 2 and (found := _runaway(real.model, runs[-2:], floor)) and found.alike:
            return found
    found = _runaway(real.model, runs[-2:], floor)
    if found is not None:
        return found
    return None if _blown(runs[-1], floor) else Judge(real, runs[-1], False, floor)


def _blown(run: MotionRun, floor: float) -> bool:
    return not run.finite or run.peak > RUNAWAY * floor


def _runaway(model: Model, runs: Sequence[MotionRun], floor: float) -> Runaway | None:
    """What two runs that both blow up show; None where one of them does not."""
    coarse, fine = runs
    if not (_blown(coarse, floor) and _blown(fine, floor)):
        return None
    early, late = sorted((coarse.reached, fine.reached))
    alike = late <= ALIKE * early
    element = _growing(model, fine.calm) if alike and fine.calm is not None else None
    return Runaway((coarse.reached, fine.reached), (coarse.dt, fine.dt), alike, element)


def _growing(model: Model, state: State) -> Element | None:
    """The element with the largest share in the fastest growth of the motion itself at a state."""
    motion = linear_motion(model, state, None)
    shares = {} if motion is None else growing_shares(motion)
    largest = max(shares, key=lambda element: shares[element], default=None)
    return largest if largest is not None and shares[largest] > 0 else None


def _same(coarse: MotionRun, fine: MotionRun, floor: float) -> bool:
    """Whether two runs agree: in kinetic energy as long as both went on, and without chatter."""
    if _blown(coarse, floor) or _blown(fine, floor):
        return False
    if bool((np.maximum(coarse.swings, fine.swings) > SOME).any()):
        return False
    until = min(coarse.reached, fine.reached)
    peaks = [max(_peak_until(run, until), floor) for run in (coarse, fine)]
    return max(peaks) <= REFINED * min(peaks)


def _peak_until(run: MotionRun, time: float) -> float:
    """The largest kinetic energy of a run until a time [J]."""
    return float(run.energies[run.times <= time * (1 + 1e-9)].max())


def judged_limit(
    here: StepStability, judge: Judge | None, wanted: float, limit: Limit
) -> tuple[Limit, Shares]:
    """The limit of an integrator, corrected by the motion itself, and the elements' shares in it.

    limit: that of the linearised step. wanted: the dt asked about [s].
    """
    shares = limiting_shares(here, limit)
    if math.isfinite(limit.dt) and not any(shares.values()):
        shares = _spinning(here, limit) or shares
    if judge is None:
        return limit, shares
    decisive = not _moving(here, shares)
    search = _Search(judge, limit.integrator, min(limit.longest, judge.longest))
    dt = search.limit(limit.dt, wanted, decisive)
    if dt == limit.dt or not search.outcomes:
        return limit, shares
    beyond = search.first_failure()
    if beyond is None:
        return replace(limit, dt=dt, state=-1, longest=min(limit.longest, judge.longest)), shares
    at, outcome = beyond
    if outcome.element is not None:
        alone = crossing_dt(here.model, judge.real.start.qpos, outcome.element.index)
        dt = first_failing(search.holds, alone, at)
        return replace(limit, dt=dt, state=0, outcome=outcome.kind), {outcome.element: 1.0}
    moved = replace(limit, dt=dt, state=0, outcome=outcome.kind)
    return moved, _shares_of_run(here, judge, limit.integrator, at) or shares


def first_failing(holds: Callable[[float], bool], low: float, high: float) -> float:
    """The step [s] up to which all hold; from `low` on they are tried, in small parts.

    Chatter begins at a step and may rest at some longer ones, by luck. low [s]: may be
    inf, where nothing says from where on. high [s]: fails.
    """
    low = min(low, high)
    good = low / NEXT
    while not holds(good) and good > low / 100:
        good /= 2
    while good * NEXT < high and holds(good * NEXT):
        good *= NEXT
    return bisected(holds, good, min(good * NEXT, high), FINE)


def _moving(here: StepStability, shares: Shares) -> bool:
    """Whether a motion limits dt that does not stay what it is: the linear step cannot decide."""
    most = max(shares, key=lambda element: shares[element], default=INERTIAL)
    if most != INERTIAL and most.kind != "spin":
        return False
    rates = [np.sort(np.abs(rates)) for rates in here.rates]
    size = max(float(r[-1]) for r in rates)
    return any(bool(np.abs(r - rates[0]).max() > STEADY * size) for r in rates)


def _spinning(here: StepStability, limit: Limit) -> Shares:
    """All to the fastest spin at the state of a limit; nothing where nothing spins."""
    motion = here.motion(here.states[limit.state])
    sizes = (
        {}
        if motion is None
        else {
            element: float(np.abs(matrices.damping).max(initial=0.0))
            for element, matrices in motion.elements.items()
            if element.kind == "spin"
        }
    )
    return {max(sizes, key=lambda element: sizes[element]): 1.0} if any(sizes.values()) else {}


def _shares_of_run(here: StepStability, judge: Judge, integrator: str, dt: float) -> Shares:
    """The elements' shares in the growth of a run that explodes, where it begins."""
    run = judge.run(integrator, dt)
    if run.calm is None:
        return {}
    sim = sim_at(here.model, run.calm)
    sim.forward()
    state = state_of(sim, f"t = {run.calm.time:.3g} s", run.calm.time)
    try:
        there = step_stability(here.model, [state], here.horizon)
    except ValueError:
        return {}
    if there.growth(integrator, dt, 0).stable:
        return {}
    return limiting_shares(there, Limit(integrator, dt, 0))


class _Search:
    """Where a motion ceases to hold, by as few runs as may be."""

    def __init__(self, judge: Judge, integrator: str, longest: float) -> None:
        self.judge, self.integrator, self.longest = judge, integrator, longest
        self.outcomes: dict[float, Outcome] = {}
        self.linear = math.inf

    def holds(self, dt: float) -> bool:
        """Whether the motion holds at a step."""
        if dt not in self.outcomes:
            # What is driven below a limit swings the wider the nearer it is, and does not explode.
            more = (1 - (dt / self.linear) ** 2) ** -2 if dt < self.linear else 1.0
            self.outcomes[dt] = self.judge.outcome(self.integrator, dt, more)
        return self.outcomes[dt].holds

    def first_failure(self) -> tuple[float, Outcome] | None:
        """The shortest step at which the motion does not hold."""
        failed = [dt for dt, outcome in self.outcomes.items() if not outcome.holds]
        return (min(failed), self.outcomes[min(failed)]) if failed else None

    def limit(self, linear: float, wanted: float, decisive: bool) -> float:
        """The limit [s]: the linear one where the motion agrees with it.

        decisive: whether the motion may only lower it.
        """
        if linear <= self.judge.fine.dt and decisive:
            return linear
        if decisive:
            self.linear = linear
        least = min(self.judge.fine.dt, self.longest)
        top = max(BELOW * linear, least) if math.isfinite(linear) else wanted
        top = min(top, self.longest)
        tried = {top / 2, top, min(wanted, top)}
        failed = [dt for dt in sorted(tried, reverse=True) if not self.holds(dt)]
        if failed:
            return self._downwards(min(failed))
        if decisive and math.isfinite(linear):
            return linear
        return self._upwards(top)

    def _downwards(self, bad: float) -> float:
        """The limit [s] below a step at which the motion does not hold."""
        good = bad / 2
        while good > self.judge.fine.dt and not self.holds(good):
            bad, good = good, good / 2
        return self._below(bisected(self.holds, max(good, self.judge.fine.dt), bad, FINE))

    def _below(self, limit: float) -> float:
        """The limit [s] where some shorter steps, which need not hold either, do."""
        for part in SHORTER_PARTS:
            if not self.holds(part * limit):
                low = part * limit / NEXT
                while low > self.judge.fine.dt and not self.holds(low):
                    low /= NEXT
                return self._below(bisected(self.holds, low, part * limit, FINE))
        return limit

    def _upwards(self, good: float) -> float:
        """The limit [s] above a step at which the motion holds; inf where there is none."""
        while good < self.longest:
            longer = min(2 * good, self.longest)
            if not self.holds(longer):
                return self._below(bisected(self.holds, good, longer, FINE))
            good = longer
        return math.inf
