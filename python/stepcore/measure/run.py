"""`run`: one simulation of a scene, with findings about contacts, limits and servos."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from stepcore import checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.axes import axes_of
from stepcore.engine.control import Control, fresh
from stepcore.engine.error_bar import judged
from stepcore.engine.model import Model
from stepcore.engine.run_settings import balanced, refsafe_note
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.snapshots import Taking
from stepcore.engine.trajectory import Trajectory, pieces, recordable, whole_steps
from stepcore.experiment.arguments import Source
from stepcore.experiment.change import Change, Servo
from stepcore.experiment.control_table import PositionTable
from stepcore.experiment.default_motion import default_motion
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import (
    begin_in_words,
    drive_in_words,
    held_in_words,
    scene_in_words,
)
from stepcore.experiment.push import Push
from stepcore.experiment.schedule import given_controls, home
from stepcore.loading import find_model
from stepcore.measure.monitors import Finding, Recording, shown, verified
from stepcore.measure.monitors.recording import READINGS, RECORDED, whole
from stepcore.report.progress import Choice, Progress
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import computing, counted, metres, seconds, times

if TYPE_CHECKING:
    from typing import Unpack

# The default horizon [s].
HORIZON = 1.0
# The counter of steps has 64 bits.
MOST_STEPS = 2.0**64
# The number of rows of the final state that are printed by default.
ROWS = 36
# The number of progress reports of a run.
TOLD = 100
CLEAN = "Nothing found: no contact creeps or sinks in, and limits and servos hold."


@dataclass(repr=False, kw_only=True)
class SimulationRun(Result):
    """The result of `stepcore.run`: one simulation of a scene, and the problems in it.

    motion: the motion that was run.
    settings: the settings of the run.
    steps: the number of steps made.
    sim: the `Sim` in its final state; if the run failed, in the last finite state.
    findings: the problems in the run, the most severe first: contacts that creep, joints beyond
        their limits, servos that do not reach their targets.
    us_per_step: computing time of a step [µs]; None if no step was timed.
    trajectory: the recorded arrays; None without `record`.
    error: the `SimulationError` of a run that failed; `error.replay` repeats the run. Else None.
    interrupted: whether Ctrl-C ended the run (command line only); the result covers the steps made.
    judged: the error of the run in words, where a finer run went beside; see `Sim.error` of `sim`.

    >>> from stepcore import lesson, run
    >>> fallen = run(lesson.drop(), horizon=0.5)
    >>> fallen.success, round(float(fallen.sim.time), 6), fallen.findings
    (True, 0.5, [])
    """

    motion: Motion
    settings: Settings
    steps: int
    sim: Sim
    findings: list[Finding]
    us_per_step: float | None
    trajectory: Trajectory | None = None
    error: SimulationError | None = None
    interrupted: bool = False
    judged: str = ""

    kind: ClassVar[str] = "run"

    @property
    def success(self) -> bool:
        """Whether the run reached its end."""
        return self.error is None and not self.interrupted

    @property
    def title(self) -> str:
        if not self.steps:
            return f"{self.name}: no step was made"
        dt, cost = self.settings.dt, self.us_per_step
        took = f"{seconds(self.steps * dt)} in {counted(self.steps, 'step')} of {seconds(dt)}"
        pace = f"; {computing(cost)} a step, {times(1e6 * dt / cost)} real time" if cost else ""
        return f"{self.name}: {took}{pace}"

    @property
    def setup(self) -> str:
        return repr(self.settings)

    @property
    def sentences(self) -> list[str]:
        said = [f"{checks.one_line(self.error)}."] if self.error is not None else []
        said += ["Interrupted."] if self.interrupted else []
        said += [f"{finding.severity}: {finding.text}" for finding in self.findings]
        if self.steps and self.success and not self.findings:
            said.append(CLEAN)
        kinetic, potential = self.sim.energy
        end = (
            f"At the end, {self.sim.time:g} s: {kinetic:.6g} J kinetic, {potential:.6g} J potential"
        )
        contacts = counted(len(self.sim.contacts), "contact")
        said += [self.judged] if self.judged else []
        return [*said, f"{end}; {contacts}, residual {self.sim.residual:.2g} m/s."]

    @property
    def table(self) -> Table:
        """Table of the final state: positions by coordinate, velocities by dof."""
        rows = []
        for array in ("qpos", "qvel"):
            values = getattr(self.sim, array)
            (axis,) = axes_of(self.sim.model, array, values.shape)
            rows += [
                {"array": array, "of": name, "value": float(value)}
                for name, value in zip(axis.entries, values, strict=True)
            ]
        return Table(rows, ("array", "of", "value"), {"value": ".6g"}, heading="Final state")

    def tables(self, full: bool) -> list[Table]:
        table = self.table
        if full or len(table) <= ROWS:
            return [table] if len(table) else []
        cut = table[:ROWS]
        cut.legend = f"and {len(table) - ROWS} more (--all)"
        return [cut]

    def details(self) -> dict[str, Any]:
        sim = self.sim
        kinetic, potential = sim.energy
        return {
            "success": self.success,
            "error": None if self.error is None else checks.one_line(self.error),
            "settings": sim.settings,
            "steps": self.steps,
            "time": sim.time,
            "qpos": sim.qpos,
            "qvel": sim.qvel,
            "kinetic": kinetic,
            "potential": potential,
            "contacts": len(sim.contacts),
            "residual": sim.residual,
            "estimated_error": sim.error._asdict() if self.judged else None,
            "us_per_step": self.us_per_step,
            "findings": [finding.record() for finding in self.findings],
        }

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Plot the recorded arrays; see `Trajectory.plot`.

        path: the file to write; by default none.

        Raises ValueError if nothing was recorded, and ImportError without matplotlib.
        """
        if self.trajectory is None:
            raise ValueError('nothing was recorded: run(…, record=("energy", "overlap"))')
        return self.trajectory.plot(path)

    def _repr_html_(self) -> str:
        return self.report().html() if self.trajectory is None else super()._repr_html_()


