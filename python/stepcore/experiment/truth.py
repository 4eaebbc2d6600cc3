"""`Truth`: the converged motion of a scene, only as fine as a question needs it.

Several methods climb their ladders on one start, the one with the cheapest next rung first, until a
rung moves the motion by less than a tenth of the error in question. That method runs from all
starts; only starts that still move climb on. The uncertainty of a start is the distance to its run
at the rung before, which is larger than its error from order 1 on. Without an order this distance
is no bound. So the hardest start also runs one rung finer, from which the effect of all finer rungs
is estimated, and the second method is compared. If either shows a larger distance than the rung
before, the uncertainty of every start is scaled up by the same factor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from stepcore import deadline
from stepcore.deadline import Deadline
from stepcore.engine.norm import Tracks
from stepcore.experiment.change import Change
from stepcore.experiment.engines import Engine, Way
from stepcore.experiment.predictable import GROWTH, Growth, converged_growth
from stepcore.experiment.quantity import Measure
from stepcore.experiment.schedule import Schedule
from stepcore.report.settings import label
from stepcore.report.units import counted, seconds

# The target uncertainty of the converged motion, as a share of the error in question.
SHARE = 0.1
# Errors below this share of a scene's size, or of a quantity's range, are rounding.
ROUNDING = 1e-11
# A rung that moves more than this share of the last one's change does not converge; after three of
# them a start is left as it is (two coarse rungs may agree by luck, if they damp a fast swing).
STALLED, PATIENCE = 0.9, 3
# The share of a measurement's time that the converged motion may take, beyond an answer's needs.
KNOWN = 0.5
# The most rungs of a ladder, and the rungs after which a method that still fails is abandoned.
RUNGS, HOPELESS = 20, 5
# The share of a study's effort that finding the method may take.
FINDING = 0.25
# If a start ends within the horizon, growth is measured at this many finer rungs, until two agree.
FINER = PATIENCE
SHIPPED = Change()


class Runs(Protocol):
    """The members of a `Study` that a converged motion needs; they are described there."""

    engine: Engine
    schedule: Schedule
    size: float
    measure: Measure
    starts: tuple[int, ...]
    effort: float
    spent: float

    @property
    def scale(self) -> float: ...
    def tracks(self, changes: Sequence[Change], starts: Sequence[int]) -> list[Tracks]: ...
    def price(self, change: Change, starts: int) -> float: ...
    def lasts(self, operations: float) -> float: ...
    def affords(self, change: Change, starts: int) -> bool: ...
    def as_length(self, error: float) -> float: ...
    def tell(self, wrong: float, moved: float, goal: float, needs: float) -> None: ...


@dataclass(frozen=True, eq=False)
class Truth:
    """The converged motion from some starts.

    starts: by index. tracks: the motion. change, settings: of the finest run.
    unsure: the uncertainty of every start, (starts,), in the unit of `measure`, the quantity.
    scored: the samples that can be predicted, (starts, n). growth: of perturbations from them.
    goal: the target uncertainty. needs: the estimated operations to reach it; 0 if it is
        reached, inf if finer runs do not reduce the uncertainty.
    """

    starts: tuple[int, ...]
    tracks: Tracks
    change: Change
    settings: Any
    unsure: np.ndarray
    scored: np.ndarray
    growth: Growth
    goal: float
    measure: Measure
    needs: float = 0.0

    def part(self, starts: Sequence[int]) -> Truth:
        """Return the truth for some of its starts, by index."""
        places = [self.starts.index(start) for start in starts]
        return replace(
            self,
            starts=tuple(starts),
            tracks=self.tracks.some(places),
            unsure=self.unsure[places],
            scored=self.scored[places],
            growth=self.growth.some(places),
        )

    @property
    def error(self) -> float:
        """The uncertainty of the worst start."""
        return float(self.unsure.max(initial=0.0))

    @property
    def words(self) -> str:
        """The method and the uncertainty as a sentence."""
        said = f"its uncertainty is {self.measure.words(self.error)}"
        if math.isinf(self.error):
            said = "from some start no run converges"
        return f"Errors are measured from a converged motion ({label(self.settings)}); {said}."


@dataclass
class _Start:
    """The runs from one start: the finest rung, and the distance that it moved the motion [m].

    before: the motion of the rung before. both: the distance moved by the last two rungs [m].
    gain: the distance moved by the rung before over the last one's.
    doubt: the factor from `moved` to the distance that all finer rungs may move.
    """

    rung: int
    tracks: Tracks
    before: Tracks
    moved: float
    both: float = 0.0
    worse: int = 0
    gain: float = 2.0
    doubt: float = 1.0

    @property
    def unsure(self) -> float:
        # At order 1 two rungs move three times as far as the second does; less is luck.
        return max(self.moved, self.both / 2.5) * self.doubt

    def finer(self, tracks: Tracks, moved: float, both: float) -> _Start:
        """Return the start after the next rung, which moved the motion by `moved` [m]."""
        worse = self.worse + 1 if moved > STALLED * self.moved else 0
        gain = self.moved / moved if moved > 0 else math.inf
        # One good rung may be luck (hopper in MuJoCo), so an earlier doubt fades slowly.
        doubt = max(left(gain), math.sqrt(self.doubt))
        return _Start(self.rung + 1, tracks, self.tracks, moved, both, worse, gain, doubt)


def left(gain: float) -> float:
    """Return the distance that all finer rungs may move over the last one's: a geometric series.

    The ratio is at most 2: rungs that no longer converge move to and fro, which does not add up
    (`benches/converging.py`).

    gain: the distance moved by one rung over the next one's.

    >>> left(4.0), left(1.75), left(0.9)
    (1.0, 1.3333333333333333, 2.0)
    """
    return max(1.0, 1 / (max(gain, 1.5) - 1))


def _half() -> AbstractContextManager[None]:
    """Return a stage that ends at half of the time, which leaves time for an answer."""
    return (deadline.current() or Deadline()).stage("a surer converged motion", KNOWN)


class Converging:
    """The converged motion of one model of a study, start by start.

    way: the method. rung: the rung that settled the first start. doubt: the factor by which the
    distance to the rung before is too small a bound.
    """

    def __init__(self, study: Runs, physics: Change, start: int, goal: float | None) -> None:
        self.study, self.physics = study, physics
        self.goal, self.doubt, self._witnessed = goal, 1.0, False
        self.known: dict[int, _Start] = {}
        self.grown: dict[int, Growth] = {}
        self.way, self.rung = self._found(start)

    def at(self, rung: int) -> Change:
        """Return the settings of a rung."""
        return self.physics.also(self.way.at(rung))

    def upto(self, starts: Sequence[int], goal: float | None, *, fewer: bool = False) -> Truth:
        """Return the converged motion from some starts, with uncertainty `goal` if affordable.

        goal: by default a hundredth of the shipped settings' error in the worst of the starts.
        fewer: whether it may be from fewer starts, if a deadline leaves no time for all.
        """
        own, goal = goal is None, self.goal if goal is None else goal
        assert goal is not None
        surer = nullcontext() if self.known else _half()
        new = [s for s in starts if s not in self.known]
        several = own and len(starts) > 1
        if several and self.study.tracks([self.physics], starts)[0].failures:
            # If the shipped settings explode, nanometres are not needed.
            goal = max(goal, self._coarse)
        if not fewer or self.known or self._in_time(len(new), goal):
            self._begin(new, goal)
        else:
            self._begin_some(new, goal)
            starts = [s for s in starts if s in self.known]
        goal = max(goal, self._shipped(starts)) if own else goal
        with surer:
            self._refine(starts, goal)
            self._witness(starts)
            self._refine(starts, goal)
        known = [self.known[s] for s in starts]
        grown = self._growth(starts)
        finest = self.at(max(one.rung for one in known))
        return Truth(
            starts=tuple(starts),
            tracks=Tracks.joined([one.tracks for one in known]),
            change=finest,
            settings=self.study.engine.settings(finest),
            unsure=np.array([one.unsure for one in known]),
            scored=grown.scored(self.study.schedule.times),
            growth=grown,
            goal=goal,
            measure=self.study.measure,
            needs=self._needs(starts, goal),
        )

    def error(self, starts: Sequence[int]) -> float:
        """Return the uncertainty of the motion in the worst of some starts."""
        return max((self.known[s].unsure for s in starts if s in self.known), default=math.inf)

    @property
    def _coarse(self) -> float:
        """The goal if the shipped settings have no error, because they explode."""
        return 1e-3 * self.study.scale

    def _shipped(self, starts: Sequence[int]) -> float:
        """Return a hundredth of the error of the shipped settings in the worst of some starts."""
        (shipped,) = self.study.tracks([self.physics], starts)
        now = Tracks.joined([self.known[s].tracks for s in starts])
        wrong = self._between(shipped, now, starts)
        return SHARE**2 * float(wrong[np.isfinite(wrong)].max(initial=0.0))

    def _needs(self, starts: Sequence[int], goal: float) -> float:
        """Estimate the operations to bring starts to a goal from their last gain."""
        needs = 0.0
        for own in (self.known[s] for s in starts):
            if goal > 0 and own.unsure > goal:
                if own.gain * STALLED <= 1.0:
                    return math.inf
                rungs = math.log(own.unsure / goal) / math.log(own.gain)
                # Both may be infinite, for a start whose last rungs failed.
                if not own.rung + rungs <= RUNGS:
                    return math.inf
                last = own.rung + math.ceil(rungs)
                needs += sum(self.study.price(self.at(k), 1) for k in range(own.rung + 1, last + 1))
        return needs

    def _between(self, a: Tracks, b: Tracks, starts: Sequence[int]) -> np.ndarray:
        """Return the distance of two motions over the predictable samples, (starts,)."""
        scored = None
        if all(s in self.grown for s in starts):
            scored = self._growth(starts).scored(self.study.schedule.times)
        return self.study.measure.error(a, b, scored)

    def _growth(self, starts: Sequence[int]) -> Growth:
        return Growth.joined([self.grown[s] for s in starts])

    def _found(self, start: int) -> tuple[Way, int]:
        """Find the method that settles first from one start, and its rung.

        The default goal is a hundredth of the shipped settings' error.
        """
        study = self.study
        ways = study.engine.ways(study.schedule, study.as_length(self.goal or self._coarse))
        rungs, moved = [0] * len(ways), [math.inf] * len(ways)
        before: list[Tracks | None] = [None] * len(ways)
        last: list[Tracks | None] = [None] * len(ways)
        (shipped,) = study.tracks([self.physics], [start])
        begun, failure = study.spent, ""

        def off(a: Tracks | None, b: Tracks | None) -> float:
            if a is None or b is None or a.failure or b.failure:
                return math.inf
            return float(self._between(a, b, [start])[0])

        while True:
            change = [self.physics.also(way.at(n)) for way, n in zip(ways, rungs, strict=True)]
            # A method that still fails at such short steps diverges itself.
            lost = [
                n > HOPELESS and bool(own and own.failure)
                for n, own in zip(rungs, last, strict=True)
            ]
            prices = [
                math.inf if gone else study.price(one, 1)
                for one, gone in zip(change, lost, strict=True)
            ]
            k = int(np.argmin(prices))
            spent = study.spent - begun + prices[k] > FINDING * study.effort
            if (spent and sum(rungs) > 2 * len(ways)) or rungs[k] >= RUNGS:
                break
            now = None
            with _half() if np.isfinite(moved).any() else nullcontext():
                (now,) = study.tracks([change[k]], [start])
            if now is None:
                break
            before[k], last[k] = last[k], now
            rungs[k] += 1
            failure, was = failure or now.failure, moved[k]
            moved[k] = off(before[k], now)
            if math.isinf(moved[k]):
                continue
            if moved[k] > STALLED * was and start not in self.grown:
                # After nearby motions have separated, no rung settles the motion.
                self.way = ways[k]
                with _half():
                    self._measure_growth([start], rungs[k] - 1)
                moved = [off(*pair) for pair in zip(before, last, strict=True)]
            wrong = off(shipped, now)
            asked = SHARE**2 * wrong if 0 < wrong < math.inf else self._coarse
            goal = max(asked, ROUNDING * study.scale) if self.goal is None else self.goal
            if moved[k] <= goal:
                self.goal = goal
                break
            # At order 1, the work times the distance that a rung moves is constant.
            needs = study.price(change[k], len(study.starts)) * moved[k] / goal
            study.tell(wrong, moved[k], goal, needs)
        k = int(np.argmin(moved))
        if not math.isfinite(moved[k]):
            raise self._fails(failure or "it does not settle")
        self.goal = moved[k] if self.goal is None else self.goal
        own = last[k]
        assert own is not None
        # The distance of a rival counts as far as the rival's last rung does not explain it.
        rivals = [
            max(0.0, off(own, other) - far)
            for j, (other, far) in enumerate(zip(last, moved, strict=True))
            if j != k and other is not None and math.isfinite(far)
        ]
        rival = min(rivals, default=0.0)
        self.doubt = max(1.0, rival / moved[k]) if moved[k] > 0 and rival > 2 * moved[k] else 1.0
        return ways[k], rungs[k] - 1

    def _fails(self, why: str) -> ValueError:
        dt = seconds(float(self.study.engine.settings(SHIPPED).dt))
        text = f"the converged motion fails{self.study.schedule.driven}, at shorter steps than"
        return ValueError(f"{text} {dt} too, so there is nothing to compare with: {why}")

    def _first(self, starts: int, goal: float) -> int:
        """Return the rung at which new starts begin: the one that settled the first start.

        A coarser goal makes it coarser, by one rung for each factor of two.
        """
        assert self.goal is not None
        ratio = goal / self.goal if self.goal > 0 else 1.0
        coarser = math.log2(min(max(1.0, ratio), 2.0**self.rung))
        first = max(1, self.rung - int(coarser))
        # Two rungs are run; the finer one costs about twice as much as the other.
        while first > 1 and not self.study.affords(self.at(first), 3 * starts // 2):
            first -= 1
        return first

    def _in_time(self, starts: int, goal: float) -> bool:
        """Return whether this many new starts can begin in the time that is left.

        Adaptive steps may be far shorter from new starts than from the first.
        """
        limit, rung = deadline.current(), self._first(starts, goal)
        if limit is None or math.isinf(limit.left):
            return True
        growing = next(self._growing(rung))
        runs = [self.at(rung - 1), self.at(rung), growing, growing]
        cost = sum(self.study.price(change, starts) for change in runs)
        return self.way.fixed and self.study.lasts(cost) < limit.left

    def _begin_some(self, starts: Sequence[int], goal: float) -> None:
        """Run the first of new starts, and as many others as there is time for."""
        limit = deadline.current() or Deadline()
        self._begin(starts[:1], goal)

        def missing() -> str:
            lost = sum(s not in self.known for s in starts)
            return f"{lost} of {counted(len(starts), 'start')}"

        with limit.stage(missing, KNOWN):
            while len(self.known) < len(starts):
                # Starts that run together take less time each: run twice as many as before.
                done = len(self.known)
                self._begin(starts[done : 2 * done], goal)

    def _begin(self, starts: Sequence[int], goal: float) -> None:
        """Run new starts at their first rung, and at the one before."""
        if not starts:
            return
        study, first, why = self.study, self._first(len(starts), goal), ""
        for rung in range(first, self.rung + PATIENCE + 1):
            before, now = study.tracks([self.at(rung - 1), self.at(rung)], starts)
            why = why or now.failure
            if not now.failure:
                break
        if now.failure:
            raise self._fails(why)
        every = all(s in self.grown for s in study.starts)
        if every and max(g.factor.max() for g in self.grown.values()) < math.sqrt(GROWTH):
            # If growth stays below the root of its limit, no start near the search's ends.
            like = next(iter(self.grown.values()))
            self.grown |= dict.fromkeys(starts, like)
        else:
            self._measure_growth(starts, rung)
        moved = self._between(before, now, starts)
        for k, start in enumerate(starts):
            pair = now.some([k]), before.some([k])
            own = _Start(rung, *pair, float(moved[k]), doubt=self.doubt)
            self.known[start] = own

    def _refine(self, starts: Sequence[int], goal: float) -> None:
        """Run the starts that still move at finer rungs, while that reduces their uncertainty."""
        study = self.study
        while True:
            todo = [
                s for s in starts if self.known[s].unsure > goal and self.known[s].worse < PATIENCE
            ]
            if not todo:
                return
            # Starts at one rung run together.
            rung = min(self.known[s].rung for s in todo) + 1
            some = [s for s in todo if self.known[s].rung == rung - 1]
            if rung >= RUNGS or not study.affords(self.at(rung), len(some)):
                return
            (finer,) = study.tracks([self.at(rung)], some)
            if finer.failure:
                return
            before = Tracks.joined([self.known[s].tracks for s in some])
            coarse = Tracks.joined([self.known[s].before for s in some])
            moved = self._between(before, finer, some).tolist()
            both = self._between(coarse, finer, some).tolist()
            for k, start in enumerate(some):
                own = self.known[start]
                self.known[start] = own.finer(finer.some([k]), moved[k], both[k])

    def _witness(self, starts: Sequence[int]) -> None:
        """Run the hardest start one rung finer, and doubt all starts if that moves it no less."""
        study = self.study
        hardest = max(starts, key=lambda s: self.known[s].unsure)
        own = self.known[hardest]
        change = self.at(own.rung + 1)
        if self._witnessed or not study.affords(change, 1):
            return
        self._witnessed = True
        (finer,) = study.tracks([change], [hardest])
        if not finer.failure and own.moved > 0:
            far = float(self._between(own.tracks, finer, [hardest])[0])
            # Two rungs may agree by luck, as two that damp a fast swing to rest do.
            gain = own.moved / far if far > 0 else math.inf
            self.doubt = max(self.doubt, left(gain), 1 / gain if gain > 0 else math.inf)
            for other in self.known.values():
                other.doubt = max(other.doubt, self.doubt)

    def _growing(self, rung: int) -> Iterator[Change]:
        """Yield the settings under which growth is measured, with ever shorter steps.

        Adaptive steps differ from run to run, so these are fixed ones.
        """
        way, first = self.way, max(1, rung - 1)
        if not way.fixed:
            way, first = self.study.engine.ways(self.study.schedule, 1.0)[0], 2
        for finer in range(FINER + 1):
            yield self.physics.also(way.at(first + finer))

    def _measure_growth(self, starts: Sequence[int], rung: int) -> None:
        """Measure until when the motion from some starts can be predicted.

        If it ends, finer rungs must show the same end: a coarse motion may be unstable itself.
        """
        study = self.study

        def changes() -> Iterator[Change]:
            for finer, change in enumerate(self._growing(rung)):
                if finer and not study.affords(change, 2 * len(starts)):
                    return
                study.spent += study.price(change, 2 * len(starts))
                yield change

        now, _ = converged_growth(study.engine, changes(), study.schedule, starts, study.size)
        for k, start in enumerate(starts):
            self.grown[start] = now.some([k])
