"""Confirms a recommendation on starts that the search has not used, and searches the hardest
starts.

A recommendation must meet the target in every start: in those of the search and in the requested
number of further starts. Each of n + 1 random starts is equally likely to be the worst. So after n
starts that meet the target, the next start misses it with a probability of at most 1/(n + 1).

Further starts may be harder than those of the search. On them, a method that was dropped early may
do better than a method that needs shorter steps. So the search is repeated on the hardest of all
starts.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.batched_runs import screened
from stepcore.experiment.errors import errors
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.failure import far_off
from stepcore.experiment.growth import DIRECTIONS
from stepcore.experiment.reference import Reference
from stepcore.experiment.runner import positions
from stepcore.experiment.schedule import Schedule
from stepcore.measure.trade.methods import DENSER, Kind, Steps
from stepcore.measure.trade.rows import MARGIN, Frontier, Further, TradeRow
from stepcore.measure.trade.run_cache import RunCache
from stepcore.measure.trade.search import FINE, SettingsSearch

# Rows tested on the further starts before the search stops.
TRIES = 30
# Number of searches on the hardest starts.
AGAIN = 2
# Number of failing rows for which shorter steps are tried; the first factor by which a step is
# shortened; the growth of this factor; and the largest number of trials.
REPAIRED, SHORTER, MORE, TIMES = 8, 1.15, 0.1, 8
# Largest relative cost of a rounder time step.
DEARER = 1.15
# Number of cheaper rows, within the error on the search's starts, that are tested.
NEAR = 3
# If no row passes on all starts: the accepted share of starts, and the number of rows tried.
SHARE, NEARLY = 0.95, 8
# How often an error that replaces one which cannot be verified is made larger.
LARGER = 2
# If perturbed runs of the search's starts separate by less than this factor, the motion is
# predictable, and the growth on further starts is not measured.
CALM = 30.0
# The second search: the number of hardest starts; the largest relative cost of rows whose methods
# it begins with; and the number of cheaper settings that are tested.
HARD, CLOSE, TESTED = 8, 2.0, 3


class Ran(NamedTuple):
    """The run of one setting from one further start; error: RMS position error [m], or inf."""

    start: int
    error: float
    failure: str | None


class Confirmation:
    """The further starts, with their own reference, on which settings are tested."""

    def __init__(self, cache: RunCache, others: Schedule) -> None:
        self.cache, experiment = cache, cache.experiment
        self.further = Experiment(experiment.model, others, experiment.workers, experiment.size)
        self.hard: list[int] = []
        self.ends = np.full(self.count, np.inf)
        self.scored: np.ndarray | None = None
        # The run of each setting from each further start.
        self.ran: dict[Settings, dict[int, Ran]] = {}
        # Use the step of the search's experiment, because a further start may be harder than all of
        # its starts.
        settings, level = cache.reference.settings, cache.reference.level
        runs = self.further.run(settings, probes=positions, bar="further starts")
        self.truth = dataclasses.replace(level, runs=runs)
        if self.truth.failed:
            return
        if cache.reference.growth.factor.max() < CALM:
            self.scored = np.ones((self.count, len(others.times)), bool)
            return
        with experiment.workers.bar("further perturbed runs", (1 + DIRECTIONS) * self.count) as bar:
            grown = self.further.growth(cache.reference.growth.settings, bar)
        self.scored, self.ends = grown.scored, grown.ends

    @property
    def count(self) -> int:
        """The number of further starts."""
        return len(self.further.schedule.starts)

    def test(self, settings: Settings, limit: float, error: float) -> Further:
        """Run settings from the further starts, and return the results.

        The starts on which other settings failed come first. If one of those runs fails, the test
        ends.

        limit: the error that the settings should not exceed [m].
        error: the requested error [m]; the starts within this error are counted.
        """
        if self.scored is None:
            return Further(0, 0, 0.0, f"the reference fails on them: {self.truth.failed}")
        rest = [i for i in range(self.count) if i not in self.hard]
        ran = self._runs(settings, self.hard)
        if not self._bad(ran, limit):
            ran += self._runs(settings, rest)
        return self._result(ran, limit, error)

    def test_all(self, settings: Settings, limit: float, error: float) -> Further:
        """Run settings from every further start, without ending at a failure; see `test`."""
        return self._result(self._runs(settings, list(range(self.count))), limit, error)

    def _result(self, ran: list[Ran], limit: float, error: float) -> Further:
        worst = max(ran, key=lambda run: run.error)
        if worst.error > limit and worst.start not in self.hard:
            self.hard.append(worst.start)
        failed = (f"further start {run.start}: {run.failure}" for run in ran if run.failure)
        held = sum(run.error <= error for run in ran)
        return Further(len(ran), held, worst.error, next(failed, None))

    def hardness(self) -> np.ndarray:
        """Return the largest error of all tested settings on each further start [m]."""
        worst = np.zeros(self.count)
        for ran in self.ran.values():
            for run in ran.values():
                worst[run.start] = max(worst[run.start], run.error)
        return worst

    def holds(self, settings: Settings, error: float) -> bool:
        """Return whether settings stay within an error on the starts on which others failed."""
        return not self._bad(self._runs(settings, self.hard), error)

    def _bad(self, ran: list[Ran], error: float) -> bool:
        return any(run.error > error for run in ran)

    def _runs(self, settings: Settings, starts: list[int]) -> list[Ran]:
        assert self.scored is not None
        known = self.ran.setdefault(settings, {})
        missing = [start for start in starts if start not in known]
        further = self.further
        runs = screened(further.runner, settings, missing, further.workers, "further starts")
        for start, run in zip(missing, runs, strict=True):
            truth = [self.truth.runs[start]]
            failure = run.failure or far_off([run], truth, further.size)
            wrong = math.inf
            if not failure:
                wrong = errors([run], truth, self.scored[[start]]).high
            known[start] = Ran(start, wrong, failure)
        return [known[start] for start in starts]


class HardestStarts:
    """A search on the hardest of all starts, those of the search and the further ones.

    target: the requested error [m].
    """

    def __init__(
        self, cache: RunCache, confirm: Confirmation, steps: Steps, kind: Kind, target: float
    ) -> None:
        self.cache, self.confirm, self.steps = cache, confirm, steps
        self.kind, self.target = kind, target

    def __call__(self, frontier: Frontier, chosen: TradeRow) -> Sequence[Settings]:
        """Return settings that cost less than the passing row, by runs on the hardest starts."""
        few = [int(i) for i in self.order(frontier)[:HARD]]
        experiment = self.cache.experiment
        model, workers, size = experiment.model, experiment.workers, experiment.size
        experiment = Experiment(model, self._schedule(few), workers, size)
        hard = RunCache(experiment, self._reference(few))
        search = SettingsSearch(hard, self.steps, self.kind)
        price = frontier.price(chosen)
        near = [r.settings for r in frontier.rows if frontier.price(r) <= CLOSE * price]
        methods = (self.steps.method(s) for s in near if s.precision == "f64")
        search.methods = list(dict.fromkeys(methods))
        met = search.meeting(MARGIN * self.target)
        self.cache.count += hard.count
        return [s for s in met if hard.score(s, len(few)).price < chosen.flops][:TESTED]

    def order(self, frontier: Frontier) -> np.ndarray:
        """Return the indices of all starts, hardest first, by the errors of the tested rows.

        The search's own starts have the first indices; the further starts follow.
        """
        worst = np.zeros(len(self.cache.experiment.schedule.starts))
        for row in frontier.rows:
            if row.further is not None and row.errors is not None:
                worst = np.maximum(worst, row.errors.each)
        return np.argsort(-np.concatenate([worst, self.confirm.hardness()]), kind="stable")

    def _schedule(self, few: Sequence[int]) -> Schedule:
        searched, further = self.cache.experiment.schedule, self.confirm.further.schedule
        return searched.joined(further).picked(few)

    def _reference(self, few: Sequence[int]) -> Reference:
        """Return the reference of these starts, at the level of the search's own reference."""
        reference = self.cache.reference
        runs = [*reference.runs, *self.confirm.truth.runs]
        level = dataclasses.replace(reference.level, runs=[runs[i] for i in few])
        ends = np.concatenate([reference.growth.ends, self.confirm.ends])[list(few)]
        factor = np.ones((len(few), len(reference.growth.times)))
        grown = dataclasses.replace(reference.growth, factor=factor, ends=ends)
        return dataclasses.replace(reference, level=level, growth=grown, exact=None)


