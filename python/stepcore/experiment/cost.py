"""The cost of a setting: measured computing time, and counted operations and memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from time import get_clock_info, perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

from stepcore import deadline
from stepcore._core import Settings, SimulationError
from stepcore.engine.sim import Sim
from stepcore.experiment.arguments import Workers
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.runner import Runner, positions
from stepcore.report.progress import Progress
from stepcore.report.units import counted

# The smallest and the largest number of rounds over all settings, and the time for fast rounds [s].
ROUNDS, MOST, LONG = 3, 9, 4.0
# A run timed for this long in all is not timed again [s]: the median of more times would differ by
# less than the load of a machine makes them differ.
ENOUGH = 0.5
# Shorter runs are repeated, because their time alone is too inaccurate [s].
SHORT = 1e-3
# The operations per step and (dofs + 2) of a robot with few contacts.
USUAL = 1500.0
# How often the clock is read to learn what a reading takes.
READINGS = 9
# Whether the system has a fine clock of the computing time of a thread.
OWN_CLOCK = get_clock_info("thread_time").resolution < 1e-5


class TimedRun:
    """Repeated timing of the motion from a runner's first start, under one setting.

    runner: makes the runs. settings: of the runs.
    failed: whether a run failed; no further runs are made then.
    times: the times of the steps of one run [s], one entry per round.
    """

    def __init__(self, runner: Runner, settings: Any, failed: bool = False) -> None:
        self.runner, self.settings, self.failed = runner, settings, failed
        self.times: list[float] = []
        self.sim: Any = None

    @property
    def cost(self) -> float:
        """Median computing time [µs per simulated second]; NaN if the run failed."""
        if not self.times:
            return math.nan
        return 1e6 * float(np.median(self.times)) / self.runner.schedule.horizon

    def once(self) -> float:
        """Run once, and return the time of the steps [s]."""
        if self.sim is None:
            self.sim = self.runner.sim(self.settings)
        watch = Stopwatch()
        self.runner.follow(self.sim, 0, clock=watch)
        return watch.total()

    def again(self) -> float:
        """Repeat the run for long enough to be timed, and return the time of all steps [s]."""
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


def costs(runs: Sequence[TimedRun], bar: Progress | None = None) -> list[float]:
    """Measure the computing time of each run [µs per simulated second], on one thread.

    The time is the median over several rounds. A round makes every run once, so that other load on
    the machine affects all runs alike; later rounds make the short ones only. Only the steps are
    timed, with one call per control period. Time in which the thread had no core does not count. A
    run that fails, or that the deadline leaves out, gives NaN.
    """
    time = deadline.current() or deadline.Deadline()
    with time.stage(f"all timing of {counted(len(runs), 'setting')}"):
        spent = _round(runs, bar)
        more = max(ROUNDS, min(MOST, int(LONG / spent))) - 1 if spent > 0 else ROUNDS
        for _ in range(more):
            _round(runs, None)
    return [run.cost for run in runs]


def _round(runs: Sequence[TimedRun], bar: Progress | None) -> float:
    spent = 0.0
    for run in runs:
        if sum(run.times) < ENOUGH:
            spent += run.again()
        if bar is not None:
            bar.advance()
    return spent


class Stopwatch:
    """A clock for the steps of a run, which counts only time in which this thread computed.

    Each call is timed by the thread's own clock. A share of the wall time would be wrong on a busy
    machine, where most of the time without a core can fall between the calls.

    spent: the computing time of the steps [s].
    """

    def __init__(self) -> None:
        self.spent = 0.0
        self._now = thread_time if OWN_CLOCK else perf_counter
        # What reading the clock adds to the time of a call.
        self._reading = float(np.median([-self._now() + self._now() for _ in range(READINGS)]))

    def timing(self, step: Callable[[int], None]) -> Callable[[int], None]:
        """Return the step function with timing."""

        def timed(count: int) -> None:
            begin = self._now()
            step(count)
            self.spent += max(0.0, self._now() - begin - self._reading)

        return timed

    def total(self) -> float:
        """Return the computing time of the steps [s]."""
        return self.spent


class Work(NamedTuple):
    """The counted work of a run.

    flops: floating-point operations per simulated second. nbytes: memory [bytes].
    row_updates: updates of constraint rows per simulated second.
    """

    flops: float
    nbytes: int
    row_updates: float


UNKNOWN = Work(math.nan, 0, math.nan)


class Counter(Probe):
    """A probe that counts the work of a run.

    The operations of one step are counted at every sample, and extrapolated to the next sample. The
    memory is that at the end of the run, which has had room for all contacts.
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
    """Run from several starts until one run fails; return the runs and the work of the first.

    The runs record positions alone.
    """
    counter = Counter(runner)
    runs = [runner.run(settings, starts[0], [*positions(runner), counter])]
    if not runs[0].failure and len(starts) > 1:
        runs += screened(runner, settings, starts[1:], workers, None, until_fails=True)
    return runs, counter.work


def heaviness(runner: Runner, settings: Settings) -> float:
    """Return the work of a step of this motion relative to a usual step; at least 1.

    The work is counted in the run from the first start. Budgets count usual steps × (dofs + 2), but
    many contacts make a step more expensive than the number of dofs suggests.
    """
    counter = Counter(runner)
    if runner.run(settings, 0, [counter]).failure:
        return 1.0
    return max(1.0, counter.work.flops * settings.dt / (USUAL * (runner.model.nv + 2)))
