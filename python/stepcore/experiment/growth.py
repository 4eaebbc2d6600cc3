"""The growth of small perturbations, which limits how long a scene can be predicted.

Each start is run again with its coordinates moved by 1e-10 of the scene's size, in several seeded
random directions. While the distance between such runs has grown by less than a factor of 1e3, an
error measures the setting. After that, an error measures how the scene amplifies errors of any
origin. Only positions are perturbed, because a perturbation in any direction soon contains the
fastest-growing one.

A contact that one of two runs meets a step later than the other parts them by what its force does
in a whole step. That is an artefact of the time step, not growth in the scene, and is avoided in
two ways. All runs of a start, including the first, are moved by a common 1e-6 of the scene's size,
because a scene with round numbers often has an impact exactly at the end of a step. And the
perturbation is small and the step not short, because two runs meet a contact in different steps
with a probability proportional to their distance over the step. Of 64 starts of a falling capsule,
35 had such a contact at 1e-9 of the scene's size and a 16th of the shipped step, and none at 1e-10
and a quarter of it. Much smaller perturbations drown in rounding where runs come together again.

The growth does not depend on what is measured besides: its time step is a quarter of the shipped
one, its samples are 20 ms apart, and its perturbation is relative to the size of the bodies. So a
motion has one answer whatever the horizon; over a longer one perturbed runs may come together
again.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from stepcore._core import Settings
from stepcore.deadline import OutOfTime
from stepcore.engine.start import Start
from stepcore.experiment.arguments import Workers
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.run import Run, separation
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule
from stepcore.experiment.sizes import scene_size
from stepcore.report.progress import Progress
from stepcore.report.units import counted, seconds

# Size of the perturbations and of the common shift, relative to the scene's size or in radians.
NEARBY, ASIDE = 1e-10, 1e-6
# The shipped time step, relative to that of perturbed runs; if those fail, the second one.
SHORTER = (4, 16)
# The time between samples [s], and the largest number of samples.
APART, MOST = 0.02, 2000
# The growth above which a start counts as unpredictable, and the number of perturbed runs.
GROWTH, DIRECTIONS = 1e3, 3


@dataclass(frozen=True)
class Growth:
    """The growth of perturbations from every start.

    times: the times of the samples [s], (n,).
    factor: the largest distance to a perturbed run, relative to the initial distance, (starts, n).
    ends: when the factor of each start first exceeds 1e3 [s], (starts,); inf if never.
    samples: the times of the samples at which errors are measured [s].
    settings: the settings of the perturbed runs.
    failure: the reason why a run from a start itself failed; None if none did.
    """

    times: np.ndarray
    factor: np.ndarray
    ends: np.ndarray
    samples: np.ndarray
    settings: Settings
    failure: str | None = None

    @property
    def overall(self) -> float:
        """Time from which the least predictable start is unpredictable [s]; inf beyond horizon."""
        return float(self.ends.min())

    @property
    def scored(self) -> np.ndarray:
        """Mask of the predictable `samples`, (starts, n); the first one is always included."""
        mask: np.ndarray = self.samples[None, :] <= self.ends[:, None]
        mask[:, :1] = True
        return mask


def growth(
    runner: Runner, settings: Settings, workers: Workers, bar: Progress, partly: bool = False
) -> Growth:
    """Make perturbed runs under some settings, and measure how fast they separate.

    Perturbed runs that fail are ignored.

    partly: whether the growth of the first starts alone is returned if the time is over. The first
        start is then measured before the others, so that this much is known early.
    """
    samples, schedule = runner.schedule.times, sampled(runner.schedule, runner.model.settings.dt)
    runner = Runner(runner.model, schedule)
    schedule = perturbed(runner, scene_size(runner.model.scene))
    count = len(runner.schedule.starts)
    # Runs of one start are adjacent, because similar worlds make a batch fast.
    order = sorted(range(len(schedule.starts)), key=lambda k: (k % count, k))
    runs: dict[int, Run] = {}

    def grown() -> Growth:
        measured = len(runs) // (1 + DIRECTIONS)
        factor = np.ones((measured, len(schedule.times)))
        for k in range(count, len(schedule.starts)):
            start = k % count
            if start < measured and not (runs[k].failure or runs[start].failure):
                far = separation(runs[start], runs[k]).max(axis=1, initial=0.0)
                near = _begun(runner.bodies, schedule.starts[start], schedule.starts[k])
                factor[start] = np.maximum(factor[start], far / near)
        ends = [_end(schedule.times, growing) for growing in factor]
        own = (runs[k] for k in range(count) if k in runs)
        failure = next((run.failure for run in own if run.failure), None)
        return Growth(schedule.times, factor, np.array(ends), samples, settings, failure)

    each, first = Runner(runner.model, schedule), 1 + DIRECTIONS if partly else 0
    for some in (order[:first], order[first:]):
        made: list[Run] = []
        try:
            screened(each, settings, some, workers, bar, made=made)
        except OutOfTime:
            if not partly or len(runs) + len(made) <= DIRECTIONS:
                raise
        finally:
            runs.update(zip(some, made, strict=False))
        if partly:
            workers.deadline.so_far(_so_far(grown(), schedule.horizon))
    return grown()


def _so_far(grown: Growth, horizon: float) -> str:
    """Return the predictable time from the starts so far, in words."""
    time = grown.overall
    how = f"for {seconds(time)}" if np.isfinite(time) else f"over all of {seconds(horizon)}"
    starts = counted(len(grown.ends), "start")
    return f"from {starts}, the motion can be predicted {how}; others are run now"


def sampled(schedule: Schedule, dt: float) -> Schedule:
    """Return the schedule with samples 20 ms apart, or a control period if that is longer.

    Without controls a period is one time step `dt` [s], so that all horizons have the same samples.
    """
    period, periods = schedule.period, schedule.periods
    if schedule.control is None and not schedule.controls.nu:
        period, periods = dt, round(schedule.horizon / dt)
    every = max(1, round(APART / period))
    while periods > MOST * every:
        every *= 2
    every = min(every, periods)
    periods -= periods % every
    return dataclasses.replace(schedule, period=period, periods=periods, every=every)


def perturbed(runner: Runner, size: float) -> Schedule:
    """Return a schedule with shifted starts, followed by all perturbed starts of each direction.

    size: the size of the scene [m].
    """
    rng = np.random.default_rng(0)
    coordinates, schedule = runner.coordinates, runner.schedule
    aside = ASIDE * coordinates.drawn(rng, size, 1.0)
    starts = [
        dataclasses.replace(start, qpos=coordinates.moved(start.qpos, aside))
        for start in schedule.starts
    ]
    for _ in range(DIRECTIONS):
        for start in starts[: len(schedule.starts)]:
            sign = coordinates.scaled(rng.choice([-1.0, 1.0], coordinates.nv), size, 1.0)
            moved = coordinates.moved(start.qpos, NEARBY * sign)
            starts.append(dataclasses.replace(start, qpos=moved))
    each = [*range(len(schedule.starts))] * (1 + DIRECTIONS)
    return dataclasses.replace(schedule.picked(each), starts=tuple(starts))


def _begun(bodies: Bodies, a: Start, b: Start) -> float:
    """Return the largest distance between the bodies of two starts [m]."""
    seen = bodies.states(np.array([a.qpos, b.qpos]), np.zeros((2, bodies.model.nv)))
    first, second = (
        Run(com=seen.com[[i]], quat=seen.quat[[i]], gyration=bodies.gyration) for i in (0, 1)
    )
    return max(float(separation(first, second).max(initial=0.0)), 1e-300)


def _end(times: np.ndarray, factor: np.ndarray) -> float:
    """Return when the growth exceeds the limit permanently [s]; inf if never.

    The growth is interpolated exponentially between samples. A growth that later falls below the
    square root of the limit is not permanent: in a dissipative scene, runs with an impact in
    different steps are far apart only for a moment.
    """
    later = np.minimum.accumulate(np.nan_to_num(factor, nan=np.inf)[::-1])[::-1]
    over = np.flatnonzero(~(factor <= GROWTH) & (later >= np.sqrt(GROWTH)))
    if not len(over):
        return np.inf
    k = int(over[0])
    before, begun = (0.0, 1.0) if k == 0 else (times[k - 1], max(factor[k - 1], 1e-3))
    rise = np.log(factor[k] / begun) if np.isfinite(factor[k]) else np.inf
    return float(before + (times[k] - before) * np.log(GROWTH / begun) / rise)
