"""Outcomes: a number of each run, from many starts; differences of their means, with intervals.

Trajectories may be unpredictable while the mean of a number over many starts is well determined.
Two settings run from the same starts. If their numbers are correlated the differences by start have
the narrower interval (paired), otherwise the difference of the two means has (unpaired): pilot
starts, whose numbers are not used again, decide.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from stepcore.experiment.change import Change
from stepcore.experiment.choose import share_of
from stepcore.experiment.engines import Engine
from stepcore.experiment.quantity import Measure, Measures
from stepcore.experiment.schedule import Schedule
from stepcore.experiment.study import Study

# The starts that only decide between paired and unpaired differences.
PILOT = 32
# The starts of one call of the engine, which runs them in vector registers.
BLOCK = 32
# The same of episodes of a task: in Python an action takes about as long for 128 worlds as for 32.
EPISODES = 128
# The quantile of a normal distribution for an interval of 95 %.
NORMAL = 1.959964


@dataclass(frozen=True, eq=False)
class Difference:
    """The difference of two means, second minus first, with its 95 % interval.

    value: the difference. low, high: its interval. paired: whether differences by start were used.
    starts: the number of starts. sd: of the numbers from which the interval follows, so that the
    half width is about 2 sd / √starts. parts: of several quantities, the difference of each, all
    relative to the allowed errors; the rest is that of the part with the largest bound.
    """

    value: float
    low: float
    high: float
    paired: bool
    starts: int
    sd: float
    parts: tuple[Difference, ...] = ()

    @property
    def half(self) -> float:
        """Half the width of the interval; of several quantities the largest."""
        return max((part.half for part in self.parts), default=(self.high - self.low) / 2)

    @property
    def bound(self) -> float:
        """The largest absolute difference in the interval; NaN if there is none."""
        return max(abs(self.low), abs(self.high))

    @property
    def significant(self) -> bool:
        """Whether the interval of any quantity does not contain 0."""
        return any(part.significant for part in self.parts) or self.low > 0 or self.high < 0

    def widened(self, uncertainty: float) -> Difference:
        """Return the difference with an interval wider by an uncertainty on both sides."""
        low, high = self.low - uncertainty, self.high + uncertainty
        parts = tuple(part.widened(uncertainty) for part in self.parts)
        return dataclasses.replace(self, low=low, high=high, parts=parts)

    def relative_to(self, error: float) -> Difference:
        """Return the difference as a multiple of an error."""
        value, low, high, sd = (x / error for x in (self.value, self.low, self.high, self.sd))
        return Difference(value, low, high, self.paired, self.starts, sd)

    def record(self) -> dict[str, Any]:
        """Return the difference as plain data."""
        fields = {name: value for name, value in vars(self).items() if name != "parts"}
        return fields | ({"parts": [part.record() for part in self.parts]} if self.parts else {})

    def within(self, error: float) -> bool:
        """Return whether the entire interval is within ± error."""
        return self.bound <= error

    def outside(self, error: float) -> bool:
        """Return whether the entire interval of any quantity is outside ± error."""
        outside = any(part.outside(error) for part in self.parts)
        return outside or self.low > error or self.high < -error


def difference(first: np.ndarray, second: np.ndarray, binary: bool = False) -> Difference:
    """Return the difference of the means of two sets of numbers from common starts.

    NaN is a run that failed; starts from which a run failed are left out. The first `PILOT` numbers
    decide whether the difference is paired. binary: for 0 and 1 the interval is exact.

    >>> numbers = np.arange(100.0) % 7
    >>> change = difference(numbers, numbers + 0.5)
    >>> change.value, change.paired, round(change.half, 12)
    (0.5, True, 0.0)
    """
    both = np.isfinite(first) & np.isfinite(second)
    a, b = first[both], second[both]
    pilot = min(PILOT, len(a) // 2)
    if len(a) - pilot < 2:
        return Difference(math.nan, -math.inf, math.inf, True, 0, math.nan)
    apart = (b - a)[:pilot].std()
    paired = bool(apart <= math.hypot(a[:pilot].std(), b[:pilot].std()))
    a, b = a[pilot:], b[pilot:]
    count = len(a)
    value = float(b.mean() - a.mean())
    sd = float((b - a).std(ddof=1) if paired else math.hypot(a.std(ddof=1), b.std(ddof=1)))
    if binary:
        lost, won = int(((a > 0.5) & (b < 0.5)).sum()), int(((a < 0.5) & (b > 0.5)).sum())
        more, less = exact_interval(won, count), exact_interval(lost, count)
        return Difference(value, more[0] - less[1], more[1] - less[0], True, count, sd)
    half = quantile(count - 1) * sd / math.sqrt(count)
    return Difference(value, value - half, value + half, paired, count, sd)


def quantile(freedom: int) -> float:
    """Return the quantile of Student's t for an interval of 95 %, within 0.2 % from 8 degrees on.

    Cornish and Fisher's expansion about the normal distribution.

    >>> round(quantile(10), 3), round(quantile(100), 3)
    (2.228, 1.984)
    """
    z, n = NORMAL, freedom
    terms = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96
    third = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    return z + terms[0] / n + terms[1] / n**2 + third / n**3


def exact_interval(hits: int, count: int, confidence: float = 0.975) -> tuple[float, float]:
    """Return Clopper and Pearson's interval of a share.

    Each of the two shares of a paired difference has a confidence of 97.5 %, so that both hold
    with 95 %.

    >>> [round(end, 3) for end in exact_interval(0, 100, 0.95)]
    [0.0, 0.036]
    """
    side = 1 - (1 - confidence) / 2
    return 1 - share_of(count - hits, count, side), share_of(hits, count, side)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The numbers of one change from common starts, compared with the reference's.

    change, settings: as in `Trial`. numbers: one of each run, NaN where it failed, (starts,); of
    several quantities (starts, quantities).
    difference: of the mean from the reference's. work, cost: as in `Trial`.
    spread: the ratio of standard deviations to the reference's, with its 95 % interval.
    distance: the largest distance between the two cumulative distributions, with the value that
    it exceeds in one of twenty repeats of equal distributions. Both are of the first quantity, if
    there are several. failure: of the first failed run.
    """

    change: Change
    settings: Any
    numbers: np.ndarray
    difference: Difference
    work: float
    cost: float
    spread: tuple[float, float, float]
    distance: tuple[float, float]
    failure: str = ""

    @property
    def mean(self) -> float:
        """The mean of the first quantity over the starts that did not fail; NaN if all did."""
        return _mean(_first(self.numbers))

    @property
    def sd(self) -> float:
        """The standard deviation of the first quantity."""
        return _sd(_first(self.numbers))

    @property
    def failed(self) -> int:
        """The number of runs that failed."""
        return int((~np.isfinite(_first(self.numbers))).sum())

    @property
    def failing(self) -> tuple[float, float]:
        """The 95 % interval of the share of runs that fail."""
        return exact_interval(self.failed, len(self.numbers), 0.95)

    @property
    def dt(self) -> float:
        """The time step [s]."""
        return float(self.settings.dt)

    def within(self, error: float) -> bool:
        """Return whether no run failed, and the entire interval is within ± error."""
        return not self.failed and self.difference.within(error)

    def record(self) -> dict[str, Any]:
        """Return the outcome as plain data."""
        d = self.difference
        return {
            "change": self.change.words,
            "mean": self.mean,
            "sd": self.sd,
            "difference": d.value,
            "low": d.low,
            "high": d.high,
            "paired": d.paired,
            "starts": len(self.numbers),
            "sd_ratio": self.spread[0],
            "sd_ratio_low": self.spread[1],
            "sd_ratio_high": self.spread[2],
            "distance": self.distance[0],
            "distance_limit": self.distance[1],
            "failed": self.failed,
            "failed_most": self.failing[1],
            "work": self.work,
            "cost": self.cost,
            "failure": self.failure or None,
        }


