"""Means: what settings change in the mean of a number of each run, over many starts.

The motion may be unpredictable: the reference is the limit of the mean, not of a trajectory. Two
methods refine it until another halving of the step changes the mean by less than a tenth of the
error, or than its confidence interval. A setting is accepted if the entire 95 % interval of its
difference from the reference is within ± error (an equivalence test), and is then tested once on
held-out starts.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepcore.deadline import PROVEN, SEARCHED
from stepcore.experiment.arguments import Setup
from stepcore.experiment.change import Change
from stepcore.experiment.choose import least
from stepcore.experiment.horizon import settled_motion
from stepcore.experiment.motion import Motion
from stepcore.experiment.outcomes import PILOT, Difference, Numbers, Outcome
from stepcore.experiment.predictable import converged_growth
from stepcore.experiment.quantity import Measure, Measures, Quantity
from stepcore.experiment.schedule import STARTS, time_steps
from stepcore.experiment.study import SHIPPED, Allowed, Study
from stepcore.measure.trade.search import MARGIN, usable_steps
from stepcore.report.result import Result
from stepcore.report.settings import label, solver_words
from stepcore.report.table import Table
from stepcore.report.units import counted, percent, round_number, seconds
from stepcore.report.verdict import Verdict

# The default number of starts, and the most.
RUNS, MOST = 256, 4096
# The change of the reference's mean that ends its refinement, as a share of the error.
SHARE = 0.1
# The most rungs of the reference, each with half the time step of the one before.
RUNGS = 8
# The half width of an interval that resolves an error, as a share of it.
RESOLVED = 0.5
# Neighbouring time steps of a family differ by at least this factor: intervals resolve no less.
RATIO = 1.25
# The share of the time after which the number of starts grows no more.
SETTLED = 0.45
# The number of choices that may be tested on held-out starts, and of cheaper settings named.
TESTS, REFUSALS = 3, 2


@dataclass(eq=False, repr=False)
class Outcomes(Result):
    """Settings by their effect on the mean of a number of each run; `trade` returns it.

    measure: the quantity, with its unit. motion: the motion of all runs. settings: as shipped.
    reference: the outcome of the settings of the converged mean. other: the difference of a second
    method from it. refined: how much the last halving of the reference's time step changed it.
    rows: all settings that ran, the cheapest first. shipped: the settings as shipped.
    error: the requested largest difference, or if there was none, the smallest that was resolved.
    requested: whether it was requested. half: half the width of the intervals that the starts give.
    chosen: the recommended settings, or None.
    proof: the difference of the recommended settings on held-out starts, or None.
    needed: the estimated number of starts that resolve the error.
    predictable: when the trajectory from the first start becomes unpredictable [s]; else inf.
    """

    kind = "outcomes"

    measure: Measure
    motion: Motion
    settings: Any
    horizon: float
    reference: Outcome
    other: Difference
    refined: Difference
    rows: list[Outcome]
    error: float
    requested: bool
    half: float
    needed: float
    chosen: Outcome | None = None
    proof: Difference | None = None
    predictable: float = math.inf
    runs: int = 0
    shipped: Outcome = field(init=False)

    def __post_init__(self) -> None:
        self.shipped = next(row for row in self.rows if row.change == SHIPPED)

    @property
    def agreed(self) -> bool:
        """Whether the two methods have the same mean, up to the error or their uncertainty."""
        return not self.other.outside(self.error)

    @property
    def resolved(self) -> bool:
        """Whether the starts suffice for the error."""
        return self.half <= self.error

    @property
    def starts(self) -> int:
        """The number of starts, the pilot starts included."""
        return len(self.reference.numbers)

    @property
    def recommended(self) -> Outcome | None:
        """The settings to use, or None."""
        return self.chosen

    def best(self) -> Any:
        """Return the recommended Settings; ValueError if there are none."""
        if self.chosen is None:
            raise ValueError(f"no setting was shown to stay within {self.words(self.error)}")
        return self.chosen.settings

    def verdict(self, limit: float | str) -> Verdict:
        """Return whether the shipped settings change the mean by at most a limit.

        limit: a number, or a text in the unit of the quantity. The whole 95 % interval must be
        within it; the test fails if the whole interval is outside, and is else undecided.
        """
        allowed = self.measure.parse("verdict", "limit", limit, math.nan)
        test = f"{self._means} changed by at most {self.words(allowed)}"
        difference, failed = self.shipped.difference, self.shipped.failed
        reason = f"{self._plus_minus(difference)} (95 %) over {counted(self.starts, 'start')}"
        if failed or difference.outside(allowed):
            lost = f"; {counted(failed, 'run')} failed" if failed else ""
            return Verdict(test, False, reason + lost)
        passed = difference.within(allowed) and self.agreed
        needed = f", about {round_number(max(self.needed, 1.0), up=True):.0f} starts decide it"
        return Verdict(test, True if passed else None, reason + ("" if passed else needed))

    def words(self, value: float) -> str:
        """Format a number in the unit of the quantity."""
        return self.measure.words(value)

    @property
    def title(self) -> str:
        """The measured quantity in a few words."""
        return f"{self.name}: mean of {self.measure.quantity.name} over many starts"

    @property
    def setup(self) -> str:
        """The runs that were made, and the reference."""
        ran = f"{counted(len(self.rows), 'setting')} in {counted(self.runs, 'run')}"
        uncertainty = self._plus_minus(self.other)
        return (
            f"{ran}. Differences are measured from the converged mean "
            f"({label(self.reference.settings)}); a second method differs from it by {uncertainty}."
        )

    @property
    def sentences(self) -> list[str]:
        """The recommendation, its validation, and the effect of the shipped settings."""
        sentences = [*self._answer(), self._as_shipped()]
        if math.isfinite(self.predictable):
            sentences.append(
                f"Single trajectories are unpredictable after {seconds(self.predictable)}; the "
                "mean is not."
            )
        return sentences

    def _answer(self) -> Iterator[str]:
        means = self._means
        if not self.agreed:
            yield (
                f"There is no reference of the {means}: two methods differ by "
                f"{self._plus_minus(self.other)} at their shortest steps. Nothing is recommended."
            )
            return
        if not self.resolved:
            yield (
                f"A difference of {self.words(self.error)} in the {means} cannot be resolved with "
                f"{counted(self.starts, 'start')} (± {self.words(self.half)}); it needs about "
                f"{round_number(max(self.needed, 1.0), up=True):.0f}: --most, --effort and "
                "--seconds allow more."
            )
            return
        row = self.chosen
        within = f"a difference of at most {self.words(self.error)} in the {means}"
        if not self.requested:
            within += f" (the smallest that {counted(self.starts, 'start')} resolve)"
        if row is None:
            yield f"No setting tried was shown to have {within}."
        else:
            cost = f"{row.cost / self.shipped.cost:.2f}× the cost of the shipped settings"
            yield (
                f"Recommended for {within}: {row.change.label(self.settings)}. The difference is "
                f"{self._plus_minus(row.difference)} (95 %), for {cost} by counted work."
            )
            yield self._validated()
            if not self.measure.parts:
                yield self._distribution(row)
        over = [other for other in self.rows if row is None or other.cost < row.cost]
        over = [other for other in over if other.difference.outside(self.error) or other.failed]
        if over:
            named = "; ".join(self._refused(other) for other in over[-REFUSALS:])
            more = len(over) - REFUSALS
            yield f"Cheaper settings that exceed it: {named}" + (
                f"; and {counted(more, 'other')}." if more > 0 else "."
            )

    @property
    def _means(self) -> str:
        several = self.measure.parts
        return "means" if several else f"mean of {self.measure.quantity.name}"

    def _refused(self, row: Outcome) -> str:
        """Name settings that exceed the error, and by how much."""
        name = row.change.label(self.settings)
        if row.failed:
            return f"{name} ({self._failures(row)})"
        return f"{name} ({self._plus_minus(row.difference)})"

    def _failures(self, row: Outcome) -> str:
        low, high = row.failing
        share = f"{percent(low)} to {percent(high)}"
        return (
            f"{row.failed} of {counted(len(row.numbers), 'run')} fail, {share} with 95 % confidence"
        )

    def _validated(self) -> str:
        """Describe the test on held-out starts."""
        if self.proof is None:
            return "It was not tried on held-out starts."
        starts, apart = counted(self.proof.starts, "held-out start"), self._plus_minus(self.proof)
        if self.proof.within(self.error):
            return f"It holds on {starts}: {apart}."
        if self.proof.outside(self.error):
            return f"It does NOT hold on {starts}: {apart}."
        return f"It is undecided on {starts}: {apart}; more starts decide it (--starts)."

    def _distribution(self, row: Outcome) -> str:
        """Compare the spread and the distribution of a row with the reference's."""
        ratio, low, high = row.spread
        far, limit = row.distance
        if math.isnan(ratio):
            return "The spread of the reference is zero."
        chance = "no more than" if far <= limit else "more than"
        return (
            f"Its standard deviation is {ratio:.2f} times the reference's ({low:.2f} to "
            f"{high:.2f}); the two distributions are {far:.2g} apart, {chance} by chance "
            f"({limit:.2g})."
        )

    def _as_shipped(self) -> str:
        row, named = self.shipped, f"As shipped ({label(self.settings)})"
        if row.failed == len(row.numbers):
            return f"{named} the simulation fails: {row.failure}."
        starts, apart = counted(len(row.numbers), "start"), self._plus_minus(row.difference)
        sentence = f"{named} the means differ by {apart} from the converged ones"
        if not self.measure.parts:
            sentence = (
                f"{named} the mean is {self.words(row.mean)} over {starts} (standard deviation "
                f"{self.words(row.sd)}), which differs by {apart} from the converged mean"
            )
        return f"{sentence}; {self._failures(row)}." if row.failed else f"{sentence}."

    def _plus_minus(self, d: Difference) -> str:
        """Format a difference of means with its interval, in the unit of each quantity."""
        if not math.isfinite(d.half):
            return "an unknown amount"
        return ", ".join(
            f"{part.words(each.value)} ± {part.words(each.half)}"
            + (f" of {name}" if d.parts else "")
            for name, (part, each) in self._differences(d).items()
        )

    def _differences(self, d: Difference) -> dict[str, tuple[Measure, Difference]]:
        """Return the difference of each quantity in its unit, by name."""
        if not isinstance(self.measure, Measures):
            return {self.measure.quantity.name: (self.measure, d)}
        parts = zip(self.measure.parts, d.parts, self.measure.allowed_errors, strict=True)
        return {part.quantity.name: (part, x.relative_to(1 / error)) for part, x, error in parts}

    @property
    def units(self) -> dict[str, str]:  # type: ignore[override]
        """The units of the columns of `table`."""
        columns = dict.fromkeys(("mean", "sd", "difference", "low", "high"), self.measure.unit)
        columns |= {part.quantity.name: part.unit for part in self.measure.parts}
        return columns | {"dt": "s", "cost": "us per simulated second"}

    @property
    def table(self) -> Table:
        """All settings, the cheapest first."""
        return Table(self._record(row) for row in self.rows)

    def _record(self, row: Outcome) -> dict[str, Any]:
        record = {"settings": self._name(row), "dt": row.dt} | row.record()
        if self.measure.parts and row.difference.parts:
            record |= {name: d.value for name, (_, d) in self._differences(row.difference).items()}
        return record

    def _name(self, row: Outcome) -> str:
        return row.change.label(self.settings)

    def tables(self, full: bool) -> list[Table]:
        """Return the table of all settings."""
        records = [self._shown(row) for row in self.rows]
        columns = [n for n in records[0] if n in ("", "dt") or any(r.get(n) for r in records)]
        apart = "difference: of the mean from the converged mean"
        if self.measure.parts:
            apart = f"{', '.join(self._of_each)}: differences of the means from the converged means"
        legend = (
            "s: shipped; r: recommended. dt [ms]; cost: by counted work, of the shipped settings'; "
            f"{apart}{self.measure.in_unit}, ± half of its "
            f"95 % interval, over {counted(self.starts - PILOT, 'start')}; "
            f"{'' if self.measure.parts else 'sd ratio: of standard deviations; '}failed: runs."
        )
        numbers = [name for name in columns if name not in ("", "integrator", "solver")]
        return [Table(records, columns, dict.fromkeys(numbers, ""), legend=legend)]

    @property
    def _of_each(self) -> list[str]:
        """The column of each of several quantities."""
        return [f"{part.quantity.name}{part.in_unit}" for part in self.measure.parts]

    def _shown(self, row: Outcome) -> dict[str, str]:
        """Return a row of the printed table."""
        d, s, ran = row.difference, row.settings, row.failed < len(row.numbers)
        record = {
            "": "s" * (row.change == SHIPPED) + "r" * (row is self.chosen),
            "dt": f"{1e3 * row.dt:.4g}",
            "integrator": s.integrator,
            "solver": solver_words(s),
            "cost": f"{row.cost / self.shipped.cost:.2f}×",
        }
        names = self._of_each or ["difference"]
        for name, (_, each) in zip(names, self._differences(d).values(), strict=True):
            finite = math.isfinite(each.half)
            half = f" ± {each.half:.2g}" if finite else ""
            record[name] = f"{each.value:+.3g}{half}" if ran else "failed"
        if not self.measure.parts:
            record["sd ratio"] = f"{row.spread[0]:.2f}" if ran else ""
        return record | {"failed": f"{row.failed}" if row.failed else ""}

    def details(self) -> dict[str, Any]:
        """Return the request, the reference and the recommendation as data."""
        return {
            "quantity": self.measure.quantity.name,
            "unit": self.measure.unit,
            "horizon": self.horizon,
            "starts": self.starts,
            "error": self.error,
            "requested": self.requested,
            "resolved": self.resolved,
            "needed": self.needed,
            "reference": self.reference.record(),
            "other_method": self.other.record(),
            "refined": self.refined.record(),
            "recommended": None if self.chosen is None else self.chosen.settings,
            "proof": None if self.proof is None else self.proof.record(),
            "predictable": self.predictable,
            "runs": self.runs,
        }

    def __repr__(self) -> str:
        return f"<Outcomes of {self.name}: {len(self.rows)} settings, {self.starts} starts>"


