"""Runs from several starts under one setting, as worlds of batches: bit-identical, and faster.

One run is made alone and timed. The other runs are worlds of batches that are as wide as the
processor's vector registers. The two times give the speed-up. If batches save no time (for example
because walkers touch the floor at different times), later runs are made singly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from time import thread_time
from typing import TypeVar

import numpy as np

from stepcore._core import Settings
from stepcore.engine.batch import Batch, unwatched
from stepcore.executors import checkpoint
from stepcore.experiment.arguments import Bar, BatchSpeedup, Timed, Workers
from stepcore.experiment.recorder import Positions
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Clock, Runner, stretches
from stepcore.report.progress import Progress

T = TypeVar("T")
# Worlds per batch: the numbers in a vector register.
WIDTH = 8
# The smallest number of runs that fills enough of a register.
LEAST = 5
# The expected speed-up of a batch before the first measurement of it.
GAIN = 1.75


def can(runner: Runner) -> bool:
    """Return whether runs can be batched: not if the user's own function controls them."""
    return runner.schedule.control is None


def helps(runs: int, threads: int, speedup: BatchSpeedup) -> bool:
    """Return whether batches are expected to end sooner than single runs.

    runs: the number of runs. threads: the number of threads. speedup: as measured so far.
    """
    if runs < LEAST or not speedup.worth:
        return False
    batches = -(-runs // WIDTH)
    return -(-batches // threads) * min(runs, WIDTH) <= GAIN * -(-runs // threads)


def portions(starts: Sequence[int]) -> list[Sequence[int]]:
    """Split the starts into batches."""
    return [starts[first : first + WIDTH] for first in range(0, len(starts), WIDTH)]


def timed(runner: Runner, settings: Settings, starts: Sequence[int]) -> Timed:
    """Make and time runs that record positions: a single run, or several as one batch."""
    begun = thread_time()
    if len(starts) == 1:
        runs = [runner.screen(settings, starts[0])]
    else:
        runs = batched(runner, settings, starts)
    return Timed(runs, thread_time() - begun)


def batched(runner: Runner, settings: Settings, starts: Sequence[int]) -> list[Run]:
    """Make the runs of `Runner.screen` as the worlds of one batch, with bit-identical results."""
    try:
        batch = BatchRun(runner, settings, starts)
    except ValueError:
        # A single run gives the reason why its settings are refused.
        return [runner.screen(settings, start) for start in starts]
    return batch.runs()


class BatchRun:
    """A batch whose worlds run from several starts, with the recorded positions of each.

    runner: the model and the schedule. settings: of all worlds. starts: the start of each world.
    on_failure: see `Batch`.
    """

    def __init__(
        self,
        runner: Runner,
        settings: Settings,
        starts: Sequence[int],
        on_failure: str = "go on",
    ) -> None:
        self.runner, self.starts = runner, starts
        model = runner.schedule.on(runner.model)
        batch = Batch(model, len(starts), settings, threads=1, on_failure=on_failure)
        self.batch = unwatched(batch)
        # The reasons of worlds that exploded; the worlds that failed otherwise.
        self.exploded: dict[int, str] = {}
        self.failed: set[int] = set()
        self.probes = [Positions(runner.bodies) for _ in starts]
        self.place(range(len(starts)))

    def place(self, worlds: Sequence[int]) -> None:
        """Set worlds to their starts."""
        for world in worlds:
            self.runner.schedule.starts[self.starts[world]].put(self.batch, world)

    def timed(self, clock: Clock) -> None:
        """Repeat the runs from their starts, timed and without records."""
        self.batch.reset()
        self.place(range(len(self.starts)))
        self.follow(clock.timing(partial(self.batch.step, progress=False)))

    def runs(self) -> list[Run]:
        """Make the runs and return them."""
        self.follow(self.step, self.sample)
        return [self.run(world) for world in range(len(self.starts))]

    def follow(self, step: Callable[[int], None], sample: Callable[[], bool] | None = None) -> None:
        """Step the worlds through the motion, until `sample` returns True."""
        schedule, batch = self.runner.schedule, self.batch
        periods, count = schedule.periods, schedule.steps(batch.settings.dt)
        if sample is None and not self.runner.model.nu:
            periods, count = 1, count * periods
        for period in range(periods):
            checkpoint()
            done = 0
            if schedule.ctrl is not None:
                batch.ctrl[:] = schedule.ctrl[list(self.starts), period]
            for end, row in stretches(
                schedule, list(self.starts), period * count, batch.settings.dt, count
            ):
                if row is not None:
                    batch.ctrl[:] = row
                step(end - done)
                done = end
            if sample is not None and (period + 1) % schedule.every == 0 and sample():
                break

    def sample(self) -> bool:
        """Record the poses of the bodies; return True if all worlds have ended."""
        batch, moving = self.batch, self.runner.bodies.moving
        self.failed = set(batch.failures) - set(self.exploded)
        if len(self.exploded) + len(self.failed) == len(self.starts):
            return True
        xpos, xquat = batch.xpos[:, moving], batch.xquat[:, moving]
        for world, probe in enumerate(self.probes):
            probe.xpos.append(xpos[world])
            probe.xquat.append(xquat[world])
        return False

    def step(self, count: int) -> None:
        """Make `count` steps in all worlds; a world that explodes stays at its start afterwards."""
        explosion, batch = self.runner.explosion, self.batch
        if not explosion.watches:
            batch.step(count, progress=False)
            return
        dt = batch.settings.dt
        for _ in range(count):
            batch.step(1, progress=False)
            for world in np.flatnonzero(explosion.beyond(batch.qvel, dt).any(axis=1)).tolist():
                if world not in self.exploded:
                    text = explosion.reason(batch.qvel[world], dt, batch.time)
                    self.exploded[world] = text or ""
                batch.reset(worlds=[world])
                self.place([world])

    def run(self, world: int) -> Run:
        """Return the run of a world."""
        if world in self.failed:
            # A batch has no energy ledger; a single run explains the failure.
            return self.runner.screen(self.batch.settings, self.starts[world])
        run = Run(failure=self.exploded.get(world))
        if run.failure is None:
            self.probes[world].place(run)
            run.refuse_overflow()
        return run


def screened(
    runner: Runner,
    settings: Settings,
    starts: Sequence[int],
    workers: Workers,
    bar: Bar,
    until_fails: bool = False,
    made: list[Run] | None = None,
) -> list[Run]:
    """Make the runs of `Runner.screen` from several starts, in batches where these are faster.

    until_fails: whether the result ends with the first failed run; later runs may be skipped.
    made: is filled with the runs, for a caller that catches OutOfTime: then with the first ones.
    """
    made = [] if made is None else made
    if not isinstance(bar, Progress):
        with workers.bar(bar, len(starts)) as drawn:
            return screened(runner, settings, starts, workers, drawn, until_fails, made)
    if not (can(runner) and helps(len(starts) - 1, workers.threads, workers.speedup)):
        job = partial(runner.screen, settings)
        if until_fails:
            made += workers.until(lambda run: run.failure, job, starts, bar)
            return made
        singly: list[Run | None] = []
        try:
            workers.each(job, starts, bar, singly)
        finally:
            made += _first(singly)
        return made
    jobs, parts = [starts[:1], *portions(starts[1:])], list[Timed | None]()
    try:
        workers.each(partial(timed, runner, settings), jobs, bar, parts)
    finally:
        whole = _first(parts)
        made += [run for part in whole for run in part.runs]
    bar.advance(len(starts) - len(jobs))
    workers.speedup.compare(whole[0], whole[1:])
    ends = next((k for k, run in enumerate(made) if until_fails and run.failure), len(made))
    return made[: ends + 1]


def _first(results: Sequence[T | None]) -> list[T]:
    """Return the results before the first that is missing."""
    first: list[T] = []
    for result in results:
        if result is None:
            break
        first.append(result)
    return first
