"""`Study`: runs changes of one scene in one motion, and scores them against the converged motion.

Measurements that compare settings use a Study: vary (a list of `Change`s), run, score (`Trial`s),
choose (`stepcore.experiment.choose`), validate on held-out starts, report.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import Any, Unpack, overload

import numpy as np

from stepcore import checks, deadline
from stepcore.engine.model import Model
from stepcore.engine.norm import Tracks
from stepcore.engine.parameters import own_value
from stepcore.experiment.answer import Answer
from stepcore.experiment.arguments import Workers
from stepcore.experiment.change import Change
from stepcore.experiment.engines import Engine, check_repeatable
from stepcore.experiment.judge import Judge
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.mujoco_engine import engine_of
from stepcore.experiment.pairs import Motions
from stepcore.experiment.price import OPERATION, OVERHEAD, computing_time
from stepcore.experiment.quantity import Measure, Measures, Quantity, Wanted
from stepcore.experiment.schedule import STARTS, Schedule, check_divide, time_steps
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import PATIENCE, SHARE, Converging, Truth
from stepcore.report import units
from stepcore.report.units import counted, metres, rounded, seconds

# Starts that run together: the worlds of a vector register.
TOGETHER = STARTS
# The default effort, the most operations of a whole study: about half a minute of a core.
EFFORT = 1e11
# An operation of adaptive steps, which run one world at a time, takes as long as this many
# operations in lanes: 0.5 ns and 0.33 ns on dm_control's walker.
LANES = 1.5
SHIPPED = Change()
# An allowed error as an argument: of several quantities one for each.
Allowed = float | str | Sequence[float | str] | None


class Study:
    """Runs changes of one scene in one motion, scores them, and keeps the runs.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    motion: a `Motion`, its kind ("hold"), or its fields as arguments (``horizon=0.5``); by default
        one that the machine could make, of about one second.
    quantity: the quantity whose error is measured, a `Quantity` or its name, such as "site/tip" or
        "max(contact/foot)", or a function of the runs; by default the motion of all bodies. A list
        of several is judged together, by the largest error relative to its allowed error.
    engine: runs the changes: "stepcore", or "mujoco", which also runs files that stepcore cannot
        load; or an `Engine`, which has a scene already, so that `model` is not needed.
    period: the control period: seconds, or a text such as "8ms". Every time step divides it. By
        default the motion's, or four shipped time steps.
    effort: the most operations of the study. When they are spent, truths stay as they are.
    by: the cost of trials: "time" by their counted work, or "flops".
    workers: threads or an executor for the runs; see `stepcore.experiment.arguments.Workers`.

    schedule: the starts, the controls and the time grid of the motion. starts: the starts of the
    search, by index. spent: the operations counted until now. allowed: the operations that may be
    spent at present, at most `effort`. measure: the quantity in this scene, with its unit.

    For example, the error of two stiffnesses of a spring:

    >>> from stepcore import lesson
    >>> from stepcore.experiment import Change, Study
    >>> study = Study(lesson.spring())
    >>> changes = [Change({"joint/spring/stiffness": k}) for k in (20.0, 80.0)]
    >>> soft, hard = study.run(changes)
    >>> soft.error < hard.error
    True
    """

    @takes_motion()
    def __init__(
        self,
        model: Any = None,
        motion: Motion | str | None = None,
        *,
        quantity: Wanted = None,
        engine: Engine | str = "stepcore",
        period: float | str | None = None,
        effort: float = EFFORT,
        by: str = "time",
        workers: Workers | None = None,
        **fields: Unpack[MotionFields],
    ) -> None:
        checks.one_of("time", "flops")("study", "by", by)
        effort = checks.real(low=0)("study", "effort", effort)
        self.motion = Motion.of(motion, fields, Study)
        made = engine_of(model, engine, self.motion)
        measure = Measure.of(Quantity.of(quantity), made.matter, lambda: made.elements)
        self.engine = made.reading(measure.sources)
        shipped, self.size = self.engine.dt, self.engine.size
        if period is None:
            horizon = self.motion.horizon or 1.0
            period = time_steps(shipped, None, self.motion.period(shipped), horizon)[1]
        period, count = units.time("period", period), self.motion.starts or STARTS
        scheduled = self.engine.schedule or self.engine.scheduled(self.motion, period, count)
        self.schedule: Schedule = scheduled
        if measure.quantity.has_scalars:
            # Peaks are found between the usual samples too.
            self.schedule = dataclasses.replace(self.schedule, every=1)
        self.measure = measure.sampled(self.schedule.times)
        self.starts: tuple[int, ...] = tuple(self.schedule.indices)
        self.workers, self.effort, self.by = workers or Workers(), effort, by
        self.spent, self.runs, self.allowed = 0.0, 0, effort
        self._running = 0.0  # the time of the runs [s]
        self._tracks: dict[tuple[Change, int], Tracks] = {}
        # Adaptive runs aborted after too many force evaluations.
        self._given_up: set[Change] = set()
        self._truths: dict[Change, Converging] = {}
        self._judges: dict[Change, Judge] = {}
        self._blocks, self._dearer = 0, 1.0
        if self.schedule.control is not None:
            check_repeatable(self.model, self.schedule, self.schedule.control)

    @property
    def model(self) -> Model:
        """stepcore's model of the scene; ValueError if MuJoCo alone can load the scene."""
        return self.engine.model

    @property
    def motion_ran(self) -> str:
        """The motion of the search in words."""
        if not self.engine.known:
            drive = self.schedule.drive or "the controls given"
            return f"{drive}; in {self.engine.version} alone"
        schedule = self.schedule.part(0, len(self.starts))
        motion = motion_in_words(self.model, self.motion, schedule)
        return f"{motion}; in {self.engine.version}" if self.engine.version else motion

    @cached_property
    def scale(self) -> float:
        """The range of the quantity over the motion; the scene's size for the motion itself.

        Of several quantities it is the largest range relative to the allowed error. Raises
        ValueError for a quantity that does not change.
        """
        measure = self.measure
        if isinstance(measure, Measures):
            parts = zip(measure.parts, measure.allowed_errors, strict=True)
            return max(self._range(part) / error for part, error in parts)
        return self._range(measure)

    def _range(self, measure: Measure) -> float:
        """Return the range of one quantity over the motion."""
        if measure.quantity.is_motion:
            return self.size
        if measure.quantity.plays:
            settings, farthest = self.engine.settings(SHIPPED), self.engine.farthest(self.schedule)
            numbers, _ = measure.quantity.play(settings, range(STARTS), farthest)
            return abs(float(np.nanmean(numbers))) or 1.0
        width = measure.range(self._ranged)
        return width if math.isfinite(width) else self.size

    @cached_property
    def _ranged(self) -> Tracks:
        """The run of the first start that ranges are measured in."""
        way = self.engine.ways(self.schedule, self.size)[0]
        for change in (SHIPPED, *(way.at(k) for k in range(1, PATIENCE + 1))):
            (tracks,) = self.tracks([change], self.starts[:1])
            if not tracks.failures:
                break
        return tracks

    def as_length(self, error: float) -> float:
        """Return an error of the quantity as a length: as large a share of the scene's size [m]."""
        return error if self.measure.quantity.is_motion else error / self.scale * self.size

    def error_of(self, owner: str, value: object, name: str = "error") -> float:
        """Return an error in the quantity's unit: a number, "1mm", or "1%" of its range.

        Of several quantities the value is a list, with the allowed error of each; these become
        part of `measure`, and the result is 1.

        owner, name: the function and its argument, for the ValueError.
        """
        values = list(value) if isinstance(value, (list, tuple)) else [value]
        parts = self.measure.parts or (self.measure,)
        if isinstance(self.measure, Measures) and value == 1 and self.measure.allowed:
            return 1.0
        if len(values) != len(parts):
            names, count = self.measure.quantity.name, counted(len(values), "value")
            limit = f"one for each of {counted(len(parts), 'quantity')} ({names})"
            raise ValueError(f"{name}: has {count}: must be {limit}")
        errors = tuple(
            part.parse(owner, name, error, self._range(part) if "%" in str(error) else 1.0)
            for part, error in zip(parts, values, strict=True)
        )
        if not isinstance(self.measure, Measures):
            return errors[0]
        self.measure = dataclasses.replace(self.measure, allowed=errors)
        self.__dict__.pop("scale", None)
        return 1.0

    def value(self, path: str) -> Any:
        """Return the scene's value at a path: a number, or an array; see `Change`."""
        own = own_value(self.model, path)
        return own if own.ndim else float(own)

    def fresh(self, count: int) -> tuple[int, ...]:
        """Return the indices of new held-out starts, from which nothing has been run."""
        self._blocks += 1
        own, seed = self.schedule, self.motion.seed + 1_000_003 * self._blocks
        unseen = dataclasses.replace(self.motion, seed=seed)
        # The first start of every block is the keyframe itself, which the search uses.
        new = self.engine.scheduled(unseen, own.period, count + 1, own.horizon)
        first, self.schedule = len(own.starts), own.joined(new.part(1))
        return tuple(range(first, first + count))

    def steps(self, change: Change = SHIPPED) -> int:
        """Return the number of time steps in a control period.

        Raises ValueError, with the nearest valid steps, if the step does not divide the period.
        """
        dt = float(self.engine.settings(change).dt)
        check_divide([dt], self.schedule.period)
        return self.schedule.steps(dt)

    def price(self, change: Change, starts: int) -> float:
        """Return the operations of runs from some starts; inf if the settings are refused.

        Operations of adaptive steps weigh more.
        """
        try:
            settings = self.engine.settings(change)
        except ValueError:
            return math.inf
        alone = 1.0 if settings.accuracy is None else LANES
        work, steps = self.work(change), OVERHEAD / float(settings.dt)
        # If a change fails at once, no work can be counted: its steps count as empty.
        paid = steps + (work if math.isfinite(work) else 0.0)
        return alone * paid * self.schedule.horizon * starts

    def affords(self, change: Change, starts: int) -> bool:
        """Return whether runs from some starts are within the operations allowed at present."""
        return self.spent + self.price(change, starts) <= self.allowed

    def lasts(self, operations: float) -> float:
        """Estimate the run time of this many operations from the previous runs [s]."""
        return operations * (self._running / self.spent if self.spent else 1e-6 * OPERATION)

    def work(self, change: Change) -> float:
        """Return the operations of a simulated second.

        Adaptive steps are short at impacts, so their evaluations are counted in the runs made.
        Before the first run they are counted at some states, and multiplied by the largest factor
        by which runs at other accuracies took more.
        """
        counted = self.engine.work(change, self.schedule)
        if self.engine.settings(change).accuracy is None:
            return counted
        made = self._evaluations(change)
        if not made:
            return counted * self._dearer
        one = self.engine.evaluation(change, self.schedule)
        work = one * float(np.mean(made)) / self.schedule.horizon
        self._dearer = max(self._dearer, work / counted)
        return work

    def _evaluations(self, change: Change) -> list[float]:
        """Return the evaluations of the forces of runs with adaptive steps, by start."""
        runs = (self._tracks.get((change, start)) for start in self.schedule.indices)
        # The evaluations of an aborted run are extrapolated to the whole run.
        return [
            float(run.evaluations[0]) / max(_share(run), 1e-2)
            for run in runs
            if run is not None and run.evaluations is not None
            if not run.failures or change in self._given_up
        ]

    def cost(self, change: Change) -> float:
        """Return the cost of a change per simulated second: µs by counted work, or operations."""
        work = self.work(change)
        return work if self.by == "flops" else computing_time(work, self.engine.settings(change))

    def tracks(
        self, changes: Sequence[Change], starts: Sequence[int], bar: str | None = None
    ) -> list[Tracks]:
        """Run changes from some starts, unless they were run before; one result for each change.

        Starts run in parallel on the workers, in groups of eight, or up to three alone. A change
        that has failed from one of the starts is not run from the others, which then count as
        failed.
        """
        jobs = list[_Job]()
        for change in dict.fromkeys(changes):
            known = [self._tracks.get((change, start)) for start in starts]
            if any(own is not None and own.failures for own in known):
                continue
            todo = [s for s, own in zip(starts, known, strict=True) if own is None]
            # A register costs about as much as three starts that run alone, on threads.
            size = TOGETHER if len(todo) > 3 else 1
            parts = (todo[k : k + size] for k in range(0, len(todo), size))
            jobs += [(change, part, self._most(change, part)) for part in parts]
        follow = partial(_followed, self.engine, self.schedule)

        def took(indices: range, made: list[Tracks]) -> None:
            """Store runs as they come: a deadline may end the others."""
            done = jobs[indices.start : indices.stop]
            for (change, some, most), own in zip(done, made, strict=True):
                if own.failures and own.evaluations is not None and own.evaluations[0] >= most:
                    self._given_up.add(change)
                for k, start in enumerate(some):
                    self._tracks[change, start] = own.some([k])
                self.runs += len(some)
                # A run that fails costs its steps until then.
                self.spent += self.price(change, len(some)) * _share(own)

        begun = deadline.clock()
        self.workers.each(follow, jobs, bar, took=took)
        self._running += deadline.clock() - begun
        return [self._together(change, starts) for change in changes]

    def _most(self, change: Change, starts: Sequence[int]) -> float:
        """Return the number of force evaluations after which an adaptive run is aborted.

        With impacts the first run may cost a hundred times its estimate, so its limit is the effort
        that is allowed now. The others cost about as much as the first.
        """
        known = any(self.ran(change, start) for start in self.schedule.indices)
        if self.engine.settings(change).accuracy is None or known or len(starts) > 1:
            return math.inf
        one = self.engine.evaluation(change, self.schedule)
        room = max(self.allowed - self.spent, self.price(change, 1))
        return room / LANES / one if math.isfinite(one) else math.inf

    def changes(self, starts: Sequence[int]) -> list[Change]:
        """Return the changes for which `tracks` has the runs from some starts already."""
        every = dict.fromkeys(change for change, _ in self._tracks)
        return [change for change in every if self._known(change, starts)]

    def _known(self, change: Change, starts: Sequence[int]) -> bool:
        """Return whether a change was run from all of some starts, or has failed from one."""
        runs = [self._tracks.get((change, start)) for start in starts]
        made = [run for run in runs if run is not None]
        return len(made) == len(runs) or any(run.failures for run in made)

    def ran(self, change: Change, start: int) -> bool:
        """Return whether a change was run from a start."""
        return (change, start) in self._tracks

    def _together(self, change: Change, starts: Sequence[int]) -> Tracks:
        """Return the runs from some starts; runs that were not made are NaN and have failed."""
        known = [self._tracks.get((change, start)) for start in starts]
        made = [own for own in known if own is not None]
        if len(made) == len(known):
            return Tracks.joined(made)
        why = next(own.failures[0] for own in made if own.failures)
        return Tracks.joined([own or made[0].nothing(why) for own in known])

    def truth(
        self,
        error: float | str | None = None,
        starts: Sequence[int] | None = None,
        physics: Change = SHIPPED,
    ) -> Truth:
        """Return the converged motion, with an uncertainty of a tenth of an error if affordable.

        error: the error in question, in the unit of the quantity: metres, "1mm", or "0.1%" of the
            scene's size, or of the quantity's range; by default a tenth of the shipped settings'
            error.
        starts: by index; by default the search's. physics: the change of the modelled physics.

        If a deadline leaves no time for all starts of the search, the search has fewer afterwards.

        Raises ValueError if no converged motion can be run.
        """
        if isinstance(error, str):
            error = self.error_of("truth", error)
        if error is None:
            # The shipped settings run too.
            self.steps()
        own, goal = starts is None and physics == SHIPPED, None if error is None else SHARE * error
        starts = self.starts if starts is None else starts
        if physics not in self._truths:
            self.engine.compile(physics, self.schedule)
            self._truths[physics] = Converging(self, physics, starts[0], goal)
        truth = self._truths[physics].upto(starts, goal, fewer=own)
        if own:
            self.starts = truth.starts
        return truth

    @overload
    def run(
        self,
        changes: Change,
        starts: Sequence[int] | None = None,
        error: Allowed = None,
        bar: str | None = None,
        stability: bool = False,
    ) -> Trial: ...
    @overload
    def run(
        self,
        changes: Sequence[Change],
        starts: Sequence[int] | None = None,
        error: Allowed = None,
        bar: str | None = None,
        stability: bool = False,
    ) -> list[Trial]: ...
    def run(
        self,
        changes: Change | Sequence[Change],
        starts: Sequence[int] | None = None,
        error: Allowed = None,
        bar: str | None = None,
        stability: bool = False,
    ) -> Trial | list[Trial]:
        """Run changes from some starts, and score each against its converged motion.

        Settings are scored against the scene's converged motion. A change of the physics is scored
        against the converged motion of the changed model (its numerical error), and
        `Trial.modelled` is this motion's distance from the scene's (its modelling error).

        changes: one `Change`, for one `Trial`; or several, for a list.
        starts: by index; by default the search's.
        error: the error in question: metres, "1mm", or "0.1%" of the scene's size; of another
            quantity "2N", or "1%" of its range; a list with one for each of several quantities.
            A tenth of it is the target uncertainty of the converged motion.
        stability: whether to judge stability, too, by longer runs from the first start, one of
            them perturbed: `Trial.energy`, `growth`, `chatter`, and `failure` if a run gains
            energy, its perturbation grows, or it chatters.

        Raises ValueError before anything runs for a change that the scene or the engine does not
        have, with the nearest names, and for a step that does not divide the control period, with
        the nearest steps. Raises ValueError if no converged motion can be run.
        """
        if isinstance(changes, Change):
            return self.run([changes], starts, error, bar, stability)[0]
        if error is not None:
            error = self.error_of("run", error)
        for start in starts or ():
            if start not in self.schedule.indices:
                known = f"below {len(self.schedule.indices)}; fresh() makes others"
                raise ValueError(f"starts: {checks.shown(start)}: must be {known}")
        starts = self.starts if starts is None else starts
        for change in dict.fromkeys(changes):
            if not any(self.ran(change, start) for start in starts):
                self.steps(change)
                self.engine.compile(change, self.schedule)
        made = zip(changes, self.tracks(changes, starts, bar), strict=True)
        trials = [
            self.score(change, tracks, self.truth(error, starts, change.physics))
            for change, tracks in made
        ]
        return [self._judged(trial) for trial in trials] if stability else trials

    def judge(self, physics: Change = SHIPPED) -> Judge:
        """Return the judge of stability: the motion from the first start, at a short step.

        Its rows are solved to rounding. `Judge.outcome(settings, dt)` is the outcome of any step,
        also of one that does not divide the control period.

        physics: the change of the modelled physics.
        """
        if physics not in self._judges:
            period = None if self.schedule.control is None else self.schedule.period
            engine = self.engine.converged()
            engine = engine if physics == SHIPPED else engine.changed(physics)
            motions = Motions(engine, self.schedule.part(0, 1), self.size, self.engine.dt, period)
            # The shipped step may be beyond the limit, but rarely by a factor of 4.
            self._judges[physics] = Judge.of(motions, self.engine.dt / 4, smooth=True)
        return self._judges[physics]

    def _judged(self, trial: Trial) -> Trial:
        """Return a trial with its stability, judged against the changed model's motion."""
        settings = Change(**dict(trial.change.settings))
        outcome = self.judge(trial.change.physics).outcome(settings, trial.dt)
        return dataclasses.replace(
            trial, stability=outcome, failure=trial.failure or outcome.failure
        )

    def score(self, change: Change, tracks: Tracks, truth: Truth) -> Trial:
        """Score runs against a converged motion from the same starts."""
        measure, settings = self.measure, self.engine.settings(change)
        motions = tracks, truth.tracks, truth.scored
        modelled = None
        if change.models:
            whole = self.truth(truth.goal / SHARE, truth.starts)
            modelled = measure.error(truth.tracks, whole.tracks, whole.scored)
        return Trial(
            change=change,
            settings=settings,
            starts=truth.starts,
            # A run like the truth's would look exact, so no error is below the uncertainty.
            errors=np.maximum(measure.error(*motions), truth.unsure),
            parts=measure.errors(*motions) if isinstance(measure, Measures) else None,
            unsure=truth.unsure,
            largest=np.maximum(measure.largest(*motions), truth.unsure),
            work=self.work(change),
            cost=self.cost(change),
            failure=tracks.failure_from(truth.starts),
            tracks=tracks,
            modelled=modelled,
            measure=measure,
        )

    def score_everywhere(self, change: Change) -> Trial:
        """Score settings from all starts that they and the converged motion have run from."""
        known = self._truths[SHIPPED].known
        starts = [s for s in self.schedule.indices if s in known and self.ran(change, s)]
        (tracks,) = self.tracks([change], starts)
        return self.score(change, tracks, self.truth(math.inf, starts))

    def times(self, changes: Sequence[Change]) -> dict[Change, float]:
        """Measure the computing time of changes from the first start [µs per simulated second].

        The runs of all changes take turns, so that other load affects all equally; the least of
        several times is kept. A change that fails has none. The time of adaptive steps is scaled
        from the first start to all starts by their numbers of force evaluations.
        """
        times = dict[Change, float]()
        for _ in range(5):
            for change in dict.fromkeys(changes):
                spent = self.engine.seconds(change, self.schedule)
                if math.isfinite(spent):
                    times[change] = min(times.get(change, math.inf), spent)
        for change in times:
            made = self._evaluations(change) or [1.0]
            times[change] *= 1e6 / self.schedule.horizon * float(np.mean(made)) / made[0]
        return times

    def answer(
        self,
        title: str,
        sentences: Sequence[str],
        rows: Sequence[Mapping[str, Any]],
        units: Mapping[str, str] | None = None,
        plot: tuple[str, str] | None = None,
    ) -> Answer:
        """Return the answer to a question as a result: text, table, JSON, page and plot.

        title: the quantity measured. sentences: the answer first. rows: the numbers, by column.
        units: of the columns. plot: the columns along the axes; by default the first two that have
        numbers. Raises ValueError without rows of numbers.
        """
        cells = [(name, checks.number(value)) for row in rows for name, value in row.items()]
        columns = list(dict.fromkeys(name for name, value in cells if value is not None))
        if not columns:
            raise ValueError("rows: must have at least one column of numbers")
        return Answer(
            name=self.engine.title,
            ran=self.motion_ran,
            notes=self.schedule.notes,
            subject=title,
            answer=list(sentences),
            rows=list(rows),
            of_columns=dict(units or {}),
            axes=plot or (columns[0], columns[min(1, len(columns) - 1)]),
            motion=self.motion,
            settings=self.engine.shipped,
        )

    def __repr__(self) -> str:
        starts = counted(len(self.starts), "start")
        horizon = seconds(self.schedule.horizon)
        ran = counted(self.runs, "run")
        return f"<Study of {self.engine.title}: {horizon} from {starts}, {ran}>"

    def __str__(self) -> str:
        """Describe the scene, the motion, the steps that can be run, and the number of runs."""
        period, dt = self.schedule.period, self.engine.dt
        ran = f"{counted(self.runs, 'run')} so far."
        if SHIPPED in self._truths:
            known = self._truths[SHIPPED].error(self.starts)
            ran += f" The uncertainty of the converged motion is {self.measure.words(known)}."
        return "\n".join(
            [
                f"Study of {self.engine.title} under {self.engine.name}, size {metres(self.size)}.",
                f"The motion: {self.motion_ran}.",
                f"Time steps divide the control period of {seconds(period)}; the shipped one is "
                f"{seconds(dt)}.",
                ran,
            ]
        )

    def tell(self, wrong: float, moved: float, goal: float, needs: float) -> None:
        """Report the progress of a search for the converged motion.

        wrong: the error of the shipped settings. moved: the distance that the last refinement
        moved the motion. goal: its target. needs: the estimated operations until then.
        """
        if math.isfinite(wrong):
            words = self.measure.words
            said = f"error as shipped {words(wrong)}, ± {words(moved)}"
            wait = seconds(max(1.0, rounded(self.lasts(needs), 1)))
            self.workers.deadline.so_far(
                f"{said}: {words(moved / SHARE)} can be verified now, {words(goal / SHARE)} in "
                f"about {wait}"
            )


# Settings, the starts from which they run, and the evaluations after which they are aborted.
_Job = tuple[Change, list[int], float]


def _followed(engine: Engine, schedule: Schedule, job: _Job) -> Any:
    change, starts, most = job
    return engine.follow(change, dataclasses.replace(schedule, most=most), starts)


def _share(tracks: Tracks) -> float:
    return float(np.isfinite(tracks.com).mean())
