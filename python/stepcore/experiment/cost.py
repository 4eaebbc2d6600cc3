"""What a setting costs: time, measured one run at a time; operations and memory, counted."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from time import get_clock_info, perf_counter, thread_time
from typing import NamedTuple

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.sim import Sim
from stepcore.experiment.runner import Course
from stepcore.report.progress import Progress

# Rounds over all settings: at least, at most; and the time to spend on them if they are quick [s].
ROUNDS, MOST, LONG = 3, 9, 4.0
# Shorter than this a run says little about its cost: it is repeated [s].
SHORT = 1e-3
# A clock of this thread's own computing, where the system has a fine one.
OWN_CLOCK = get_clock_info("thread_time").resolution < 1e-5


class Timed(ABC):
    """What can be run through the motion again and again, and timed."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.failed = False

    @abstractmethod
    def once(self) -> float:
        """One run through the motion of the first start; the time its steps took [s]."""

    def again(self) -> float:
        """Runs for long enough to be timed; the time this took [s]."""
        if self.failed:
            return 0.0
        try:
            times = [self.once()]
            while sum(times) < SHORT and len(times) < 20:
                times.append(self.once())
        except (ValueError, SimulationError):
            self.failed, self.times = True, []
            return 0.0
        self.times.append(float(np.median(times)))
        return sum(times)


def costs(course: Course, players: Sequence[Settings | Timed], bar: Progress) -> list[float]:
    """Computing time of each setting [µs per simulated second], median of interleaved rounds.

    One thread. Every round steps each setting once through the motion of the first start, so
    that what else the machine does meanwhile falls on all settings alike. Only `Sim.step` is
    timed, called once a control period, and of that the share of the time in which the thread
    had a core to itself. A setting that fails gives NaN. Another engine's runs take their turn.
    """
    runs = [one if isinstance(one, Timed) else _Ours(course, one) for one in players]
    spent = _round(runs, bar)
    more = max(ROUNDS, min(MOST, int(LONG / spent))) - 1 if spent > 0 else ROUNDS
    for _ in range(more):
        _round(runs, None)
    horizon = course.motion.horizon
    return [
        1e6 * float(np.median(run.times)) / horizon if run.times else float("nan") for run in runs
    ]


def _round(runs: Sequence[Timed], bar: Progress | None) -> float:
    spent = 0.0
    for run in runs:
        spent += run.again()
        if bar is not None:
            bar.advance()
    return spent


class Watch:
    """Times parts of a run: of their wall time the share in which this thread was computing."""

    def __init__(self) -> None:
        self.spent = 0.0
        self._first, self._own = perf_counter(), thread_time()

    def start(self) -> None:
        self._begin = perf_counter()

    def stop(self) -> None:
        self.spent += perf_counter() - self._begin

    def total(self) -> float:
        """The time of the parts [s]."""
        whole, own = perf_counter() - self._first, thread_time() - self._own
        return self.spent * min(1.0, own / whole) if OWN_CLOCK and whole > 0 else self.spent


class _Ours(Timed):
    """One setting of stepcore."""

    def __init__(self, course: Course, settings: Settings) -> None:
        super().__init__()
        self.course, self.settings = course, settings
        self.count, self.periods = calls(course, settings.dt)
        self.drive = course.drive(0)
        self.sim: Sim | None = None

    def once(self) -> float:
        if self.sim is None:
            self.sim = self.course.sim(self.settings)
        sim, count, drive = self.sim, self.count, self.drive
        self.course.place(sim, 0)
        watch = Watch()
        for period in range(self.periods):
            drive(sim, period)
            watch.start()
            sim.step(count)
            watch.stop()
        return watch.total()


def calls(course: Course, dt: float) -> tuple[int, int]:
    """How many steps a call takes, and how many calls the motion."""
    count, periods = course.motion.steps(dt), course.motion.periods
    # Where nothing is set between periods: one call, as a user would.
    return (count, periods) if course.dofs.motors else (count * periods, 1)


class Work(NamedTuple):
    """What is counted: floating-point operations per simulated second, and bytes of memory."""

    flops: float
    nbytes: int


UNKNOWN = Work(math.nan, 0)


class Counter:
    """Counts the work of a run: operations of one step at every sample, by the engine itself,
    taken to hold until the next; memory at the end, where all contacts have had room.
    """

    def __init__(self, course: Course, settings: Settings) -> None:
        self._horizon = course.motion.horizon
        self._steps = course.motion.steps(settings.dt) * course.motion.every
        self._sum = 0.0

    def look(self, sim: Sim) -> None:
        """Counts the next step; nothing moves."""
        self._sum += sim.count_flops() * self._steps

    def total(self, sim: Sim) -> Work:
        """The work, after the run."""
        return Work(self._sum / self._horizon, sim.nbytes)
