"""`Runner`: a model and a schedule; it makes the runs of a measurement under different settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.executors import checkpoint
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.control import ControlError, controls
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.path import Path
from stepcore.experiment.probe import Probe
from stepcore.experiment.recorder import Positions, Recorder
from stepcore.experiment.schedule import Schedule


class Clock(Protocol):
    """Times the steps of a run."""

    def timing(self, step: Callable[[int], None]) -> Callable[[int], None]:
        """The same step, timed."""


class Runner:
    """A model and a schedule: everything that runs under different settings share."""

    def __init__(self, model: Model, schedule: Schedule) -> None:
        self.model, self.schedule = model, schedule
        self.coordinates = Coordinates(model)
        self.bodies = Bodies(model, self.coordinates)

    def __reduce__(self) -> tuple[Any, ...]:
        # What is looked up by identity is made anew in another process.
        return type(self), (self.model, self.schedule)

    def run(self, settings: Any, start: int, probes: Sequence[Probe] | None = None) -> Path:
        """The motion from one start; a failure ends it and says why.

        Raises ControlError for a control function that no settings can run.

        settings: of `sim`. probes: they observe the run and fill the path; by default a `Recorder`.
        """
        path = Path()
        if probes is None:
            probes = [Recorder(self.bodies, self.schedule)]
        try:
            sim = self.sim(settings)
            self.follow(sim, start, probes)
        except ControlError:
            raise
        except (ValueError, SimulationError) as error:
            path.failure = one_line(error)
            return path
        for probe in probes:
            probe.end(sim, path)
        if not np.all(np.isfinite(path.com)):
            path.failure = "positions overflow"
        return path

    def screen(self, settings: Any, start: int) -> Path:
        """The same of which only positions are recorded: enough for errors, and much faster."""
        return self.run(settings, start, [Positions(self.bodies)])

    def runs(self, settings: Settings) -> list[Path]:
        """The motion from every start, until one fails."""
        paths: list[Path] = []
        while len(paths) < len(self.schedule.starts) and not (paths and paths[-1].failure):
            paths.append(self.run(settings, len(paths)))
        return paths

    def follow(
        self, sim: Any, start: int, probes: Sequence[Probe] = (), clock: Clock | None = None
    ) -> None:
        """Steps a Sim through the motion from one start; the one loop over control periods.

        clock: times the steps. Where there are no controls, all are then made in one call.
        """
        schedule = self.schedule
        periods, count = schedule.periods, schedule.steps(sim.settings.dt)
        self.place(sim, start)
        for probe in probes:
            probe.begin(sim)
        step = sim.step
        if clock is not None:
            step = clock.timing(step)
            if not self.model.nu:
                periods, count = 1, count * periods
        stride = min((n for probe in probes if (n := probe.stride(count))), default=count)
        for period in range(periods):
            checkpoint()
            self.control(sim, start, period)
            for probe in probes:
                probe.period(sim, period)
            for first in range(0, count, stride):
                step(min(stride, count - first))
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
        sim.qpos = self.schedule.starts[start].qpos
        sim.qvel = self.schedule.starts[start].qvel

    def control(self, sim: Any, start: int, period: int) -> None:
        """Sets the controls of a Sim at the beginning of a period."""
        schedule = self.schedule
        if schedule.control is not None:
            sim.ctrl = controls(schedule.control, sim)
        elif schedule.ctrl is not None:
            sim.ctrl[:] = schedule.ctrl[start][period]
