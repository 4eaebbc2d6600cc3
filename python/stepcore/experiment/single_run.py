"""One run of a Sim under a user's controls and pushes, observed by probes and timed."""

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
from stepcore.engine.error_bar import driven, judged
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.snapshots import Taking
from stepcore.engine.trajectory import Trajectory, whole_steps
from stepcore.experiment.run import Probe
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import time_of

# The approximate number of observations of a run by its probes.
LOOKS = 2000
# The number of progress reports of a run.
TOLD = 100
# The default duration of a push [s], and the text form of a push.
PUSH = 0.1
PUSH_FORM = "BODY:FX,FY,FZ@T or BODY:FX,FY,FZ@T+DURATION, in N and s"
# The number of states that are kept along a run, of steps timed from each, and of repetitions. The
# shortest time counts, because other load on the machine only adds time.
STATES, STEPS, TIMES = 20, 4, 3


@dataclass(frozen=True)
class Push:
    """A force on a body's centre of mass for some time.

    body: the name or index of the body.
    force: the force in world axes [N], shape (3,).
    start: the time since the beginning of the run [s].
    duration: how long the force acts [s]; at least one time step.

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
        """Return a Push from a Push, its fields, or "BODY:FX,FY,FZ@START[+DURATION]".

        Raises ValueError for any other argument.
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
        # The "+" may belong to an exponent, as in "1e+0".
        start, plus, length = when.partition("+") if "e+" not in when else (when, "", "")
        x, y, z = (_finite(push, part) for part in parts)
        times = _finite(push, start, time_of), _finite(push, length, time_of) if plus else PUSH
        if min(times) < 0:
            raise ValueError(f"push {push}: its times must be >= 0 s")
        return cls(body, (x, y, z), *times)

    def on(self, model: Model) -> int:
        """Return the index of the body in a model.

        Raises ValueError for an unknown body and for the world.
        """
        if isinstance(self.body, str) and self.body not in model.body_names[1:]:
            near = checks.nearest(self.body, model.body_names[1:])
            raise ValueError(f"push {self}: no body is named '{self.body}'{near}")
        index = model.index("body", self.body)
        if not index:
            raise ValueError(f"push {self}: the world cannot be pushed")
        return index

    def span(self, dt: float) -> range:
        """Return the time steps during which the force acts."""
        first = round(self.start / dt)
        return range(first, first + max(1, round(self.duration / dt)))

    def __str__(self) -> str:
        lasting = "" if self.duration == PUSH else f"+{self.duration:g}"
        return f"{self.body}:{','.join(f'{x:g}' for x in self.force)}@{self.start:g}{lasting}"


@dataclass
class SingleRun:
    """One run of a Sim from its current state.

    sim: the Sim.
    control: a function of (time, sim) that returns the controls. It is called every `control_dt`
        [s], by default before every step. None keeps the controls constant.
    pushes: forces that are added to the applied forces of the Sim.
    probes: observe the run about `LOOKS` times.
    record: the names of the arrays to record at every step.
    progress: the choice of progress bar; see `Progress`.
    trajectory: the recorded arrays; None without `record`.
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
        """Make `steps` steps.

        Raises any exception of `Sim.step` and of the control function.
        """
        sim, dt = self.sim, self.sim.settings.dt
        period = 1 if self.control_dt is None else whole_steps("control_dt", self.control_dt, dt, 1)
        stride = 1 if self.record else max(1, steps // LOOKS)
        self.record = judged(sim, self.record) if self.record else ()
        applied = np.array(sim.xfrc_applied)
        spans = [(push.on(sim.model), push.force, push.span(dt)) for push in self.pushes]
        data: dict[str, list[np.ndarray]] = {name: [] for name in ("time", *self.record)}
        for probe in self.probes:
            probe.begin(sim)
        self._note(data)
        taking = Taking(sim, steps) if self.record else None
        try:
            with (
                Progress("steps", steps, self.progress) as bar,
                driven(sim, self.control) as beside,
            ):
                self._steps(steps, period, stride, spans, applied, data, taking, bar, beside)
        finally:
            # A failed run keeps the records up to the failure.
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
        beside: Callable[[], None],
    ) -> None:
        sim = self.sim
        edges = sorted({edge for *_, span in spans for edge in (span.start, span.stop)})
        done = told = 0
        while done < steps:
            if self.control is not None and done % period == 0:
                beside()
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
    """A probe that keeps states along a run, and times steps from these states after the run.

    Steps are not timed during the run, because a probe evicts the data of the step from the
    processor's caches, and the next step then takes several times as long.

    looks: the number of times that the probe observes the run.
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
        """Return the mean computing time of a step over the states [s]; 0 if every state fails.

        sim: a Sim of the run's model and settings; its state is overwritten.
        """
        times = [timed for state in self.states if (timed := _timed(sim, state)) is not None]
        return float(np.mean(times)) if times else 0.0


def _timed(sim: Any, state: bytes) -> float | None:
    """Return the computing time of a step from a state [s], or None if the step fails."""
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
