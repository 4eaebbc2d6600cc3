"""`run`: one simulation of a scene, with findings about contacts, limits and servos."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from stepcore import checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.axes import axes_of
from stepcore.engine.model import Model
from stepcore.engine.run_settings import balanced, refsafe_note, spinning_note
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.engine.trajectory import Trajectory, recordable, whole_steps
from stepcore.experiment.arguments import Source
from stepcore.experiment.change import Change
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import begin_in_words, scene_in_words
from stepcore.experiment.schedule import HORIZON
from stepcore.experiment.single_run import Push, SingleRun, drive_of
from stepcore.loading import find_model
from stepcore.measure.monitors import Finding, Recording, shown, verified
from stepcore.measure.monitors.recording import RECORDED, whole
from stepcore.report.progress import Choice
from stepcore.report.report import not_shown
from stepcore.report.result import Result
from stepcore.report.settings import differing
from stepcore.report.table import Table
from stepcore.report.units import computing, counted, seconds, times

if TYPE_CHECKING:
    from typing import Unpack

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
    us_per_step: computing time per step [µs]; None if no step was timed.
    trajectory: the recorded arrays; None without `record`.
    error: the `SimulationError` of a run that failed; `error.replay` repeats the run. Else None.
    interrupted: whether Ctrl-C ended the run (command line only); the result covers the steps made.
    judged: the error of the run in words, if it was compared with a finer run; see `Sim.error`.

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
        return differing(self.settings)

    @property
    def sentences(self) -> list[str]:
        said = [f"{checks.one_line(self.error)}."] if self.error is not None else []
        said += ["Interrupted."] if self.interrupted else []
        said += [f"{finding.severity}: {finding.text}" for finding in self.findings]
        said += [CLEAN] if self.steps and self.success and not self.findings else []
        said += [self.judged] if self.judged else []
        kinetic, potential = self.sim.energy
        end = f"{self.sim.time:g} s: {kinetic:.6g} J kinetic, {potential:.6g} J potential"
        contacts = counted(len(self.sim.contacts), "contact")
        rest = f"{contacts}, residual {self.sim.residual:.2g} m/s"
        return [*said, f"At the end, {end}; {rest}."]

    @property
    def table(self) -> Table:
        """Table of the final state: positions by coordinate, velocities by dof."""
        rows = list[dict[str, Any]]()
        for array in ("qpos", "qvel"):
            values = getattr(self.sim, array)
            (axis,) = axes_of(self.sim.model, array, values.shape)
            named = zip(axis.entries, values.tolist(), strict=True)
            rows += [{"array": array, "of": name, "value": value} for name, value in named]
        return Table(rows, ("array", "of", "value"), {"value": ".6g"}, heading="Final state")

    def tables(self, full: bool) -> list[Table]:
        table = self.table
        if full or len(table) <= ROWS:
            return [table] if len(table) else []
        cut = table[:ROWS]
        cut.legend = not_shown(counted(len(table) - ROWS, "row"))
        return [cut]

    def details(self) -> dict[str, Any]:
        sim = self.sim
        return {
            "success": self.success,
            "error": None if self.error is None else checks.one_line(self.error),
            "settings": sim.settings,
            "steps": self.steps,
            "time": sim.time,
            "qpos": sim.qpos,
            "qvel": sim.qvel,
            **sim.energy._asdict(),
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
        seed; or a kind of motion. By default 1 s (or the whole log) from the first keyframe, with
        its controls.
    pushes: forces on bodies, such as "torso:50,0,0@1" (50 N along x from 1 s on, for 0.1 s),
        "torso:50,0,0@1+0.3", or (body, force, start, duration).
    record: the arrays to record at every step, such as ("qpos", "energy"); see `Sim.run`.
    ledger: whether to balance the energy of each step. The balance explains failures in full and
        costs a few percent of the time. Adaptive steps (`accuracy`) have no balance.
    error_bar: whether to make a finer run too, from which the error is estimated; see `Sim`. By
        default only if the model's settings have an `accuracy`, which here is the requested error
        at the end of the horizon.
    threads: the number of threads; see `Sim`.
    progress: see `stepcore.trade`.

    A run that fails also returns a result: `success` is False, and `error` is the SimulationError.

    Raises ValueError for an argument outside its limits, and any exception of the control function.

    >>> from stepcore import lesson
    >>> result = run(lesson.spring(), horizon=0.1, record="energy")
    >>> result.steps, result.trajectory["energy"].shape
    (10, (11, 2))
    """
    motion = Motion.of(motion, fields, run)
    compiled = motion.driven(find_model(model))
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
    interruptible: whether Ctrl-C ends the run with a result instead of KeyboardInterrupt.
    """
    model, dt = sim.model, sim.settings.dt
    key = 0 if motion.key is None and model.keys else motion.key
    sim.reset(key=key)
    if motion.from_log and motion.table is not None:
        begin = motion.table.start(model, Start(np.array(sim.qpos), np.array(sim.qvel)))
        sim.qpos, sim.qvel = begin.qpos, begin.qvel
    if not horizon / dt < 2.0**64:
        limit = f"below {2.0**64 * dt:g} s at dt = {dt:g} s (2^64 steps)"
        raise ValueError(f"horizon = {horizon:g}: must be {limit}")
    steps, notes = round(horizon / dt), [refsafe_note(model.scene, sim.settings)]
    if motion.horizon is not None and abs(steps * dt - horizon) > 1e-6 * dt:
        whole = f"is not a whole number of steps of {dt:g} s: the run is {steps * dt:g} s long"
        notes.append(f"{horizon:g} s {whole}")
    if motion.control_dt is not None:
        whole_steps("control_dt", motion.control_dt, dt, least=1)
    drive, shoved = drive_of(sim, motion, horizon), [Push.of(push) for push in pushes]
    notes += drive.remarks
    if drive.servos:
        # The servos follow the controls instead of the motors.
        state, finer = sim.state(), sim._finer is not None
        driven = Change(servos=drive.servos).of(model)
        sim = Sim(driven, sim.settings, threads=sim._threads, error_bar=finer)
        sim.restore(state)
    plain = model.with_settings(sim.settings.replace(ledger=False))
    held, unused, qpos = np.array(sim.ctrl), drive.fresh(), np.array(sim.qpos)
    single = SingleRun(sim, drive, shoved, RECORDED, recordable(record))

    def again(cured: Model, share: float) -> Recording:
        """Repeat a share of the run with another model, and return the recording."""
        other = unwatched(Sim(Change(servos=drive.servos).of(cured)))
        other.reset(key=key)
        other.qpos, other.ctrl = qpos, held
        repeated = SingleRun(other, unused.fresh(), shoved, RECORDED)
        repeated.run(round(share * steps * dt / other.settings.dt))
        if repeated.error is not None:
            raise repeated.error
        return _recording(repeated, cured, key)

    begun, interrupted = sim.time, False
    try:
        single.run(steps, progress)
    except KeyboardInterrupt:
        if not interruptible:
            raise
        interrupted, steps = True, round((sim.time - begun) / dt)
    error, bar = single.error, single.bar
    steps = steps if error is None else error.step
    found = shown(_recording(single, plain, key)) if steps else []
    timed = error is None and not interrupted and steps
    notes.append(spinning_note(sim.model, sim.settings, np.array(single.readings["qvel"])))
    parts = [drive.words, *(f"push {push}" for push in shoved), scene_in_words(model)]
    return SimulationRun(
        name=model.scene.name or "scene",
        motion=motion,
        ran=f"{seconds(steps * dt)} from {begin_in_words(model, motion)}; {'; '.join(parts)}",
        settings=settings,
        steps=steps,
        sim=sim,
        findings=verified(found, plain, again, steps),
        us_per_step=1e6 * single.seconds / steps if timed else None,
        notes=[*filter(None, notes), *model.scene.notes],
        trajectory=single.trajectory,
        error=error,
        interrupted=interrupted,
        judged="" if bar is None or error else bar.words(sim, settings.accuracy),
    )


def _recording(single: SingleRun, model: Model, key: str | int | None) -> Recording:
    """Return the recording of a run for findings. model: with its settings, without our servos."""
    data = {name: np.array(values) for name, values in single.readings.items()}
    failure = None if single.error is None else checks.one_line(single.error)
    times = data.pop("time")
    found = whole(single.sim.model, times, data, lambda sim: sim.reset(key=key), failure)
    return replace(found, model=model)
