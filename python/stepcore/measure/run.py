"""`run`: one simulation of a scene, with findings about contacts, limits and servos."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from stepcore import checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.axes import axes_of
from stepcore.engine.control import Control, fresh
from stepcore.engine.model import Model
from stepcore.engine.run_settings import balanced, refsafe_note
from stepcore.engine.sim import Sim
from stepcore.engine.trajectory import Trajectory, recordable, whole_steps
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
from stepcore.experiment.run import Probe
from stepcore.experiment.schedule import given_controls, home
from stepcore.experiment.single_run import LOOKS, Pace, Push, SingleRun
from stepcore.loading import find_model
from stepcore.measure.monitors import Finding, Monitor, verified
from stepcore.report.progress import Choice
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


class Bars(Probe):
    """A probe that keeps the largest estimated error of a run.

    error: [m]. body: which body's. time: when [s].
    """

    def __init__(self) -> None:
        self.error, self.body, self.time = 0.0, 0, 0.0

    def step(self, sim: Any) -> None:
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


class Driven(NamedTuple):
    """What drives a run: a control function, its period [s], words, and servos of ours.

    Without a function, controls are constant.
    """

    control: Control | None
    period: float | None
    words: str
    servos: tuple[Servo, ...] = ()


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
    sim.reset(key=0 if motion.key is None and model.keys else motion.key)
    if isinstance(motion.ctrl, PositionTable):
        sim.qpos = motion.ctrl.begin(model, sim.qpos)
    if not horizon / dt < MOST_STEPS:
        limit = f"below {MOST_STEPS * dt:g} s at dt = {dt:g} s (2^64 steps)"
        raise ValueError(f"horizon = {horizon:g}: must be {limit}")
    harder = refsafe_note(model.scene, sim.settings)
    steps, notes = round(horizon / dt), [*filter(None, [harder]), *model.scene.notes]
    bars = None if sim._finer is None else Bars()
    if motion.horizon is not None and abs(steps * dt - horizon) > 1e-6 * dt:
        notes.append(
            f"{horizon:g} s is not a whole number of steps of {dt:g} s: the run is "
            f"{steps * dt:g} s long"
        )
    if motion.control_dt is not None:
        whole_steps("control_dt", motion.control_dt, dt, least=1)
    control, period, drive, servos = _driven(sim, motion, horizon)
    if servos:
        # The servos obey the controls in place of the motors.
        state, driven, finer = sim.state(), Change(servos=servos).of(model), sim._finer is not None
        sim = Sim(driven, sim.settings, threads=sim._threads, error_bar=finer)
        sim.restore(state)
    shoved = [Push.of(push) for push in pushes]
    begin = begin_in_words(model, motion)
    parts = [drive, *(f"push {push}" for push in shoved), scene_in_words(model)]
    monitor, pace = Monitor(model), Pace(min(steps, LOOKS))
    single = SingleRun(
        sim,
        control=control,
        control_dt=period,
        pushes=shoved,
        probes=[monitor, pace, *([bars] if bars is not None else [])] if steps else [],
        record=recordable(record),
        progress=progress,
    )
    error, interrupted, begun = None, False, sim.time
    held, unused = np.array(sim.ctrl), None if control is None else fresh(control)

    def again(cured: Model) -> Monitor:
        """Return the monitor of the same run with another model."""
        other, watching = Sim(Change(servos=servos).of(cured)), Monitor(cured)
        other.reset(key=0 if motion.key is None and cured.keys else motion.key)
        other.ctrl = held
        function = None if unused is None else fresh(unused)
        repeated = SingleRun(other, function, period or dt, shoved, [watching])
        repeated.run(round(steps * dt / other.settings.dt))
        return watching

    try:
        single.run(steps)
        sim.balance()
    except SimulationError as failure:
        error, steps = failure, failure.step
    except KeyboardInterrupt:
        if not interruptible:
            raise
        interrupted, steps = True, round((sim.time - begun) / dt)
    found = monitor.findings(failed=error is not None) if steps else []
    plain = model.with_settings(settings.replace(ledger=False))
    timed = steps and error is None
    cost = pace.seconds(Sim(model, sim.settings)) if timed else 0.0
    return SimulationRun(
        name=model.scene.name or "scene",
        motion=motion,
        ran=f"{seconds(steps * dt)} from {begin}; {'; '.join(parts)}",
        settings=settings,
        steps=steps,
        sim=sim,
        findings=verified(found, plain, again, steps),
        us_per_step=1e6 * cost or None,
        notes=notes,
        trajectory=single.trajectory,
        error=error,
        interrupted=interrupted,
        judged="" if bars is None or error else bars.words(sim, settings.accuracy),
    )


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
    return Driven(_player(rows, period, sim), period, said, controls.servos)


def _player(rows: np.ndarray, period: float, sim: Sim) -> Callable[[float, Sim], np.ndarray]:
    """Return a control function that plays one row per period [s], and then keeps the last row."""
    begin = sim.time

    def control(time: float, sim: Sim) -> np.ndarray:
        row: np.ndarray = rows[min(round((time - begin) / period), len(rows) - 1)]
        return row

    return control
