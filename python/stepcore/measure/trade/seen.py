"""Runs of a trade made again, to be looked at."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.snapshots import RATE, Snapshots
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.run import Probe
from stepcore.experiment.runner import Runner


class _States(Probe):
    """Keeps whole states of a run, with the inputs of the step that follows each."""

    def __init__(self, dt: float) -> None:
        self.apart = max(1, round(1 / (RATE * dt)))
        self.least = 1 / RATE - 0.5 * dt
        self.times: list[float] = []
        self.states: list[bytes] = []

    def stride(self, steps: int) -> int:
        return min(steps, self.apart)

    def begin(self, sim: Any) -> None:
        self._keep(sim)

    def period(self, sim: Any, period: int) -> None:
        self._keep(sim)

    def step(self, sim: Any) -> None:
        self._keep(sim)

    def _keep(self, sim: Any) -> None:
        if self.times and sim.time == self.times[-1]:
            # The same instant, now with its controls.
            self.states[-1] = sim.state()
        elif not self.times or sim.time - self.times[-1] >= self.least:
            self.times.append(sim.time)
            self.states.append(sim.state())


def seen_runs(runner: Runner | None, settings: Sequence[Settings], start: int) -> list[Trajectory]:
    """The motion from one start under each of these settings; what fails ends where it failed."""
    if runner is None:
        raise ValueError("this trade does not hold its runs, so that they cannot be made again")
    return [_seen(runner, each, start) for each in settings]


def _seen(runner: Runner, settings: Settings, start: int) -> Trajectory:
    sim, states = runner.sim(settings), _States(settings.dt)
    with contextlib.suppress(SimulationError):
        runner.follow(sim, start, [states])
    kept = Snapshots(type(sim), sim.model, tuple(states.states))
    return Trajectory(np.array(states.times), snapshots=kept)
