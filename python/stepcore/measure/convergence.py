"""`converge`: the errors that the time step and the sweeps cause, and what to increase."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Unpack

import numpy as np

from stepcore.deadline import SEARCHED
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.horizon import settled_motion
from stepcore.experiment.motion import Motion
from stepcore.experiment.predictable import until_in_words
from stepcore.experiment.quantity import Measure, Quantity
from stepcore.experiment.schedule import divides, often
from stepcore.experiment.study import EFFORT, SHIPPED, Study
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import Truth
from stepcore.measure.monitors import Finding, monitored
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import counted, metres, seconds, speed, times

__all__ = ["Convergence", "converge"]

# Time steps relative to the shipped one, and numbers of sweeps relative to the shipped number.
DT_RATIOS, SWEEP_RATIOS = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8), (4, 16)
STARTS = 3  # by default; the command's help reads it
# Distances below this share of the scene's size do not make a motion under-solved: iterative
# solvers stop at tolerances that leave as much. Errors that differ by less than the factor count as
# equal.
NOTABLE, EQUAL = 1e-5, 1.2


@dataclass(frozen=True)
class Ending:
    """The difference between the ends of the motion as shipped and with converged forces.

    The end is the last sample that can be predicted.

    start, body: the start and the body for which the distance is largest.
    apart: that distance [m].
    speed: the body's mean speed over the tenth of the motion as shipped before it [m/s].
    solver: the distance of the quantity in the worst start; of the motion, the RMS distance over
        what can be predicted.
    """

    start: int
    body: str
    apart: float
    speed: float
    solver: float


@dataclass(eq=False, repr=False)
class Convergence(Result):
    """The error of a scene's settings, split into the parts of the time step and of the sweeps.

    shipped, solved: the trials of the scene's settings, and of these with converged forces, whose
        error is that of the time step alone.
    dts: the trials of other time steps. sweeps: those of more sweeps; empty for settings without a
        number of sweeps.
    has_rows: whether any row was ever active.
    reference: the converged motion that all trials are compared with.
    measure: the quantity whose error was measured, with its unit: by default the motion.
    size: the size of the scene [m]. scale: the same for the motion, else the quantity's range.
    ending: the difference that the sweeps make; None if a run fails.
    findings: problems of the settings in the first start, such as rows that stay unsolved.

    >>> from stepcore import converge, lesson
    >>> tower = lesson.stack(50, "rigid", (1.0, 1.0))
    >>> converge(tower, horizon=0.2, starts=1, progress=False)
    <Convergence of tower: solved>
    """

    kind = "convergence"

    settings: Any
    motion: Motion
    horizon: float
    shipped: Trial
    solved: Trial
    dts: list[Trial]
    sweeps: list[Trial]
    has_rows: bool
    reference: Truth
    measure: Measure
    size: float
    scale: float
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
        least = max(self.solved.error, NOTABLE * self.scale)
        return "under-solved" if self.ending.solver > least else "solved"

    @property
    def better(self) -> str:
        """The more accurate at equal work: "smaller steps", "more sweeps" or "neither"."""
        _, steps, sweeps = self.at_equal_work
        if steps * EQUAL < sweeps:
            return "smaller steps"
        return "more sweeps" if sweeps * EQUAL < steps else "neither"

    @property
    def at_equal_work(self) -> tuple[float, float, float]:
        """The largest work that both were run with, and the errors of smaller steps and of sweeps.

        work: operations per simulated second. Errors are interpolated on log axes [m]; inf if all
        runs fail, NaN if there are no rows, no number of sweeps, or no runs.
        """
        shorter = [t for t in self.dts if t.dt < self.shipped.dt]
        if not (self.has_rows and self.sweeps and shorter):
            return math.nan, math.nan, math.nan
        ran = [[t for t in trials if not t.failure] for trials in (shorter, self.sweeps)]
        work = min((max(t.work for t in trials) for trials in ran if trials), default=math.nan)
        first = [] if self.shipped.failure else [self.shipped]
        steps, sweeps = (
            _error_at(work, first + trials, self._least) if trials else math.inf for trials in ran
        )
        return work, steps, sweeps

    @property
    def _least(self) -> float:
        """The uncertainty of errors, which have a logarithm [m]."""
        return max(self.reference.error, float(np.finfo(float).tiny))

    # --- tables and data -------------------------------------------------------------------------

    @property
    def units(self) -> dict[str, str]:  # type: ignore[override]
        """The units of the columns of `table`."""
        return dict.fromkeys(("error", "median", "largest"), self.measure.unit)

    def words(self, error: float) -> str:
        """Format an error in the unit of the quantity."""
        return self.measure.words(error)

    @property
    def title(self) -> str:
        """The scene measured."""
        return f"{self.name}: convergence over time steps and sweeps"

    @property
    def setup(self) -> str:
        """The runs that were made."""
        return f"Settings: {label(self.settings)}. {self.reference.words}"

    @property
    def rows(self) -> list[Trial]:
        """The trials: time steps, sweeps, converged forces."""
        return [*self.dts, *self.sweeps, self.solved]

    @property
    def table(self) -> Table:
        """One row for each run; work in operations per simulated second."""
        named = [(f"dt {seconds(trial.dt)}", trial) for trial in self.dts]
        named += [(f"{dict(t.change.settings)['sweeps']} sweeps", t) for t in self.sweeps]
        named.append(("converged forces", self.solved))
        names = ("error", "median", "largest", "work", "failure")
        records = [{"settings": words} | trial.record() for words, trial in named]
        failed = any(record["failure"] for record in records)
        columns = ["settings", *(names if failed else names[:-1])]
        heading = f"All else as shipped: {self.measure.error_words}{self.measure.in_unit}"
        return Table(records, columns, dict.fromkeys(names[:-1], ".2e"), heading=heading)

    def details(self) -> dict[str, Any]:
        """Return the verdict and the parts of the error."""
        return {
            "verdict": self.verdict,
            "better": self.better,
            "of_the_time_step": self.solved.error,
            "of_the_sweeps": None if self.ending is None else self.ending.solver,
            "at_equal_work": dict(
                zip(("work", "smaller_steps", "more_sweeps"), self.at_equal_work, strict=True)
            ),
            "reference": self.reference.settings.as_dict(),
            "reference_error": self.reference.error,
            "size": self.size,
            "ending": self.ending,
            "findings": [finding.record() for finding in self.findings],
        }

    def __repr__(self) -> str:
        return f"<Convergence of {self.name}: {self.verdict}>"

    # --- sentences -------------------------------------------------------------------------------

    @property
    def sentences(self) -> list[str]:
        """The verdict with both parts of the error, and what to increase."""
        sentences = until_in_words(self.reference.growth.ends, self.horizon)
        sentences += [self._diverging() if self.ending is None else self._verdict(self.ending)]
        if self.has_rows:
            sentences.append(self._what_to_increase())
        sentences += [finding.text for finding in self.findings]
        return [sentence for sentence in sentences if sentence]

    def _verdict(self, ending: Ending) -> str:
        solver, starts = ending.solver, len(self.shipped.starts)
        worst = f" in the worst of {counted(starts, 'start')}" if starts > 1 else ""
        error = f"{self._error(self.solved)}{worst}"
        step = f"The time step causes an error of {error}{self._shorter()}."
        if not self.has_rows:
            none = "No contact, limit or other row was ever active, so sweeps have no effect."
            return f"{none} {step}"
        rms = "" if self.measure.quantity.reduction else " (RMS)"
        distance = f"{self.words(solver)}{rms} from the motion with converged forces"
        if self.verdict == "under-solved":
            end = self._end(ending)
            alone = f"The time step alone causes an error of {error}."
            return f"Under-solved: {end} Over the motion it is {distance}. {alone}"
        fine = "the solver is fine." if solver < 1e-9 * self.scale else f"the motion is {distance}."
        return f"Solved: {fine} {step}"

    def _shorter(self) -> str:
        """Name the longest step that about halves the error, or state that none does."""
        tried = [t for t in self.dts if t.dt < self.shipped.dt and not t.failure]
        if self.shipped.error <= 2 * self.reference.error:
            return ""
        better = [trial for trial in tried if trial.error <= 0.6 * self.shipped.error]
        if better:
            best = max(better, key=lambda trial: trial.dt)
            return f"; a dt of {seconds(best.dt)} leaves {self._error(best)}"
        if not tried:
            return ""
        least = min(tried, key=lambda trial: trial.dt)
        return f", which shorter steps, down to {seconds(least.dt)}, hardly lower"

    def _end(self, ending: Ending) -> str:
        """Describe the end of an under-solved motion."""
        distance = f"{metres(ending.apart)} from where converged forces take it"
        if ending.apart <= NOTABLE * self.size:
            return "the motion differs on the way, but ends in the same place."
        # A resting body moves less than a tenth of the distance.
        if ending.speed <= 0.1 * ending.apart / self.horizon:
            return f"{ending.body} settles at a wrong fixed point, {distance}."
        return f"{ending.body} ends {distance}, at {speed(ending.speed)}."

    def _diverging(self) -> str:
        if not self.shipped.failure:
            return (
                f"Diverging: with converged forces the motion fails ({self.solved.failure}); it "
                "runs only because sweeps are too few."
            )
        why = f"Diverging: {self.shipped.failure}."
        if not self.solved.failure:
            return f"{why} With converged forces at the same time step it runs: use more sweeps."
        smaller = [t.dt for t in self.dts if not t.failure and t.dt < self.shipped.dt]
        if smaller:
            return (
                f"{why} Converged forces do not help; a time step of {seconds(max(smaller))} does. "
                "`stepcore diagnose` names the element that limits it."
            )
        if all(trial.dt >= self.shipped.dt for trial in self.dts):
            return f"{why} Converged forces do not help; smaller time steps were not run."
        return f"{why} Neither converged forces nor the smaller time steps tried help."

    def _exceeds_uncertainty(self, trial: Trial) -> bool:
        return trial.error > self.reference.error * (1 + 1e-9)

    def _error(self, trial: Trial) -> str:
        error = self.words(trial.error)
        exact = self._exceeds_uncertainty(trial) or error.startswith("<")
        return error if exact else f"at most {error}"

    def _what_to_increase(self) -> str:
        """Compare smaller steps and more sweeps at equal work."""
        work, steps, sweeps = self.at_equal_work
        if math.isnan(work):
            return "Both smaller steps and more sweeps fail." if math.isinf(steps) else ""
        if max(self.shipped.error, steps, sweeps) <= self._least * (1 + 1e-9):
            least = self.words(self.reference.error)
            return f"With more sweeps or smaller steps no error exceeds the uncertainty, {least}."
        answer = {"neither": "Smaller steps and more sweeps are equally accurate"}
        words = answer.get(self.better, f"Use {self.better}")
        price = "" if self.shipped.failure else f" ({times(work / self.shipped.work)} the shipped)"
        left = ["fail" if math.isinf(x) else f"leave {self.words(x)}" for x in (steps, sweeps)]
        return f"{words}: at equal work{price}, smaller steps {left[0]}, more sweeps {left[1]}."


def _error_at(work: float, trials: Sequence[Trial], least: float) -> float:
    """Return the error of trials at a work, interpolated on log axes; `least`: uncertainty."""
    points = sorted((t.work, max(t.error, least)) for t in trials)
    x, y = np.log(np.array(points).T)
    return float(np.exp(np.interp(math.log(work), x, y)))


@measurement()
def converge(
    model: Source,
    motion: Motion | str | None = None,
    *,
    quantity: Quantity | str | Callable[..., Any] | None = None,
    engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> Convergence:
    """Find which part of the error comes from the time step and which from the sweeps.

    `converge` runs the motion as shipped, with converged forces, at other time steps, and with more
    sweeps, and names what to increase. Errors are distances from the scene's converged motion in
    the worst start, as in `stepcore.trade`.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name"). The model's settings
        are judged.
    motion: a `Motion`, or its fields as arguments. By default 3 starts and 1 s, or longer
        if it is not at rest by then; see `stepcore.experiment.horizon`.
    quantity: the quantity whose error is measured, such as "site/tip" or "max(contact/foot)", see
        `stepcore.experiment.Quantity`. By default the motion of all bodies (RMS distance, [m]).
    engine: "stepcore", or "mujoco", which also runs files that stepcore cannot load.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, or if no converged motion can be run.

    >>> from stepcore import lesson
    >>> tower = lesson.stack(1, "lesson", softness=0.0)
    >>> result = converge(tower, horizon=0.2, starts=1, progress=False)
    >>> result.verdict, result.better
    ('under-solved', 'more sweeps')
    """
    setup = set_up(converge, model, motion, fields, missing="nothing to solve", engine=engine)
    shipped, motion, workers = setup.engine.settings(SHIPPED), setup.motion, setup.workers
    if motion.control_dt is not None and not divides(shipped.dt, motion.control_dt):
        limit = f"must be a whole number of steps of {shipped.dt:g} s"
        raise ValueError(f"control_dt = {motion.control_dt:g}: {limit}")
    starts = motion.starts or STARTS
    motion = dataclasses.replace(motion, starts=starts)
    motion, far = settled_motion(setup.engine, motion, starts, EFFORT)
    period = motion.period(shipped.dt) or often(DT_RATIOS[0] * shipped.dt, shipped.dt, far.length)
    shared: dict[str, Any] = {"engine": setup.engine, "period": period, "workers": workers}
    study = Study(motion=motion, quantity=quantity, **shared)
    dts, sweeps, solved = other_steps(study), more_sweeps(shipped), converged_forces(study)
    truth = study.truth()
    has_rows = study.engine.has_rows(study.schedule)
    # The answer needs these two, so they run first.
    first, exact = study.run([SHIPPED, solved], bar="runs")
    workers.deadline.so_far(
        f"as shipped the error is {first.words(first.error)}, with converged forces "
        f"{first.words(exact.error)}, ± {first.words(truth.error)}; other settings are run now"
    )
    every = list(dict.fromkeys([SHIPPED, solved, *dts, *sweeps]))

    def done(changes: Sequence[Change]) -> list[Change]:
        return [change for change in changes if change in study.changes(study.starts)]

    with workers.deadline.stage(
        lambda: f"{len(every) - len(done(every))} of {len(every)} settings", SEARCHED
    ):
        study.tracks(every, study.starts, "runs")
    findings = list[Finding]()
    if engine == "stepcore":
        with workers.deadline.stage("the findings on the shipped settings"):
            findings = [*monitored(setup.model, study.schedule)[0]]
    with workers.deadline.closing():
        return Convergence(
            name=setup.name,
            settings=shipped,
            motion=dataclasses.replace(motion, horizon=study.schedule.horizon),
            horizon=study.schedule.horizon,
            shipped=first,
            solved=exact,
            dts=study.run(done(dts)),
            sweeps=study.run(done(sweeps)),
            has_rows=has_rows,
            reference=truth,
            measure=study.measure,
            size=study.size,
            scale=study.scale,
            ending=_ending(study, first, exact, truth),
            notes=[*(setup.model.scene.notes if setup.engine.known else ()), *study.schedule.notes],
            findings=findings,
            ran=far.after(study.motion_ran),
        )


def converged_forces(study: Study) -> Change:
    """Return the change to converged forces, as in the converged motion; the rest is as shipped."""
    engine = study.engine
    shipped, exact = engine.settings(SHIPPED), engine.ways(study.schedule, 1.0)[0].at(0)
    kept = {name: getattr(shipped, name) for name in ("dt", "integrator", "refsafe", "sleep")}
    return Change.between(engine.settings(exact.also(Change(**kept))), shipped)


def other_steps(study: Study) -> list[Change]:
    """Return the shipped settings at all time steps that divide the control period."""
    period, shipped = study.schedule.period, study.engine.dt
    steps = {f: f * shipped for f in DT_RATIOS if f * shipped <= period * (1 + 1e-9)}
    valid = {f: dt for f, dt in steps.items() if divides(dt, period)}
    return [SHIPPED if f == 1 else Change(dt=dt) for f, dt in valid.items()]


def more_sweeps(shipped: Any) -> list[Change]:
    """Return multiples of the shipped sweeps; empty for settings without a number of sweeps."""
    if shipped.solver != "pgs" or shipped.sweeps in ("auto", 0):
        return []
    return [Change(sweeps=factor * shipped.sweeps, cost_tolerance=0.0) for factor in SWEEP_RATIOS]


def _ending(study: Study, shipped: Trial, solved: Trial, truth: Truth) -> Ending | None:
    """Compare the ends of both motions in the start where converged forces matter most."""
    a, b = shipped.tracks, solved.tracks
    if a is None or b is None or shipped.failure or solved.failure:
        return None
    over = study.measure.error(a, b, truth.scored)
    # The last samples that can be predicted.
    last, times = truth.scored.sum(axis=1) - 1, study.schedule.times
    every = np.arange(len(last))
    gap = np.linalg.norm(a.com[every, last] - b.com[every, last], axis=-1)
    start, body = map(int, np.unravel_index(gap.argmax(), gap.shape))
    # The speed over the tenth of the motion before it.
    end = int(last[start])
    first = max(0, end - max(1, len(times) // 10))
    with np.errstate(invalid="ignore"):
        moved = a.com[start, end, body] - a.com[start, first, body]
        speed = float(np.linalg.norm(moved) / max(times[end] - times[first], 1e-300))
    index = study.engine.matter.moving[body]
    has_model = study.engine.known
    name = study.model.element_name("body", index) if has_model else f"body {index}"
    return Ending(start, name, float(gap.max()), speed, float(over.max()))
