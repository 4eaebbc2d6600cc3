"""The search once more, on the starts that proved hardest.

The first search knows eight starts; the further ones that a recommendation must pass may be harder,
and a method that was dropped early may do better there than the one that only needs shorter steps.
Searching on the hardest of all starts finds what is cheapest where it matters, whichever of them
the seed put among the first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.growth import Growth
from stepcore.experiment.reference import Reference
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule
from stepcore.measure.trade.frontier import MARGIN, Frontier
from stepcore.measure.trade.moves import Steps
from stepcore.measure.trade.recommend import Confirmation
from stepcore.measure.trade.row import TradeRow
from stepcore.measure.trade.search import SettingsSearch
from stepcore.measure.trade.trials import Trials

# So many of all starts are searched on.
HARD = 8
# Methods to begin with: of the rows that cost at most so many times what passed.
NEAR = 2.0
# Of what is found, so many settings that cost less are tested.
TESTED = 3


class HardestStarts:
    """Searches on the hardest of the search's own and the further starts.

    rows: the most at once in the reference. friction: whether a contact can have friction. target:
    the error asked for [m].
    """

    def __init__(
        self,
        trials: Trials,
        confirm: Confirmation,
        steps: Steps,
        shipped: Settings,
        rows: int,
        friction: bool,
        target: float,
    ) -> None:
        self.trials, self.confirm, self.steps = trials, confirm, steps
        self.shipped, self.rows, self.friction, self.target = shipped, rows, friction, target

    def __call__(self, frontier: Frontier, chosen: TradeRow) -> Sequence[Settings]:
        """Settings cheaper than the row that passed, as far as the hardest starts tell."""
        order = self.order(frontier)
        few = [int(i) for i in order[:HARD]]
        runner = Runner(self.trials.runner.model, self._schedule(few))
        hard = Trials(runner, self._reference(few), self.trials.size, self.trials.workers)
        search = SettingsSearch(hard, self.steps, self.shipped, self.rows, self.friction)
        price = frontier.price(chosen)
        near = [r.settings for r in frontier.rows if frontier.price(r) <= NEAR * price]
        search.methods = list(
            dict.fromkeys(self.steps.at(s, self.steps.own) for s in near if s.precision == "f64")
        )
        found = search.meeting(MARGIN * self.target)
        self.trials.runs += hard.runs
        own = chosen.flops
        cheaper = [s for s in found if hard.score(s, len(few)).price < own]
        return cheaper[:TESTED]

    def order(self, frontier: Frontier) -> np.ndarray:
        """All starts, the search's own first in number, by how wrong tested rows were there."""
        own = np.zeros(len(self.trials.runner.schedule.starts))
        for row in frontier.rows:
            if row.further is not None and row.errors is not None:
                own = np.maximum(own, row.errors.each)
        return np.argsort(-np.concatenate([own, self.confirm.hardness()]), kind="stable")

    def _schedule(self, few: Sequence[int]) -> Schedule:
        one, other = self.trials.runner.schedule, self.confirm.runner.schedule
        starts = [*one.starts, *other.starts]
        ctrl = None
        if one.ctrl is not None and other.ctrl is not None:
            ctrl = np.concatenate([one.ctrl, other.ctrl])[list(few)]
        return dataclasses.replace(one, starts=tuple(starts[i] for i in few), ctrl=ctrl)

    def _reference(self, few: Sequence[int]) -> Reference:
        """The reference of these starts, as known as that of the search's own."""
        one = self.trials.reference
        paths = [*one.runs, *self.confirm.truth.runs]
        level = dataclasses.replace(one.level, runs=[paths[i] for i in few])
        ends = np.concatenate([one.growth.ends, self.confirm.ends])[list(few)]
        factor = np.ones((len(few), len(one.growth.times)))
        growth = Growth(one.growth.times, factor, ends)
        return dataclasses.replace(one, level=level, growth=growth, exact=None)
