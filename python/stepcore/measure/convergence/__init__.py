"""`converge`: whether more sweeps or smaller steps help, and which rows are not solved."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, Unpack

import numpy as np

from stepcore import checks
from stepcore.deadline import SEARCHED
from stepcore.engine.norm import apart, rms
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.horizon import settled_motion
from stepcore.experiment.motion import Motion
from stepcore.experiment.predictable import until_in_words
from stepcore.experiment.schedule import divides, often
from stepcore.experiment.study import EFFORT, SHIPPED, Study
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import Truth
from stepcore.measure.convergence.sweeps import (
    ROUNDING,
    SWEEPS,
    ResidualHistory,
    RowForce,
    residual_history,
    row_states,
)
from stepcore.measure.monitors import Finding, monitored
from stepcore.measure.monitors.finding import OTHERS
from stepcore.report.report import SHORT, not_shown
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, metres, seconds, speed

__all__ = ["Convergence", "ResidualHistory", "RowForce", "Split", "converge"]

# Equal work, as steps × sweeps.
SPLITS = ((64, 1), (16, 4), (4, 16), (1, 64))
# Time steps tried at the shipped sweeps, relative to the shipped one.
FACTORS = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8)
# The default number of starts.
STARTS = 3
# NOTABLE: distances below this share of the scene's size do not make a motion under-solved, as the
# tolerances of iterative solvers allow such distances. ALIKE: a smaller ratio of errors counts as
# equal. STILL: a body at rest moves less than this share of the distance in the whole motion.
NOTABLE, ALIKE, STILL = 1e-5, 1.2, 0.1


class Split(NamedTuple):
    """Equal work as steps × sweeps, and its trial."""

    steps: int
    sweeps: int
    trial: Trial


@dataclass(frozen=True)
class Ending:
    """The difference between the ends of the motion as shipped and with converged forces.

    The end is the last sample that can be predicted.

    start, body: the start and the body with the largest distance. apart: this distance [m].
    speed: the body's mean speed as shipped, over the last tenth of the motion before the end [m/s].
    solver: RMS distance over the predictable time in the worst start [m].
    """

    start: int
    body: str
    apart: float
    speed: float
    solver: float


@dataclass(eq=False, repr=False)
class Convergence(Result):
    """The convergence of a scene's rows, and whether sweeps or smaller steps gain more accuracy.

    shipped, solved: the trials of the scene's settings, and of these with converged forces.
    dts: trials of other time steps. splits: trials of equal work. more: the trial of four times the
        sweeps; None if the settings have no number of sweeps.
    histories: the residual by sweeps at states of the motion. has_rows: whether any row acts.
    reference: the converged motion that all trials are compared with.
    size: the size of the scene [m].
    ending: the end of the motion; None if a run fails.
    findings: problems of the settings in the first start, such as creep; see `Finding`.

    >>> from stepcore import converge, lesson
    >>> tower = lesson.stack(50, "rigid", (1.0, 1.0))
    >>> result = converge(tower, horizon=0.2, starts=1, states=2, progress=False)
    >>> result
    <Convergence of tower: solved>
    >>> print(f"{result.contraction:.3f}")
    0.500
    """

    kind = "convergence"
    units: ClassVar = {"missing": "m/s", "force": "N or N·m", "solved": "N or N·m"}

    settings: Any
    motion: Motion
    horizon: float
    shipped: Trial
    solved: Trial
    dts: list[Trial]
    splits: list[Split]
    more: Trial | None
    histories: list[ResidualHistory]
    has_rows: bool
    reference: Truth
    size: float
    ending: Ending | None
    findings: list[Finding] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """ "diverging", "under-solved", "no rows" or "solved"."""
        if self.ending is None:
            return "diverging"
        if not self.has_rows:
            return "no rows"
        # Unconverged forces matter if they move bodies further than the time step does.
        least = max(self.solved.error, NOTABLE * self.size)
        return "under-solved" if self.ending.solver > least else "solved"

    @property
    def better(self) -> str:
        """The more accurate at equal work: "smaller steps", "more sweeps" or "neither".

        Two comparisons are made, at equal row updates and at four times the shipped work. The one
        that reaches the smaller error decides.
        """
        pairs = [self.at_equal_work]
        if self.more is not None and self.quarter is not None:
            pairs.append((self.quarter.error, self.more.error))
        return _better(*min(pairs, key=min)) if self.has_rows else "neither"

    @property
    def at_equal_work(self) -> tuple[float, float]:
        """The least errors [m] of splits with more steps than sweeps, and with fewer; inf if all
        fail."""
        steps = [split.trial.error for split in self.splits if split.steps > split.sweeps]
        sweeps = [split.trial.error for split in self.splits if split.steps < split.sweeps]
        return min(steps, default=math.inf), min(sweeps, default=math.inf)

    @property
    def quarter(self) -> Trial | None:
        """The shipped settings at a quarter of their time step; None if not tried."""
        return next((t for t in self.dts if math.isclose(t.dt, self.shipped.dt / 4)), None)

    @property
    def contraction(self) -> float | None:
        """The asymptotic share of the error that each sweep leaves, at the slowest state."""
        known = (history.contraction for history in self.histories)
        return max((share for share in known if share is not None), default=None)

    @property
    def rows(self) -> list[RowForce]:
        """Elements that have rows, the one furthest from its converged force first.

        Each element is listed at the state with its largest missing impulse, after the shipped
        sweeps.
        """
        by_name: dict[str, list[RowForce]] = {}
        for force in (force for history in self.histories for force in history.forces):
            by_name.setdefault(force.name, []).append(force)
        rows = [
            replace(max(forces, key=lambda force: force.missing), states=len(forces))
            for forces in by_name.values()
        ]
        return sorted(rows, key=lambda row: -row.missing)

    # --- tables and data -------------------------------------------------------------------------

    @property
    def title(self) -> str:
        """The name of the scene and the measurement."""
        return f"{self.name}: convergence of contact forces and other rows"

    @property
    def setup(self) -> str:
        """The runs that were made."""
        return f"Settings: {label(self.settings)}. {self.reference.words}"

    @property
    def table(self) -> Table:
        """The rows; see `RowForce`."""
        return Table(
            [vars(row) for row in self.rows],
            ["name", "missing", "force", "solved", "states"],
            {"missing": ".2e"},
            heading="Rows after the shipped sweeps, the largest missing impulse first",
            legend=(
                "missing: missing impulse as a speed [m/s]; force reached and converged force "
                "(solved) [N or N·m]; states: number of states in which it has rows."
            ),
        )

    @property
    def sweeps(self) -> Table:
        """The residual by sweeps, cold and warm: median and worst of the states [m/s]."""
        records = []
        for k, count in enumerate(SWEEPS if self.histories else ()):
            record: dict[str, Any] = {"sweeps": count}
            for kind in ("cold", "warm"):
                values = [getattr(history, kind)[k] for history in self.histories]
                record[kind], record[f"{kind} worst"] = float(np.median(values)), max(values)
            records.append(record)
        names = ("cold", "cold worst", "warm", "warm worst")
        heading = "Residual by sweeps, median and worst of the states [m/s]"
        return Table(records, ["sweeps", *names], dict.fromkeys(names, ".2e"), heading=heading)

    @property
    def steps(self) -> Table:
        """One row for each time step; other settings are as shipped; errors in metres.

        work: counted operations per simulated second.
        """
        rows = [(seconds(trial.dt), trial) for trial in self.dts]
        return _table("dt", rows, "By time step, all else as shipped: RMS position error [m]")

    @property
    def work(self) -> Table:
        """Equal row updates as steps × sweeps, under pgs, and four times the shipped work."""
        named = [(f"{steps}x{sweeps}", trial) for steps, sweeps, trial in self.splits]
        named.append(("shipped", self.shipped))
        named += [("shipped, 4 x sweeps", self.more)] if self.more else []
        named += [("shipped, 1/4 dt", self.quarter)] if self.quarter else []
        named.append(("shipped dt, converged", self.solved))
        heading = "Equal row updates, steps x sweeps under pgs, and the shipped settings"
        return _table("steps x sweeps", named, heading)

    def tables(self, full: bool) -> list[Table]:
        """Return the tables of rows and time steps; rows that Newton solved only with `full`.

        full: whether to include every row, equal work and residuals by sweeps.
        """
        rows, known = self.table, bool(self.histories)
        if full:
            return [rows, self.steps, self.work, self.sweeps] if known else [self.steps, self.work]
        if not known or (self.verdict == "solved" and self.settings.solver != "pgs"):
            return [self.steps]
        few = rows[:SHORT]
        if len(rows) > SHORT:
            few.legend += f" {not_shown(counted(len(rows) - SHORT, 'row'))}"
        return [few, self.steps]

    def details(self) -> dict[str, Any]:
        """Return the verdict, the contraction and the other tables."""
        return {
            "verdict": self.verdict,
            "better": self.better,
            "contraction": self.contraction,
            "reference": self.reference.settings.as_dict(),
            "reference_error": self.reference.error,
            "size": self.size,
            "ending": self.ending,
            "findings": [finding.record() for finding in self.findings],
            "sweeps": self.sweeps.records,
            "steps": self.steps.records,
            "work": self.work.records,
        }

    def __repr__(self) -> str:
        return f"<Convergence of {self.name}: {self.verdict}>"

    # --- sentences -------------------------------------------------------------------------------

    @property
    def sentences(self) -> list[str]:
        """The verdict, the cause, the convergence of sweeps, and what would gain more accuracy."""
        said = until_in_words(self.reference.growth.ends, self.horizon)
        said += [self._diverging() if self.ending is None else self._verdict(self.ending)]
        if self.has_rows:
            said += [self._forces(), self._convergence(), self._equal_work(), self._four_times()]
        said += [finding.text for finding in self.findings]
        return [sentence for sentence in said if sentence]

    def _verdict(self, ending: Ending) -> str:
        solver, starts = ending.solver, len(self.shipped.starts)
        worst = f" in the worst of {counted(starts, 'start')}" if starts > 1 else ""
        error = f"{self._error(self.solved)}{worst}"
        step = f"The time step causes an error of {error}{self._shorter()}."
        if not self.has_rows:
            none = "No contact, limit or other row was ever active, so sweeps have no effect."
            return f"{none} {step}"
        apart = f"{metres(solver)} (RMS) from the motion with converged forces"
        if self.verdict == "under-solved":
            where, own = self._where_it_ends(ending), "The time step itself causes an error of"
            return f"Under-solved: {where} Over the motion it is {apart}. {own} {error}."
        fine = "the solver is fine." if solver < 1e-9 * self.size else f"the motion is {apart}."
        return f"Solved: {fine} {step}"

    def _shorter(self) -> str:
        """Describe the error of the longest step that about halves it, or that no step does."""
        tried = [t for t in self.dts if t.dt < self.shipped.dt and not t.failure]
        better = [trial for trial in tried if trial.error <= 0.6 * self.shipped.error]
        if better:
            best = max(better, key=lambda trial: trial.dt)
            return f"; a dt of {seconds(best.dt)} leaves {self._error(best)}"
        if not tried or self.shipped.error <= 2 * self.reference.error:
            return ""
        least = min(tried, key=lambda trial: trial.dt)
        return f", which shorter steps, down to {seconds(least.dt)}, hardly lower"

    def _where_it_ends(self, ending: Ending) -> str:
        """Describe where an under-solved motion ends."""
        apart = f"{metres(ending.apart)} from where converged forces take it"
        if ending.apart <= NOTABLE * self.size:
            return "the motion differs on the way, but ends in the same place."
        if ending.speed <= STILL * ending.apart / self.horizon:
            return f"{ending.body} settles at a wrong fixed point, {apart}."
        return f"{ending.body} ends {apart}, at {speed(ending.speed)}."

    def _diverging(self) -> str:
        if not self.shipped.failure:
            return (
                f"Diverging: with converged forces the motion fails ({self.solved.failure}); it "
                "runs only because sweeps are too few."
            )
        why = f"Diverging: {self.shipped.failure}."
        if not self.solved.failure:
            return f"{why} With converged forces at the same time step it runs: use more sweeps."
        steps = [trial.dt for trial in self.dts if not trial.failure]
        smaller = [dt for dt in steps if dt < self.shipped.dt]
        if smaller:
            return (
                f"{why} Converged forces do not help; a time step of {seconds(max(smaller))} does. "
                "`stepcore diagnose` names the element that limits it."
            )
        return f"{why} Neither converged forces nor the smaller time steps tried help."

    def _told(self, trial: Trial) -> bool:
        """Return whether an error exceeds the uncertainty of the converged motion."""
        return trial.error > self.reference.error * (1 + 1e-9)

    def _error(self, trial: Trial) -> str:
        said = metres(trial.error)
        return said if self._told(trial) or said.startswith("<") else f"at most {said}"

    @property
    def _untold(self) -> str:
        least = metres(self.reference.error)
        return f"no error is more than the {least} to which the converged motion is known."

    def _forces(self) -> str:
        """Describe the rows that are furthest from their converged force."""
        rows = [row for row in self.rows if row.missing > 0][:OTHERS]
        if not rows or self.verdict == "solved":
            return ""
        said = [
            f"{row.name} ({row.force:.3g} of {row.solved:.3g}; {compact(row.missing)} m/s missing)"
            for row in rows
        ]
        return f"Force reached, of the converged force: {', '.join(said)}."

    def _convergence(self) -> str:
        """Describe how fast sweeps converge; Newton makes no sweeps."""
        rate = self.contraction
        if self.settings.solver != "pgs" or not self.histories:
            return ""
        if rate is None:
            return "No two rows act at once, so one sweep solves them."
        if rate >= 1 - 1e-9:
            return f"Sweeps do not converge: each leaves {rate:.6g} of the error."
        if rate <= ROUNDING:
            return "Each sweep leaves nothing of the solver's error."
        # Enough digits to tell a number near 1 from 1.
        digits = 4 if rate < 0.99 else 2 + math.ceil(-math.log10(1 - rate))
        tenfold = math.log(10) / -math.log(rate)
        share = f"{rate:.1e}" if rate < 1e-3 else f"{rate:.{digits}f}"
        gains = f"({tenfold:.3g} sweeps reduce it tenfold)"
        return f"Each sweep leaves {share} of the solver's error {gains}."

    def _equal_work(self) -> str:
        if not self.splits:
            return ""
        errors = [
            f"{counted(steps, 'step')} of {counted(sweeps, 'sweep')} "
            + ("fails" if trial.failure else metres(trial.error))
            for steps, sweeps, trial in self.splits
        ]
        answer = {
            (True, True): {
                "smaller steps": "smaller steps are more accurate than more sweeps",
                "more sweeps": "more sweeps are more accurate than smaller steps",
                "neither": "smaller steps and more sweeps are equally accurate",
            }[_better(*self.at_equal_work)],
            (True, False): "only smaller steps do not fail",
            (False, True): "only more sweeps do not fail",
            (False, False): "both smaller steps and more sweeps fail",
        }
        steps, sweeps = map(math.isfinite, self.at_equal_work)
        begin = "At" if self.settings.solver == "pgs" else "Under pgs, at"
        ran = [trial for *_, trial in self.splits if not trial.failure]
        if ran and not any(map(self._told, ran)):
            return f"{begin} equal work (row updates) {self._untold}"
        return f"{begin} equal work (row updates) {answer[steps, sweeps]}: {', '.join(errors)}."

    def _four_times(self) -> str:
        """Describe the gain from four times the work."""
        more, quarter = self.more, self.quarter
        if more is None or quarter is None:
            return ""
        if self.shipped.failure or more.failure or quarter.failure:
            return ""
        if not any(map(self._told, (self.shipped, more, quarter))):
            return f"With four times the sweeps, or a quarter of the time step, {self._untold}"
        return (
            f"The shipped settings have an error of {metres(self.shipped.error)}; four times the "
            f"sweeps give {metres(more.error)}, a quarter of the time step {metres(quarter.error)}."
        )


def _better(steps: float, sweeps: float) -> str:
    """Return which of two errors is notably smaller, in words."""
    if steps * ALIKE < sweeps:
        return "smaller steps"
    return "more sweeps" if sweeps * ALIKE < steps else "neither"


def _table(name: str, rows: Sequence[tuple[str, Trial]], heading: str) -> Table:
    """Return a table of trials, with a column of failures if there are any."""
    names = ("error", "median", "largest", "work", "failure")
    records = [{name: said} | trial.record() for said, trial in rows]
    failed = any(record["failure"] for record in records)
    columns = [name, *(names if failed else names[:-1])]
    return Table(records, columns, dict.fromkeys(names[:-1], ".2e"), heading=heading)


@measurement()
def converge(
    model: Source,
    motion: Motion | str | None = None,
    *,
    states: int = 8,
    engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> Convergence:
    """Test whether contact forces and other rows are solved, and whether sweeps or steps help more.

    Over the whole motion, `converge` measures the error as shipped, with converged forces, at other
    time steps, and at equal row updates split into many sweeps or many steps. Errors are RMS
    distances from the scene's converged motion in the worst start [m], as in `stepcore.trade`. At
    states of the motion, it measures the residual by the number of sweeps, cold and warm; the share
    of the error that each sweep leaves; and which rows are furthest from their converged force.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). The settings in the
        model are tested.
    motion: a `Motion`, or its fields as arguments. By default 3 starts and 1 s, or longer
        if it is not at rest by then; see `stepcore.experiment.horizon`.
    states: the number of states at which sweeps are measured.
    engine: "stepcore", or "mujoco", which also runs files that stepcore cannot load. With MuJoCo
        the result has only errors, and no rows.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, or if no converged motion can be run.

    >>> from stepcore import lesson
    >>> heavy = lesson.stack(5, "rigid", (1.0, 1000.0), warm_start=False)
    >>> result = converge(heavy, horizon=0.1, starts=1, progress=False)
    >>> result.verdict, result.better
    ('under-solved', 'smaller steps')
    >>> print(f"{result.contraction:.4f}")
    0.9990
    """
    setup = set_up(converge, model, motion, fields, missing="nothing to solve", engine=engine)
    states = checks.count("states", states)
    shipped, motion, workers = setup.engine.settings(SHIPPED), setup.motion, setup.workers
    if motion.control_dt is not None and not divides(shipped.dt, motion.control_dt):
        limit = f"must be a whole number of steps of {shipped.dt:g} s"
        raise ValueError(f"control_dt = {motion.control_dt:g}: {limit}")
    starts = motion.starts or STARTS
    motion = dataclasses.replace(motion, starts=starts)
    motion, far = settled_motion(setup.engine, motion, starts, EFFORT)
    frame, period = periods(shipped, motion.period(shipped.dt), far.length)
    study = Study(motion=motion, engine=setup.engine, period=period, workers=workers)
    dts, splits, more = other_steps(study), equal_work(frame), four_times(shipped)
    solved, truth = converged_forces(study), study.truth()
    every = list(dict.fromkeys([SHIPPED, solved, *dts, *splits.values(), *more]))
    # The answer needs two of the settings: run these first.
    two = study.run([SHIPPED, solved], bar="runs")
    has_rows = study.engine.has_rows(study.schedule)
    said = f"as shipped the error is {metres(two[0].error)}, with converged forces "
    said += f"{metres(two[1].error)}, ± {metres(truth.error)}; other settings are run now"
    workers.deadline.so_far(said)

    def done() -> list[Change]:
        known = set(study.changes(study.starts))
        return [change for change in every if change in known]

    def left_out() -> str:
        return f"{len(every) - len(done())} of {len(every)} settings"

    with workers.deadline.stage(left_out, SEARCHED):
        study.tracks(every, study.starts, "runs")
    with workers.deadline.closing():
        trials = {trial.change: trial for trial in study.run(done())}
    histories, findings = list[ResidualHistory](), list[Finding]()
    if engine == "stepcore":
        with workers.deadline.stage("the findings on the shipped settings"):
            found = monitored(setup.model, study.schedule)[0]
            # The residual is already reported by this measurement.
            findings = [one for one in found if one.kind != "residual"]
        with workers.deadline.stage("the residual by sweeps"):
            chosen = row_states(setup.model, study.schedule, states, study.starts)
            job = partial(residual_history, setup.model, shipped)
            histories = workers.each(job, chosen, "sweeps")
    return Convergence(
        name=setup.name,
        settings=shipped,
        motion=dataclasses.replace(motion, horizon=study.schedule.horizon),
        horizon=study.schedule.horizon,
        shipped=trials[SHIPPED],
        solved=trials[solved],
        dts=[trials[change] for change in dts if change in trials],
        splits=[Split(*at, trials[change]) for at, change in splits.items() if change in trials],
        more=next((trials[change] for change in more if change in trials), None),
        histories=histories,
        has_rows=has_rows,
        reference=truth,
        size=study.size,
        ending=_ending(study, trials[SHIPPED], trials[solved], truth),
        notes=[*(setup.model.scene.notes if setup.engine.known else ()), *study.schedule.notes],
        findings=findings,
        ran=far.after(study.motion_ran),
    )


def periods(shipped: Any, control: float | None, horizon: float) -> tuple[float, float]:
    """Return the time over which equal work is split, and the control period [s].

    The split whose number of sweeps is nearest to the shipped one has the shipped time step. If the
    solver has no such number, the third split has it.

    control: the control period of the motion [s]; None if it has none.
    """
    known = shipped.solver == "pgs" and shipped.sweeps != "auto"
    sweeps = max(1, int(shipped.sweeps)) if known else SPLITS[2][1]
    frame = shipped.dt * min(SPLITS, key=lambda split: abs(math.log(split[1] / sweeps)))[0]
    if control is not None:
        return control / max(1, round(control / frame)), control
    period = often(max(frame, FACTORS[0] * shipped.dt), shipped.dt, horizon)
    return min(frame, period), period


def converged_forces(study: Study) -> Change:
    """Return the change to converged forces, as in the converged motion; all else as shipped."""
    engine = study.engine
    shipped, exact = engine.settings(SHIPPED), engine.ways(study.schedule, 1.0)[0].at(0)
    own = {name: getattr(shipped, name) for name in ("dt", "integrator", "refsafe", "sleep")}
    return Change.between(engine.settings(exact.also(Change(**own))), shipped)


def other_steps(study: Study) -> list[Change]:
    """Return the shipped settings at all time steps that divide the control period."""
    period, shipped = study.schedule.period, study.engine.dt
    steps = {f: f * shipped for f in FACTORS if f * shipped <= period * (1 + 1e-9)}
    own = {f: dt for f, dt in steps.items() if divides(dt, period)}
    return [SHIPPED if f == 1 else Change(dt=dt) for f, dt in own.items()]


def equal_work(frame: float) -> dict[tuple[int, int], Change]:
    """Return equal numbers of row updates in a time [s], by steps and sweeps."""
    plain = Change(solver="pgs", tolerance=0.0, cost_tolerance=0.0)
    return {(n, k): plain.also(Change(dt=frame / n, sweeps=k)) for n, k in SPLITS}


def four_times(shipped: Any) -> list[Change]:
    """Return four times the shipped sweeps; empty for settings without a number of sweeps."""
    if shipped.solver != "pgs" or shipped.sweeps in ("auto", 0):
        return []
    return [Change(sweeps=4 * shipped.sweeps, cost_tolerance=0.0)]


def _ending(study: Study, shipped: Trial, solved: Trial, truth: Truth) -> Ending | None:
    """Compare the ends of both motions in the start with the largest difference."""
    a, b = shipped.tracks, solved.tracks
    if a is None or b is None or shipped.failure or solved.failure:
        return None
    over = rms(apart(a, b, study.engine.matter), truth.scored)
    # The last samples that can be predicted.
    last, times = truth.scored.sum(axis=1) - 1, study.schedule.times
    every = np.arange(len(last))
    gap = np.linalg.norm(a.com[every, last] - b.com[every, last], axis=-1)
    start, body = map(int, np.unravel_index(gap.argmax(), gap.shape))
    # The speed over the tenth of the motion before the end.
    end = int(last[start])
    first = max(0, end - max(1, len(times) // 10))
    with np.errstate(invalid="ignore"):
        moved = a.com[start, end, body] - a.com[start, first, body]
        speed = float(np.linalg.norm(moved) / max(times[end] - times[first], 1e-300))
    index = study.engine.matter.moving[body]
    known = study.engine.known
    name = study.model.element_name("body", index) if known else f"body {index}"
    return Ending(start, name, float(gap.max()), speed, float(over.max()))
