"""`Pace`: what a step of a run costs, without what looks at the run between its steps."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.experiment.run import Probe

# From so many states along a run, so many steps are timed, so often; the quickest counts, as
# whatever else the machine does only adds.
STATES, STEPS, TIMES = 20, 4, 3


class Pace(Probe):
    """Keeps states along a run, from which some steps are timed once the run is over.

    A step that follows a look at the run finds its numbers gone from the processor's caches, and
    takes several times as long as those of a run that nobody looks at.

    looks: how often a run is looked at.
    """

    def __init__(self, looks: int) -> None:
        self.every = max(1, looks // STATES)
        self.looks = 0
        self.states: list[bytes] = []

    def begin(self, sim: Any) -> None:
        self.states.append(sim.state())

    def step(self, sim: Any) -> None:
        self.looks += 1
        if self.looks % self.every == 0:
            self.states.append(sim.state())

    def seconds(self, sim: Any) -> float:
        """Computing time of a step [s], in the mean of the states; 0 where none can be stepped.

        sim: a Sim of the run's model and settings, whose state is lost.
        """
        times = [timed for state in self.states if (timed := _timed(sim, state)) is not None]
        return float(np.mean(times)) if times else 0.0


def _timed(sim: Any, state: bytes) -> float | None:
    """The time of a step from a state; None where it fails."""
    best = np.inf
    for _ in range(TIMES):
        sim.restore(state)
        try:
            sim.step()
            begin = perf_counter()
            sim.step(STEPS)
        except SimulationError:
            return None
        best = min(best, perf_counter() - begin)
    return best / STEPS
