"""`SingleRun`: one run of a Sim from its present state, under controls and pushes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.control import Control, new_control
from stepcore.engine.error_bar import recorded_names
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.snapshots import Taking
from stepcore.engine.trajectory import Trajectory, pieces
from stepcore.experiment.change import Servo
from stepcore.experiment.default_motion import MotionRequest
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import drive_in_words, held_in_words
from stepcore.experiment.schedule import driving, home
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import metres, seconds, time_of

# The approximate number of readings of a run.
READINGS = 400
# The default duration of a push [s], and the text form of a push.
PUSH = 0.1
PUSH_FORM = "BODY:FX,FY,FZ@T or BODY:FX,FY,FZ@T+DURATION, in N and s"


@dataclass(frozen=True)
class Push:
    """A force on a body's centre of mass for some time.

    body: the name or index of the body.
    force: the force in world axes [N], shape (3,).
    start: the time since the beginning of the run [s].
    duration: the time for which the force acts [s]; at least one time step.

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
            fields = checks.as_list(push)
            if fields is None or not 2 <= len(fields) <= 4:
                limit = "(body, force, start, duration)"
                raise ValueError(f"push = {checks.shown(push)}: must be {limit} or {PUSH_FORM}")
            return cls(*fields)
        # The "+" may belong to an exponent, as in "1e+0".
        form = re.fullmatch(r"(.*):([^,@]*),([^,@]*),([^,@]*)@(.*?)((?<!e)\+.*)?", push)
        if form is None:
            raise ValueError(f"push {push}: must be {PUSH_FORM}")
        body, *force, start, lasting = form.groups()
        x, y, z = (_finite(push, part) for part in force)
        duration = PUSH if lasting is None else _finite(push, lasting[1:], time_of)
        times = _finite(push, start, time_of), duration
        if min(times) < 0:
            raise ValueError(f"push {push}: its times must be >= 0 s")
        return cls(body, (x, y, z), *times)

    def body_index(self, model: Model) -> int:
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


def _finite(push: str, part: str, read: Callable[[str], float | None] = float) -> float:
    try:
        value = read(part)
    except ValueError:
        value = None
    if value is None or not math.isfinite(value):
        raise ValueError(f"push {push}: '{part}' must be a finite number")
    return value


class Drive(NamedTuple):
    """The input of a run: a control function or rows, their period [s], words, servos and remarks.

    Without control, the controls are constant.
    """

    control: Control | np.ndarray | None
    period: float | None
    words: str
    servos: tuple[Servo, ...] = ()
    remarks: tuple[str, ...] = ()

    def fresh(self) -> Drive:
        """Return the same drive with a new copy of a control object."""
        return self._replace(control=new_control(self.control)) if callable(self.control) else self


def drive_of(sim: Sim, motion: Motion, horizon: float) -> Drive:
    """Return the input of a run. Constant controls are written to the Sim."""
    model, dt, ctrl = sim.model, sim.settings.dt, np.array(sim.ctrl)
    period, every = motion.control_dt or dt, motion.control_dt
    if not motion.is_users and (motion.kind is None or not model.nu):
        return Drive(None, every, held_in_words(model, ctrl))
    begin, periods = home(model, motion.key)[0], int(np.ceil(horizon / period)) + 1
    begin = replace(begin, qpos=np.array(sim.qpos))
    constant = motion.control_dt is not None
    request = MotionRequest(begin, ctrl, [begin], motion.seed, period, periods, constant)
    controls = driving(motion, model, request)
    words = controls.words or drive_in_words(model, motion, "", f"every {seconds(period)}")
    if controls.function is not None:
        return Drive(controls.function, every, words)
    log = controls.log
    assert log is not None
    if len(log.times) == 1:
        sim.ctrl = log.rows.reshape(-1)
        return Drive(None, every, words, controls.servos, controls.remarks)
    # Without a control period, each row of controls is for one step.
    rows = log.steps(0.0, period, periods).reshape(periods, -1)
    return Drive(rows, period, words, controls.servos, controls.remarks)