def _first(numbers: np.ndarray) -> np.ndarray:
    """Return the numbers of the first quantity, (starts,)."""
    return numbers if numbers.ndim == 1 else numbers[:, 0]


def _mean(numbers: np.ndarray) -> float:
    finite = numbers[np.isfinite(numbers)]
    return float(finite.mean()) if finite.size else math.nan


def _sd(numbers: np.ndarray) -> float:
    finite = numbers[np.isfinite(numbers)]
    return float(finite.std(ddof=1)) if len(finite) > 1 else math.nan


def ratio_of_spreads(first: np.ndarray, second: np.ndarray) -> tuple[float, float, float]:
    """Return the ratio of two standard deviations, second over first, with its 95 % interval.

    The interval uses the variance of the logarithm of each standard deviation, (κ − 1) / 4n with
    the kurtosis κ, as for independent samples; correlated samples have a narrower one.
    """
    parts = [x[np.isfinite(x)] for x in (first, second)]
    if any(len(x) < 3 or x.std() == 0 for x in parts):
        return math.nan, 0.0, math.inf
    variance = 0.0
    for x in parts:
        centred = x - x.mean()
        kurtosis = float((centred**4).mean() / (centred**2).mean() ** 2)
        variance += max(kurtosis - 1, 0.1) / (4 * len(x))
    ratio = float(parts[1].std(ddof=1) / parts[0].std(ddof=1))
    factor = math.exp(NORMAL * math.sqrt(variance))
    return ratio, ratio / factor, ratio * factor


