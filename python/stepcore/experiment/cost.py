"""The cost of a setting: time, measured in turn with others; operations and memory, counted."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from time import get_clock_info, perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.sim import Sim
from stepcore.experiment.arguments import Workers
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.runner import Runner, positions
from stepcore.report.progress import Progress

# The fewest and the most rounds over all settings, and the time to spend on them if they are quick
# [s].
ROUNDS, MOST, LONG = 3, 9, 4.0
# A shorter run says little about its cost: it is repeated [s].
SHORT = 1e-3
# The operations of a step over (dofs + 2), of a robot in few contacts.
USUAL = 1500.0
# Whether the system has a fine clock of a thread's own computing.
OWN_CLOCK = get_clock_info("thread_time").resolution < 1e-5


class TimedRun:
    """The motion from a runner's first start, timed again and again under one setting.

    failed: whether a run failed; it is then not run again.
    """

    def __init__(self, runner: Runner, settings: Any, failed: bool = False) -> None:
        self.runner, self.settings, self.failed = runner, settings, failed
        self.times: list[float] = []
        self.sim: Any = None

    @property
    def cost(self) -> float:
        """Computing time [µs per simulated second], the median; NaN if it failed."""
        if not self.times:
            return math.nan
        return 1e6 * float(np.median(self.times)) / self.runner.schedule.horizon

    def once(self) -> float:
        """Runs once; returns the time of the steps [s]."""
        if self.sim is None:
            self.sim = self.runner.sim(self.settings)
        watch = Stopwatch()
        self.runner.follow(self.sim, 0, clock=watch)
        return watch.total()

    def again(self) -> float:
        """Runs for long enough to be timed; returns the time of all steps [s]."""
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


def costs(runs: Sequence[TimedRun], bar: Progress) -> list[float]:
    """Computing time of each run [µs per simulated second], the median of interleaved rounds.

    On one thread. Every round makes each run once, so that other load on the machine falls on all
    of them alike. Only steps are timed, a control period in one call, less the time in which the
    thread had no core. A run that fails gives NaN.
    """
    spent = _round(runs, bar)
    more = max(ROUNDS, min(MOST, int(LONG / spent))) - 1 if spent > 0 else ROUNDS
    for _ in range(more):
        _round(runs, None)
    return [run.cost for run in runs]


def _round(runs: Sequence[TimedRun], bar: Progress | None) -> float:
    spent = 0.0
    for run in runs:
        spent += run.again()
        if bar is not None:
            bar.advance()
    return spent


class Stopwatch:
    """Times the steps of a run: the share of their wall time in which this thread was computing."""

    def __init__(self) -> None:
        self.spent = 0.0
        self._first, self._own = perf_counter(), thread_time()

    def timing(self, step: Callable[[int], None]) -> Callable[[int], None]:
        """The same step, timed."""

        def timed(count: int) -> None:
            begin = perf_counter()
            step(count)
            self.spent += perf_counter() - begin

        return timed

    def total(self) -> float:
        """The time of the steps [s]."""
        whole, own = perf_counter() - self._first, thread_time() - self._own
        return self.spent * min(1.0, own / whole) if OWN_CLOCK and whole > 0 else self.spent


class Work(NamedTuple):
    """Floating-point operations and row updates per simulated second, and bytes of memory."""

    flops: float
    nbytes: int
    row_updates: float


UNKNOWN = Work(math.nan, 0, math.nan)


class Counter(Probe):
    """Counts the work of a run: the operations of one step at every sample, which are taken to hold
    until the next sample, and the memory at the end, where all contacts have had room.
    """

    def __init__(self, runner: Runner) -> None:
        self.schedule = runner.schedule
        self.work, self._sum = UNKNOWN, 0.0

    def period(self, sim: Sim, period: int) -> None:
        if period % self.schedule.every == 0:
            steps = self.schedule.steps(sim.settings.dt) * self.schedule.every
            self._sum += sim.count_flops() * steps

    def end(self, sim: Sim, run: Run) -> None:
        horizon = self.schedule.horizon
        self.work = Work(self._sum / horizon, sim.nbytes, sim.row_updates / horizon)


def priced(
    runner: Runner, settings: Settings, starts: Sequence[int], workers: Workers
) -> tuple[list[Run], Work]:
    """Runs of positions from some starts, until one fails, and the work of the first of them."""
    counter = Counter(runner)
    runs = [runner.run(settings, starts[0], [*positions(runner), counter])]
    if not runs[0].failure and len(starts) > 1:
        hidden = Progress("", len(starts) - 1, False)
        runs += screened(runner, settings, starts[1:], workers, hidden, until_fails=True)
    return runs, counter.work


def heaviness(runner: Runner, settings: Settings) -> float:
    """The work of a step of this motion over that of a usual step; at least 1.

    It is counted in the run from the first start. Budgets of steps × (dofs + 2) are of usual steps;
    many contacts make a step dearer than its degrees of freedom tell.
    """
    counter = Counter(runner)
    if runner.run(settings, 0, [counter]).failure:
        return 1.0
    return max(1.0, counter.work.flops * settings.dt / (USUAL * (runner.model.nv + 2)))