def trade_means(
    setup: Setup,
    quantity: Quantity,
    error: Allowed,
    most: int,
    effort: float,
    by: str,
    validate: bool,
    dts: Sequence[float | str] | None,
    grid: Callable[[Study, Sequence[float]], Sequence[Change]] | None,
) -> Outcomes:
    """Measure how settings change the mean of a number of each run, and recommend settings.

    The arguments are those of `stepcore.trade`; validate: whether to test the choice on held-out
    starts. grid: returns the settings to try, by time step; None for a search.

    Raises ValueError for fewer than 64 starts.
    """
    starts = setup.motion.starts or min(RUNS, most)
    if starts < 2 * PILOT:
        raise ValueError(
            f"starts = {starts}: must be at least {2 * PILOT} for a mean, because {PILOT} of them "
            'decide how means are compared; statistic="worst" judges each start'
        )
    motion, horizon = settled_motion(setup.engine, setup.motion, STARTS, effort)
    held_period = motion.period(setup.engine.dt)
    steps, period = time_steps(setup.engine.dt, dts, held_period, horizon.length)
    study = Study(
        motion=dataclasses.replace(motion, starts=starts),
        quantity=quantity,
        engine=setup.engine,
        period=period,
        effort=effort,
        by=by,
        workers=setup.workers,
    )
    study.measure.check_scalar()
    target = None if error is None else study.error_of("trade", error)
    search = _Search(study, starts, max(most, starts), held_period is not None, target)
    deadline = setup.workers.deadline
    search.refer()
    with deadline.stage("more starts", SETTLED):
        search.resolve()
    with deadline.stage("some of the settings", SEARCHED):
        if grid is None:
            search.choose()
        else:
            search.choose_from(grid(study, steps))
    if validate:
        with deadline.stage("the test on held-out starts", PROVEN):
            search.validate()
    if not quantity.plays:
        with deadline.stage("when trajectories become unpredictable"):
            search.predict()
    return search.result(
        name=setup.name,
        motion=motion,
        ran=quantity.words if quantity.plays else horizon.after(study.motion_ran),
        notes=[*study.schedule.notes, *(setup.model.scene.notes if setup.engine.known else ())],
    )


