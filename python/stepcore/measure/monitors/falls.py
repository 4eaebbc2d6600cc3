"""Robots with servos that fall over: nothing balances them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stepcore.engine.actuator import SERVO, actuators
from stepcore.engine.model import Model
from stepcore.experiment.moves import Upright, moves_about, roots
from stepcore.measure.monitors.finding import Finding, named
from stepcore.report.units import seconds


class FallMonitor:
    """Records when a robot on a free base falls in one run.

    Robots without servos are not watched: motors at zero hold nothing, and walkers that learn fall
    by design.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.drives = model, actuators(model)
        self.upright: Upright | None = None
        self.begun = 0.0
        self.fell: tuple[int, float] | None = None

    def begin(self, sim: Any) -> None:
        """Record how the robot stands."""
        if any(drive.kind == SERVO for drive in self.drives):
            sim.forward()
            about = moves_about(self.model, self.drives)
            bodies = roots(self.model, self.drives) if about else set()
            self.upright, self.begun = Upright(sim, bodies), sim.time

    def look(self, sim: Any) -> None:
        """Record the first time at which the robot has fallen."""
        if self.upright is None or self.fell is not None:
            return
        body = self.upright.lost(sim)
        if body is not None:
            self.fell = body, sim.time - self.begun

    def findings(self) -> Iterator[Finding]:
        """Yield the robot that fell."""
        if self.fell is None:
            return
        body, after = self.fell
        of = named(self.model, "body", [body])
        problem = (
            f"{of[0].name} falls over within {seconds(after)}, because its servos do not balance it"
        )
        cure = "give the controls or the controller that balance it (--ctrl, --control)"
        yield Finding("fall", "warning", problem, cure, of, after, "s")
