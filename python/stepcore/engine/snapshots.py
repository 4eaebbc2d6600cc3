"""Snapshots of a run for later drawing: complete states, at most 60 a second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stepcore.engine.world import World

# Snapshots per second of motion.
RATE = 60.0


@dataclass(frozen=True, repr=False)
class Snapshots:
    """States of a `Sim` during a run, each with the inputs of the following step.

    A solve from such a state is bit-identical to the solve in the run, so contacts and forces can
    be computed later and need not be recorded.

    model: the simulated model. states: snapshots by `Sim.state`.
    """

    kind: type[World]
    model: Any
    states: tuple[bytes, ...]

    def sim(self) -> Any:
        """Create a Sim into which the states can be restored."""
        kind: Any = self.kind
        return kind(self.model)

    def __repr__(self) -> str:
        return f"<Snapshots: {len(self.states)} of {self.model!r}>"


class Taking:
    """A recorder of snapshots during a run of `steps` steps."""

    def __init__(self, sim: Any, steps: int) -> None:
        self.sim = sim
        self.states: list[bytes] = []
        size: int = len(self.sim.state())
        # At most 6000 snapshots and 256 MiB a run.
        most = max(2, min(6000, 2**28 // size))
        self.steps = steps
        self.stride = max(1, round(1 / (RATE * sim.settings.dt)), -(-steps // most))

    def look(self, step: int) -> None:
        """Store the present state at the first and last step and at every `stride` steps."""
        if step % self.stride == 0 or step == self.steps:
            self.states.append(bytes(self.sim.state()))

    def kept(self) -> Snapshots:
        """Return the snapshots."""
        return Snapshots(type(self.sim), self.sim.model, tuple(self.states))