class Recommendation:
    """Tests rows of a frontier on further starts; `frontier` contains the results.

    finish: makes the complete row of settings.
    again: searches on the hardest starts for settings cheaper than a row that passed; None without
        a search.
    """

    def __init__(
        self,
        frontier: Frontier,
        confirm: Confirmation,
        finish: Callable[[Settings], TradeRow],
        steps: Steps,
        again: HardestStarts | None = None,
    ) -> None:
        self.frontier, self.confirm, self.finish = frontier, confirm, finish
        self.steps, self.again = steps, again
        # The largest number of steps in a period that the reference can judge.
        self.finest = int(steps.period / confirm.cache.reference.settings.dt / 2 + 1e-9)

    def add(self, row: TradeRow) -> TradeRow:
        """Add a row to the frontier."""
        self.frontier = self.frontier.updated(row)
        return row

    def tested(self, row: TradeRow, further: Further) -> TradeRow:
        """Return the row with the results of a test, and update the frontier."""
        return self.add(dataclasses.replace(row, further=further))

    def within_error(self, target: float) -> TradeRow | None:
        """Test the cheapest rows within an error [m] until a row passes, and return that row.

        A row must stay below the error by a margin. Some of the rows that fail are also tried with
        shorter steps. If no row passes, a row within the error itself is accepted. The row that
        passes is compared with the results of a search on the hardest starts. Its time step is
        rounded if a nearby round time step also passes.
        """
        chosen = self._first_that_passes(target)
        if self.confirm.scored is None:
            return chosen
        for _ in range(AGAIN if self.again else 0):
            if chosen is None or self.again is None:
                break
            for settings in self.again(self.frontier, chosen):
                if not self.frontier.has(settings):
                    self.add(self.finish(settings))
            better = self._first_that_passes(target)
            if better is None or better.settings == chosen.settings:
                break
            chosen = better
        if chosen is None:
            return self._nearly_always(target)
        self._count_misses(target, chosen)
        return self.rounded(chosen, target)

    def within_least(self, error: float) -> tuple[TradeRow | None, float]:
        """Test rows within the least error that any has on all starts it ran from.

        Return the row that passes, or None, and the error [m]; error: the one that none met.
        """
        for _ in range(LARGER):
            least = self.frontier.least()
            if not error < least < math.inf:
                break
            error = least
            if (row := self.within_error(error)) is not None:
                return row, error
        return None, error

    def _first_that_passes(self, target: float) -> TradeRow | None:
        """Return the cheapest row that stays within the limit on all further starts."""
        limit, repairs, confirm = MARGIN * target, REPAIRED, self.confirm
        for _ in range(TRIES):
            try:
                row = self.frontier.cheapest(limit)
            except ValueError:
                if limit == target:
                    break
                limit = target
                continue
            if row.further is not None and row.further.starts in (0, confirm.count):
                return row
            row = self.tested(row, confirm.test(row.settings, limit, target))
            if self.frontier.error(row) > limit and repairs and confirm.scored is not None:
                repairs -= 1
                shorter = self._repaired(row, limit)
                if shorter is not None and not self.frontier.has(shorter):
                    self.add(self.finish(shorter))
        return None

    def _repaired(self, row: TradeRow, limit: float) -> Settings | None:
        """Return the settings of a failed row with a time step short enough to pass, or None.

        Steps that keep an accuracy keep a finer one.
        """
        if (asked := row.settings.accuracy) is not None:
            finer = (row.settings.replace(accuracy=asked / 2**k) for k in range(1, TIMES))
            return next((s for s in finer if self.confirm.holds(s, limit)), None)
        misses = pieces = self.steps.pieces(row.settings)

        def holds(count: int) -> bool:
            return self.confirm.holds(self.steps.at(row.settings, count), limit)

        for k in range(TIMES):
            pieces = min(math.ceil(pieces * (SHORTER + MORE * k)), self.finest)
            if pieces <= misses:
                return None
            if holds(pieces):
                break
            misses = pieces
        else:
            return None
        while pieces - misses > 1 and pieces > FINE * misses:
            middle = math.ceil(math.sqrt(misses * pieces))
            if middle in (misses, pieces):
                break
            misses, pieces = (misses, middle) if holds(middle) else (middle, pieces)
        return self.steps.at(row.settings, pieces)

    def _nearly_always(self, target: float) -> TradeRow | None:
        """Return a row that passes on 19 of 20 starts, or None."""
        good = [row for row in self.frontier.rows if row.errors and row.errors.high <= target]
        for row in sorted(good, key=self.frontier.price)[-NEARLY:]:
            further = self.confirm.test_all(row.settings, target, target)
            tested = self.tested(row, further)
            if further.held >= SHARE * further.starts and further.high < math.inf:
                return tested
        return None

    def _count_misses(self, target: float, chosen: TradeRow) -> None:
        """Test the cheaper rows that stay within the error on the search's own starts.

        If only a few starts reject a cheaper row, the answer reports this.
        """
        price = self.frontier.price
        near = [
            row
            for row in self.frontier.rows
            if row.errors and row.errors.high <= target and price(row) < price(chosen)
        ]
        for row in sorted(near, key=price)[-NEAR:]:
            self.tested(row, self.confirm.test_all(row.settings, target, target))

    def rounded(self, row: TradeRow, target: float) -> TradeRow:
        """Return the passing row with a rounder step if that row passes too at little more cost."""
        frontier, steps = self.frontier, self.steps
        if row.settings.accuracy is not None:
            return row
        limit = MARGIN * target if frontier.error(row) <= MARGIN * target else target
        for pieces in steps.rounder(steps.pieces(row.settings)):
            # A step slightly beyond the searched range is acceptable: the reference judges it
            # nearly as well.
            if pieces > DENSER * self.finest:
                continue
            settings = steps.at(row.settings, pieces)
            other = next((r for r in self.frontier.rows if r.settings == settings), None)
            other = self.add(other or self.finish(settings))
            dear = not frontier.price(other) <= DEARER * frontier.price(row)
            if dear or not frontier.error(other) <= limit:
                continue
            other = self.tested(other, self.confirm.test(settings, limit, target))
            if frontier.error(other) <= limit:
                return other
        return row

    def within_budget(self, budget: float) -> None:
        """Fit the time step of the most accurate row to the budget, and test the row."""
        for _ in range(TRIES):
            try:
                row = self.frontier.most_accurate(budget)
            except ValueError:
                break
            pieces = self.steps.pieces(row.settings)
            more = int(pieces * budget / self.frontier.price(row) * 0.98)
            # Use a longer round step, so that the cost stays within the budget.
            more = next((n for n in self.steps.rounder(more) if n <= more), more)
            finer = self.steps.at(row.settings, more)
            fixed = row.settings.accuracy is None
            if fixed and more >= 1.08 * pieces and not self.frontier.has(finer):
                self.add(self.finish(finer))
                continue
            if row.further is not None:
                break
            self.tested(row, self.confirm.test(row.settings, math.inf, math.inf))
