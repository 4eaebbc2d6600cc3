"""`Runner`: makes the runs of one model and schedule under different settings."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.control import Control, ControlError, controls
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.executors import checkpoint
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.failure import Explosion
from stepcore.experiment.recorder import Means, Positions, Recorder
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.schedule import Schedule

# The number of control periods in the test whether a control function is repeatable.
REPEATED = 32


def recorded(runner: Runner) -> Sequence[Probe]:
    """Return the probes that record everything."""
    return [Recorder(runner.bodies, runner.schedule)]


def positions(runner: Runner) -> Sequence[Probe]:
    """Return the probes that record positions alone: sufficient for errors, and much faster."""
    return [Positions(runner.bodies)]


def means(runner: Runner) -> Sequence[Probe]:
    """Return the probes that record heights, energies and contacts."""
    return [Means(runner.bodies)]


class Clock(Protocol):
    """An object that times the steps of a run."""

    def timing(self, step: Callable[[int], None]) -> Callable[[int], None]:
        """Return the step function with timing."""


class Runner:
    """A model and a schedule, which all runs of a measurement share, in any process.

    A subclass that overrides `sim`, `place` and `control` runs the schedule with another engine.

    coordinates: the coordinates of the model. bodies: the moving bodies. explosion: the test for
    diverging runs.
    """

    def __init__(self, model: Model, schedule: Schedule) -> None:
        self.model, self.schedule = model, schedule
        self.coordinates = Coordinates(model)
        self.bodies = Bodies(model, self.coordinates)
        self.explosion = Explosion(model, self.coordinates)

    def __reduce__(self) -> tuple[Any, ...]:
        # Tables keyed by object identity must be rebuilt in another process.
        return type(self), (self.model, self.schedule)

    @property
    def starts(self) -> range:
        """Indices of the schedule's starts."""
        return range(len(self.schedule.starts))

    def run(self, settings: Any, start: int, probes: Sequence[Probe] | None = None) -> Run:
        """Run the motion from one start; a run that fails ends early, with the reason.

        settings: the argument of `sim`. start: the index of the start. probes: observe the run and
        fill the result; by default a `Recorder`.

        Raises ControlError for a control function that fails under any settings.
        """
        run = Run()
        probes = recorded(self) if probes is None else probes
        try:
            sim = self.sim(settings)
            self.follow(sim, start, probes)
        except ControlError:
            raise
        except (ValueError, SimulationError) as error:
            run.failure = one_line(error)
            return run
        for probe in probes:
            probe.end(sim, run)
        run.refuse_overflow()
        return run

    def observed(self, settings: Any, probes: Probes, start: int) -> Run:
        """Run the motion from one start, with new probes for this run."""
        return self.run(settings, start, probes(self))

    def screen(self, settings: Any, start: int) -> Run:
        """Run the motion from one start, and record positions alone."""
        return self.run(settings, start, positions(self))

    def runs(self, settings: Settings) -> list[Run]:
        """Run the motion from every start, until one run fails."""
        runs: list[Run] = []
        while len(runs) < len(self.starts) and not (runs and runs[-1].failure):
            runs.append(self.run(settings, len(runs)))
        return runs

    def check_repeatable(self) -> None:
        """Raise ControlError if the control function is not repeatable.

        The beginning of a run is made twice. If the controls differ, they depend on more than the
        motion, and runs cannot be compared.
        """
        function = self.schedule.control
        if function is None:
            return
        periods = min(REPEATED, self.schedule.periods)
        beginning = Runner(self.model, dataclasses.replace(self.schedule, periods=periods))
        first, again = _Controls(), _Controls()
        for probe in (first, again):
            with contextlib.suppress(SimulationError):
                beginning.follow(self.sim(self.model.settings), 0, [probe])
        if not np.array_equal(first.ctrl, again.ctrl):
            raise ControlError.not_repeatable(function, "the same run was made again")

    def follow(
        self,
        sim: Any,
        start: int,
        probes: Sequence[Probe] = (),
        clock: Clock | None = None,
        steps: int | None = None,
    ) -> None:
        """Step a Sim through the motion from one start, in a loop over control periods.

        start: the index of the start. probes: observe the run.
        clock: times the steps. A model without controls then makes all steps in one call.
        steps: the number of steps; see `blocks_of`.

        `stepcore.experiment.batched_runs.BatchRun.follow` is the same loop for a batch.
        """
        schedule = self.schedule
        blocks: Iterable[tuple[int, int]] = blocks_of(schedule, sim.settings.dt, steps)
        function = schedule.function()
        self.place(sim, start)
        for probe in probes:
            probe.begin(sim)
        step = sim.step
        if clock is not None:
            step = clock.timing(step)
            if not self.model.nu:
                blocks = [(0, sum(count for _, count in blocks))]
        elif self.explosion.watches and isinstance(sim, Sim):
            step = self.explosion.guarded(sim)
        made = 0
        for period, count in blocks:
            checkpoint()
            self.control(sim, start, period, function)
            for probe in probes:
                probe.period(sim, period)
            done = 0
            for end, row in stretches(schedule, start, made, sim.settings.dt, count):
                if row is not None:
                    sim.ctrl[:] = row
                while done < end:
                    stops = (n for probe in probes if (n := probe.stop(done, count)))
                    stop = min(stops, default=end)
                    step(min(stop, end) - done)
                    done = min(stop, end)
                    for probe in probes:
                        probe.step(sim)
            made += count
            if (period + 1) % schedule.every == 0:
                for probe in probes:
                    probe.sample(sim)

    def sim(self, settings: Settings) -> Any:
        """Return a Sim of the model under some settings."""
        return unwatched(Sim(self.schedule.on(self.model), settings))

    def place(self, sim: Any, start: int) -> None:
        """Reset a Sim (time 0, no warm start), and set it to a start of the schedule."""
        sim.reset()
        self.schedule.starts[start].put(sim)

    def control(self, sim: Any, start: int, period: int, function: Control | None) -> None:
        """Set the controls of a Sim at the beginning of a period.

        start, period: indices. function: this run's copy of the control function, or None.
        """
        schedule = self.schedule
        if function is not None:
            sim.ctrl = controls(function, sim)
        elif schedule.ctrl is not None:
            sim.ctrl[:] = schedule.ctrl[start][period]