@takes_motion(without=("starts",))
def run(
    model: Source,
    motion: Motion | str | None = None,
    *,
    pushes: Iterable[Push | str | Sequence[Any]] = (),
    record: Sequence[str] = (),
    ledger: bool = True,
    error_bar: bool | None = None,
    threads: int = 1,
    progress: Choice = None,
    **fields: Unpack[MotionFields],
) -> SimulationRun:
    """Simulate a scene once, and list the problems that occur in the run.

    model: a Model, a Scene, or any argument of `stepcore.load`.
    motion: a `Motion`, or its fields as arguments: horizon, key, control, ctrl, control_dt, kind,
        seed; or a kind of motion. By default 1 s (or all of a log) from the first keyframe,
        with the controls of that keyframe.
    pushes: forces on bodies, such as "torso:50,0,0@1" (50 N along x from 1 s on, for 0.1 s),
        "torso:50,0,0@1+0.3", or (body, force, start, duration).
    record: the arrays to record at every step, such as ("qpos", "energy"); see `Sim.run`.
    ledger: whether to balance the energy of each step. The balance explains a failure in full and
        costs a few percent of the time. Steps with an `accuracy` have none.
    error_bar: whether a finer run goes beside, from which the error of this one is known; see
        `Sim`. By default where the model's settings have an `accuracy`, which here is the error
        asked for at the end of the horizon.
    threads: the number of threads; see `Sim`.
    progress: see `stepcore.trade`.

    A run that fails also returns a result: `success` is False, and `error` is the SimulationError.

    Raises ValueError for an argument outside its limits, and any exception of the control function.

    >>> from stepcore import lesson
    >>> result = run(lesson.spring(), horizon=0.1, record="energy")
    >>> result.steps, result.trajectory["energy"].shape
    (10, (11, 2))
    """
    compiled = find_model(model)
    motion = Motion.of(motion, fields, run)
    horizon = motion.horizon or max(HORIZON, motion.duration)
    sim = sim_of(compiled, horizon, ledger=ledger, error_bar=error_bar, threads=threads)
    return simulated(sim, compiled.settings, motion, horizon, pushes, record, progress)


def sim_of(
    model: Model,
    horizon: float,
    *,
    ledger: bool = True,
    error_bar: bool | None = None,
    threads: int = 1,
) -> Sim:
    """Return the Sim of a run over a horizon [s]; see `run`."""
    settings = balanced(model.settings) if ledger else model.settings
    asked = settings.accuracy
    if asked is not None and horizon > 0:
        settings = settings.replace(accuracy=asked / horizon)
    judged = asked is not None if error_bar is None else error_bar
    return Sim(model, settings, threads=threads, error_bar=judged)


