"""`Trade`: the trials and the recommendation of `trade`, in sentences, tables and data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore._core import Settings
from stepcore.deadline import SECONDS
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.change import Change
from stepcore.experiment.choose import Proof, frontier
from stepcore.experiment.motion import Motion, picklable
from stepcore.experiment.predictable import until_in_words
from stepcore.experiment.quantity import Measure
from stepcore.experiment.schedule import STARTS, Schedule
from stepcore.experiment.study import EFFORT, SHIPPED
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import SHARE, Truth
from stepcore.measure.monitors import Finding
from stepcore.measure.trade.search import COST, KNOWING, MARGIN, UNSURE, Search
from stepcore.report.report import SHORT, not_shown
from stepcore.report.result import Result
from stepcore.report.settings import solver_words, unlabelled
from stepcore.report.table import Table
from stepcore.report.units import (
    beginning,
    compact,
    computing,
    counted,
    operations,
    rounded,
    seconds,
)

if TYPE_CHECKING:
    from stepcore.viewing.live import View

# Default error of `Trade.best` [m].
ERROR = 1e-3
# The number of cheaper settings that exceed the error and are named in the answer.
REFUSALS = 2
# A slope of log error over log dt counts as an order if it deviates this little from 1, 2 or 4.
CLOSE = 0.15
UNITS = {
    "dt": "s",
    "accuracy": "m per simulated second",
    **dict.fromkeys(("error", "median", "largest", "unsure"), "m"),
    "work": "operations per simulated second",
    "cost": "us per simulated second",
}
FIELDS = (
    *("dt", "integrator", "solver", "sweeps", "precision", "tolerance", "warm_start"),
    *("cost_tolerance", "acceleration", "cone", "accuracy"),
)


@dataclass(eq=False, repr=False)
class Trade(Result):
    """The trade-off between cost and accuracy for one scene; `stepcore.trade` returns it.

    motion: the motion that every setting ran; schedule: its starts and controls.
    engine: "stepcore" or "mujoco".
    measure: the quantity whose error was measured, with its unit: by default the motion. Errors are
        in this unit.
    model: the scene as shipped; None for a file that only MuJoCo can load.
    reference: the converged motion, with its uncertainty.
    rows: every setting that ran, with the errors from all its starts; coarsest step first. `whole`
        has the rows that ran from all starts of the search.
    shipped: the trial of the settings as shipped.
    target, budget: the requested error or the requested budget.
    unsure: the uncertainty of the converged motion when the settings were chosen.
    verified: if the target cannot be verified, the least round error that can.
    chosen: the settings for `target`, or for `verified`, or for `budget`.
    proof: the validation of the chosen settings on held-out starts; None without one.
    by: "time" or "flops". times: measured computing times [µs per simulated second], by change.
    size: the size of the scene [m]. scale: 100 % of an error: the scene's size, or the range of the
        quantity.
    effort: the largest number of operations of the runs. ended: whether it ended the search.
    pace: the measured time of an operation [s].
    runs: the number of runs that the trade made.
    findings: problems of the shipped settings in the first start, such as creep; see `Finding`.
    chatter: joints that chatter there under the chosen settings.
    beside: the same trade with MuJoCo, if it was requested.
    parted: the distance of the two engines' converged motions in the worst start.
    """

    kind = "trade"

    motion: Motion
    model: Model | None
    schedule: Schedule
    engine: str = "stepcore"
    by: str = "time"
    target: float | None = None
    budget: float | None = None
    unsure: float = math.nan
    verified: float | None = None
    size: float = math.nan
    scale: float = math.nan
    measure: Measure = field(kw_only=True)
    rows: list[Trial] = field(default_factory=list)
    chosen: Trial | None = None
    proof: Proof | None = None
    times: Mapping[Change, float] = field(default_factory=dict)
    effort: float = EFFORT
    ended: bool = False
    pace: float = math.nan
    runs: int = 0
    moved: float = math.nan
    findings: Sequence[Finding] = ()
    chatter: Sequence[Finding] = ()
    beside: Trade | None = None
    parted: float = math.nan
    reference: Truth = field(init=False)
    shipped: Trial = field(init=False)

    def take(self, search: Search) -> None:
        """Copy the trials of a search without poses; the truth may be finer than at the choice."""
        self.reference = search.truth
        self.moved, self.ended, self.pace = search.moved, search.ended, search.study.lasts(1.0)
        self.score(search)
        if self.target is not None and (self.chosen is None or self.chosen.error > self.asked):
            # Use rows from fewer starts if the time was over before any ran from all.
            holds = [row for row in self.rows if row.error <= self.asked]
            by = (self.partial, lambda row: row.error > MARGIN * self.asked, COST)
            best = min(holds, key=lambda row: [rank(row) for rank in by], default=None)
            if self.chosen is None or (best is not None and not self.partial(best)):
                self.chosen = best

    def score(self, search: Search) -> None:
        """Score all rows from every start that they ran from."""
        self.schedule = search.study.schedule
        rows = {change: search.row(change, self.asked) for change in search.trials}
        self.rows = sorted(rows.values(), key=lambda trial: (-trial.dt, trial.cost))
        self.shipped = rows[SHIPPED]
        self.chosen = self.chosen and rows[self.chosen.change]

    def compare(self, beside: Trade) -> None:
        """Add the same trade with a second engine."""
        ours, theirs = self.reference, beside.reference
        both = [start for start in ours.starts if start in theirs.starts]
        ours, theirs = ours.part(both), theirs.part(both)
        scored = ours.scored & theirs.scored
        self.beside = beside
        self.parted = float(self.measure.error(ours.tracks, theirs.tracks, scored).max())

    def __getstate__(self) -> dict[str, Any]:
        state = dict(self.__dict__)
        if self.schedule.control is not None:
            control = picklable(self.schedule.control)
            controls = dataclasses.replace(self.schedule.controls, function=control)
            state["schedule"] = dataclasses.replace(self.schedule, controls=controls)
        return state

    @property
    def units(self) -> dict[str, str]:  # type: ignore[override]
        """The units of the columns of `table`."""
        columns = dict.fromkeys(("error", "median", "largest", "unsure"), self.measure.unit)
        return UNITS | columns | {part.quantity.name: part.unit for part in self.measure.parts}

    def words(self, error: float) -> str:
        """Format an error in the unit of the quantity."""
        return self.measure.words(error)

    # Rows and recommendations.

    @property
    def asked(self) -> float:
        """The error that settings are chosen for: `verified`, or else `target`."""
        return self.verified or self.target or self._usual

    @property
    def _usual(self) -> float:
        """The error that `best` uses without any request."""
        shipped = self.shipped.error
        return ERROR if self.measure.quantity.is_motion or math.isinf(shipped) else shipped

    @property
    def starts(self) -> int:
        """The number of starts of the search."""
        return len(self.shipped.starts)

    @property
    def horizon(self) -> float:
        """The simulated time [s]."""
        return self.schedule.horizon

    @property
    def settings(self) -> Settings:
        """The settings as shipped."""
        settings: Settings = self.shipped.settings
        return settings

    @property
    def recommended(self) -> Trial | None:
        """The settings for the requested error or budget; None without any."""
        return self.chosen if self.verified is None else None

    @property
    def nearest(self) -> Trial | None:
        """The settings for `verified`, if the requested error cannot be verified."""
        return None if self.verified is None else self.chosen

    @property
    def _searched(self) -> set[int]:
        """The starts of the search."""
        return set(self.reference.starts)

    def partial(self, row: Trial) -> bool:
        """Return whether a row ran from some starts of the search only; its error is a lower bound.

        The row exceeded the requested error there, or the effort did not suffice for the others.
        """
        return not self._searched <= set(row.starts)

    @property
    def whole(self) -> list[Trial]:
        """The rows that ran from all starts of the search."""
        return [row for row in self.rows if not self.partial(row)]

    @property
    def front(self) -> list[Trial]:
        """The settings that no others beat in both price and error, the cheapest first.

        They ran from all starts of the search.
        """
        return frontier(self.whole, COST)

    def missed(self, row: Trial) -> int:
        """Return the number of starts from which a row exceeds the requested error."""
        return int((~(row.errors <= self.asked)).sum())

    @property
    def refused(self) -> list[Trial]:
        """The settings that cost less than the chosen ones and exceed the requested error.

        They are sorted by the share of their starts that exceed it, then by cost.
        """
        chosen = self.chosen
        if chosen is None or self.target is None:
            return []
        some = [row for row in self.rows if row.cost < chosen.cost and row.error > self.asked]
        return sorted(some, key=lambda row: (self.missed(row) / len(row.starts), row.cost))

    @property
    def named(self) -> list[Trial]:
        """The settings that the answer names besides the shipped ones."""
        some = [self.chosen, self.next_better() if self.chosen is not None else None]
        asked = self.target is not None or self.budget is not None
        if self.chosen is None and not asked and not self.shipped.failure:
            some = [self.next_better(), self._same()]
        return [row for row in some if row is not None]

    @property
    def failures(self) -> list[Trial]:
        """The settings that failed; `Trial.failure` gives the reason."""
        return [row for row in self.rows if row.failure]

    @property
    def predictable(self) -> float:
        """The time when the first start becomes unpredictable [s]; inf if none does.

        Errors are measured before this time; see `stepcore.predict`.
        """
        return self.reference.growth.overall

    def error(self, row: Trial) -> float:
        """Return the error of the worst start that a row ran from.

        For the chosen settings it includes the held-out starts. It is inf if a run failed.
        """
        return row.error

    def best(self, error: float | str | None = None) -> Settings:
        """Return the cheapest Settings whose error in every start is at most `error`.

        error: metres, "1mm", or "0.1%" of the scene's size; of another quantity in its unit, or
            "1%" of its range. The default is the error that `trade`
            was called with. After a call with a budget, the most accurate settings within the
            budget are returned. After a call with neither, the default is 1 mm; of another quantity
            it is the error of the shipped settings.

        Raises ValueError, naming the smallest error reached, if no row is accurate enough.
        """
        row = self.recommended if error in (None, self.target) else None
        settings: Settings = (row or self.cheapest(error)).settings
        return settings

    def cheapest(self, error: float | str | None = None) -> Trial:
        """Return the row with the lowest price whose error is at most `error`; see `best`."""
        limit = self.target or self._usual
        if error is not None:
            limit = self._error_of(error)
        good = [row for row in self.whole if row.error <= limit]
        if not good:
            least = min((row.error for row in self.whole), default=math.inf)
            unit = self.measure.unit
            raise ValueError(
                f"error = {limit:g} {unit}: the smallest in this trade is {least:.3g} {unit}"
            )
        return min(good, key=lambda row: (row.cost, row.error))

    def next_better(self, error: float | str | None = None) -> Trial | None:
        """Return the cheapest row with at most half of an error; None if there is none.

        error: as in `best`; by default the error of the chosen settings, or of the shipped ones.
        """
        row = self.chosen or self.shipped
        half = (row.error if error is None else self._error_of(error)) / 2
        good = [row for row in self.whole if row.error <= half < math.inf]
        return min(good, key=COST) if good and half > 0 else None

    def _error_of(self, error: float | str) -> float:
        """Return an error in the unit of the quantity."""
        return self.measure.parse("best", "error", error, self.scale)

    def _same(self) -> Trial | None:
        """Return a notably cheaper row with at most the shipped error."""
        if math.isinf(self.shipped.error):
            return None
        row = self.cheapest(max(self.shipped.error, 1e-300))
        return row if row.cost < 0.9 * self.shipped.cost else None

    @property
    def orders(self) -> dict[str, float]:
        """The observed order of accuracy of each integrator: the slope of log error over log dt.

        It needs three or more rows that differ only in dt, with errors at least ten times the
        truth's uncertainty and below a tenth of the motion; only slopes near 1, 2 or 4 count.
        """
        lines: dict[Change, list[tuple[float, float]]] = {}
        for row in (row.part(self.reference.starts) for row in self.whole):
            plain = row.settings.precision == "f64" and row.settings.accuracy is None
            if plain and self.reference.error / SHARE < row.error < SHARE * self.moved:
                family = Change.between(row.settings.replace(dt=self.settings.dt), self.settings)
                lines.setdefault(family, []).append((row.dt, row.error))
        slopes: dict[str, list[float]] = {}
        for family, points in lines.items():
            if len(points) < 3:
                continue
            dts, errors = np.log(np.array(points)).T
            slope = float(np.polyfit(dts, errors, 1)[0])
            if min(abs(slope - order) / order for order in (1, 2, 4)) <= CLOSE:
                name = dict(family.settings).get("integrator", self.settings.integrator)
                slopes.setdefault(name, []).append(slope)
        return {name: float(np.median(some)) for name, some in slopes.items()}

    # Sentences.

    @property
    def title(self) -> str:
        """The measured quantity in a few words."""
        if self.measure.quantity.is_motion:
            return f"{self.name}: position error against cost"
        return f"{self.name}: {self.measure.error_words} against cost"

    @property
    def setup(self) -> str:
        """The number of settings and runs, and the converged motion, in one line."""
        tried = f"{counted(len(self.rows), 'setting')} in {counted(self.runs, 'run')}"
        ended = "; more were not tried, because --effort was spent" if self.ended else ""
        return f"{tried}{ended}. {self.reference.words}"

    @property
    def sentences(self) -> list[str]:
        """The recommendation, the error of the shipped settings, and the cost of less error."""
        said = until_in_words(self.reference.growth.ends, self.horizon)
        said += [*self._answer(), self._as_shipped()]
        if self.target is None and self.budget is None:
            said += self._improvements()
        if self.measure.quantity.is_scalar and math.isfinite(self.predictable):
            said.append("The mean over many starts may be known: --statistic mean measures it.")
        said += self._beside()
        return [*said, *(finding.text for finding in self.findings)]

    def _answer(self) -> Iterator[str]:
        target, row = self.target, self.chosen
        # Finer runs of the search may have increased the uncertainty.
        unsure = float(np.fmax(self.unsure, self.reference.error))
        if target is not None and unsure > (UNSURE if self.verified else 1.0) * target:
            well = "" if unsure > target else " well"
            lost = self.reference.unsure > target
            if row is not None and self.unsure <= target and lost.any() and not lost.all():
                # The motion may be uncertain from joined starts only: report the number of these.
                well = f" from {lost.sum()} of {counted(len(lost), 'start')}"
            verb = "was" if unsure > self.reference.error else "is"
            known = f"the uncertainty of the converged motion {verb} {self.words(unsure)}"
            known += " in the worst start"
            if not math.isfinite(unsure):
                known = "from some start no run converges"
            yield f"{self.words(target)} cannot be verified{well}: {known}. {self._surer()}"
        elif target is not None and self.verified is not None:
            yield f"No setting tried has an error of at most {self.words(target)} in every start."
        if row is not None:
            within = f"an error of at most {self.words(self.asked)}"
            if self.budget is not None:
                within = f"a cost of at most {self._amount(self.budget)} per simulated second"
            heading = "Best so far" if self._is_preliminary(row) else "Recommended"
            choice = f"{heading} for {within}: {self.label(row)}"
            if self.budget is None and row.error > self.asked:
                held, ran = len(row.starts) - self.missed(row), counted(len(row.starts), "start")
                choice = f"{heading} for {within} from {held} of {ran}: {self.label(row)}"
                if not any(other.error <= self.asked for other in self.whole):
                    choice = f"No setting tried has {within} in every start. The fewest exceed it "
                    choice += f"with {self.label(row)}"
            wrong, priced = self._wrong_in(row), self._priced_beside(row)
            yield f"{choice}. Its {self.measure.error_words} is {wrong}, for {priced}."
            if self.proof is not None:
                yield self.proof.words
            elif target is not None:
                also = ", and may miss the error from others" * (len(row.starts) < self.starts)
                yield f"It was not tried on held-out starts{also}."
            if self.refused:
                yield self._refusals()
            for finding in self.chatter:
                yield f"Under these settings {finding.text[0].lower()}{finding.text[1:]}"
            if self.engine == "mujoco" and row.change.settings and self._meets_request(row):
                yield f"In the file: {row.change.mjcf}"
            yield self._halved()
        elif target is not None:
            most = self.words(self.asked)
            yield f"No setting tried has an error of at most {most} in every start."
            done = [row for row in self.whole if row.error < math.inf]
            if done:
                least = min(done, key=lambda row: row.error)
                yield f"The smallest is {self._wrong(least)}: {self.label(least)}."
        elif self.budget is not None:
            yield f"No setting costs at most {self._amount(self.budget)} per simulated second."

    def _is_preliminary(self, row: Trial) -> bool:
        """Return whether a choice ran from fewer starts than requested, or was not validated."""
        return self._lacks_starts(row) or (self.target is not None and self.proof is None)

    def _lacks_starts(self, row: Trial) -> bool:
        # The schedule has held-out starts too.
        requested = 0 if self.motion is None else self.motion.starts or STARTS
        return len(row.starts) < max(requested, self.starts)

    def _meets_request(self, row: Trial) -> bool:
        """Return whether a choice meets the requested error or budget from all starts."""
        if self._lacks_starts(row) or row.failure:
            return False
        return self.target is None or (self.verified is None and row.error <= self.target)

    def _wrong_in(self, row: Trial) -> str:
        """Describe the error of a row in the worst start that it ran from."""
        ran, count = counted(len(row.starts), "start"), len(row.starts)
        if row.failure:
            rest = [float(error) for error in row.errors if error < math.inf]
            most = f" of at most {self.words(max(rest))} from {len(rest)} of {ran}" if rest else ""
            return (
                f"infinite, because a run fails ({beginning(row.failure)}){most and ', and'}{most}"
            )
        return f"{self._wrong(row)} " + (
            f"in the worst of {ran}" if count > 1 else "in the one start that ran"
        )

    def _refusals(self) -> str:
        """Name the cheaper settings that exceed the requested error, and from how many starts."""
        some = self.refused[:REFUSALS]
        named = "; ".join(
            f"{self.label(row)} ({self._least(row)}, from {self.missed(row)} of "
            f"{counted(len(row.starts), 'start')})"
            for row in some
        )
        more = len(self.refused) - len(some)
        others = f"; and {counted(more, 'other')}" if more else ""
        return f"Cheaper settings that exceed {self.words(self.asked)}: {named}{others}."

    def _least(self, row: Trial) -> str:
        """Return the error of a row in words, a lower bound if it ran from fewer starts."""
        if row.failure:
            return "fails"
        return f"at least {self.words(row.error)}" if self.partial(row) else self.words(row.error)

    def _surer(self) -> str:
        """Describe what is needed to verify the requested error."""
        truth = self.reference
        if not (math.isfinite(truth.needs) or truth.error < self.unsure):
            is_users = self.motion is not None and self.motion.is_users
            other = "a shorter piece of this motion" if is_users else "your own motion"
            return f"Shorter steps do not make it surer: try {other}."
        # The search may have reduced the uncertainty since, and spent the effort.
        needs = truth.needs if math.isfinite(truth.needs) else 0.0
        effort = rounded(self.effort + max(needs / KNOWING, 0.01 * self.effort), 1, up=True)
        spent = rounded(max(1.0, self.pace * effort), 1)
        if spent > 3600:
            return f"That takes about {seconds(spent)} with shorter steps: try a shorter --horizon."
        longer = f" --seconds {2 * spent:.0f}" if 2 * spent > SECONDS["trade"] else ""
        also = f"--effort {effort:.0e}{longer} (in Python effort=)"
        return f"With {also} it may be: about {seconds(spent)}."

    def _halved(self) -> str:
        better = self.next_better()
        if better is None:
            return "No setting tried halves that error."
        cost = f"{self._multiple(better)}: {self.label(better)}"
        return (
            f"Half that error or less comes at {cost}, with an error of {self.words(better.error)}."
        )

    def _as_shipped(self) -> str:
        """Describe the error of the shipped settings, in the worst and in the median start."""
        row = self.shipped
        what = f"As shipped ({self.label(row)})"
        if row.failure:
            return f"{what} the simulation fails: {beginning(row.failure)}."
        where, count = "", len(row.starts)
        if count > 1:
            median = f"start {row.worst}; median {self.words(row.median)}"
            where = f" in the worst of {count} starts ({median})"
        if math.isinf(row.error):
            return (
                f"{what} the {self.measure.error_words} is {self.words(row.median)} in the median "
                f"of {count} starts, for {self._priced(row)}; from start {row.worst} no run "
                "converges."
            )
        scored = min(self.horizon, self.predictable)
        over = seconds(self.horizon) if scored == self.horizon else "what can be predicted"
        return (
            f"{what} the {self.measure.error_words} over {over} is {self._wrong(row)}{where}, for "
            f"{self._priced(row)}.{self._largest(row)}"
        )

    def _largest(self, row: Trial) -> str:
        """Describe the largest error at any time; "" for a scalar, which has one error per run."""
        if self.measure.quantity.reduction:
            return ""
        of = " of a body" if self.measure.quantity.is_motion else ""
        return f" The largest error{of} at any time is {self.words(float(row.largest.max()))}."

    def _improvements(self) -> Iterator[str]:
        """Yield the cost of half the shipped error, and of the shipped error itself."""
        if self.shipped.failure:
            ran = [row for row in self.whole if not row.failure]
            if ran:
                least = min(ran, key=COST)
                wrong = f"with an error of {self._wrong(least)}"
                yield f"The cheapest setting that runs is {self.label(least)}, {wrong}."
            return
        yield self._halved()
        same = self._same()
        if same is not None and same is not self.next_better():
            yield (
                f"The same error or less comes at {self._multiple(same)}: {self.label(same)}, with "
                f"an error of {self.words(same.error)}."
            )

    def _beside(self) -> Iterator[str]:
        """Describe whether MuJoCo converges to the same motion, and its settings' errors."""
        other = self.beside
        if other is None:
            return
        ours, theirs = self.reference.error, other.reference.error
        if self.parted <= ours + theirs:
            known = self.words(max(ours, theirs))
            yield (
                "MuJoCo computes the same physics: both converge to one motion, with an "
                f"uncertainty of {known}."
            )
        else:
            yield (
                f"MuJoCo does NOT compute the same physics: the converged motions are "
                f"{self.words(self.parted)} apart, with uncertainties of {self.words(ours)} and "
                f"{self.words(theirs)}."
            )
        said = f"As shipped MuJoCo's error is {other._wrong(other.shipped)}"
        yield f"{said}{self._there(other.shipped)}{self._times(SHIPPED)}."
        row = other.chosen
        if row is not None and row.change != SHIPPED:
            within = f"an error of at most {self.words(other.asked)}"
            settings = None if self.chosen is None else self.chosen.change
            said = f"Its cheapest settings for {within} are {other.label(row)}"
            yield f"{said}, with {self.words(row.error)}{self._times(row.change, settings)}."
        elif self.target is not None and row is None:
            yield f"None of its settings has an error of at most {self.words(other.asked)}."

    def _there(self, theirs: Trial) -> str:
        """Return the shipped error from MuJoCo's starts, if other starts joined the search."""
        row = self.shipped
        errors = [e for s, e in zip(row.starts, row.errors, strict=True) if s in theirs.starts]
        if row.failure or len(errors) == len(row.starts):
            return ""
        ours = self.words(max(errors))
        return f" in the worst of {len(errors)} starts (stepcore's from these: {ours})"

    def _times(self, theirs: Change, ours: Change | None = None) -> str:
        """Return the measured ratio of MuJoCo's to stepcore's time, in words; "" if unknown."""
        other = self.beside
        time = self.times.get(ours or SHIPPED)
        spent = None if other is None else other.times.get(theirs)
        if not time or not spent:
            return ""
        named = "stepcore" if ours in (None, SHIPPED) else "stepcore's recommended ones"
        return f", and it takes {spent / time:.2f} times as long as {named}"

    def label(self, row: Trial) -> str:
        """Describe settings, with every field that differs from the shipped settings."""
        return row.change.label(self.settings)

    def _wrong(self, row: Trial) -> str:
        if math.isinf(row.error):
            return "infinite"
        # A held-out start with more uncertainty counts by how far it may exceed the worst error.
        of_search = [u for s, u in zip(row.starts, row.unsure, strict=True) if s in self._searched]
        unsure = max(row.bound - row.error, *of_search, 0.0)
        sure = "" if unsure < 0.005 * row.error else f" (± {self.words(unsure).removeprefix('< ')})"
        return f"{self.words(row.error)}{sure}"

    def _multiple(self, row: Trial) -> str:
        if self.shipped.failure:
            return self._amount(row.cost)
        return f"{row.cost / self.shipped.cost:.2f}× the cost of the shipped settings"

    def _priced_beside(self, row: Trial) -> str:
        if row.change == SHIPPED:
            return f"{self._priced(row)}, as shipped"
        beside, here = self._multiple(row), self.times.get(row.change)
        shipped = self.times.get(SHIPPED)
        if here is None or not shipped:
            return f"{beside} by counted work"
        measured = f"{here / shipped:.2f}× as measured here: {self._priced(row)}"
        if row.cost < self.shipped.cost and here > shipped:
            measured += "; work is counted along the shipped motion, which may take less"
        return f"{beside} by counted work ({measured})"

    def _priced(self, row: Trial) -> str:
        if self.by == "flops" or row.change not in self.times:
            return f"{operations(row.work)} per simulated second"
        return f"{computing(self.times[row.change])} of computing per simulated second"

    def _amount(self, cost: float) -> str:
        return operations(cost) if self.by == "flops" else computing(cost)

    # Tables, data and motions.

    @property
    def table(self) -> Table:
        """All rows, coarsest step first."""
        return Table(self._record(row) for row in self.rows)

    def _record(self, row: Trial) -> dict[str, Any]:
        record: dict[str, Any] = {name: getattr(row.settings, name) for name in FIELDS}
        front = {id(other) for other in self.front}
        return record | {
            **row.record(),
            "at_least": self.partial(row),
            "missed": None if self.target is None else self.missed(row),
            "worst_start": row.worst,
            "measured": self.times.get(row.change),
            "pareto": id(row) in front,
            "shipped": row.change == SHIPPED,
            "recommended": self.chosen is not None and row.change == self.chosen.change,
        }

    def tables(self, full: bool) -> list[Table]:
        """Return the table of the main settings, or of all if `full`."""
        shown = self.rows if full else self._main_rows()
        front, records = self.front, []
        parts = self.measure.parts
        columns_of = {part.quantity.name: f"{part.quantity.name}{part.in_unit}" for part in parts}
        for row in shown:
            mark = "*" * any(row is one for one in front)
            mark += "s" * (row.change == SHIPPED)
            mark += "r" * (self.chosen is not None and row.change == self.chosen.change)
            s, here = row.settings, self.times.get(row.change)
            known = [w for w in unlabelled(s, self.settings) if w not in solver_words(s)]
            wrong = (row.error, row.median, float(row.largest.max()))
            errors = ["failed", "", ""] if row.failure else [compact(value) for value in wrong]
            if self.partial(row) and not row.failure:
                errors = [f"≥ {errors[0]}", "", f"≥ {errors[2]}"]
            record = {"": mark, "dt": f"{1e3 * s.dt:.4g}", "integrator": s.integrator}
            record |= {"solver": solver_words(s), "also": ", ".join(known)}
            record["cost"] = f"{row.cost / self.shipped.cost:.2f}×"
            record["measured"] = "" if here is None else f"{here:.0f}"
            record |= dict(zip(("error", "median", "max"), errors, strict=True))
            if not row.failure:
                record |= {columns_of[name]: compact(e) for name, e in row.named.items()}
            records.append(record | {"starts": f"{len(row.starts)}"})
        counts = {len(row.starts) for row in shown}
        every = dict.fromkeys(name for record in records for name in record)
        columns = [n for n in every if any(r.get(n) for r in records) or n in ("", "dt")]
        columns = [n for n in columns if n != "starts" or len(counts) > 1]
        ran = counted(max(counts), "start") if len(counts) == 1 else "the starts that it ran from"
        legend = (
            "*: no other setting is cheaper and at least as accurate; s: shipped; r: chosen. dt "
            "[ms]; cost: by counted work, of the shipped settings'; measured: computing time here "
            f"[µs per simulated second]; error: {self._error_legend(ran)}; median: of the median "
            "start; max: the largest"
            f"{self._of_any} at any time."
        )
        if columns_of:
            legend += f" {', '.join(columns_of.values())}: the errors in the worst start."
        if any(self.partial(row) for row in shown):
            most = counted(len(self.reference.starts), "start")
            legend += f" ≥: it did not run from all {most} of the search."
        chosen = self.chosen if self.budget is None and self.target is not None else None
        near = [row for row in shown if chosen and row.cost < chosen.cost]
        if any(row.error <= self.asked and not self.partial(row) for row in near):
            legend += (
                " Cheaper settings within the error are above "
                f"{self.words(MARGIN * self.asked)}, or were not tested on other starts."
            )
        if len(shown) < len(self.rows):
            legend += f" {not_shown(counted(len(self.rows) - len(shown), 'setting'))}"
        right = ("dt", "cost", "measured", "error", "median", "max", *columns_of.values(), "starts")
        numbers = dict.fromkeys(right, "")
        return [Table(records, columns, numbers, legend=legend)]

    @property
    def _of_any(self) -> str:
        return " of any body" if self.measure.quantity.is_motion else ""

    def _error_legend(self, ran: str) -> str:
        """Describe the column of errors."""
        arcs = ", rotations included as arcs" if self.measure.quantity.is_motion else ""
        return f"{self.measure.error_words} of the worst of {ran}{self.measure.in_unit}{arcs}"

    def _main_rows(self) -> list[Trial]:
        """Return about a screen of rows: those that the answer names, and others of the front."""
        named = {row.change for row in (self.shipped, *self.named, *self.refused[:REFUSALS])}
        others = [row for row in self.front if row.change not in named]
        left = min(len(others), max(0, SHORT - len(named)))
        kept = named | {others[int(k)].change for k in np.linspace(0, len(others) - 1, left)}
        return [row for row in self.rows if row.change in kept]

    def details(self) -> dict[str, Any]:
        """Return the reference, the request and the recommendation as data."""
        truth = self.reference
        return {
            "horizon": self.horizon,
            "starts": self.starts,
            "size": self.size,
            "reference": {
                "change": truth.change.words,
                "error": truth.error,
                "unsure": truth.unsure,
                "predictable": self.predictable,
                "predictable_starts": truth.growth.ends,
            },
            "orders": self.orders,
            "quantity": self.measure.quantity.name,
            "asked": {"error": self.target, "budget": self.budget, "by": self.by},
            "recommended": None if self.recommended is None else self.recommended.settings,
            "verified": self.verified,
            "nearest": None if self.nearest is None else self.nearest.settings,
            "proof": None if self.proof is None else self.proof.record(),
            "runs": self.runs,
            "findings": [finding.record() for finding in self.findings],
            "chatter": [finding.record() for finding in self.chatter],
        }

    def seen(self, row: Trial | None = None) -> list[Trajectory]:
        """Return the converged motion and the motion of a row, from the row's worst start.

        row: by default the chosen row, or the shipped settings if there is none.

        The runs are repeated. A run that fails ends at its failure.
        """
        row = row or self.chosen or self.shipped
        return [self._again(change, row.worst) for change in (self.reference.change, row.change)]

    def _again(self, change: Change, start: int) -> Trajectory:
        if self.engine != "stepcore" or self.model is None:
            raise ValueError("the motions of MuJoCo's settings are not kept: run them in MuJoCo")
        schedule = self.schedule
        sim = Sim(schedule.driven_model(change.of(self.model)))
        schedule.starts[start].put(sim)
        control: Any = schedule.function()
        held = schedule.period
        if control is None:
            rows, hold = schedule.rows([start], sim.settings.dt)
            control, held = (None if rows is None else rows[0]), hold * sim.settings.dt
        return sim.run(schedule.horizon, control, held, record=())

    def view(
        self,
        row: Trial | None = None,
        *,
        host: str = "localhost",
        port: int = 8080,
        wait: bool | None = None,
    ) -> View:
        """Open a page with the motion of a row, the converged motion, and their distance.

        row: by default the chosen row, or the shipped settings if there is none. The motion begins
            at the row's worst start.
        host, port, wait: see `stepcore.view`. Needs the extra "view".
        """
        from stepcore.viewing.live import view

        row = row or self.chosen or self.shipped
        named = f"dt {seconds(row.settings.dt)}, {row.settings.integrator}"
        return view(self.seen(row), labels=["converged", named], host=host, port=port, wait=wait)

    def __repr__(self) -> str:
        failed = len(self.failures)
        return f"<Trade of {self.name}: {len(self.rows)} settings, {failed} failed>"
