"""Snapshots of a run for looking at it later: whole states, at most 60 a second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stepcore.engine.world import World

# Snapshots per second of motion, the most of a run, and the most memory of a run [bytes].
RATE = 60.0
MOST = 6000
MEMORY = 2**28


@dataclass(frozen=True, repr=False)
class Snapshots:
    """States of a `Sim` during a run, each with the inputs of the step that follows it.

    A solve from such a state is the one that the run made, bit for bit, so contacts and forces
    need not be recorded to be seen later.

    model: what was run. states: as `Sim.state` gives them.
    """

    kind: type[World]
    model: Any
    states: tuple[bytes, ...]

    def sim(self) -> Any:
        """Another Sim, into which the states can be restored."""
        kind: Any = self.kind
        return kind(self.model)

    def __repr__(self) -> str:
        return f"<Snapshots: {len(self.states)} of {self.model!r}>"


class Taking:
    """Takes the snapshots of a run of `steps` steps."""

    def __init__(self, sim: Any, steps: int) -> None:
        self.sim = sim
        self.states: list[bytes] = []
        size: int = len(self.sim.state())
        most = max(2, min(MOST, MEMORY // size))
        self.steps = steps
        self.stride = max(1, round(1 / (RATE * sim.settings.dt)), -(-steps // most))

    def look(self, step: int) -> None:
        """Keep the present state at the first and last step and at every `stride` steps."""
        if step % self.stride == 0 or step == self.steps:
            self.states.append(self.sim.state())

    def kept(self) -> Snapshots:
        """The snapshots taken so far."""
        return Snapshots(type(self.sim), self.sim.model, tuple(self.states))
