"""The time for which a motion can be predicted: until perturbations have grown a thousandfold.

A start is run again from coordinates moved by 1e-10 of the scene's size. While the distance between
the two runs has grown by less than a factor of 1e3, an error measures the settings. After that, it
measures how the scene amplifies errors of any origin.

If one of two runs meets a contact a step later than the other, they separate by the effect of its
force in a whole step. That is an artefact of the step, not growth in the scene. So both runs begin
1e-6 of the size aside, because a scene with round numbers often has an impact exactly at the end of
a step; and the perturbation is small. (35 of 64 starts of a falling capsule had such a contact at
1e-9 and none at 1e-10. Much smaller perturbations drown in rounding.)
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from stepcore.engine.norm import Matter, Tracks, distances
from stepcore.experiment.change import Change
from stepcore.experiment.engines import Engine
from stepcore.experiment.quantity import Measure
from stepcore.experiment.schedule import Schedule
from stepcore.report.units import counted, seconds

# The time between samples is at most this [s].
SAMPLE_TIME = 0.02
# The growth above which a motion counts as unpredictable.
GROWTH = 1e3
# Two motions agree on the end of a start to this share of the time; closely to a quarter of it.
AGREE = 0.2


@dataclass(frozen=True)
class Growth:
    """The growth of perturbations from every start.

    times: the times of the samples [s], (n,).
    factor: the distance to the perturbed run over the distance at the start, (starts, n).
    ends: when the factor of each start has exceeded 1e3 for good [s], (starts,); inf if never.
    failure: why a run failed; "" if none did.
    """

    times: np.ndarray
    factor: np.ndarray
    ends: np.ndarray
    failure: str = ""

    @property
    def overall(self) -> float:
        """The end of the least predictable start [s]; inf beyond the horizon."""
        return float(self.ends.min(initial=np.inf))

    def some(self, indices: Sequence[int]) -> Growth:
        """Return the growth from some of the starts, by their indices."""
        chosen = list(indices)
        return Growth(self.times, self.factor[chosen], self.ends[chosen], self.failure)

    @classmethod
    def joined(cls, parts: Sequence[Growth]) -> Growth:
        """Return the growth from all starts of some parts."""
        factor, ends = (np.concatenate([getattr(p, n) for p in parts]) for n in ("factor", "ends"))
        failure = next((part.failure for part in parts if part.failure), "")
        return cls(parts[0].times, factor, ends, failure)

    def then(self, longer: Growth) -> Growth:
        """Return this growth, continued by the later samples of a longer one."""
        after = longer.factor[:, len(self.times) :]
        factor = np.concatenate([self.factor, after], axis=1)
        return dataclasses.replace(self, times=longer.times, factor=factor)

    def scored(self, samples: np.ndarray) -> np.ndarray:
        """Return which samples can be predicted, (starts, n); the first one always counts."""
        mask: np.ndarray = samples[None, :] <= self.ends[:, None]
        mask[:, :1] = True
        return mask


T = TypeVar("T")
# A generator that requests the growth under a change over a schedule, and returns a T.
Asking = Generator[tuple[Change, Schedule], Growth, T]


def growth(
    engine: Engine,
    change: Change,
    schedule: Schedule,
    starts: Sequence[int],
    size: float,
    directions: int = 1,
) -> Growth:
    """Measure how fast perturbed runs separate; the perturbations are always the same.

    size: of the scene [m]. directions: the number of perturbed runs of every start.
    """
    schedules = [schedule] * len(starts)
    return Growth.joined(growths(engine, change, schedules, starts, size, directions))


def growths(
    engine: Engine,
    change: Change,
    schedules: Sequence[Schedule],
    starts: Sequence[int],
    size: float,
    directions: int = 1,
    measure: Measure | None = None,
) -> list[Growth]:
    """Measure the growth from each start over its schedule; all runs are made together.

    measure: the series whose distance grows, by default the motion.
    """
    schedule = max(schedules, key=lambda entry: entry.periods)
    # Samples are at most 20 ms apart, and include the schedule's.
    most = max(1, int(SAMPLE_TIME / schedule.period + 1e-9))
    every = max(n for n in range(1, schedule.every + 1) if schedule.every % n == 0 and n <= most)
    sampled = dataclasses.replace(schedule, every=every)
    moved, rng, count = engine.coordinates, np.random.default_rng(0), len(starts)
    # The common shift of all runs, relative to the scene's size or in radians.
    aside = 1e-6 * moved.drawn(rng, size, 1.0)
    nudges = [np.zeros(moved.nv)]
    nudges += [
        engine.nearby * moved.scaled(rng.choice([-1.0, 1.0], moved.nv), size, 1.0)
        for _ in range(directions)
    ]
    begin = [
        dataclasses.replace(start, qpos=moved.moved(moved.moved(start.qpos, aside), nudge))
        for nudge in nudges
        for start in (schedule.starts[k] for k in starts)
    ]
    both = dataclasses.replace(sampled.picked([*starts] * len(nudges)), starts=tuple(begin))
    runs = engine.follow(change, both, both.indices, first=0)
    lengths = [dataclasses.replace(sampled, periods=entry.periods).times for entry in schedules]
    alike = [runs.some(range(k, len(runs), count)) for k in range(count)]
    parts = [each.first(1 + len(times)) for each, times in zip(alike, lengths, strict=True)]
    if measure is None:
        return [_grown(part, n, engine.matter) for part, n in zip(parts, lengths, strict=True)]
    return [
        _grown_series(part, n, measure, engine.nearby)
        for part, n in zip(parts, lengths, strict=True)
    ]


def _grown_series(runs: Tracks, times: np.ndarray, measure: Measure, nearby: float) -> Growth:
    """Return the growth of a series in perturbed runs; the first run is the unperturbed one.

    The distance counts relative to the range of the series, as the perturbation does relative to
    the scene's size.

    nearby: the size of the perturbation, relative to the scene's size.
    """
    base, factor = runs.some([0]), np.ones((1, len(times)))
    smallest = nearby * measure.range(base)
    for k in range(1, len(runs)):
        away = measure.apart(base, runs.some([k])).max(axis=2)[:, 1:]
        factor = np.maximum(factor, away / smallest)
    return Growth(times, factor, np.array([_end(times, factor[0])]), base.failure)


def _grown(runs: Tracks, times: np.ndarray, matter: Matter) -> Growth:
    """Return the growth of perturbed runs; the first run is the unperturbed one."""
    base, factor = runs.some([0]), np.ones((1, len(times)))
    for k in range(1, len(runs)):
        # A perturbed rotation moves bodies by other distances than the perturbation, so growth is
        # relative to the distance of the runs at the start.
        away = distances(base, runs.some([k]), matter).max(axis=2)
        factor = np.maximum(factor, away[:, 1:] / np.maximum(away[:, :1], 1e-300))
    return Growth(times, factor, np.array([_end(times, factor[0])]), base.failure)


def converged_growth(
    engine: Engine,
    changes: Iterable[Change],
    schedule: Schedule,
    starts: Sequence[int],
    size: float,
    directions: int = 1,
    full: Growth | None = None,
) -> tuple[Growth, Change]:
    """Measure the growth at shorter and shorter steps, as `growth_requests` requires."""
    asking = growth_requests(changes, schedule, len(starts), full)
    request = next(asking)
    while True:
        try:
            request = asking.send(growth(engine, *request, starts, size, directions))
        except StopIteration as end:
            grown, change, _ = end.value
            return grown, change


def growth_requests(
    changes: Iterable[Change], schedule: Schedule, starts: int, full: Growth | None = None
) -> Asking[tuple[Growth, Change, bool]]:
    """Request the growth at shorter and shorter steps, until two agree on the ends of starts.

    A motion of long steps may be unstable itself. If no start ends, the first step is enough; if
    all end, shorter steps run for twice the time until then. The longer of two steps that agree is
    returned, with its change, as it has less rounding; and whether they agree closely.

    changes: with ever shorter steps. starts: their number. full: the growth in which all starts
    end under another method, if available. A step that agrees with it is enough, and so are two
    that end earlier: the longer time is the right one.
    """
    last, span = None, schedule if full is None else shortened(schedule, full)
    previous_ends = np.zeros(starts) if full is None else full.ends
    for change in changes:
        grown = yield change, span
        if span is not schedule and not np.isfinite(grown.ends).all():
            # Starts that do not end there again may end later.
            span = schedule
            grown = yield change, span
        if not (grown.failure or np.isfinite(grown.ends).any()):
            return grown, change, True
        if not grown.failure:
            full, span = full or grown, shortened(span, grown)
        before, last = last, (grown if full is None else grown.then(full), change)
        if not grown.failure and _agree(grown.ends, previous_ends).all():
            return *last, False
        if before is not None:
            first, failed = before[0].ends, grown.failure or before[0].failure
            short = (np.maximum(grown.ends, first) < (1 - AGREE) * previous_ends) & (not failed)
            if (_agree(grown.ends, first) | short).all():
                return *before, not failed and bool(_agree(grown.ends, first, AGREE / 4).all())
    assert last is not None
    return *last, False


def until_in_words(
    ends: np.ndarray, horizon: float, at: str = "from", each: str = "start"
) -> list[str]:
    """Describe until when errors count, if that is not the whole horizon [s]."""
    lost = ends[np.isfinite(ends)]
    if not lost.size:
        return []
    where = f"{at} {lost.size} of {counted(len(ends), each)} " if len(ends) > 1 else ""
    after = f"{'the first ' * (lost.size > 1)}after {seconds(float(lost.min()))}"
    return [
        f"Errors count only while the motion can be predicted: {where}nearby motions part "
        f"before {seconds(horizon)} are over, {after}."
    ]


def _agree(ends: np.ndarray, others: np.ndarray, share: float = AGREE) -> np.ndarray:
    """Return which starts end at the same time, to a share of it."""
    a, b = (np.minimum(times, 1e300) for times in (ends, others))
    agree: np.ndarray = np.abs(a - b) <= share * np.maximum(a, b)
    return agree


def shortened(schedule: Schedule, grown: Growth) -> Schedule:
    """Return the schedule for twice the time in which all starts end, if they all end."""
    if not np.isfinite(grown.ends).all():
        return schedule
    samples = math.ceil(2 * grown.ends.max() / (schedule.period * schedule.every))
    periods = samples * schedule.every
    return (
        dataclasses.replace(schedule, periods=periods) if periods < schedule.periods else schedule
    )


def _end(times: np.ndarray, factor: np.ndarray) -> float:
    """Return when the growth exceeds the limit for good [s]; inf if never.

    The growth is interpolated exponentially between samples. A growth that later falls below the
    square root of the limit is not for good: in a scene that dissipates, runs with an impact in
    different steps are far apart only for a moment.
    """
    factor = np.where(np.isnan(factor), np.inf, factor)
    later = np.minimum.accumulate(factor[::-1])[::-1]
    over = np.flatnonzero((factor > GROWTH) & (later >= np.sqrt(GROWTH)))
    if not len(over):
        return np.inf
    k = int(over[0])
    before, begun = (0.0, 1.0) if k == 0 else (times[k - 1], max(factor[k - 1], 1e-3))
    rise = np.log(factor[k] / begun) if np.isfinite(factor[k]) else np.inf
    return float(before + (times[k] - before) * np.log(GROWTH / begun) / rise)
