"""One run of a Sim under a user's controls and pushes, observed by probes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stepcore.engine.control import Control, controls
from stepcore.engine.sim import Sim
from stepcore.engine.snapshots import Taking
from stepcore.engine.trajectory import Trajectory, whole_steps
from stepcore.experiment.run import Probe
from stepcore.report.progress import Choice, Progress

# About how often probes look at a run, unless they ask for more.
LOOKS = 2000
# How often a run says how far it is.
TOLD = 100


@dataclass(frozen=True)
class Push:
    """A force on a body's centre of mass for some time.

    body: its index. force: in world axes [N]. start: time since the run began [s]. duration: [s];
    it lasts for at least one step.
    """

    body: int
    force: tuple[float, float, float]
    start: float
    duration: float

    def span(self, dt: float) -> range:
        """The steps during which it acts."""
        first = round(self.start / dt)
        return range(first, first + max(1, round(self.duration / dt)))


@dataclass
class SingleRun:
    """Runs a Sim from the state that it has.

    control: a function of (time, sim) that gives the controls, called every `control_dt` [s], by
    default before every step; None leaves them as they are. pushes: forces, added to what is
    applied already. probes: observe the run about `LOOKS` times. record: what the trajectory
    holds, at every step; without any there is none.

    progress: who is told how far the run is; see `Progress`.
    """

    sim: Sim
    control: Control | None = None
    control_dt: float | None = None
    pushes: Sequence[Push] = ()
    probes: Sequence[Probe] = ()
    record: Sequence[str] = ()
    progress: Choice = False
    trajectory: Trajectory | None = field(default=None, init=False)

    def run(self, steps: int) -> None:
        """Takes so many steps; raises what `Sim.step` raises, and what the control raises."""
        sim, dt = self.sim, self.sim.settings.dt
        period = 1 if self.control_dt is None else whole_steps("control_dt", self.control_dt, dt, 1)
        stride = 1 if self.record else max(1, steps // LOOKS)
        applied = np.array(sim.xfrc_applied)
        spans = [(push, push.span(dt)) for push in self.pushes]
        data: dict[str, list[np.ndarray]] = {name: [] for name in ("time", *self.record)}
        for probe in self.probes:
            probe.begin(sim)
        self._note(data)
        taking = Taking(sim, steps) if self.record else None
        try:
            with Progress("steps", steps, self.progress) as bar:
                self._steps(steps, period, stride, spans, applied, data, taking, bar)
        finally:
            # Of a run that fails there is what it did until then.
            sim.xfrc_applied[:] = applied
            if taking is not None:
                arrays = {name: np.array(values) for name, values in data.items()}
                kept = taking.kept()
                self.trajectory = Trajectory(arrays.pop("time"), arrays, snapshots=kept)

    def _steps(
        self,
        steps: int,
        period: int,
        stride: int,
        spans: list[tuple[Push, range]],
        applied: np.ndarray,
        data: dict[str, list[np.ndarray]],
        taking: Taking | None,
        bar: Progress,
    ) -> None:
        sim = self.sim
        edges = sorted({edge for _, span in spans for edge in (span.start, span.stop)})
        done = told = 0
        while done < steps:
            if self.control is not None and done % period == 0:
                sim.ctrl = controls(self.control, sim)
            if done in edges or (done == 0 and spans):
                sim.xfrc_applied[:] = applied
                for push, span in spans:
                    if done in span:
                        sim.xfrc_applied[push.body, :3] += push.force
            upto = [steps, *(edge for edge in edges if edge > done)]
            if self.control is not None:
                upto.append((done // period + 1) * period)
            if self.probes or self.record:
                upto.append((done // stride + 1) * stride)
            count = min(upto) - done
            if taking is not None:
                taking.look(done)
            sim.step(count)
            done += count
            if done % stride == 0 or done == steps:
                for probe in self.probes:
                    probe.step(sim)
                self._note(data)
            if done >= told or done == steps:
                bar.advance(done - bar.done)
                told = done + max(1, steps // TOLD)
        if taking is not None:
            taking.look(steps)

    def _note(self, data: dict[str, list[np.ndarray]]) -> None:
        if self.record:
            for name, values in data.items():
                values.append(np.array(getattr(self.sim, name)))
