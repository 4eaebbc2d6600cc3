"""How long a scene can be predicted: perturbed runs, which start a rounding apart.

Each start is run again with its coordinates moved by 1e-9 of the scene's size, in several seeded
directions. Until two such runs are more than 1e3 times as far apart as they began, an error of a
setting says something of the setting; after that it says how errors grow in the scene, whatever
began them. Positions alone are moved: whatever grows in the scene soon grows from any direction.

All runs of a start, the first of them too, are moved by one common 1e-6 of the scene's size. A
scene in round numbers often has an impact exactly at the end of a step, and there a run a rounding
away meets it one step later: a jump of the method's, not of the scene's.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.arguments import Workers
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.coordinates import Start
from stepcore.experiment.run import Run, separation
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule
from stepcore.report.progress import Progress

# Perturbations, and the shift of all runs, over the scene's size and in radians.
NEARBY, ASIDE = 1e-9, 1e-6
# The growth of a perturbation at which a start is lost, and the number of perturbed runs.
GROWTH, DIRECTIONS = 1e3, 3


@dataclass(frozen=True)
class Growth:
    """How fast perturbed runs separate.

    times: of the samples [s], (n,).
    factor: the largest distance of any direction over that at the start, (starts, n).
    ends: when each start first exceeds 1e3 [s]; inf if it never does.
    """

    times: np.ndarray
    factor: np.ndarray
    ends: np.ndarray

    @property
    def overall(self) -> float:
        """When the first start can no longer be predicted [s]; inf beyond the horizon."""
        return float(self.ends.min())

    @property
    def scored(self) -> np.ndarray:
        """Which samples of each start can be predicted, (starts, n); the first always counts."""
        mask: np.ndarray = self.times[None, :] <= self.ends[:, None]
        mask[:, :1] = True
        return mask


def growth(
    runner: Runner, settings: Settings, size: float, workers: Workers, bar: Progress
) -> Growth:
    """Makes the perturbed runs of a runner under `settings`; size: of the scene [m].

    A perturbed run that fails says nothing, and is left out.
    """
    schedule = perturbed(runner, size)
    count = len(runner.schedule.starts)
    # Runs of one start lie beside each other: they do alike in a batch.
    order = sorted(range(len(schedule.starts)), key=lambda k: (k % count, k))
    made = screened(Runner(runner.model, schedule), settings, order, workers, bar)
    runs = dict(zip(order, made, strict=True))
    factor = np.ones((count, len(schedule.times)))
    for k in range(count, len(runs)):
        start = k % count
        if not (runs[k].failure or runs[start].failure):
            far = separation(runs[start], runs[k]).max(axis=1, initial=0.0)
            near = _begun(runner.bodies, schedule.starts[start], schedule.starts[k])
            factor[start] = np.maximum(factor[start], far / near)
    ends = [_end(schedule.times, growing) for growing in factor]
    return Growth(schedule.times, factor, np.array(ends))


def perturbed(runner: Runner, size: float) -> Schedule:
    """Starts that are all moved aside, then these moved in one direction, then in the next …"""
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
    ctrl = None if schedule.ctrl is None else np.concatenate([schedule.ctrl] * (1 + DIRECTIONS))
    return dataclasses.replace(schedule, starts=tuple(starts), ctrl=ctrl)


def _begun(bodies: Bodies, a: Start, b: Start) -> float:
    """The distance of two starts [m]."""
    seen = bodies.states(np.array([a.qpos, b.qpos]), np.zeros((2, bodies.model.nv)))
    first, second = (
        Run(com=seen.com[[i]], quat=seen.quat[[i]], gyration=bodies.gyration) for i in (0, 1)
    )
    return max(float(separation(first, second).max(initial=0.0)), 1e-300)


def _end(times: np.ndarray, factor: np.ndarray) -> float:
    """When the growth passes the limit for good, as if exponential between samples [s].

    For good means that it does not come back below the limit's square root: runs that meet
    something one step apart are far apart for a moment only, where the scene dissipates.
    """
    later = np.minimum.accumulate(np.nan_to_num(factor, nan=np.inf)[::-1])[::-1]
    over = np.flatnonzero(~(factor <= GROWTH) & (later >= np.sqrt(GROWTH)))
    if not len(over):
        return np.inf
    k = int(over[0])
    before, begun = (0.0, 1.0) if k == 0 else (times[k - 1], max(factor[k - 1], 1e-3))
    rise = np.log(factor[k] / begun) if np.isfinite(factor[k]) else np.inf
    return float(before + (times[k] - before) * np.log(GROWTH / begun) / rise)
