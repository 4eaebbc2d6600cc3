"""What a setting costs: time, measured one run at a time, and row updates, counted."""

from __future__ import annotations

from collections.abc import Sequence
from time import get_clock_info, perf_counter, thread_time

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.progress import Progress
from stepcore.sim import Sim
from stepcore.trade.run import Course

# Rounds over all settings: at least, at most; and the time to spend on them if they are quick [s].
ROUNDS, MOST, LONG = 3, 9, 4.0
# Shorter than this a run says little about its cost: it is repeated [s].
SHORT = 1e-3
# A clock of this thread's own computing, where the system has a fine one.
OWN_CLOCK = get_clock_info("thread_time").resolution < 1e-5


def costs(course: Course, settings: Sequence[Settings], bar: Progress) -> list[float]:
    """Computing time of each setting [µs per simulated second], median of interleaved rounds.

    One thread. Every round steps each setting once through the motion of the first start, so
    that what else the machine does meanwhile falls on all settings alike. Only `Sim.step` is
    timed, called once a control period, and of that the share of the time in which the thread
    had a core to itself. A setting that fails gives NaN.
    """
    runs = [_Timed(course, one) for one in settings]
    spent = _round(runs, bar)
    more = max(ROUNDS, min(MOST, int(LONG / spent))) - 1 if spent > 0 else ROUNDS
    for _ in range(more):
        _round(runs, None)
    horizon = course.motion.horizon
    return [
        1e6 * float(np.median(run.times)) / horizon if run.times else float("nan") for run in runs
    ]


def _round(runs: Sequence[_Timed], bar: Progress | None) -> float:
    spent = 0.0
    for run in runs:
        spent += run.again()
        if bar is not None:
            bar.advance()
    return spent


class _Timed:
    """One setting, run through the motion again and again."""

    def __init__(self, course: Course, settings: Settings) -> None:
        self.course, self.settings = course, settings
        motion = course.motion
        self.count, self.periods = motion.steps(settings.dt), motion.periods
        if not course.dofs.motors:
            # Nothing to set between periods: one call, as a user would.
            self.count, self.periods = self.count * self.periods, 1
        self.drive = course.drive(0)
        self.times: list[float] = []
        self.sim: Sim | None = None
        self.failed = False

    def again(self) -> float:
        """Steps through the motion; the time this took [s]."""
        if self.failed:
            return 0.0
        try:
            times = [self._once()]
            while sum(times) < SHORT and len(times) < 20:
                times.append(self._once())
        except (ValueError, SimulationError):
            self.failed, self.times = True, []
            return 0.0
        self.times.append(float(np.median(times)))
        return sum(times)

    def _once(self) -> float:
        if self.sim is None:
            self.sim = self.course.sim(self.settings)
        sim, count, drive = self.sim, self.count, self.drive
        self.course.place(sim, 0)
        spent, first, own = 0.0, perf_counter(), thread_time()
        for period in range(self.periods):
            drive(sim, period)
            begin = perf_counter()
            sim.step(count)
            spent += perf_counter() - begin
        whole, own = perf_counter() - first, thread_time() - own
        return spent * min(1.0, own / whole) if OWN_CLOCK and whole > 0 else spent