def distance_of(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Return the largest distance of two empirical distributions, and its 95 % limit.

    Kolmogorov and Smirnov's two-sample statistic; the limit is asymptotic.

    >>> distance_of(np.zeros(50), np.ones(50))[0]
    1.0
    """
    a, b = (np.sort(x[np.isfinite(x)]) for x in (first, second))
    if not (len(a) and len(b)):
        return math.nan, math.nan
    every = np.concatenate([a, b])
    shares = (np.searchsorted(x, every, "right") / len(x) for x in (a, b))
    return float(np.abs(np.subtract(*shares)).max()), 1.3581 * math.sqrt(1 / len(a) + 1 / len(b))


class Numbers:
    """The numbers of changes by start, run once each; more starts continue the list.

    study: runs the changes; its quantity is a scalar or a function of runs.
    """

    def __init__(self, study: Study) -> None:
        self.study = study
        self._numbers: dict[Change, np.ndarray] = {}
        self.failures: dict[Change, str] = {}

    def of(self, changes: Sequence[Change], count: int, bar: str | None = None) -> list[np.ndarray]:
        """Return the numbers of changes from the first `count` starts, (count,) each."""
        study, quantity = self.study, self.study.measure.quantity
        if not quantity.plays and count > (have := len(study.schedule.starts)):
            study.fresh(count - have)
        jobs, block = list[tuple[Change, range]](), EPISODES if quantity.plays else BLOCK
        for change in dict.fromkeys(changes):
            ran = len(self._numbers.get(change, ()))
            jobs += [(change, range(k, min(k + block, count))) for k in range(ran, count, block)]
        follow = partial(_numbers, study.engine, study.schedule, study.measure)
        if quantity.plays:
            follow = partial(_played, study.engine, study.schedule, quantity)

        def took(indices: range, blocks: list[_Block]) -> None:
            for (change, starts), (numbers, failure, binary) in zip(
                jobs[indices.start : indices.stop], blocks, strict=True
            ):
                done[change, starts.start] = numbers
                study.measure.mark(binary)
                if failure:
                    self.failures.setdefault(change, failure)
                study.runs += len(starts)
                study.spent += study.price(change, len(starts))

        done = dict[tuple[Change, int], np.ndarray]()
        try:
            study.workers.each(follow, jobs, bar, took=took)
        finally:
            # Keep what is complete from the first start on: a deadline may end the rest.
            for change, starts in jobs:
                before = self._numbers.get(change)
                if (
                    starts.start == (0 if before is None else len(before))
                    and (numbers := done.get((change, starts.start))) is not None
                ):
                    joined = numbers if before is None else np.concatenate([before, numbers])
                    self._numbers[change] = joined
        return [self._numbers[change][:count] for change in changes]

    def compare(self, first: np.ndarray, second: np.ndarray) -> Difference:
        """Return the difference of two sets of numbers; see `difference`.

        Of several quantities it is relative to the allowed errors.
        """
        measure = self.study.measure
        if not isinstance(measure, Measures):
            return difference(first, second, measure.binary)
        columns = zip(first.T, second.T, measure.parts, measure.allowed_errors, strict=True)
        parts = [difference(a, b, part.binary).relative_to(e) for a, b, part, e in columns]
        worst = max(parts, key=lambda part: part.bound)
        return dataclasses.replace(worst, sd=max(part.sd for part in parts), parts=tuple(parts))

    def outcome(self, change: Change, reference: np.ndarray, uncertainty: float = 0.0) -> Outcome:
        """Compare a change with the reference's numbers; uncertainty: of its mean."""
        study = self.study
        (numbers,) = self.of([change], len(reference))
        return Outcome(
            change=change,
            settings=study.engine.settings(change),
            numbers=numbers,
            difference=self.compare(reference, numbers).widened(uncertainty),
            work=study.work(change),
            cost=study.cost(change),
            spread=ratio_of_spreads(_first(reference), _first(numbers)),
            distance=distance_of(_first(reference), _first(numbers)),
            failure=self.failures.get(change, ""),
        )


# The numbers of a block of runs, the first failure, and the quantities that are True or False.
_Block = tuple[np.ndarray, str, tuple[bool, ...]]


def _played(engine: Engine, schedule: Schedule, quantity: Any, job: tuple[Change, range]) -> _Block:
    """Play the episodes of a task from some starts; return a block of numbers."""
    change, starts = job
    return *quantity.play(engine.settings(change), starts, engine.farthest(schedule)), (False,)


def _numbers(
    engine: Engine, schedule: Schedule, measure: Measure, job: tuple[Change, range]
) -> _Block:
    """Run a change from some starts; return a block of numbers."""
    change, starts = job
    tracks = engine.follow(change, schedule, starts)
    return measure.numbers(tracks, starts), tracks.failure_from(starts), measure.binaries
