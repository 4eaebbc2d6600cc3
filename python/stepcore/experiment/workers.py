"""Where the runs of a measurement are made, and how its progress is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, TypeVar

from stepcore import checks
from stepcore.executors import check_executor, each
from stepcore.experiment.saving import Saving
from stepcore.report.progress import Choice, Progress

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Workers:
    """threads: how many runs at once; executor: takes their place; progress: see `Progress`.

    saving: what batches have saved so far, of all runs made here.
    """

    threads: int = 1
    executor: Executor | None = None
    progress: Choice = False
    saving: Saving = field(default_factory=Saving, compare=False)

    @property
    def inside(self) -> Workers:
        """Those of a job that itself runs at the same time as others."""
        return Workers(saving=self.saving)

    @classmethod
    def checked(
        cls, owner: str, threads: int | None, executor: Executor | None, progress: Choice
    ) -> Workers:
        """The arguments of a measurement; None threads are one a core."""
        checks.progress(owner, progress)
        check_executor(owner, executor)
        return cls(checks.threads(threads), executor, progress)

    @property
    def arguments(self) -> dict[str, Any]:
        """What a measurement within another is called with."""
        return {"threads": self.threads, "executor": self.executor, "progress": self.progress}

    def bar(self, label: str, total: int) -> Progress:
        """A progress bar, to be used in a `with`."""
        return Progress(label, total, self.progress)

    def each(self, job: Callable[[T], R], points: Sequence[T], bar: Progress | str) -> list[R]:
        """The results in the order of the points. bar: one that is drawn already, or a label."""
        if isinstance(bar, str):
            with self.bar(bar, len(points)) as own:
                return self.each(job, points, own)
        return each(job, points, bar=bar, threads=self.threads, executor=self.executor)

    def until(
        self, ends: Callable[[R], object], job: Callable[[T], R], points: Sequence[T], bar: Progress
    ) -> list[R]:
        """The results up to the first that `ends` is true of, and that one: on any number of
        threads the same. What would come after it is not begun, or its result is dropped.
        """
        together = len(points) if self.executor is not None else self.threads
        done: list[R] = []
        for first in range(0, len(points), max(1, together)):
            for result in self.each(job, points[first : first + together], bar):
                done.append(result)
                if ends(result):
                    return done
        return done
