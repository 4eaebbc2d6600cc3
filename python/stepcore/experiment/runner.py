"""`Runner`: a model and a schedule; it makes the runs of a measurement under different settings."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.control import Control, ControlError, control_name, controls, fresh
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.executors import checkpoint
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.failure import Explosion
from stepcore.experiment.recorder import Means, Positions, Recorder
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.schedule import Schedule

# This many control periods show whether a control function answers the same when asked again.
REPEATED = 32


def recorded(runner: Runner) -> Sequence[Probe]:
    """The probes of a run of which everything is recorded."""
    return [Recorder(runner.bodies, runner.schedule)]


def positions(runner: Runner) -> Sequence[Probe]:
    """The probes of a run of which positions are recorded: enough for errors, and much faster."""
    return [Positions(runner.bodies)]


def means(runner: Runner) -> Sequence[Probe]:
    """The probes of a run of which heights, energies and contacts are recorded."""
    return [Means(runner.bodies)]


class Clock(Protocol):
    """Times the steps of a run."""

    def timing(self, step: Callable[[int], None]) -> Callable[[int], None]:
        """The same step, timed."""


class Runner:
    """A model and a schedule: what all runs of a measurement share, in any process.

    A subclass that overrides `sim`, `place` and `control` runs the schedule with another engine.
    """

    def __init__(self, model: Model, schedule: Schedule) -> None:
        self.model, self.schedule = model, schedule
        self.coordinates = Coordinates(model)
        self.bodies = Bodies(model, self.coordinates)
        self.explosion = Explosion(model, self.coordinates)

    def __reduce__(self) -> tuple[Any, ...]:
        # What is looked up by identity is made anew in another process.
        return type(self), (self.model, self.schedule)

    @property
    def starts(self) -> range:
        """The indices of the schedule's starts."""
        return range(len(self.schedule.starts))

    def run(self, settings: Any, start: int, probes: Sequence[Probe] | None = None) -> Run:
        """The motion from one start; a failure ends it and says why.

        Raises ControlError for a control function that no settings can run.

        settings: of `sim`. probes: they observe the run and fill it; by default a `Recorder`.
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
        """The motion from one start, observed by probes of its own."""
        return self.run(settings, start, probes(self))

    def screen(self, settings: Any, start: int) -> Run:
        """A run of which positions alone are recorded."""
        return self.run(settings, start, positions(self))

    def runs(self, settings: Settings) -> list[Run]:
        """The motion from every start, until one fails."""
        runs: list[Run] = []
        while len(runs) < len(self.starts) and not (runs and runs[-1].failure):
            runs.append(self.run(settings, len(runs)))
        return runs

    def check_repeatable(self) -> None:
        """Makes the beginning of a run twice; ControlError if the controls are not the same.

        They then depend on more than the motion, and no two runs can be compared.
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
            raise ControlError(
                f"{control_name(function)} returned other controls when the same run was made "
                "again: it is random, or remembers earlier calls. Runs with it cannot be compared; "
                "give a callable object that keeps its memory in its attributes, of which each run "
                "gets a copy"
            )

    def follow(
        self,
        sim: Any,
        start: int,
        probes: Sequence[Probe] = (),
        clock: Clock | None = None,
        steps: int | None = None,
    ) -> None:
        """Steps a Sim through the motion from one start: the loop over control periods.

        clock: times the steps. Where there are no controls, all are then made in one call. steps:
        see `Schedule.blocks`.

        `stepcore.experiment.batched_runs.BatchRun.follow` is the same loop for the worlds of a
        batch.
        """
        schedule = self.schedule
        blocks: Iterable[tuple[int, int]] = schedule.blocks(sim.settings.dt, steps)
        function = None if schedule.control is None else fresh(schedule.control)
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
        for period, count in blocks:
            checkpoint()
            self.control(sim, start, period, function)
            for probe in probes:
                probe.period(sim, period)
            done = 0
            while done < count:
                stop = min((n for probe in probes if (n := probe.stop(done, count))), default=count)
                step(stop - done)
                done = stop
                for probe in probes:
                    probe.step(sim)
            if (period + 1) % schedule.every == 0:
                for probe in probes:
                    probe.sample(sim)

    def sim(self, settings: Settings) -> Any:
        """A Sim of the model under these settings."""
        return unwatched(Sim(self.model, settings))

    def place(self, sim: Any, start: int) -> None:
        """Puts a Sim at a start of the schedule, at time 0, nothing warm."""
        sim.reset()
        self.schedule.starts[start].put(sim)

    def control(self, sim: Any, start: int, period: int, function: Control | None) -> None:
        """Sets the controls of a Sim at the beginning of a period; function: of this run."""
        schedule = self.schedule
        if function is not None:
            sim.ctrl = controls(function, sim)
        elif schedule.ctrl is not None:
            sim.ctrl[:] = schedule.ctrl[start][period]


# Makes the probes of a run.
Probes = Callable[[Runner], Sequence[Probe]]


class _Controls(Probe):
    """The controls of each period."""

    def __init__(self) -> None:
        self.ctrl: list[np.ndarray] = []

    def period(self, sim: Sim, period: int) -> None:
        self.ctrl.append(np.array(sim.ctrl))
