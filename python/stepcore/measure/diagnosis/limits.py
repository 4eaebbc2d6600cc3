"""The largest stable dt of an integrator, by runs of the motion and by the linearised step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from stepcore.experiment.change import Change
from stepcore.experiment.judge import Judge
from stepcore.experiment.pairs import LONGEST, SHORTEST, Loop
from stepcore.measure.diagnosis.linear import Held, bisected

# The shares of a limit at which the run is stable, and at which it fails; limits that differ by
# less than the ratio STEP count as one.
HOLDS, FAILS = 0.98, 1.03
STEP = FAILS / HOLDS
# The relative resolution of a limit if runs are cheap; else it is STEP.
FINE = 0.01
# The ratios of successive steps that are tried, from the converged motion's up to the limit. Cheap
# runs are DENSE: a body that makes whole turns in a step cannot hide shorter steps that fail.
# Costly runs are SPARSE.
DENSE, SPARSE = 1.2, 2.0
# Near a limit at contacts, stability is erratic: this share of the longest stable step must be
# stable, too (G1 is at 26.64 ms and not at 26.6; dm-control's quadruped at 12.88 ms and not at
# 12.8). Under a control function it need not: each call is a step of another phase.
NEAR = 0.995
# These shares of the limit must be stable, too; only the first one if runs are costly. At limits of
# sensitive motions, stability is erratic: under `implicitfast` gymnasium's inverted double pendulum
# is stable at 70.7 ms, and diverges at 68.5 and 64.9 ms.
BELOW = (0.95, 0.9, 0.85, 0.8)


@dataclass(frozen=True)
class Limit:
    """The largest stable dt of an integrator.

    integrator: the integrator. dt: the limit by runs [s], which are stable at 0.98 dt and fail at
        1.03 dt; inf if none fails up to `longest`, 0 if none is stable down to `shortest`. If
        nothing was `ran`, because the motion blows up at every step: the least limit of the
        linearised step over all states.
    held: the limit of the linearised step where the motion ends and is held [s]; inf and 0 as
        above, NaN if the time was over before.
    state: the index of the state whose linearised step has this limit, too; -1 if none has.
    outcome: how the run fails beyond dt: the `Outcome.kind`; "" if it does not.
    time: the time of this failure [s].
    holds: the longest step that was run and is stable [s]; 0 if none is.
    fails: the shortest step that was run and fails [s]; inf if none does.
    """

    integrator: str
    dt: float
    held: float
    state: int = -1
    outcome: str = ""
    longest: float = LONGEST
    shortest: float = SHORTEST
    ran: bool = True
    time: float = math.nan
    holds: float = 0.0
    fails: float = math.inf

    @property
    def known(self) -> bool:
        """Whether the limit was found."""
        return not math.isnan(self.dt)

    @property
    def erratic(self) -> tuple[float, float] | None:
        """The range of steps [s] in which some are stable and some fail; None if there is none."""
        return (self.fails, self.holds) if STEP * self.fails < self.holds else None

    @property
    def ends(self) -> tuple[float, float]:
        """The steps up to which runs, and the pose at the end, are stable [s]."""
        ran = min(self.dt, self.longest)
        if not self.known:
            ran = self.holds if self.holds < self.fails else 0.0
        at_end = min(self.held, LONGEST)
        if math.isinf(self.held):
            # No limit of the held pose is shown beyond the steps that were run.
            at_end = ran if ran > 0 else math.nan
        return ran, at_end


def run_limit(
    judge: Judge,
    change: Change,
    guesses: Sequence[float],
    loop: Loop | None = None,
    top: float = math.inf,
) -> tuple[float, float]:
    """Return the largest stable dt of the motion, and the longest step that was tried [s].

    The run is stable at 0.98 of the limit and at shorter steps, and fails at 1.03 of it. Steps are
    tried from the converged motion's step upwards, because failure is not monotonic in dt.

    guesses: limits of the linearised step, which are tried first if they may be the run's.
    top: a step that fails [s]; none longer is tried.
    """

    def holds(dt: float) -> bool:
        return judge.outcome(change, dt, loop).holds

    good, bad, longest = judge.fine.dt, math.inf, judge.fine.dt
    if not holds(good):
        good, bad = _lower(holds, good, guesses)
        if good <= 0:
            return 0.0, longest
    else:
        rungs = ladder(judge, good, top)
        for dt in rungs:
            if not holds(dt):
                bad = dt
                break
            good = dt
        longest = rungs[-1]
        if math.isinf(bad):
            return math.inf, longest
    limit = _matching(holds, good, bad, guesses)
    coarse = judge.motions.costly and judge.motions.users is None
    if limit is None:
        limit = _between(holds, good, bad, STEP if coarse else FINE)
    return _lowered(judge, change, limit, loop), longest


def _lower(
    holds: Callable[[float], bool], bad: float, guesses: Sequence[float]
) -> tuple[float, float]:
    """Return a stable step, 0 if there is none, and a longer one that fails.

    Guesses are tried first: halving down to a limit of µs takes as many runs again.
    """
    for guess in sorted(guesses, reverse=True):
        dt = HOLDS * guess
        if SHORTEST <= dt < bad / STEP:
            if holds(dt):
                return dt, bad
            bad = dt
    while bad / 2 >= SHORTEST:
        if holds(bad / 2):
            return bad / 2, bad
        bad /= 2
    return 0.0, bad


def _matching(
    holds: Callable[[float], bool], good: float, bad: float, guesses: Sequence[float]
) -> float | None:
    """Return the guess that is the limit between a stable step and one that fails, or None."""
    for g in sorted(guesses, key=lambda g: abs(math.log(g / good)) if g > 0 else math.inf):
        if not 0 < g < math.inf or good > FAILS * g or bad < HOLDS * g:
            continue
        if holds(HOLDS * g) and not holds(FAILS * g):
            return g
    return None


def ladder(judge: Judge, low: float, top: float = math.inf) -> list[float]:
    longest = max(min(judge.motions.longest, top), low * STEP)
    ratio = SPARSE if judge.motions.costly else DENSE
    number = max(1, math.ceil(math.log(longest / low) / math.log(ratio) - 1e-9))
    return [low * (longest / low) ** (k / number) for k in range(1, 1 + number)]


def _between(holds: Callable[[float], bool], good: float, bad: float, fine: float) -> float:
    """Return a limit between a stable step and one that fails; beyond it a run fails."""
    low, high = good, bad
    while high / low > STEP:
        count = math.ceil(math.log(high / low) / math.log(STEP) - 1e-9)
        middle = low * (high / low) ** (count // 2 / count)
        low, high = (middle, high) if holds(middle) else (low, middle)
    tried = [low / HOLDS, high / FAILS]
    if fine < STEP:
        tried.insert(0, bisected(holds, low, high, fine) * math.sqrt(1 + fine))
    return next((x for x in tried if holds(HOLDS * x) and not holds(FAILS * x)), tried[-1])


def _lowered(judge: Judge, change: Change, limit: float, loop: Loop | None) -> float:
    """Return the limit, lowered until no run just below it fails."""
    while True:
        below = _below(judge, limit)
        failed = next((dt for dt in below if not judge.lasts(change, dt, loop)), None)
        if failed is None:
            return limit
        limit = failed / FAILS


def _below(judge: Judge, limit: float) -> Iterator[float]:
    """Yield the steps below a limit that must be stable: more of them if runs are cheap."""
    motions, highest = judge.motions, HOLDS * limit
    yield highest
    if NEAR * highest > judge.fine.dt and motions.users is None:
        yield NEAR * highest
    cheap = motions.cheap(limit)
    if cheap or limit > judge.fine.dt:
        yield from (share * limit for share in BELOW[: len(BELOW) if cheap else 1])


def held_limits(
    states: Sequence[Held], integrator: str, near: float, fine: float
) -> tuple[float, list[float]]:
    """Return the limit at the held end of the motion, and the limits of all states [s].

    states: states of the motion, the last one at its end. Limits above the least one found are not
    searched for: such states have inf. fine: the resolution of the others.
    """
    last = least = states[-1].limit(integrator, near)
    limits = [math.inf] * (len(states) - 1)
    for k, step in enumerate(states[:-1]):
        if least <= 0:
            break
        top = min(least, LONGEST)
        if not all(step.stable(integrator, top * share) for share in (0.999, 0.5)):
            limits[k] = step.limit(integrator, min(top, near), fine)
            least = min(least, limits[k])
    return last, [*limits, last]
