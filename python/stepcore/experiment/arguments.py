"""The arguments that every measurement takes: what is measured, its motion, and who makes runs."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.executors import check_executor, each
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.motion import Motion
from stepcore.experiment.run import Run
from stepcore.loading import find_model
from stepcore.report.progress import Choice, Progress
from stepcore.scene.scene import Scene

T = TypeVar("T")
R = TypeVar("R")
# What a measurement can be made of: a file is read, a scene compiled.
Source = Model | Scene | str | os.PathLike[str]
# The speed-up from which the next batch is made.
WORTH = 1.05


class Timed(NamedTuple):
    """Runs, and the computing time that they took [s]."""

    runs: list[Run]
    spent: float


@dataclass
class BatchSpeedup:
    """The speed-up of batched runs over single runs.

    runs, batches: the number made. alone: the computing time that the runs would have taken singly,
    by that of one run of each setting [s]; spent: the computing time of their batches [s].
    """

    runs: int = 0
    batches: int = 0
    alone: float = 0.0
    spent: float = 0.0
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False, compare=False)

    @property
    def worth(self) -> bool:
        """Whether further batches are worth making."""
        return not self.batches or self.alone > WORTH * self.spent

    def compare(self, alone: Timed, batches: Sequence[Timed]) -> None:
        """Counts batches beside one run that was made alone under the same settings.

        Runs that ended early say nothing. Threads may call this at the same time.
        """
        runs = [run for batch in batches for run in batch.runs]
        if any(run.failure for run in (*alone.runs, *runs)):
            return
        with self._lock:
            self.runs, self.batches = self.runs + len(runs), self.batches + len(batches)
            self.alone += alone.spent * len(runs)
            self.spent += sum(batch.spent for batch in batches)

    @property
    def sentences(self) -> list[str]:
        """The speed-up in words; nothing where no batch was made or none saved anything."""
        if not self.batches or self.alone <= self.spent:
            return []
        batches = "one batch" if self.batches == 1 else f"{self.batches} batches"
        return [
            f"{self.runs} runs were made as {batches}, {self.alone / self.spent:.2g} times quicker "
            "than singly (computing time of a core)"
        ]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())


@dataclass(frozen=True)
class Workers:
    """Where the runs of a measurement are made, and how its progress is shown.

    threads: the number of runs at once; executor: used in place of threads; progress: see
    `Progress`. speedup: of the batches among all runs made here.
    """

    threads: int = 1
    executor: Executor | None = None
    progress: Choice = False
    speedup: BatchSpeedup = field(default_factory=BatchSpeedup, compare=False)

    @property
    def inside(self) -> Workers:
        """The workers of a job that itself runs at the same time as others."""
        return Workers(speedup=self.speedup)

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
        """The arguments for a measurement within another."""
        return {"threads": self.threads, "executor": self.executor, "progress": self.progress}

    def bar(self, label: str, total: int) -> Progress:
        """A progress bar, to be used in a `with`."""
        return Progress(label, total, self.progress)

    def each(self, job: Callable[[T], R], points: Sequence[T], bar: Progress | str) -> list[R]:
        """The results in the order of the points. bar: one that is drawn already, or a label."""
        if isinstance(bar, str):
            with self.bar(bar, len(points)) as drawn:
                return self.each(job, points, drawn)
        return each(job, points, bar=bar, threads=self.threads, executor=self.executor)

    def until(
        self,
        ends: Callable[[R], object],
        job: Callable[[T], R],
        points: Sequence[T],
        bar: Progress | str,
    ) -> list[R]:
        """The results up to and with the first for which `ends` is true: on any number of threads
        the same. What comes after it is not begun, or its result is dropped.
        """
        if isinstance(bar, str):
            with self.bar(bar, len(points)) as drawn:
                return self.until(ends, job, points, drawn)
        together = len(points) if self.executor is not None else self.threads
        done: list[R] = []
        for first in range(0, len(points), max(1, together)):
            for result in self.each(job, points[first : first + together], bar):
                done.append(result)
                if ends(result):
                    return done
        return done


class Setup(NamedTuple):
    """A measurement's common arguments, checked. name: of the scene."""

    model: Model
    motion: Motion
    workers: Workers

    @property
    def name(self) -> str:
        return self.model.scene.name or "scene"


def set_up(
    measurement: Callable[..., Any],
    model: Source,
    motion: Motion | None,
    fields: Mapping[str, Any],
    *,
    missing: str,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> Setup:
    """Checks the arguments that all measurements share, and loads and compiles the model.

    measurement: the function that was called. fields: its keyword arguments for `Motion`. missing:
    what there is none of where nothing in the scene can move, in words.
    """
    motion = Motion.of(motion, fields, measurement)
    compiled = find_model(model)
    workers = Workers.checked(measurement.__name__, threads, executor, progress)
    if not compiled.nv:
        raise ValueError(
            "the scene has no joint, so nothing in it can move: add a body with a joint"
        )
    if not Coordinates(compiled).moving:
        raise ValueError(f"nothing in the scene can move: there is {missing}")
    return Setup(compiled, motion, workers)
