"""Runs of one setting from several starts as worlds of batches: the bits of single runs, sooner.

One run is made alone, and timed; the others are worlds of batches as wide as the processor's vector
registers. The two times say what batches save. Where they save nothing, as where walkers touch the
floor at different times, the runs that follow are made singly again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from time import thread_time

import numpy as np

from stepcore._core import Settings
from stepcore.engine.batch import Batch, unwatched
from stepcore.executors import checkpoint
from stepcore.experiment.arguments import BatchSpeedup, Timed, Workers
from stepcore.experiment.recorder import Positions
from stepcore.experiment.run import Run
from stepcore.experiment.runner import Clock, Runner
from stepcore.report.progress import Progress

# Worlds of a batch: as many as a register holds numbers.
WIDTH = 8
# Fewer runs than this fill too little of a register.
LEAST = 5
# The speed-up that is expected of a batch before one was made; measured speed-ups decide later.
GAIN = 1.75


def can(runner: Runner) -> bool:
    """Whether runs can be worlds of a batch: no Python function controls them."""
    return runner.schedule.control is None


def helps(runs: int, threads: int, speedup: BatchSpeedup) -> bool:
    """Whether batches end sooner than single runs on this number of threads."""
    if runs < LEAST or not speedup.worth:
        return False
    batches = -(-runs // WIDTH)
    return -(-batches // threads) * min(runs, WIDTH) <= GAIN * -(-runs // threads)


def portions(starts: Sequence[int]) -> list[Sequence[int]]:
    """The starts of each batch."""
    return [starts[first : first + WIDTH] for first in range(0, len(starts), WIDTH)]


def timed(runner: Runner, settings: Settings, starts: Sequence[int]) -> Timed:
    """Runs of which positions are recorded, and their time: one alone, several as a batch."""
    begun = thread_time()
    if len(starts) == 1:
        runs = [runner.screen(settings, starts[0])]
    else:
        runs = batched(runner, settings, starts)
    return Timed(runs, thread_time() - begun)


def batched(runner: Runner, settings: Settings, starts: Sequence[int]) -> list[Run]:
    """`Runner.screen` from each of the starts, as the worlds of one batch; the same bits."""
    try:
        batch = BatchRun(runner, settings, starts)
    except ValueError:
        # Each run says itself what its settings are refused for.
        return [runner.screen(settings, start) for start in starts]
    return batch.runs()


class BatchRun:
    """Worlds that run from several starts, and the positions recorded of them.

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
        batch = Batch(runner.model, len(starts), settings, threads=1, on_failure=on_failure)
        self.batch = unwatched(batch)
        # Why worlds exploded; those that failed otherwise.
        self.exploded: dict[int, str] = {}
        self.failed: set[int] = set()
        self.probes = [Positions(runner.bodies) for _ in starts]
        self.place(range(len(starts)))

    def place(self, worlds: Sequence[int]) -> None:
        """Puts worlds at their starts."""
        for world in worlds:
            self.runner.schedule.starts[self.starts[world]].put(self.batch, world)

    def timed(self, clock: Clock) -> None:
        """Makes the runs once more from their starts, timed and not observed."""
        self.batch.reset()
        self.place(range(len(self.starts)))
        self.follow(clock.timing(partial(self.batch.step, progress=False)))

    def runs(self) -> list[Run]:
        """Makes the runs."""
        self.follow(self.step, self.sample)
        return [self.run(world) for world in range(len(self.starts))]

    def follow(self, step: Callable[[int], None], sample: Callable[[], bool] | None = None) -> None:
        """Steps the worlds through the motion, until `sample` says that all have ended."""
        schedule, batch = self.runner.schedule, self.batch
        periods, count = schedule.periods, schedule.steps(batch.settings.dt)
        if sample is None and not self.runner.model.nu:
            periods, count = 1, count * periods
        for period in range(periods):
            checkpoint()
            if schedule.ctrl is not None:
                batch.ctrl[:] = schedule.ctrl[list(self.starts), period]
            step(count)
            if sample is not None and (period + 1) % schedule.every == 0 and sample():
                break

    def sample(self) -> bool:
        """Records where the bodies are; True if all worlds have ended."""
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
        """Steps all worlds; one that explodes is ended, and stands at its start from then on."""
        explosion, batch = self.runner.explosion, self.batch
        if not explosion.watches:
            batch.step(count, progress=False)
            return
        dt = batch.settings.dt
        for _ in range(count):
            batch.step(1)
            for world in np.flatnonzero(explosion.beyond(batch.qvel, dt).any(axis=1)).tolist():
                if world not in self.exploded:
                    text = explosion.reason(batch.qvel[world], dt, batch.time)
                    self.exploded[world] = text or ""
                batch.reset(worlds=[world])
                self.place([world])

    def run(self, world: int) -> Run:
        """What was recorded of a world."""
        if world in self.failed:
            # A batch keeps no account of energies; alone the run says what its cause is.
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
    bar: Progress | str,
    until_fails: bool = False,
) -> list[Run]:
    """`Runner.screen` from each of the starts, in batches where those end sooner.

    until_fails: the first run that failed is the last; those that come after it need not be made.
    """
    if isinstance(bar, str):
        with workers.bar(bar, len(starts)) as drawn:
            return screened(runner, settings, starts, workers, drawn, until_fails)
    if not (can(runner) and helps(len(starts) - 1, workers.threads, workers.speedup)):
        job = partial(runner.screen, settings)
        if until_fails:
            return workers.until(lambda run: run.failure, job, starts, bar)
        return workers.each(job, starts, bar)
    jobs = [starts[:1], *portions(starts[1:])]
    made = workers.each(partial(timed, runner, settings), jobs, bar)
    bar.advance(len(starts) - len(jobs))
    workers.speedup.compare(made[0], made[1:])
    runs = [run for part in made for run in part.runs]
    ends = next((k for k, run in enumerate(runs) if until_fails and run.failure), len(runs))
    return runs[: ends + 1]
