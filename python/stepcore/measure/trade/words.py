"""Sentences of a trade: the answer, and notes on the reference, the motion and the failures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.growth import GROWTH, NEARBY
from stepcore.experiment.reference import FINER, Reference, smallest
from stepcore.experiment.schedule import Schedule
from stepcore.measure.trade.batch_cost import BatchPoint
from stepcore.measure.trade.methods import Steps
from stepcore.measure.trade.rows import MARGIN, NOTABLE, Frontier, TradeRow
from stepcore.measure.trade.run_cache import RunCache
from stepcore.report.settings import label
from stepcore.report.units import (
    beginning,
    compact,
    computing,
    counted,
    metres,
    operations,
    percent,
    seconds,
    times,
)

# Residuals of the reference above this are reported [m/s].
UNSOLVED = 1e-9
# Two integrators disagree if their distance is this many times larger than the sum of the
# reference's error and the other's last change under halving.
DISAGREE = 4.0
# Ratio of the worst start's error to the median's above which both are reported.
DIFFER = 30.0
# Causes of a difference between the reference and another model.
MODELS = {"pyramid": "the friction pyramid", "softness": "the softness of contacts and limits"}


def error(value: float, sure: float) -> str:
    """Return an error with that of the reference [m], in words."""
    bound = metres(sure).removeprefix("< ")
    return f"{metres(value)} ± {bound}" if value < math.inf else "a failed run"


def so_far(frontier: Frontier, row: TradeRow, further: int) -> str:
    """Return a recommendation that further starts are to confirm, beside the shipped settings."""
    known, shipped = frontier.known, frontier.shipped
    share = times(frontier.price(row) / frontier.price(shipped))
    return (
        f"error as shipped {error(frontier.searched(shipped), known)}; best {label(row.settings)}: "
        f"{error(frontier.searched(row), known)} at {share} the shipped cost; "
        f"{counted(further, 'start')} more are to confirm it"
    )


@dataclass(frozen=True)
class Words:
    """The sentences of a trade's answer; the fields are those of `Trade`.

    recommended: the row for `target`, or else for `verified` or `budget`.
    """

    frontier: Frontier
    reference: Reference
    target: float | None
    verified: float | None
    budget: float | None
    recommended: TradeRow | None
    passed_over: TradeRow | None
    horizon: float

    def answer(self) -> Iterator[str]:
        """Yield the recommendation, then the shipped settings and the cost of less error."""
        if self.target is not None:
            yield from self._for_error(self.target)
        elif self.budget is not None:
            yield from self._for_budget(self.budget)
        yield self._as_shipped()
        if self.target is None and self.budget is None:
            yield from self._improvements()

    def _for_error(self, target: float) -> Iterator[str]:
        """Yield the cheapest settings within an error and the next better, or the nearest row."""
        row, error = self.recommended, self.verified or target
        if self.reference.high > target:
            yield (
                f"{metres(target)} cannot be verified: the reference is good to "
                f"{metres(self.reference.high)} in the worst start. Try your own motion, or a "
                "larger `effort` (--effort)."
            )
            yield from self._where_verified(target)
        if row is not None:
            what = f"Recommended for an error of at most {metres(error)}"
            if self.verified is not None:
                what += ", which can be verified"
            if self.frontier.error(row) > error:
                missed, count = row.misses(error)
                what += f" on {count - missed} of {count} starts (no setting keeps to it on all)"
            yield f"{what}: {self._described(row)}"
            yield from self._why_passed_over(row, error)
            yield self._halved(row)
            return
        if len(self.frontier.rows) == 1:
            yield "No other settings than the shipped ones were tried."
            return
        if self.reference.high <= target:
            yield f"No setting tried has an error of at most {metres(error)} in every start."
        yield from self._most_accurate()

    def _where_verified(self, target: float) -> Iterator[str]:
        """Yield the cheapest settings within an error on those starts whose reference can tell."""
        sure, count = self.reference.each, len(self.reference.each)
        telling = [i for i in range(count) if sure[i] <= MARGIN * target]
        if not telling:
            return
        good = [
            row
            for row in self.frontier.rows
            if row.errors and max(row.errors.each[i] for i in telling) <= MARGIN * target
        ]
        if good:
            least = min(good, key=self.frontier.price)
            yield (
                f"In the {len(telling)} of {counted(count, 'start')} whose reference is good enough"
                f", {self._named(least)} keeps to it, for {self._priced_beside(least)}."
            )

    def _most_accurate(self) -> Iterator[str]:
        """Yield the row with the smallest error, or the rows that the reference cannot rank."""
        ran = [row for row in self.frontier.rows if row.errors is not None]
        tied = [row for row in ran if self.frontier.tied(row)]
        if len(tied) > 1:
            yield (
                f"{counted(len(tied), 'setting')} are as accurate as the reference can tell, the "
                f"cheapest of them {self._named(min(tied, key=self.frontier.price))}."
            )
            yield from self._ranked(tied)
        elif ran:
            least = min(ran, key=lambda row: (self.frontier.error(row), self.frontier.price(row)))
            best = metres(self.frontier.error(least))
            yield f"The most accurate one is {self._named(least)}, with an error of {best}."

    def _ranked(self, tied: Sequence[TradeRow]) -> Iterator[str]:
        """Rank rows that tie in the worst start by the starts whose reference is finer."""
        sure = self.reference.each
        telling = [i for i in range(len(sure)) if sure[i] * FINER <= self.reference.high]

        def there(row: TradeRow) -> float:
            assert row.errors is not None
            return max(max(row.errors.each[i], sure[i]) for i in telling)

        if telling:
            least = min(tied, key=lambda row: (there(row), self.frontier.price(row)))
            yield (
                f"In the {len(telling)} of {counted(len(sure), 'start')} whose reference is ten "
                f"times as good, the most accurate one is {self._named(least)}, with an error of "
                f"{metres(there(least))}."
            )

    def _for_budget(self, budget: float) -> Iterator[str]:
        """Yield the most accurate settings within a budget and the next better, or the cheapest."""
        within = operations(budget) if self.frontier.by == "flops" else computing(budget)
        row = self.recommended
        if row is not None:
            what = f"Recommended for at most {within} per simulated second"
            yield f"{what}: {self._described(row)}"
            yield self._halved(row)
            return
        yield f"No setting tried costs at most {within} per simulated second."
        ran = [other for other in self.frontier.rows if not other.failure]
        if ran:
            least = min(ran, key=self.frontier.price)
            yield f"The cheapest one is {self._named(least)}, at {self._priced(least)}."

    def _described(self, row: TradeRow) -> str:
        """Describe recommended settings: error, cost, and the result on further starts."""
        within = "at most " * self.frontier.tied(row)
        return (
            f"{self._named(row)}. The RMS position error is {within}"
            f"{metres(self.frontier.error(row))} in the worst start, for "
            f"{self._priced_beside(row)}.{self._confirmed(row)}"
        )

    def _priced_beside(self, row: TradeRow) -> str:
        """Describe the cost of settings, beside that of the shipped settings."""
        price = self._priced(row)
        if row.settings == self.frontier.shipped.settings:
            return f"{price}, as shipped"
        if math.isnan(self.frontier.price(self.frontier.shipped)):
            return price
        return f"{price}, {self._multiple(row)}"

    def _multiple(self, row: TradeRow) -> str:
        """Describe the cost of settings as a multiple of the cost of the shipped settings.

        Every multiple of an answer is of that cost. Where the shipped settings fail and so have
        none, it is the cost itself.
        """
        shipped = self.frontier.price(self.frontier.shipped)
        if math.isnan(shipped):
            return self._priced(row)
        return f"{self.frontier.price(row) / shipped:.2f}× the cost of the shipped settings"

    def _confirmed(self, row: TradeRow) -> str:
        """Describe the result on further starts."""
        tried = row.further
        if tried is None:
            return " It was not tried on further starts."
        if tried.starts == 0:
            return f" It could not be confirmed: {beginning(tried.failure or '')}."
        count = counted(tried.starts, "further start")
        if self.target is None:
            return f" This includes {count}."
        if tried.held < tried.starts:
            return f" The error stayed within it on {tried.held} of {count}."
        # The next of n + 1 random starts is the worst with a probability of 1/(n + 1).
        every = len(self.reference.runs) + tried.starts
        share = percent(every / (every + 1))
        return f" Confirmed on {count}; {share} of other starts are expected to stay within it."

    def _why_passed_over(self, row: TradeRow, error: float) -> Iterator[str]:
        """Yield a cheaper setting that almost meets the error, and why it is not recommended."""
        other = self.passed_over
        if other is None:
            return
        cost = "as shipped" if other.shipped else self._multiple(other)
        which = f"{cost}: {self._named(other)}"
        (missed, count), wrong = other.misses(error), self.frontier.error(other)
        if missed:
            yield (
                f"Cheaper settings ({which}) exceeded {metres(error)} on {missed} of {count} "
                f"starts, by up to {metres(wrong - error)}; with other starts the answer may "
                "change."
            )
        elif wrong <= MARGIN * error:
            yield (
                f"Cheaper settings also pass ({which}); the recommended ones have a rounder time "
                "step."
            )
        else:
            yield (
                f"Cheaper settings ({which}) stayed within {metres(error)} too, with "
                f"{metres(wrong)}; but a recommendation keeps to {metres(MARGIN * error)}, because "
                "starts that were not run may be worse."
            )

    def _halved(self, row: TradeRow) -> str:
        """Describe the cost of at most half the error."""
        better, searched = self.frontier.halving(row), self.frontier.searched
        there = self.frontier.error(row) > searched(row)
        starts = f"{counted(len(self.reference.runs), 'start')} of the search"
        if searched(row) / 2 < self.frontier.known:
            known = metres(self.frontier.known)
            return f"Half that error cannot be verified: the reference is good to {known}."
        if better is None:
            return f"No setting tried halves that error{f' in the {starts}' * there}."
        comes = f"comes at {self._multiple(better)}"
        named = f"{self._named(better)}, with an error of {metres(searched(better))}"
        if not there:
            return f"Half that error or less {comes}: {named}."
        return (
            f"In the {starts} its error is {metres(searched(row))}; half of that or less {comes}: "
            f"{named} there."
        )

    def _as_shipped(self) -> str:
        """Describe the error of the shipped settings, in the worst and in the median start."""
        row = self.frontier.shipped
        what = f"As shipped ({label(row.settings)})"
        if row.errors is None:
            return f"{what} the simulation fails: {beginning(row.failure or '')}."
        e, where, count = row.errors, "", len(self.reference.runs)
        if count > 1:
            median = f"median {metres(e.median)}"
            if e.high > DIFFER * e.median:
                median = f"starts differ widely: {median}"
            where = f" in the worst of {count} starts (start {e.each.index(e.high)}; {median})"
        return (
            f"{what} the RMS position error over {seconds(self.horizon)} is "
            f"{metres(self.frontier.searched(row))}{where}, for {self._priced(row)}. The largest "
            f"error of a body at any time is {metres(self.frontier.largest(row))}."
        )

    def _improvements(self) -> Iterator[str]:
        """Yield the cost of half the shipped error, and of the shipped error itself."""
        row = self.frontier.shipped
        if row.errors is None:
            ran = [other for other in self.frontier.rows if not other.failure]
            if ran:
                least = min(ran, key=self.frontier.price)
                named, least_error = self._named(least), metres(self.frontier.searched(least))
                yield f"The cheapest setting that runs is {named}, with an error of {least_error}."
            return
        error = self.frontier.searched(row)
        half, same = self.frontier.halving(row) if error else None, self.frontier.cheapest(error)
        offers = [("Half that error", half)] if half is not None else []
        if half is None:
            yield "No setting tried halves that error."
        if same is not half and self.frontier.price(same) < NOTABLE * self.frontier.price(row):
            offers.append(("The same error", same))
        for what, other in offers:
            yield (
                f"{what} or less comes at {self._multiple(other)}: {self._named(other)}, with an "
                f"error of {metres(self.frontier.searched(other))}."
            )

    def in_a_batch(self, timed: Sequence[BatchPoint]) -> Iterator[str]:
        """Yield the cost of a world of a batch under the recommended or the shipped settings."""
        chosen = self.recommended or self.frontier.shipped
        alike = chosen.settings.precision
        points = [
            point
            for point in timed
            if point.row.settings.replace(precision=alike) == chosen.settings
            and not math.isnan(point.cost)
        ]
        if points:
            which = "recommended" if self.recommended else "shipped"
            costs = "; ".join(
                f"{computing(point.cost)} in {point.row.settings.precision} (a single world: "
                f"{computing(point.row.cost)}{'' if point.lanes else '; not in lanes'})"
                for point in points
            )
            yield (
                f"In a batch of {points[0].worlds} worlds on one thread, the {which} settings cost "
                f"for each world and simulated second {costs}."
            )

    def _named(self, row: TradeRow) -> str:
        """Describe settings, with every field that differs from the shipped settings."""
        return label(row.settings, self.frontier.shipped.settings)

    def _priced(self, row: TradeRow) -> str:
        if self.frontier.by == "flops":
            return f"{operations(row.flops)} per simulated second"
        return f"{computing(row.cost)} of computing per simulated second"


def about_run(
    schedule: Schedule, rows: int, forces: bool, softened: float | None, asked: float | None
) -> Iterator[str]:
    """Yield notes on the motion.

    rows: the largest number of rows at once.
    forces: whether contacts are forces rather than rows.
    softened: the time constant that refsafe guards [s], or None.
    asked: the requested horizon [s].
    """
    if asked is not None and schedule.horizon < asked * (1 - 1e-9):
        yield (
            f"the horizon is {seconds(schedule.horizon)} instead of {seconds(asked)}, because it "
            "must be a whole number of samples"
        )
    if rows == 0:
        what = "no contact, limit or other row"
        if forces:
            what = "contacts are forces under the law penalty, and no limit or other row"
        yield f"{what} was ever active, so the choice of solver has no effect"
    yield from schedule.notes
    if softened is not None:
        yield (
            "contacts and limits are softened (MuJoCo's refsafe keeps their time constants at 2 dt "
            f"or more) above dt {seconds(softened / 2)}, in the rows marked c"
        )


def about_reference(reference: Reference, rows: Sequence[TradeRow], size: float) -> Iterator[str]:
    """Yield notes on the converged motion, the reference of all errors, and its uncertainty."""
    ends = reference.growth.ends
    lost = int(np.isfinite(ends).sum())
    if lost:
        yield (
            f"{lost} of {len(ends)} starts cannot be predicted to the end (the first one only for "
            f"{seconds(float(ends.min()))}), and their errors count only until then: a "
            f"perturbation of {NEARBY:g} of the scene's size has grown more than {GROWTH:g} times"
        )
    if reference.exact is not None:
        yield (
            "errors are measured from the closed form of the motion; the converged run differs "
            f"from it by {metres(reference.exact.check)}"
        )
    if reference.stiffens:
        yield (
            f'under the law "{reference.settings.law}" contacts stiffen as dt shrinks (beta/dt): '
            "errors are measured from the limit dt → 0, where contacts are harder than as shipped"
        )
    for name, gap in reference.gaps.items():
        bound = "" if gap.settled else "at least "
        yield (
            f"modelling error: {MODELS[name]} moves positions by {bound}{metres(gap.distance)} "
            f"(RMS, worst start; compared with {gap.against}); no time step and no solver changes "
            "this"
        )
    least = smallest([row.errors.high for row in rows if row.errors], size)
    if reference.high * FINER > least > 0:
        known = metres(reference.high)
        yield (
            f"the reference error is {known}: errors below {metres(FINER * reference.high)} are "
            f"uncertain by that amount, and those below {known} are printed as "
            f"<{compact(reference.high)}; a larger `effort` (--effort) converges the reference "
            "further"
        )
    marked = sum(row.best and row.below_max and not row.below for row in rows)
    if marked:
        yield (
            f"the column max is uncertain by {metres(reference.largest)}, the largest error of the "
            f"reference; {marked} of the best rows are below that"
        )
    rest = max(run.residual for run in reference.runs)
    if rest > UNSOLVED:
        yield f"the solver left the rows of the reference at a residual of {rest:.0e} m/s"
    if reference.other and reference.agreement > DISAGREE * (
        reference.other_error + reference.error
    ):
        yield (
            f"two integrators converge to motions {metres(reference.agreement)} apart: halving the "
            f"step moves {reference.other} by only {metres(reference.other_error)}, and no nearer "
            f"to {reference.level.integrator}; errors below that distance are unknown"
        )


def not_searched(cache: RunCache) -> str:
    """Return what the deadline left out of a search."""
    tried = len({*cache.full, *cache.screened})
    return f"the rest of the search ({counted(tried, 'setting')} tried)"


def not_run(cache: RunCache, settings: Sequence[Settings]) -> str:
    """Return which of some settings the deadline left out."""
    left = sum(setting not in cache.full for setting in settings)
    return f"{left} of {len(settings)} settings from all starts"


def about_search(reference: Reference, steps: Steps, finest: float) -> Iterator[str]:
    """Yield a note on time steps left out of the search because the reference cannot judge them.

    finest: the shortest step [s] that the search begins with, if the reference is fine enough.
    """
    shortest = 2 * reference.settings.dt
    if shortest > min(finest, steps.shipped) * (1 + 1e-9):
        yield (
            f"no time step below {seconds(shortest)} was searched: the reference, at dt "
            f"{seconds(reference.settings.dt)} within its `effort` (--effort), cannot judge them"
        )


def observed(reference: Reference, horizon: float, orders: Mapping[str, float]) -> Iterator[str]:
    """Yield how long the motion is predictable, and the observed order of each integrator."""
    growth = reference.growth
    if np.isfinite(growth.overall):
        yield f"the motion can be predicted for {seconds(growth.overall)} of {seconds(horizon)}"
    else:
        yield (
            f"the motion can be predicted over all of {seconds(horizon)}: perturbations grow at "
            f"most {times(float(growth.factor.max()))}"
        )
    if orders:
        shown = ", ".join(f"{name} {order:.2g}" for name, order in orders.items())
        yield f"observed order of accuracy in the worst start: {shown}"


def failed(rows: Sequence[TradeRow]) -> Iterator[str]:
    """Yield one note on all failures, by integrator and solver."""
    failures: dict[tuple[str, str], list[TradeRow]] = {}
    for row in rows:
        if row.failure:
            failures.setdefault((row.settings.integrator, row.settings.solver), []).append(row)
    if not failures:
        return
    kinds = []
    for kind, some in failures.items():
        # Rows are sorted coarsest first.
        coarsest, finest = (seconds(row.settings.dt) for row in (some[0], some[-1]))
        steps = coarsest if coarsest == finest else f"{finest} to {coarsest}"
        kinds.append(f"{', '.join(kind)} at dt {steps}")
    first = next(iter(failures.values()))[0]
    kinds[0] += f" ({beginning(first.failure or '')})"
    count = sum(map(len, failures.values()))
    yield f"{counted(count, 'setting')} fail{'s' * (count == 1)}: {'; '.join(kinds)}"
