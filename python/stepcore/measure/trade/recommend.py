"""The recommendation, tried on starts that the search has not seen.

A target must be met in every start, those of the search and as many further ones as are asked
for. Of n + 1 like starts each is as likely to be the worst, so after n that hold the next one
fails with a probability of at most 1/(n + 1).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial

import numpy as np

from stepcore._core import Settings
from stepcore.executors import each
from stepcore.experiment.errors import errors, far_off
from stepcore.experiment.growth import DIRECTIONS, growth
from stepcore.experiment.motion import Motion
from stepcore.experiment.reference import Search
from stepcore.experiment.runner import Course
from stepcore.measure.trade.frugal import MARGIN
from stepcore.measure.trade.glance import glance
from stepcore.measure.trade.moves import Steps
from stepcore.measure.trade.result import Further, Row, Trade
from stepcore.measure.trade.trials import Trials
from stepcore.report.progress import Progress

# Candidates tried on the further starts before the search gives up.
TRIES = 30
# For so many of those that fail there, shorter steps are tried: by this at first, then by more each
# time, so many times.
REPAIRED, SHORTER, MORE, TIMES = 8, 1.15, 0.1, 8

# Where twins of the search's starts grow apart by less than this, further starts can be predicted.
CALM = 30.0

# Makes a finished row of settings: runs them from all starts, counts and times them.
Finish = Callable[[Settings], Row]
# A start, how wrong a run from it was [m], and why it failed if it did.
Ran = tuple[int, float, str | None]


class Confirmation:
    """Further starts, with their own reference, and what settings do on them."""

    def __init__(self, trials: Trials, search: Search, others: Motion) -> None:
        self.trials, self.progress = trials, trials.progress
        course = search.course
        self.course = Course(course.model, course.dofs, others)
        own = Search(
            self.course, search.shipped, search.finest, math.inf, search.threads, search.executor
        )
        self.hard: list[int] = []
        self.scored: np.ndarray | None = None
        # As fine as the search's own: a further start may be harder than all of those.
        level = trials.reference.level
        count = len(others.starts)
        with Progress("further starts", count, self.progress) as bar:
            self.truth = own.level(level.integrator, level.dt, bar)
        if self.truth.failed:
            return
        if trials.reference.growth.factor.max() < CALM:
            self.scored = np.ones((count, len(others.times)), bool)
            return
        settings = own.settings(level.integrator, level.dt)
        with Progress("further twins", (1 + DIRECTIONS) * count, self.progress) as bar:
            runs = (search.threads, search.executor)
            found = growth(self.course, settings, trials.size, bar, *runs)
        self.scored = found.scored

    @property
    def count(self) -> int:
        """How many further starts there are."""
        return len(self.course.motion.starts)

    def test(self, settings: Settings, limit: float, error: float) -> Further:
        """Runs settings from every further start; limit: what they should keep to [m].

        First from those where others have failed; if these fail there too, that is all. error:
        what is asked for [m], to count those that keep to it.
        """
        if self.scored is None:
            return Further(0, 0, 0.0, f"the reference fails on them: {self.truth.failed}")
        rest = [i for i in range(self.count) if i not in self.hard]
        found = self._runs(settings, self.hard)
        if not self._bad(found, limit):
            found += self._runs(settings, rest)
        worst = max(found, key=lambda one: one[1])
        if worst[1] > limit and worst[0] not in self.hard:
            self.hard.append(worst[0])
        failure = next((f"further start {i}: {text}" for i, _, text in found if text), None)
        held = sum(wrong <= error for _, wrong, _ in found)
        return Further(len(found), held, worst[1], failure)

    def holds(self, settings: Settings, error: float) -> bool:
        """Whether settings keep to the error on the starts where others have failed."""
        return not self._bad(self._runs(settings, self.hard), error)

    def _bad(self, found: list[Ran], error: float) -> bool:
        return any(wrong > error for _, wrong, _ in found)

    def _runs(self, settings: Settings, starts: list[int]) -> list[Ran]:
        trials, scored = self.trials, self.scored
        assert scored is not None
        with Progress("further starts", len(starts), self.progress) as bar:
            paths = each(
                partial(glance, self.course, settings),
                starts,
                bar=bar,
                threads=trials.threads,
                executor=trials.executor,
            )
        found: list[Ran] = []
        for start, (path, _) in zip(starts, paths, strict=True):
            truth = [self.truth.paths[start]]
            failure = path.failure or far_off([path], truth, trials.size)
            wrong = math.inf if failure else errors([path], truth, scored[[start]]).high
            found.append((start, wrong, failure))
        return found


def confirmed(
    trade: Trade, trials: Trials, search: Search, others: Motion, finish: Finish, steps: Steps
) -> None:
    """Tries what is recommended on other starts; goes on to the next until it holds."""
    if trade.recommended is None:
        return
    confirm = Confirmation(trials, search, others)
    if trade.target is not None:
        within_error(trade, confirm, finish, steps)
    else:
        within_budget(trade, confirm, finish, steps)


def within_error(trade: Trade, confirm: Confirmation, finish: Finish, steps: Steps) -> None:
    """Tests the cheapest rows that meet the trade's error, until the cheapest has been tested.

    They are held to a little less than it. Of those that do not keep to that, some are tried with
    shorter steps. Where none keeps to it, what keeps to the error itself will do.
    """
    assert trade.target is not None
    limit, repairs = MARGIN * trade.target, REPAIRED
    for _ in range(TRIES):
        try:
            row = trade.cheapest(limit)
        except ValueError:
            if limit == trade.target:
                return
            limit = trade.target
            continue
        if row.further is not None and row.further.starts in (0, confirm.count):
            trade.chosen = row
            return
        row.further = confirm.test(row.settings, limit, trade.target)
        trade.mark()
        if trade.error(row) > limit and repairs and confirm.scored is not None:
            repairs -= 1
            _repair(trade, confirm, finish, steps, row, limit)


def _repair(
    trade: Trade, confirm: Confirmation, finish: Finish, steps: Steps, row: Row, limit: float
) -> None:
    """Adds a row like one that failed on further starts, with a step short enough for them."""
    pieces = steps.pieces(row.settings)
    finest = int(steps.period / confirm.trials.reference.settings.dt / 2 + 1e-9)
    for k in range(TIMES):
        pieces = math.ceil(pieces * (SHORTER + MORE * k))
        if pieces > finest:
            return
        settings = steps.at(row.settings, pieces)
        if any(other.settings == settings for other in trade.rows):
            return
        if confirm.holds(settings, limit):
            _add(trade, finish, settings)
            return


def within_budget(trade: Trade, confirm: Confirmation, finish: Finish, steps: Steps) -> None:
    """Fits the step of the most accurate row to the budget, and tests it on the further starts."""
    assert trade.budget is not None
    for _ in range(TRIES):
        try:
            row = trade.most_accurate(trade.budget)
        except ValueError:
            return
        before = len(trade.rows)
        pieces = steps.pieces(row.settings)
        more = int(pieces * trade.budget / trade.price(row) * 0.98)
        if more >= 1.08 * pieces:
            _add(trade, finish, steps.at(row.settings, more))
        if len(trade.rows) > before:
            continue
        if row.further is not None:
            return
        row.further = confirm.test(row.settings, math.inf, math.inf)
        trade.mark()


def _add(trade: Trade, finish: Finish, settings: Settings) -> None:
    if all(row.settings != settings for row in trade.rows):
        trade.rows.append(finish(settings))
        trade.rows.sort(key=lambda row: -row.settings.dt)
        trade.mark()


def others(made: Motion) -> Motion:
    """A motion without its first start, the keyframe, which the search has seen."""
    ctrl = None if made.ctrl is None else made.ctrl[1:]
    return dataclasses.replace(made, starts=made.starts[1:], ctrl=ctrl)