class Driven(NamedTuple):
    """What drives a run: a control function or rows, their period [s], words, and servos of ours.

    Without control, the controls are constant.
    """

    control: Control | np.ndarray | None
    period: float | None
    words: str
    servos: tuple[Servo, ...] = ()


@dataclass
class _Bar:
    """The largest estimated error of a run [m], of which body, and when [s]."""

    error: float = 0.0
    body: int = 0
    time: float = 0.0

    def look(self, sim: Sim) -> None:
        each = sim.body_error
        body = int(each.argmax())
        if each[body] > self.error:
            self.error, self.body, self.time = float(each[body]), body, sim.time

    def words(self, sim: Sim, asked: float | None) -> str:
        """Return what the finer run says, after the last step; asked: the accuracy [m]."""
        until = sim.predictable_until
        if math.isfinite(until):
            return (
                f"From {seconds(until)} on no error is known: a finer run is elsewhere. Take "
                "shorter steps; stepcore predict says whether any can tell."
            )
        said = f"The error is estimated as {metres(sim.error.largest)} at the end"
        if self.error > 0:
            body = sim.model.element_name("body", self.body)
            said += f" and at most {metres(self.error)} ({body} at {seconds(self.time)})"
        against = "" if asked is None else f"; asked for {metres(asked)}"
        return f"{said}, from a finer run{against}."


