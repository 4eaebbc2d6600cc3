"""`Monitor`: finds problems in any run: creep, gaps, contact depths, saturation, unsolved rows.

The findings are measured on the run itself and need no reference. `run`, `trade`, `converge` and
`check` monitor a run of the scene as shipped.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import numpy as np

from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.run import Probe
from stepcore.experiment.runner import Runner
from stepcore.experiment.sizes import Sizes
from stepcore.measure.monitors.actuators import ActuatorMonitor
from stepcore.measure.monitors.contacts import ContactMonitor
from stepcore.measure.monitors.creep import creep_findings
from stepcore.measure.monitors.cures import proven, verified
from stepcore.measure.monitors.falls import FallMonitor
from stepcore.measure.monitors.finding import Finding, Next, named, ordered
from stepcore.measure.monitors.friction_loss import FrictionLossMonitor
from stepcore.measure.monitors.joints import JointMonitor
from stepcore.measure.monitors.noise import NoiseMonitor
from stepcore.measure.monitors.play import PlayMonitor
from stepcore.measure.monitors.readings import REST
from stepcore.measure.monitors.tunnelling import TunnellingMonitor
from stepcore.report.settings import solver_words
from stepcore.report.units import percent, speed, times

__all__ = ["Finding", "Monitor", "Next", "monitored", "ordered", "proven", "verified"]

# Approximate number of readings in a run.
LOOKS = 1000
# Findings reported after a failure; the others would describe the explosion.
BEFORE = ("overlap at the start", "clamped control")
# Rows are unsolved if the residual exceeds this share of gravity's speed gain in one step.
UNSOLVED = 0.1


class Monitor(Probe):
    """A probe that finds problems in a run.

    model: the model of the run.
    bodies: the bodies of the model; made from the model by default.
    periods: the number of control periods of the run; each is read at least once.
    """

    def __init__(self, model: Model, bodies: Bodies | None = None, periods: int = 1) -> None:
        bodies = bodies or Bodies(model, Coordinates(model))
        self.model, self.looks = model, max(1, LOOKS // periods)
        sizes = Sizes(model)
        self.contacts = ContactMonitor(model, bodies.friction, sizes)
        self.joints = JointMonitor(model, bodies.joints, sizes)
        self.actuators = ActuatorMonitor(model)
        self.friction_losses = FrictionLossMonitor(model, sizes)
        self.play = PlayMonitor(model)
        self.noise = NoiseMonitor(model, self.contacts)
        self.falls = FallMonitor(model)
        self.tunnelling = TunnellingMonitor(model, sizes)
        # The times of the readings [s]; their residuals [m/s]; the worst residual and its row.
        self.times: list[float] = []
        self.residuals: list[float] = []
        self.worst, self.unsolved = 0.0, ("", 0)

    @property
    def span(self) -> float:
        """The monitored time [s]."""
        return self.times[-1] - self.times[0] if self.times else 0.0

    def stride(self, steps: int) -> int:
        return max(1, steps // self.looks)

    def begin(self, sim: Any) -> None:
        self.times.append(sim.time)
        self.contacts.begin(sim)
        self.falls.begin(sim)
        self.tunnelling.begin(sim)

    def step(self, sim: Any) -> None:
        self.times.append(sim.time)
        residual = float(sim.residual)
        if residual > self.worst:
            rows = sim.rows
            row = rows[np.argmax(np.abs(rows["residual"]))]
            self.worst, self.unsolved = residual, (str(row["kind"]), int(row["index"]))
        self.residuals.append(residual)
        rows = functools.cache(lambda: sim.rows)
        self.contacts.look(sim, rows)
        self.joints.look(sim)
        self.play.look(sim)
        self.noise.look(sim)
        self.tunnelling.look(sim)
        self.falls.look(sim)
        self.actuators.look(sim)
        if self.friction_losses.watches:
            self.friction_losses.look(sim, rows())

    def findings(self, depth: float | None = None, failed: bool = False) -> list[Finding]:
        """Return the findings of the run, most severe first.

        depth: the wanted depth of resting contacts [m]. By default a depth is a finding only if
            large relative to the geoms.
        failed: whether the run failed.
        """
        every = (
            *self.falls.findings(),
            *self.tunnelling.findings(),
            *creep_findings(self.contacts, self.times[1:]),
            *self.contacts.findings(depth, {at.pair for at in self.tunnelling.passed()}),
            *self.friction_losses.findings(self.times[1:]),
            *self.joints.findings(),
            *self.play.findings(),
            *self.noise.findings(self.times[1:]),
            *self.actuators.findings(),
            *self._unsolved_rows(),
        )
        return ordered(each for each in every if not failed or each.kind in BEFORE)

    def _unsolved_rows(self) -> Iterator[Finding]:
        """Yield a lasting residual: the median over the end of the run, relative to gravity."""
        model, settings = self.model, self.model.settings
        gravity = float(np.linalg.norm(model.scene.gravity)) if model.scene.features.gravity else 0
        given = gravity * settings.dt
        if not self.residuals or not given:
            return
        stays = float(np.median(self.residuals[-max(1, int(REST * len(self.residuals))) :]))
        if not stays > UNSOLVED * given:
            return
        share = percent(stays / given) if stays < given else times(stays / given)
        pgs = settings.law == "solref" and settings.solver == "pgs"
        worst = named(model, self.unsolved[0], [self.unsolved[1]])
        problem = (
            f"the rows are not solved by {solver_words(settings)}: a residual of {speed(stays)} "
            f"stays, {share} of the speed that gravity gives in a step, worst in {worst[0].name}"
        )
        cure = (
            f"use more sweeps{', solver newton' * pgs} or smaller time steps; `stepcore converge` "
            "says how many"
        )
        commands = (Next("converge", "how many sweeps, or how small a step, solve the rows"),)
        yield Finding("residual", "warning", problem, cure, worst, stays, "m/s", commands)


def monitored(
    runner: Runner, settings: Settings, depth: float | None = None
) -> tuple[list[Finding], str | None]:
    """Run a measurement's motion from the first start, and return the findings and any failure.

    Their cures are seen to hold in this motion. depth: see `Monitor.findings`.
    """

    def seen(other: Runner, settings: Settings) -> tuple[Monitor, str | None]:
        model = other.model.with_settings(settings)
        monitor = Monitor(model, other.bodies, other.schedule.periods)
        return monitor, other.run(settings, 0, [monitor]).failure

    def again(model: Model) -> Monitor | None:
        monitor, failure = seen(type(runner)(model, runner.schedule), model.settings)
        return None if failure else monitor

    monitor, failure = seen(runner, settings)
    findings = monitor.findings(depth, failed=failure is not None)
    model = runner.model.with_settings(settings.replace(ledger=False))
    steps = round(runner.schedule.horizon / settings.dt)
    return verified(findings, model, again, steps), failure
