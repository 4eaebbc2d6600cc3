"""`Trials`: every setting that was run so far, from how many starts, with its paths and its work.

The search only records positions; settings that it chooses are run again and fully recorded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from stepcore._core import Settings
from stepcore.experiment.arguments import Timed, Workers
from stepcore.experiment.batched_runs import can, helps, portions, timed
from stepcore.experiment.cost import UNKNOWN, Counter, Work
from stepcore.experiment.errors import errors
from stepcore.experiment.failure import far_off
from stepcore.experiment.recorder import Positions
from stepcore.experiment.reference import Reference
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Runner

T = TypeVar("T")
# Runs of a setting, and the work of the first.
Ran = tuple[list[Run], Work]
# The same of which some were made alone and others in batches.
Made = tuple[Ran, list[Timed]]
# A setting, the first start of its runs and the one after the last.
Screened = tuple[Settings, int, int]


@dataclass(frozen=True)
class Score:
    """price: floating-point operations per simulated second. error: RMS of the worst start [m].

    Both infinite for a failure.
    """

    price: float
    error: float


FAILED = Score(math.inf, math.inf)


class Trials:
    """Runs under settings, kept, so that nothing is run twice.

    Scores are those of the first so many starts, against the reference as it is when asked.
    """

    def __init__(self, runner: Runner, reference: Reference, size: float, workers: Workers) -> None:
        self.runner, self.reference, self.size, self.workers = runner, reference, size, workers
        self.screened: dict[Settings, list[Run]] = {}
        self.paths: dict[Settings, list[Run]] = {}
        self.work: dict[Settings, Work] = {}
        self.runs = 0

    def screen(self, settings: Sequence[Settings], starts: int, label: str) -> None:
        """Runs what is missing; a setting that failed from one start is not run from others."""
        jobs = []
        for setting in dict.fromkeys(settings):
            done = self.screened.get(setting, [])
            if len(done) < starts and not (done and done[-1].failure):
                jobs.append((setting, len(done), starts))
        for (setting, first, _), (paths, work) in zip(
            jobs, self._screened(jobs, label), strict=True
        ):
            self.screened.setdefault(setting, []).extend(paths)
            if first == 0:
                self.work[setting] = work

    def run(self, settings: Sequence[Settings], label: str = "errors") -> None:
        """Runs settings from every start, fully recorded; what has been run is not run again, and
        what failed in the search is not run to fail again."""
        for setting in settings:
            done = self.screened.get(setting)
            if done and setting not in self.paths and (done[-1].failure or self.far(done)):
                self.paths[setting] = done
        missing = [setting for setting in dict.fromkeys(settings) if setting not in self.paths]
        # The dearest first, so that all threads end together.
        missing.sort(key=lambda setting: setting.dt)
        ran = self._each(partial(all_starts, self.runner), missing, label)
        for setting, (paths, work) in zip(missing, ran, strict=True):
            self.paths[setting], self.work[setting] = paths, work

    def _screened(self, jobs: Sequence[Screened], label: str) -> list[Ran]:
        """The runs of jobs; of fewer jobs than threads the starts run at the same time."""
        if self.workers.executor is not None or len(jobs) >= self.workers.threads:
            several_starts = partial(several, self.runner, self.workers.inside)
            made = self.workers.each(several_starts, jobs, label)
            for (paths, _), took in made:
                self.runs += len(paths)
                if took:
                    self.workers.speedup.compare(took[0], took[1:])
            return [ran for ran, _ in made]
        job = partial(screen_starts, self.runner)
        ran = []
        for setting, first, last in jobs:
            starts = [(setting, start, start + 1) for start in range(first, last)]
            with self.workers.bar(label, len(starts)) as bar:
                parts = self.workers.until(lambda part: part[0][-1].failure, job, starts, bar)
            self.runs += len(parts)
            ran.append(([path for paths, _ in parts for path in paths], parts[0][1]))
        return ran

    def _each(self, job: Callable[[T], Ran], points: Sequence[T], label: str) -> list[Ran]:
        ran = self.workers.each(job, points, label)
        self.runs += sum(len(paths) for paths, _ in ran)
        return ran

    def score(self, settings: Settings, starts: int) -> Score:
        """How a setting did, by its positions alone, from the first so many starts."""
        paths = self.screened[settings][:starts]
        if paths[-1].failure or self.far(paths):
            return FAILED
        truth, scored = self.reference.runs[: len(paths)], self.reference.scored[: len(paths)]
        return Score(self.work[settings].flops, errors(paths, truth, scored).high)

    def failure(self, settings: Settings) -> str | None:
        """Why a setting failed; None if it did not."""
        paths = self.paths[settings]
        if paths[-1].failure:
            return f"start {len(paths) - 1}: {paths[-1].failure}"
        return self.far(paths)

    def far(self, paths: Sequence[Run]) -> str | None:
        """Why paths count as failed: they are too far from the reference. None if they are not."""
        return far_off(paths, self.reference.runs[: len(paths)], self.size)


def priced(runner: Runner, settings: Settings) -> tuple[Run, Work]:
    """The positions of the run from the first start, and its work."""
    counter = Counter(runner)
    return runner.run(settings, 0, [Positions(runner.bodies), counter]), counter.work


def screen_starts(runner: Runner, job: Screened) -> Ran:
    """Positions under one setting from start `first` to before `last`, until one fails."""
    settings, first, last = job
    paths, work = [], UNKNOWN
    for start in range(first, last):
        if start == 0:
            path, work = priced(runner, settings)
        else:
            path = runner.screen(settings, start)
        paths.append(path)
        if path.failure:
            break
    return paths, work


def several(runner: Runner, workers: Workers, job: Screened) -> Made:
    """The same; of many starts all but the first two in batches, with what each took."""
    settings, first, last = job
    singly = first + 2 if first == 0 else first + 1
    left = last - singly
    if not (can(runner) and helps(left, 1, workers.speedup)):
        return screen_starts(runner, job), []
    paths, work = screen_starts(runner, (settings, first, singly - 1))
    if paths and paths[-1].failure:
        return (paths, work), []
    parts = [timed(runner, settings, [singly - 1])]
    if not parts[0].runs[0].failure:
        rest = range(singly, last)
        parts += [timed(runner, settings, some) for some in portions(rest)]
    paths += [path for part in parts for path in part.runs]
    ends = next((k for k, path in enumerate(paths) if path.failure), len(paths))
    return (paths[: ends + 1], work), parts if len(parts) > 1 else []


def all_starts(runner: Runner, settings: Settings) -> Ran:
    """Recorded runs of one setting from every start, until one fails; and the work."""
    paths = runner.runs(settings)
    return paths, UNKNOWN if paths[-1].failure else priced(runner, settings)[1]
