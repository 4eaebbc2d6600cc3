"""`Runner`: a model and a schedule; it makes the runs of a measurement under different settings."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.executors import checkpoint
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.control import Control, ControlError, control_name, controls, fresh
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.explosion import Explosion
from stepcore.experiment.path import Path
from stepcore.experiment.probe import Probe
from stepcore.experiment.recorder import Positions, Recorder
from stepcore.experiment.schedule import Schedule

# So many control periods show whether a control function can be asked again.
REPEATED = 32


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
        self.explosion = Explosion(model, self.coordinates)

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

    def check_repeatable(self) -> None:
        """Makes the beginning of a run twice; ControlError if the controls are not the same.

        Then they depend on more than the motion, and no two runs can be compared.
        """
        function = self.schedule.control
        if function is None:
            return
        first, again = self._asked(fresh(function)), self._asked(fresh(function))
        if len(first) == len(again) and np.array_equal(first, again):
            return
        raise ControlError(
            f"{control_name(function)} returned other controls when the same run was made again: "
            "it is random, or remembers earlier calls. Runs with it cannot be compared; give a "
            "callable object that keeps its memory in its attributes, of which each run gets a copy"
        )

    def _asked(self, function: Control) -> np.ndarray:
        """The controls of the first periods of the first start."""
        sim, asked = Sim(self.model), []
        self.place(sim, 0)
        count = self.schedule.steps(sim.settings.dt)
        with contextlib.suppress(SimulationError):
            for period in range(min(REPEATED, self.schedule.periods)):
                self.control(sim, 0, period, function)
                asked.append(np.array(sim.ctrl))
                sim.step(count)
        return np.array(asked)

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
        function = None if schedule.control is None else fresh(schedule.control)
        self.place(sim, start)
        for probe in probes:
            probe.begin(sim)
        step = sim.step
        if clock is not None:
            step = clock.timing(step)
            if not self.model.nu:
                periods, count = 1, count * periods
        elif self.explosion.watches and isinstance(sim, Sim):
            step = self.explosion.guarded(sim)
        stride = min((n for probe in probes if (n := probe.stride(count))), default=count)
        for period in range(periods):
            checkpoint()
            self.control(sim, start, period, function)
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
        act = self.schedule.starts[start].act
        if act is not None:
            sim.act = act

    def control(self, sim: Any, start: int, period: int, function: Control | None) -> None:
        """Sets the controls of a Sim at the beginning of a period; function: of this run."""
        schedule = self.schedule
        if function is not None:
            sim.ctrl = controls(function, sim)
        elif schedule.ctrl is not None:
            sim.ctrl[:] = schedule.ctrl[start][period]