@dataclass
class Bar:
    """The largest estimated error of a run [m], the body that has it, and its time [s]."""

    error: float = 0.0
    body: int = 0
    time: float = 0.0

    def look(self, sim: Sim) -> None:
        each = sim.body_error
        body = int(each.argmax())
        if each[body] > self.error:
            self.error, self.body, self.time = float(each[body]), body, sim.time

    def words(self, sim: Sim, accuracy: float | None) -> str:
        """Describe the finer run's error estimate after the last step; accuracy: requested [m]."""
        until = sim.predictable_until
        if math.isfinite(until):
            return (
                f"From {seconds(until)} on no error is known: a finer run is elsewhere. Take "
                "shorter steps; stepcore predict says whether any can tell."
            )
        text = f"The error is estimated as {metres(sim.error.largest)} at the end"
        if self.error > 0:
            body = sim.model.element_name("body", self.body)
            text += f" and at most {metres(self.error)} ({body} at {seconds(self.time)})"
        against = "" if accuracy is None else f"; requested: {metres(accuracy)}"
        return f"{text}, from a finer run{against}."


class SingleRun:
    """One run of a Sim from its present state, with its recorded arrays.

    drive, pushes: see `Drive` and `Push`. names: the arrays to read about `READINGS` times.
    record: the arrays to record at every step.
    readings: the arrays that were read, by name, and "time"; the first is the start.
    trajectory: the recorded arrays; None without `record`. seconds: computing time of the steps.
    error: why the run failed. bar: the error estimate of a run with a finer run; else None.
    """

    def __init__(
        self,
        sim: Sim,
        drive: Drive,
        pushes: Sequence[Push],
        names: Sequence[str],
        record: Sequence[str] = (),
    ) -> None:
        self.sim, self.drive, self.pushes = sim, drive, pushes
        self.record = ("time", *recorded_names(sim, record)) if record else ()
        self.bar = None if sim._finer is None else Bar()
        self.trajectory: Trajectory | None = None
        self.error: SimulationError | None = None
        self.seconds, self.done = 0.0, 0
        self.readings: dict[str, list[np.ndarray]] = {name: [] for name in ("time", *names)}

    def run(self, steps: int, progress: Choice = False) -> None:
        """Make steps. A run that fails ends, and the steps recorded until then are kept."""
        sim, dt = self.sim, self.sim.settings.dt
        hold = round(self.drive.period / dt) if self.drive.period else 1
        applied = np.array(sim.xfrc_applied)
        spans = [(push.body_index(sim.model), push.force, push.span(dt)) for push in self.pushes]
        edges = {edge for *_, span in spans for edge in (span.start, span.stop)}
        every = max(1, steps // READINGS)
        often = [every, max(1, steps // 100), *([math.gcd(*edges) or steps] if edges else [])]
        arrays, taking = self._arrays(steps), Taking(sim, steps) if self.record else None
        begun = process_time()
        try:
            with Progress("steps", steps, progress) as shown:
                for done in pieces(sim, steps, self.drive.control, hold, arrays, often, taking):
                    self.seconds += process_time() - begun
                    self.done = done
                    if done in edges:
                        sim.xfrc_applied[:] = applied
                        for body, force, span in spans:
                            sim.xfrc_applied[body, :3] += np.multiply(force, done in span)
                    if done % every == 0:
                        self._read()
                    shown.advance(done - shown.done)
                    begun = process_time()
            sim.balance()
        except SimulationError as error:
            self.error = error
        finally:
            sim.xfrc_applied[:] = applied
            if taking is not None:
                kept = {name: values[: self.done + 1] for name, values in arrays.items()}
                self.trajectory = Trajectory(kept.pop("time"), kept, snapshots=taking.kept())

    def _arrays(self, steps: int) -> dict[str, np.ndarray]:
        """Return the arrays to record at every step; their first entry is the present state."""
        arrays = {}
        for name in self.record:
            value = np.asarray(getattr(self.sim, name))
            arrays[name] = np.empty((steps + 1, *value.shape), value.dtype)
            arrays[name][0] = value
        return arrays

    def _read(self) -> None:
        for name, values in self.readings.items():
            values.append(np.array(getattr(self.sim, name)))
        if self.bar is not None:
            self.bar.look(self.sim)