class _Watched:
    """One run of a Sim under controls and pushes, with what is recorded of it.

    model: with the settings of the run, without servos of ours. key: of the start.
    drive, pushes: see `Driven` and `Push`. record: the arrays to record at every step.
    trajectory: what was recorded; None without `record`. seconds: computing time of the steps.
    error: why the run failed. bar: of a run with a finer one beside it.
    """

    def __init__(
        self,
        sim: Sim,
        model: Model,
        key: str | int | None,
        drive: Driven,
        pushes: Sequence[Push],
        record: Sequence[str] = (),
    ) -> None:
        self.sim, self.model, self.key, self.drive, self.pushes = sim, model, key, drive, pushes
        self.record = ("time", *judged(sim, record)) if record else ()
        self.bar = None if sim._finer is None else _Bar()
        self.trajectory: Trajectory | None = None
        self.error: SimulationError | None = None
        self.seconds, self.done = 0.0, 0
        self.readings: dict[str, list[np.ndarray]] = {name: [] for name in ("time", *RECORDED)}

    def run(self, steps: int, progress: Choice = False) -> None:
        """Make steps. A run that fails ends, and what was recorded up to there is kept."""
        sim, dt = self.sim, self.sim.settings.dt
        hold = round(self.drive.period / dt) if self.drive.period else 1
        applied = np.array(sim.xfrc_applied)
        spans = [(push.on(sim.model), push.force, push.span(dt)) for push in self.pushes]
        edges = {edge for *_, span in spans for edge in (span.start, span.stop)}
        every = max(1, steps // READINGS)
        often = [every, max(1, steps // TOLD), *([math.gcd(*edges) or steps] if edges else [])]
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
        """Return arrays for what is recorded at every step, which begin with the present state."""
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

    def recording(self) -> Recording:
        """Return the run as findings see it."""
        data = {name: np.array(values) for name, values in self.readings.items()}
        failure = None if self.error is None else checks.one_line(self.error)
        times, key = data.pop("time"), self.key
        found = whole(self.sim.model, times, data, lambda sim: sim.reset(key=key), failure)
        return replace(found, model=self.model)


def simulated(
    sim: Sim,
    settings: Settings,
    motion: Motion,
    horizon: float,
    pushes: Iterable[Push | str | Sequence[Any]],
    record: Sequence[str],
    progress: Choice,
    interruptible: bool = False,
) -> SimulationRun:
    """Run a Sim from the start of a motion, and return the result.

    settings: the settings for the result (the Sim's settings may differ in `ledger`).
    horizon: simulated time [s]; may be 0.
    interruptible: whether Ctrl-C ends the run with a result, and not with KeyboardInterrupt.
    """
    model, dt = sim.model, sim.settings.dt
    key = 0 if motion.key is None and model.keys else motion.key
    sim.reset(key=key)
    if isinstance(motion.ctrl, PositionTable):
        sim.qpos = motion.ctrl.begin(model, sim.qpos)
    if not horizon / dt < MOST_STEPS:
        limit = f"below {MOST_STEPS * dt:g} s at dt = {dt:g} s (2^64 steps)"
        raise ValueError(f"horizon = {horizon:g}: must be {limit}")
    steps, notes = round(horizon / dt), list(model.scene.notes)
    if motion.horizon is not None and abs(steps * dt - horizon) > 1e-6 * dt:
        notes.insert(
            0,
            f"{horizon:g} s is not a whole number of steps of {dt:g} s: the run is "
            f"{steps * dt:g} s long",
        )
    if harder := refsafe_note(model.scene, sim.settings):
        notes.insert(0, harder)
    if motion.control_dt is not None:
        whole_steps("control_dt", motion.control_dt, dt, least=1)
    drive, shoved = _driven(sim, motion, horizon), [Push.of(push) for push in pushes]
    if drive.servos:
        # The servos obey the controls in place of the motors.
        state, finer = sim.state(), sim._finer is not None
        driven = Change(servos=drive.servos).of(model)
        sim = Sim(driven, sim.settings, threads=sim._threads, error_bar=finer)
        sim.restore(state)
    begin = begin_in_words(model, motion)
    parts = [drive.words, *(f"push {push}" for push in shoved), scene_in_words(model)]
    plain = model.with_settings(sim.settings.replace(ledger=False))
    held, unused, qpos = np.array(sim.ctrl), _fresh(drive), np.array(sim.qpos)
    watched = _Watched(sim, plain, key, drive, shoved, recordable(record))

    def again(cured: Model) -> Recording:
        """Return the recording of the same run with another model."""
        other = Sim(Change(servos=drive.servos).of(cured))
        other.reset(key=key)
        other.qpos, other.ctrl = qpos, held
        repeated = _Watched(unwatched(other), cured, key, _fresh(unused), shoved)
        repeated.run(round(steps * dt / other.settings.dt))
        if repeated.error is not None:
            raise repeated.error
        return repeated.recording()

    begun, interrupted = sim.time, False
    try:
        watched.run(steps, progress)
    except KeyboardInterrupt:
        if not interruptible:
            raise
        interrupted, steps = True, round((sim.time - begun) / dt)
    error = watched.error
    steps = steps if error is None else error.step
    found = shown(watched.recording()) if steps else []
    timed = error is None and not interrupted and steps
    return SimulationRun(
        name=model.scene.name or "scene",
        motion=motion,
        ran=f"{seconds(steps * dt)} from {begin}; {'; '.join(parts)}",
        settings=settings,
        steps=steps,
        sim=sim,
        findings=verified(found, plain, again, steps),
        us_per_step=1e6 * watched.seconds / steps if timed else None,
        notes=notes,
        trajectory=watched.trajectory,
        error=error,
        interrupted=interrupted,
        judged="" if watched.bar is None or error else watched.bar.words(sim, settings.accuracy),
    )


def _fresh(drive: Driven) -> Driven:
    """Return the same drive with a new copy of a control object."""
    return drive._replace(control=fresh(drive.control)) if callable(drive.control) else drive


def _driven(sim: Sim, motion: Motion, horizon: float) -> Driven:
    """Return what drives a run. Constant controls are written to the Sim."""
    model, dt, held = sim.model, sim.settings.dt, np.array(sim.ctrl)
    period, every = motion.control_dt or dt, motion.control_dt
    if not motion.is_users and (motion.kind is None or not model.nu):
        return Driven(None, every, held_in_words(model, held))
    begin, periods = home(model, motion.key)[0], int(np.ceil(horizon / period)) + 1
    begin = replace(begin, qpos=np.array(sim.qpos))
    controls = given_controls(motion, model, begin, held, period)
    if controls is None:
        how = (motion.kind, begin, held, [begin], motion.seed, period, periods)
        controls = default_motion(model, *how)
    said = controls.words or drive_in_words(model, motion, "", f"every {seconds(period)}")
    if controls.function is not None:
        return Driven(controls.function, every, said)
    log = controls.log
    assert log is not None
    if len(log.times) == 1:
        sim.ctrl = log.rows.reshape(-1)
        return Driven(None, every, said, controls.servos)
    # Without a period of its own, each row of controls is that of a step.
    rows = log.steps(0.0, period, periods).reshape(periods, -1)
    return Driven(rows, period, said, controls.servos)
