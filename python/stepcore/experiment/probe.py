"""`Probe`: observes a run while it goes on."""

from __future__ import annotations

from typing import Any

from stepcore.experiment.path import Path


class Probe:
    """Observes a run at the times at which `Runner.follow` calls it; a subclass overrides some
    methods.

    sim: the `Sim` that runs, or another engine's world that has its step, qpos and qvel.
    """

    def stride(self, steps: int) -> int | None:
        """Steps between two calls of `step`, out of `steps` in a period; None if it need not be
        called.

        If several probes run together, all are called at the shortest of their strides.
        """
        return None

    def begin(self, sim: Any) -> None:
        """The run is at its start."""

    def period(self, sim: Any, period: int) -> None:
        """A control period begins: its controls are set."""

    def step(self, sim: Any) -> None:
        """Some steps were made."""

    def sample(self, sim: Any) -> None:
        """A sample of the schedule is reached."""

    def end(self, sim: Any, path: Path) -> None:
        """The run has ended without a failure: the probe writes what it recorded into its path."""