def blocks_of(schedule: Schedule, dt: float, count: int | None = None) -> Iterator[tuple[int, int]]:
    """Yield the index of each control period and the number of time steps that begin in it.

    dt: time step [s].
    count: the total number of time steps, if dt does not divide the period; the last controls
        then stay constant to the end.
    """
    if count is None:
        yield from ((period, schedule.steps(dt)) for period in range(schedule.periods))
        return
    if schedule.control is None and not schedule.controls.nu:
        yield 0, count
        return
    steps, period, done = schedule.period / dt, 0, 0
    while done < count:
        end = min(math.ceil((period + 1) * steps - 1e-9), count)
        if end > done:
            yield min(period, schedule.periods - 1), end - done
        done, period = end, period + 1


def stretches(
    schedule: Schedule, starts: int | Sequence[int], made: int, dt: float, count: int
) -> Iterator[tuple[int, np.ndarray | None]]:
    """Yield the end of each stretch of equal controls in some time steps, and these controls.

    The controls are None if nothing changes them within a period.

    starts: the index of a start, or of several, whose controls have the shape (starts, nu).
    made: the number of time steps before these. dt: time step [s]. count: the number of steps.
    """
    log = schedule.log
    if log is None:
        yield count, None
        return
    rows = log.steps(made * dt, dt, count)
    rows = rows if rows.ndim == 2 else np.moveaxis(rows[starts], -2, 0)
    first = changes(rows)
    yield from ((end, rows[end - 1]) for end in (*first[1:], count))


def changes(rows: np.ndarray) -> list[int]:
    """Return the indices of the steps at which the controls change, the first step included.

    >>> changes(np.array([[1.0], [1.0], [2.0]]))
    [0, 2]
    """
    rows = rows.reshape(len(rows), -1)
    return [0, *(1 + np.flatnonzero(np.any(rows[1:] != rows[:-1], axis=1))).tolist()]


# A function that makes the probes of a run.
Probes = Callable[[Runner], Sequence[Probe]]


class _Controls(Probe):
    """A probe that records the controls of each period."""

    def __init__(self) -> None:
        self.ctrl: list[np.ndarray] = []

    def period(self, sim: Sim, period: int) -> None:
        self.ctrl.append(np.array(sim.ctrl))
