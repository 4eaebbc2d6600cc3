"""Runs of one setting from several starts as worlds of batches: the bits of single runs, sooner.

One run is made alone, and timed; the others are worlds of batches as wide as the processor's vector
registers. Both times together say what batches save. Where they save nothing, as where walkers
touch the floor at different times, the runs that follow are made singly again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from time import thread_time

import numpy as np

from stepcore._core import Settings
from stepcore.engine.batch import Batch, unwatched
from stepcore.executors import checkpoint
from stepcore.experiment.path import Path
from stepcore.experiment.recorder import Positions
from stepcore.experiment.runner import Clock, Runner
from stepcore.experiment.saving import Saving, Timed
from stepcore.experiment.workers import Workers
from stepcore.report.progress import Progress

# Worlds of a batch: as many as a register holds numbers.
WIDTH = 8
# Fewer runs than this fill too little of a register.
LEAST = 5
# A batch takes about so many times less time than its worlds alone, if it is worth making at all.
GAIN = 1.75


def can(runner: Runner) -> bool:
    """Whether runs can be worlds of a batch: their controls are no function of Python's."""
    return runner.schedule.control is None


def helps(runs: int, threads: int, saving: Saving) -> bool:
    """Whether batches end sooner than single runs on so many threads."""
    if runs < LEAST or not saving.worth:
        return False
    batches = -(-runs // WIDTH)
    return -(-batches // threads) * min(runs, WIDTH) <= GAIN * -(-runs // threads)


def portions(starts: Sequence[int]) -> list[Sequence[int]]:
    """The starts of each batch."""
    return [starts[first : first + WIDTH] for first in range(0, len(starts), WIDTH)]


def timed(runner: Runner, settings: Settings, starts: Sequence[int]) -> Timed:
    """Runs of which positions are recorded: one alone, several as a batch."""
    begun = thread_time()
    if len(starts) == 1:
        paths = [runner.screen(settings, starts[0])]
    else:
        paths = batched(runner, settings, starts)
    return Timed(paths, thread_time() - begun)


def batched(runner: Runner, settings: Settings, starts: Sequence[int]) -> list[Path]:
    """`Runner.screen` from each of the starts, as the worlds of one batch; the same bits."""
    try:
        run = BatchRun(runner, settings, starts)
    except ValueError:
        # What a setting is refused for, each run says itself.
        return [runner.screen(settings, start) for start in starts]
    return run.paths()


class BatchRun:
    """Worlds from several starts, and what was recorded of them.

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
        # Those that exploded, and why; those that failed otherwise.
        self.ended: dict[int, str] = {}
        self.failed: set[int] = set()
        self.looks = [Positions(runner.bodies) for _ in starts]
        self.place(range(len(starts)))

    def place(self, worlds: Sequence[int]) -> None:
        """Puts worlds at their starts."""
        for world in worlds:
            start = self.runner.schedule.starts[self.starts[world]]
            self.batch.qpos[world], self.batch.qvel[world] = start.qpos, start.qvel
            if start.act is not None:
                self.batch.act[world] = start.act

    def timed(self, clock: Clock) -> None:
        """Makes the runs once more from their starts, timed and not looked at."""
        self.batch.reset()
        self.place(range(len(self.starts)))
        self.follow(clock.timing(partial(self.batch.step, progress=False)))

    def paths(self) -> list[Path]:
        """Makes the runs."""
        self.follow(self.step, self.look)
        return [self.path(world) for world in range(len(self.starts))]

    def follow(self, step: Callable[[int], None], look: Callable[[], bool] | None = None) -> None:
        """Steps the worlds through the motion; looks at the samples whether all have ended."""
        schedule, batch = self.runner.schedule, self.batch
        periods, count = schedule.periods, schedule.steps(batch.settings.dt)
        if look is None and not self.runner.model.nu:
            periods, count = 1, count * periods
        for period in range(periods):
            checkpoint()
            if schedule.ctrl is not None:
                batch.ctrl[:] = schedule.ctrl[list(self.starts), period]
            step(count)
            if look is not None and (period + 1) % schedule.every == 0 and look():
                break

    def look(self) -> bool:
        """Notes where the bodies are, unless all worlds have ended."""
        batch, moving = self.batch, self.runner.bodies.moving
        self.failed = set(batch.failures) - set(self.ended)
        if len(self.ended) + len(self.failed) == len(self.starts):
            return True
        xpos, xquat = batch.xpos[:, moving], batch.xquat[:, moving]
        for world, look in enumerate(self.looks):
            look.xpos.append(xpos[world])
            look.xquat.append(xquat[world])
        return False

    def step(self, count: int) -> None:
        """Steps all worlds; what explodes is ended, and stands at its start from then on."""
        explosion, batch = self.runner.explosion, self.batch
        if not explosion.watches:
            batch.step(count, progress=False)
            return
        dt = batch.settings.dt
        for _ in range(count):
            batch.step(1)
            for world in np.flatnonzero(explosion.beyond(batch.qvel, dt).any(axis=1)).tolist():
                if world not in self.ended:
                    text = explosion.reason(batch.qvel[world], dt, batch.time)
                    self.ended[world] = text or ""
                batch.reset(worlds=[world])
                self.place([world])

    def path(self, world: int) -> Path:
        """What was recorded of a world."""
        if world in self.failed:
            # A batch keeps no account of energies; alone the run says what its cause is.
            return self.runner.screen(self.batch.settings, self.starts[world])
        path = Path()
        if world in self.ended:
            path.failure = self.ended[world]
            return path
        self.looks[world].place(path)
        if not np.all(np.isfinite(path.com)):
            path.failure = "positions overflow"
        return path


def screened(
    runner: Runner,
    settings: Settings,
    starts: Sequence[int],
    workers: Workers,
    bar: Progress | str,
    until_fails: bool = False,
) -> list[Path]:
    """`Runner.screen` from each of the starts, in batches where those end sooner.

    until_fails: the first path that failed is the last; runs that come after it need not be made.
    """
    if isinstance(bar, str):
        with workers.bar(bar, len(starts)) as own:
            return screened(runner, settings, starts, workers, own, until_fails)
    if not (can(runner) and helps(len(starts) - 1, workers.threads, workers.saving)):
        job = partial(runner.screen, settings)
        if until_fails:
            return workers.until(lambda path: path.failure, job, starts, bar)
        return workers.each(job, starts, bar)
    paths = _made(runner, settings, [starts[:1], *portions(starts[1:])], workers, bar)
    ends = next((k for k, path in enumerate(paths) if until_fails and path.failure), len(paths))
    return paths[: ends + 1]


def _made(
    runner: Runner,
    settings: Settings,
    jobs: Sequence[Sequence[int]],
    workers: Workers,
    bar: Progress,
) -> list[Path]:
    """The first job is one run; the others are batches."""
    made = workers.each(partial(timed, runner, settings), jobs, bar)
    bar.advance(sum(map(len, jobs)) - len(jobs))
    workers.saving.compare(made[0], made[1:])
    return [path for some in made for path in some.paths]
