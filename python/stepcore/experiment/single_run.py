"""One run of a Sim under a user's controls and pushes, observed by probes; what a step costs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.control import Control, controls
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.snapshots import Taking
from stepcore.engine.trajectory import Trajectory, whole_steps
from stepcore.experiment.run import Probe
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import time_of

# About how many times probes observe a run.
LOOKS = 2000
# How many times a run reports its progress.
TOLD = 100
# How long a push lasts where nobody says it [s], and how one is written.
PUSH = 0.1
PUSH_FORM = "BODY:FX,FY,FZ@T or BODY:FX,FY,FZ@T+DURATION, in N and s"
# So many states along a run are kept; from each so many steps are timed, so often, and the quickest
# counts, as whatever else the machine does only adds.
STATES, STEPS, TIMES = 20, 4, 3


@dataclass(frozen=True)
class Push:
    """A force on a body's centre of mass for some time.

    body: its name or index. force: in world axes [N], shape (3,). start: time since the run began
    [s]. duration: [s]; it lasts for at least one step.

    >>> Push.of("torso:50,0,0@1+0.2")
    Push(body='torso', force=(50.0, 0.0, 0.0), start=1.0, duration=0.2)
    """

    body: str | int
    force: tuple[float, float, float]
    start: float = 0.0
    duration: float = PUSH

    def __post_init__(self) -> None:
        force = checks.vector(3)("push", "force", self.force)
        object.__setattr__(self, "force", force)
        for name in ("start", "duration"):
            object.__setattr__(self, name, checks.real(low=0.0)("push", name, getattr(self, name)))

    @classmethod
    def of(cls, push: Push | str | Sequence[Any]) -> Push:
        """A push as it is, as its fields, or as "BODY:FX,FY,FZ@START" with "+DURATION" or not.

        Raises ValueError for anything else.
        """
        if isinstance(push, Push):
            return push
        if not isinstance(push, str):
            fields = checks.listed(push)
            if fields is None or not 2 <= len(fields) <= 4:
                limit = "(body, force, start, duration)"
                raise ValueError(f"push = {checks.shown(push)}: must be {limit} or {PUSH_FORM}")
            return cls(*fields)
        body, colon, rest = push.rpartition(":")
        force, at, when = rest.partition("@")
        parts = force.split(",")
        if not colon or not at or len(parts) != 3:
            raise ValueError(f"push {push}: must be {PUSH_FORM}")
        # A sign may stand in an exponent: "1e+0".
        start, plus, length = when.partition("+") if "e+" not in when else (when, "", "")
        x, y, z = (_finite(push, part) for part in parts)
        times = _finite(push, start, time_of), _finite(push, length, time_of) if plus else PUSH
        if min(times) < 0:
            raise ValueError(f"push {push}: its times must be >= 0 s")
        return cls(body, (x, y, z), *times)

    def on(self, model: Model) -> int:
        """The index of its body; ValueError for a body that cannot be pushed."""
        if isinstance(self.body, str) and self.body not in model.body_names[1:]:
            near = checks.nearest(self.body, model.body_names[1:])
            raise ValueError(f"push {self}: no body is named '{self.body}'{near}")
        index = model.index("body", self.body)
        if not index:
            raise ValueError(f"push {self}: the world cannot be pushed")
        return index

    def span(self, dt: float) -> range:
        """The steps during which it acts."""
        first = round(self.start / dt)
        return range(first, first + max(1, round(self.duration / dt)))

    def __str__(self) -> str:
        lasting = "" if self.duration == PUSH else f"+{self.duration:g}"
        return f"{self.body}:{','.join(f'{x:g}' for x in self.force)}@{self.start:g}{lasting}"


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
        """Takes `steps` steps; raises what `Sim.step` and the control raise."""
        sim, dt = self.sim, self.sim.settings.dt
        period = 1 if self.control_dt is None else whole_steps("control_dt", self.control_dt, dt, 1)
        stride = 1 if self.record else max(1, steps // LOOKS)
        applied = np.array(sim.xfrc_applied)
        spans = [(push.on(sim.model), push.force, push.span(dt)) for push in self.pushes]
        data: dict[str, list[np.ndarray]] = {name: [] for name in ("time", *self.record)}
        for probe in self.probes:
            probe.begin(sim)
        self._note(data)
        taking = Taking(sim, steps) if self.record else None
        try:
            with Progress("steps", steps, self.progress) as bar:
                self._steps(steps, period, stride, spans, applied, data, taking, bar)
        finally:
            # A run that fails keeps what was recorded until then.
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
        spans: list[tuple[int, tuple[float, float, float], range]],
        applied: np.ndarray,
        data: dict[str, list[np.ndarray]],
        taking: Taking | None,
        bar: Progress,
    ) -> None:
        sim = self.sim
        edges = sorted({edge for *_, span in spans for edge in (span.start, span.stop)})
        done = told = 0
        while done < steps:
            if self.control is not None and done % period == 0:
                sim.ctrl = controls(self.control, sim)
            if done in edges or (done == 0 and spans):
                sim.xfrc_applied[:] = applied
                for body, force, span in spans:
                    if done in span:
                        sim.xfrc_applied[body, :3] += force
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


class Pace(Probe):
    """Keeps states along a run; some steps from each are timed after the run.

    Steps are not timed during the run: a probe evicts the step's data from the processor's caches,
    and the next step takes several times as long.

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


def _finite(push: str, part: str, read: Callable[[str], float | None] = float) -> float:
    try:
        value = read(part)
    except ValueError:
        value = None
    if value is None or not math.isfinite(value):
        raise ValueError(f"push {push}: '{part}' must be a finite number")
    return value
