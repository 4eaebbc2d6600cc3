"""What has been run: every setting tried so far, from how many starts, and how it came out.

The search glances; what it chooses is run once more and looked at closely.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from stepcore._core import Settings
from stepcore.executors import each
from stepcore.experiment.cost import UNKNOWN, Work
from stepcore.experiment.errors import errors, far_off
from stepcore.experiment.reference import Reference
from stepcore.experiment.runner import Course, Path
from stepcore.measure.trade.glance import glance
from stepcore.report.progress import Choice, Progress

T = TypeVar("T")
# Runs of a setting, and the work of the first.
Ran = tuple[list[Path], Work]


@dataclass(frozen=True)
class Score:
    """price: floating-point operations per simulated second. error: rms of the worst start [m].

    Both infinite for a failure.
    """

    price: float
    error: float


FAILED = Score(math.inf, math.inf)


class Trials:
    """Runs of a course, kept, so that nothing is run twice.

    Scores are those of the first so many starts, against the reference as it is when asked.
    """

    def __init__(
        self,
        course: Course,
        reference: Reference,
        size: float,
        threads: int = 1,
        executor: Executor | None = None,
        progress: Choice = None,
    ) -> None:
        self.course, self.reference, self.size = course, reference, size
        self.threads, self.executor, self.progress = threads, executor, progress
        self.glances: dict[Settings, list[Path]] = {}
        self.paths: dict[Settings, list[Path]] = {}
        self.work: dict[Settings, Work] = {}
        self.runs = 0

    def glance(self, settings: Sequence[Settings], starts: int, label: str) -> None:
        """Runs what is missing; a setting that failed from one start is not run from others."""
        jobs = []
        for one in dict.fromkeys(settings):
            done = self.glances.get(one, [])
            if len(done) < starts and not (done and done[-1].failure):
                jobs.append((one, len(done), starts))
        found = self._each(partial(glances, self.course), jobs, label)
        for (one, first, _), (paths, work) in zip(jobs, found, strict=True):
            self.glances.setdefault(one, []).extend(paths)
            if first == 0:
                self.work[one] = work

    def run(self, settings: Sequence[Settings], label: str = "errors") -> None:
        """Runs settings from every start and looks closely; what has been run is not run again."""
        missing = [one for one in dict.fromkeys(settings) if one not in self.paths]
        found = self._each(partial(all_starts, self.course), missing, label)
        for one, (paths, work) in zip(missing, found, strict=True):
            self.paths[one], self.work[one] = paths, work

    def _each(self, work: Callable[[T], Ran], jobs: Sequence[T], label: str) -> list[Ran]:
        with Progress(label, len(jobs), self.progress) as bar:
            found = each(work, jobs, bar=bar, threads=self.threads, executor=self.executor)
        self.runs += sum(len(paths) for paths, _ in found)
        return found

    def score(self, settings: Settings, starts: int) -> Score:
        """How a setting did, at a glance, from the first so many starts."""
        paths = self.glances[settings][:starts]
        if paths[-1].failure or self.far(paths):
            return FAILED
        truth, scored = self.reference.paths[: len(paths)], self.reference.scored[: len(paths)]
        return Score(self.work[settings].flops, errors(paths, truth, scored).high)

    def failure(self, settings: Settings) -> str | None:
        """Why a setting that has been run failed, if it did."""
        paths = self.paths[settings]
        if paths[-1].failure:
            return f"start {len(paths) - 1}: {paths[-1].failure}"
        return self.far(paths)

    def far(self, paths: Sequence[Path]) -> str | None:
        """Why paths are too far from the reference to be an error of it, if they are."""
        return far_off(paths, self.reference.paths[: len(paths)], self.size)


def glances(course: Course, job: tuple[Settings, int, int]) -> Ran:
    """Glances at one setting from start `first` to before `last`, until one fails; the work."""
    settings, first, last = job
    paths, work = [], UNKNOWN
    for start in range(first, last):
        path, counted = glance(course, settings, start, priced=start == 0)
        paths.append(path)
        work = counted if start == 0 else work
        if path.failure:
            break
    return paths, work


def all_starts(course: Course, settings: Settings) -> Ran:
    """Runs of one setting from every start, until one fails; and the work."""
    paths = []
    for start in range(len(course.motion.starts)):
        paths.append(course.run(settings, start))
        if paths[-1].failure:
            return paths, UNKNOWN
    return paths, glance(course, settings, 0, priced=True)[1]