class _Search:
    """The search for the cheapest settings whose mean is within the error."""

    def __init__(
        self, study: Study, count: int, most: int, held_period: bool, target: float | None
    ) -> None:
        self.study, self.count, self.most, self.target = study, count, most, target
        self.numbers, self.steps = Numbers(study), usable_steps(study, held_period)
        self.tried = dict[Change, Outcome]()
        self.chosen: Outcome | None = None
        self.proof: Difference | None = None
        self.predictable, self.needed = math.inf, math.nan

    @property
    def error(self) -> float:
        """The requested error, or the smallest round one that the starts resolve."""
        if self.target is not None:
            return self.target
        return round_number(max(self.half / RESOLVED, 1e-12), up=True)

    @property
    def half(self) -> float:
        """Half the width of the interval that the starts resolve."""
        rows = self.shipped, self._outcome(self.second)
        halves = [row.difference.half for row in rows if math.isfinite(row.difference.half)]
        return max(halves, default=math.inf)

    def refer(self) -> None:
        """Find the converged mean by two methods."""
        ways = [way for way in self.study.engine.ways(self.study.schedule, 1.0) if way.fixed][:2]
        limits = [self._settled(way.at) for way in ways]
        # The method that its last halving changed least.
        limits.sort(key=lambda limit: limit[1].bound)
        (self.finest, self.refined), (self.second, _) = limits[0], limits[-1]
        self._compare()

    def _settled(self, at: Callable[[int], Change]) -> tuple[Change, Difference]:
        """Halve the time step until that changes the mean no more; return the finer change."""
        enough = SHARE * (self.target or 0.0)
        change, last = at(0), None
        (before,) = self.numbers.of([change], self.count, "the converged mean")
        for rung in range(1, RUNGS):
            change = at(rung)
            (now,) = self.numbers.of([change], self.count, "the converged mean")
            last = self.numbers.compare(before, now)
            before = now
            settled = abs(last.value) <= max(enough, last.half) and np.isfinite(now).all()
            if (settled and rung > 1) or not self.study.affords(at(rung + 1), self.count):
                break
        assert last is not None
        if not np.isfinite(before).any():
            raise ValueError(
                f"every run fails at shorter steps too: {self.numbers.failures[change]}"
            )
        return change, last

    def _compare(self) -> None:
        """Compare the two methods and the shipped settings with the reference."""
        self.reference, second = self.numbers.of([self.finest, self.second], self.count)
        self.other = self.numbers.compare(self.reference, second)
        self.shipped = self._outcome(SHIPPED)

    @property
    def uncertainty(self) -> float:
        """The uncertainty of the reference's mean, where the two methods show a difference."""
        return abs(self.other.value) if self.other.significant else 0.0

    def _outcome(self, change: Change) -> Outcome:
        if change not in self.tried or len(self.tried[change].numbers) != len(self.reference):
            self.tried[change] = self.numbers.outcome(change, self.reference, self.uncertainty)
        return self.tried[change]

    def resolve(self) -> None:
        """Double the number of starts until the error can be resolved."""
        while True:
            sd = float(np.nanmax([self.shipped.difference.sd, self.other.sd]))
            half = self.half
            if self.target is None:
                return
            self.needed = (2 * sd / (RESOLVED * self.target)) ** 2 + PILOT
            more = 2 * self.count
            if half <= RESOLVED * self.target or more > self.most:
                return
            if not self.study.affords(self.finest, self.count):
                return
            self.numbers.of([self.finest, self.second, SHIPPED], more, "more starts")
            self.count = more
            self._compare()

    @property
    def agreed(self) -> bool:
        return not self.other.outside(self.error)

    def choose(self) -> None:
        """Find the fewest steps of each family that hold; the cheapest family first."""
        study, limit = self.study, self.study.cost(self.finest)
        if not self.agreed or self.half > self.error:
            return
        self.chosen = self.shipped if self.shipped.within(self.error) else None
        shipped = study.steps()
        families = study.engine.families(study.schedule)
        rates = {family: study.cost(self._at(family, shipped)) / shipped for family in families}
        for family in sorted(families, key=rates.__getitem__):
            most = limit if self.chosen is None else MARGIN * self.chosen.cost
            ladder = [n for n in self.steps if n * rates[family] <= most]
            if ladder and study.affords(self._at(family, shipped), self.count):
                self._least(family, ladder, shipped)

    def choose_from(self, changes: Sequence[Change]) -> None:
        """Try all of some changes, and keep the cheapest setting that holds."""
        rows = [self.shipped, *(self._outcome(c) for c in changes if self._affords(c))]
        held = [row for row in rows if row.within(self.error)]
        if self.agreed and self.half <= self.error and held:
            self.chosen = min(held, key=lambda row: row.cost)

    def _affords(self, change: Change) -> bool:
        return self.study.affords(change, self.count)

    def _least(self, family: Change, ladder: Sequence[int], shipped: int) -> None:
        """Try the steps of a family, and keep the cheapest setting that holds."""

        def excess(steps: int) -> float:
            change = self._at(family, steps)
            if not self.study.affords(change, self.count):
                return math.inf
            row = self._outcome(change)
            better = self.chosen is None or row.cost < self.chosen.cost
            if row.within(self.error) and better:
                self.chosen = row
            return math.inf if row.failed else row.difference.bound

        least(ladder, excess, self.error, shipped, ratio=RATIO)

    def _at(self, family: Change, steps: int) -> Change:
        """Return a family at a number of steps in a control period."""
        dt = self.study.schedule.period / steps
        same = math.isclose(dt, self.study.engine.dt, rel_tol=1e-9)
        return family if same else family.also(Change(dt=dt))

    def validate(self) -> None:
        """Test the choice on as many held-out starts; if it fails, test the next."""
        for _ in range(TESTS if self.chosen is not None else 0):
            row, first = self.chosen, self.count
            assert row is not None
            if not self.study.affords(self.finest, self.count):
                return
            reference, numbers = self.numbers.of([self.finest, row.change], 2 * first, "held-out")
            apart = self.numbers.compare(reference[first:], numbers[first:])
            self.proof = apart.widened(self.uncertainty)
            held = self.proof.within(self.error)
            rest = [
                other
                for other in self.tried.values()
                if other.cost > row.cost and other.within(self.error)
            ]
            if held or not rest:
                return
            self.chosen = min(rest, key=lambda other: other.cost)

    def predict(self) -> None:
        """Measure when the trajectory from the first start becomes unpredictable."""
        study = self.study
        way = study.engine.ways(study.schedule, 1.0)[0]
        growth, _ = converged_growth(
            study.engine, (way.at(k) for k in (1, 2)), study.schedule, [0], study.size
        )
        self.predictable = growth.overall

    def result(self, **about: Any) -> Outcomes:
        """Return the result."""
        study = self.study
        # Rows of fewer starts ran before their number was doubled.
        rows = [row for row in self.tried.values() if len(row.numbers) == len(self.reference)]
        return Outcomes(
            **about,
            measure=study.measure,
            settings=study.engine.settings(SHIPPED),
            horizon=study.schedule.horizon,
            reference=self._outcome(self.finest),
            other=self.other,
            refined=self.refined,
            rows=sorted(rows, key=lambda row: row.cost),
            error=self.error,
            requested=self.target is not None,
            half=self.half,
            needed=self.needed,
            chosen=self.chosen,
            proof=self.proof,
            predictable=self.predictable,
            runs=study.runs,
        )
