"""`Judge`: whether a run is stable, judged against the converged motion.

A step fails if

- a run does not stay finite, or has `LARGE` times the kinetic energy of the converged motion;
- the perturbation grows without end: towards the end of the run it is `GROWN` times as large as it
  ever was in the converged motion. Growth of the motion itself (chaos, a fall) is in the
  converged motion, too, and is no limit;
- it chatters: forces of actuators jump between their bounds, unlike in the converged motion, or
  saturate where the converged motion rests. Bounds set the size of chatter, and no perturbation
  grows in it.

The converged motion is a pair of runs (see `stepcore.experiment.pairs`) at a short step, which a
shorter one confirms. If a run is longer, energy and perturbation of the converged motion are
continued by a power of time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from stepcore.engine.arrays import Floats
from stepcore.experiment.change import Change
from stepcore.experiment.pairs import CALM, GROWN, LEAST, Loop, Motions, Pair, continued
from stepcore.report.units import seconds

# A run that grew by less than GROWN² is made this many times as long, to see if the growth ends.
LONGER = 4
# The largest ratio of the kinetic energy to the converged motion's. A step below its limit makes
# the energy of a swinging spring at most 1/(1 − 0.98²) = 25 times as large.
LARGE = 50.0
# The parts of a short step that are tried for the converged motion; the largest ratios of two
# kinetic energies, and of two perturbations, that agree.
FINER = (1.0, 0.5, 0.125, 0.03, 0.008)
SAME, ALIKE = 1.5, 10.0


@dataclass(frozen=True)
class Outcome:
    """The outcome of a motion at a step.

    kind: "holds", "diverges" (not finite), "gains energy", "grows" (the perturbation), "chatters".
    time: the time of the failure, or the simulated time [s].
    energy, growth: the largest kinetic energy, and the perturbation towards the end, relative to
        the converged motion; inf if it diverges. early: `energy` in the first half.
    brief: whether the growth may be a pulse.
    """

    kind: str
    time: float
    energy: float = 0.0
    growth: float = 0.0
    early: float = 0.0
    brief: bool = False

    @property
    def holds(self) -> bool:
        return self.kind == "holds"

    @property
    def failure(self) -> str:
        """How and when the run fails; "" if it holds."""
        if self.holds:
            return ""
        thing = "the perturbation " * (self.kind == "grows")
        return f"{thing}{self.kind} at {seconds(self.time)}"


@dataclass(frozen=True)
class Runaway:
    """A motion that blows up at every step: the times, at the two shortest steps, `dts` [s]."""

    times: tuple[float, float]
    dts: tuple[float, float]

    @property
    def alike(self) -> bool:
        """Whether both times agree: the motion itself then grows, and no dt changes that."""
        return max(self.times) <= 1.2 * min(self.times)


@dataclass
class Judge:
    """The converged motion of a scene, and the outcomes of other runs compared with it.

    motions: the runs. fine: the converged pair. confirmed: whether two steps agreed. long: a longer
    converged pair, if other runs fail later. runaway: how the motion blows up by itself.
    loop: how the converged motion samples a user's control; None if as the other runs do.
    """

    motions: Motions
    fine: Pair
    confirmed: bool
    long: Pair | None = None
    runaway: Runaway | None = None
    loop: Loop | None = None
    _outcomes: dict[tuple[Change, float, Loop | None], Outcome] = field(default_factory=dict)
    _lasting: set[tuple[Change, float, Loop | None]] = field(default_factory=set)

    @classmethod
    def of(
        cls, motions: Motions, dt: float, loop: Loop | None = None, smooth: bool = False
    ) -> Judge:
        """Return the judge of a motion, whose converged run has a step of at most `dt` [s].

        smooth: whether two runs in which forces of actuators jump are not sufficient, because `dt`
            may be much longer than the limit.
        """
        runs = list[Pair]()
        for part in FINER:
            if runs and part * dt * motions.most < runs[-1].reached / 2 and not runs[-1].failure:
                break
            runs.append(motions.pair(motions.fine, part * dt, loop=loop, samples=LEAST))
            motions.count(runs[-1])
            if len(runs) < 2 or (smooth and runs[-1].jumps):
                continue
            if runs[-2].jumps == runs[-1].jumps and _agree(runs[-2], runs[-1]):
                longer = max(runs[-2:], key=lambda run: round(run.reached, 9))
                return cls(motions, longer, True, loop=loop)._extended()
        usable = [run for run in runs if math.isinf(run.blows_up())]
        judge = cls(motions, (usable or runs)[-1], False, loop=loop)
        if len(runs) > 1:
            judge.runaway = _runaway(runs[-2], runs[-1])
            judge.fine = judge.fine if judge.runaway is None else runs[-1]
        return judge

    @classmethod
    def calm(cls, motions: Motions, dt: float) -> Judge:
        """Return the judge of a motion, without its control period if that makes it flutter."""
        sampled = cls.of(motions, dt)
        if motions.period is None or motions.users is None:
            return sampled
        closed = cls.of(motions, dt, Loop(period=0.0))
        if closed.runaway is not None:
            return sampled
        most = LARGE * max(float(np.nanmax(closed.fine.energy)), motions.floor)
        flutters = sampled.runaway is not None or float(np.nanmax(sampled.fine.energy)) > most
        flutters |= sampled.fine.jumps and not closed.fine.jumps
        return closed if flutters else sampled

    def _extended(self) -> Judge:
        """Extend a motion that grows at its end, until it is calm or blows up by itself."""
        motions, run, steps = self.motions, self.fine, round(self.fine.reached / self.fine.dt)
        while run.grows() and LONGER * steps <= motions.most:
            steps *= LONGER
            run = motions.pair(motions.fine, run.dt, steps, self.loop, LEAST)
            if math.isfinite(run.blows_up()):
                break
            self.long = run
        while math.isfinite(run.blows_up()) and 2 * steps <= motions.most:
            steps *= 2
            finer = motions.pair(motions.fine, run.dt / 2, steps, self.loop, LEAST)
            self.runaway = _runaway(run, finer)
            if self.runaway is None or self.runaway.alike:
                break
            run = finer
        return self

    def outcome(self, change: Change, dt: float, loop: Loop | None = None) -> Outcome:
        """Return the outcome of a step under a change; each is run once."""
        # Steps that differ by rounding are one: a chaotic motion may be stable at only one of them.
        key = change, float(f"{dt:.12g}"), loop
        if key not in self._outcomes:
            pair = self.motions.pair(change, dt, loop=loop)
            outcome = self._longer(self.judged(pair), pair)
            gains = outcome.holds and outcome.energy > SAME * max(outcome.early, SAME)
            unclear = outcome.brief or outcome.growth < self.clear
            if gains or (outcome.kind == "grows" and unclear):
                # Growth without end goes on; the effects of contacts die out.
                pair = self.motions.pair(change, dt, LONGER * self.motions.steps(dt), loop)
                self._cover(float(pair.times[-1]))
                longer = self.judged(pair)
                if gains and longer.holds and longer.energy > SAME * max(outcome.energy, SAME):
                    longer = replace(longer, kind="gains energy")
                outcome = longer
            if outcome.holds and self._chatters(change, loop, pair):
                outcome = replace(outcome, kind="chatters")
            self._outcomes[key] = outcome
        return self._outcomes[key]

    def lasts(self, change: Change, dt: float, loop: Loop | None = None) -> bool:
        """Return whether a step is stable; for a sensitive motion, in a longer run as well.

        Steps of a sensitive motion hold by luck. A longer run that fails replaces the outcome.
        """
        key = change, float(f"{dt:.12g}"), loop
        if self.outcome(change, dt, loop).holds and key not in self._lasting:
            self._lasting.add(key)
            if self.sensitive and self.motions.cheap(dt):
                pair = self.motions.pair(change, dt, LONGER * self.motions.steps(dt), loop)
                outcome = self._longer(self.judged(pair), pair)
                self._outcomes[key] = self._outcomes[key] if outcome.holds else outcome
        return self._outcomes[key].holds

    @property
    def sensitive(self) -> bool:
        """Whether perturbations grow by orders of magnitude in the converged motion."""
        apart = self.fine.apart
        return float(np.nanmax(apart)) > GROWN**2 * float(apart[0])

    def tried(self, change: Change) -> dict[float, bool]:
        """Return the steps that were run under a change, and whether each is stable."""
        outcomes = self._outcomes.items()
        return {dt: out.holds for (ran, dt, loop), out in outcomes if ran == change and not loop}

    def _longer(self, outcome: Outcome, pair: Pair) -> Outcome:
        """Judge a run that fails after the end of the converged motion again, with a longer one."""
        end = (self.long or self.fine).times[-1]
        late = outcome.kind in ("gains energy", "grows") and outcome.time > end
        return self.judged(pair) if late and self._cover(outcome.time) else outcome

    def _cover(self, time: float) -> bool:
        """Extend the converged motion to a time [s], within `WORK`; return whether it is longer."""
        dt, longest = self.fine.dt, self.long or self.fine
        steps = min(math.ceil(1.1 * time / dt), self.motions.most)
        if steps <= 1.05 * longest.times[-1] / dt:
            return False
        longer = self.motions.pair(self.motions.fine, dt, steps, self.loop, LEAST)
        if not longer.failure:
            self.long = longer
        return not longer.failure

    def usual(self, name: str, times: Floats) -> Floats:
        """Return the largest `energy` or `apart` of the converged motion up to some times."""
        fine, long = self.fine, self.long
        largest = continued(fine.times, getattr(fine, name), times)
        if long is not None:
            # Its samples may be far apart: each counts from the one before.
            later = times > fine.times[-1]
            ahead = times[later] + long.times[1]
            largest[later] = np.maximum(
                np.nanmax(getattr(fine, name)), continued(long.times, getattr(long, name), ahead)
            )
        return largest

    @property
    def clear(self) -> float:
        """The growth from which no longer run is needed: more if the motion itself grows."""
        apart = self.fine.apart
        return max(GROWN**2, GROWN * float(np.nanmax(apart)) / max(float(apart[0]), 1e-300))

    def judged(self, pair: Pair) -> Outcome:
        """Return the outcome of a pair by its energy and the growth of its perturbation."""
        if pair.failure:
            return Outcome("diverges", pair.reached, math.inf, math.inf)
        times, usual = pair.times, self.usual("energy", pair.times)
        least = max(self.motions.floor, 4 * self.motions.falling(pair.dt))
        with np.errstate(all="ignore"):
            apart = self.usual("apart", times)
            # If the converged pair has grown apart by then, a body may fall earlier: there only a
            # gain of total energy counts.
            lost = apart > GROWN**2 * self.fine.apart[0]
            energy = np.where(lost, np.minimum(pair.energy, pair.gained), pair.energy)
            energy /= np.maximum(usual, least)
            growth = pair.apart / apart
        # NaN: two runs that stay equal, or a motion whose growth has no bound.
        growth[np.isnan(growth)] = 0.0
        late, most = float(growth[pair.late].max()), float(energy.max())
        over = times[energy > LARGE]
        if len(over):
            return Outcome("gains energy", float(over[0]), most, late)
        if late > GROWN:
            wide = growth > GROWN
            # Two runs that pass a kink in different steps differ for a moment.
            brief = not all(half.any() for half in np.array_split(wide[pair.late], 2))
            return Outcome("grows", float(times[wide][0]), most, late, brief=brief)
        early = float(energy[times <= 0.5 * times[-1]].max())
        return Outcome("holds", pair.reached, most, late, early)

    def _chatters(self, change: Change, loop: Loop | None, pair: Pair) -> bool:
        """Return whether forces of actuators keep a run moving, unlike the converged motion.

        They jump, or saturate where the converged motion rests, for as long as the motion took.
        """
        motions, dt = self.motions, pair.dt
        steps = math.ceil(2 * motions.horizon / dt)
        if (pair.jumps or pair.presses) and steps > motions.steps(dt):
            pair = motions.pair(change, dt, steps, loop)
        changes, jumping = pair.jumping()
        if not (jumping.any() or pair.presses):
            return False
        self._cover(float(pair.times[-1]))
        longest = self.long or self.fine
        usual, jumped = longest.jumping(float(pair.times[1]))
        # An undamped servo that saturates swings between its bounds in the converged motion, too.
        if not jumped.any() and (jumping & (changes > SAME * usual)).any():
            return True
        calm = longest.times >= CALM * min(longest.times[-1], pair.times[-1])
        return float(pair.energy[pair.late].min()) > GROWN * float(longest.energy[calm].max())


def _runaway(coarse: Pair, fine: Pair) -> Runaway | None:
    times = coarse.blows_up(), fine.blows_up()
    return Runaway(times, (coarse.dt, fine.dt)) if math.isfinite(max(times)) else None


def _agree(coarse: Pair, fine: Pair) -> bool:
    """Return whether two runs agree on the energies and the growth of the perturbation."""
    if not math.isinf(min(coarse.blows_up(), fine.blows_up())):
        return False
    until = min(coarse.reached, fine.reached) * (1 + 1e-9)

    def peaks(name: str) -> list[float]:
        return [float(getattr(run, name)[run.times <= until].max()) for run in (coarse, fine)]

    energies, apart = [max(peak, fine.slow) for peak in peaks("energy")], peaks("apart")
    return max(energies) <= SAME * min(energies) and max(apart) <= ALIKE * min(apart)
