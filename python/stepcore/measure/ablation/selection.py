"""Finds the smallest model within a tolerance: chosen on some starts, confirmed on others."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from stepcore.engine.features import MotionUsage, RemovableFeatures, Removal
from stepcore.experiment.arguments import Workers
from stepcore.experiment.runner import Runner
from stepcore.measure.ablation.variants import Baseline, VariantOutcome, outcome_of, usage_of
from stepcore.report.progress import Progress

Measure = Callable[[Sequence[Removal]], VariantOutcome]


class Selection:
    """The features removed one at a time, and those that can be removed together.

    removed: the features that the smallest model leaves out.
    restored: the features that other starts needed.
    chosen_on: the smallest model's outcome on the starts on which it was chosen.
    confirmed_on: the smallest model's outcome on the last other starts.
    restored_on: the smallest model's outcome on the last starts that restored a feature.
    """

    def __init__(
        self, baseline: Baseline, features: RemovableFeatures, tolerance: float, workers: Workers
    ) -> None:
        self.baseline, self.features, self.tolerance = baseline, features, tolerance
        self.workers = workers
        self.known: dict[Removal, VariantOutcome] = {}
        self.removed: list[Removal] = []
        self.restored: list[Removal] = []
        self.chosen_on = self.confirmed_on = VariantOutcome()
        self.restored_on: VariantOutcome | None = None

    def alone(self, removal: Removal) -> VariantOutcome:
        """Return the outcome of one feature removed, on the starts of the choice."""
        if removal not in self.known:
            self.known[removal] = outcome_of(self.baseline, [removal], self.workers)
        return self.known[removal]

    def choose(self, removals: Sequence[Removal], whole: VariantOutcome, bar: Progress) -> None:
        """Remove as many features together as the tolerance allows on the baseline's starts."""

        def measure(chosen: Sequence[Removal]) -> VariantOutcome:
            bar.advance()
            return outcome_of(self.baseline, chosen, self.workers)

        alone = [self.alone(removal) for removal in removals]

        def keep(removed: list[Removal], outcome: VariantOutcome) -> None:
            self.removed, self.chosen_on = removed, outcome

        keep([], whole)
        greedy(removals, alone, whole, self.tolerance, measure, keep)

    def confirm(self, others: Iterable[Baseline]) -> None:
        """Run the smallest model on sets of other starts, until a set needs nothing restored."""
        for baseline in others:
            # Made only if a feature has to be restored.
            runner = Runner(baseline.model, baseline.schedule)
            usage = functools.cache(partial(usage_of, runner, self.workers))
            self.removed, self.confirmed_on, restored = confirmed(
                self.removed,
                self.tolerance,
                partial(outcome_of, baseline, workers=self.workers),
                partial(self._reduced, usage),
            )
            self.restored += restored
            if not restored:
                break
            self.restored_on = self.confirmed_on
        if self.restored:
            self.chosen_on = outcome_of(self.baseline, self.removed, self.workers)

    def _reduced(self, usage: Callable[[], MotionUsage], removal: Removal) -> Removal | None:
        return self.features.reduced(removal, usage())


def greedy(
    removals: Sequence[Removal],
    alone: Sequence[VariantOutcome],
    whole: VariantOutcome,
    tolerance: float,
    measure: Measure,
    keep: Callable[[list[Removal], VariantOutcome], object] = lambda removed, outcome: None,
) -> tuple[list[Removal], VariantOutcome]:
    """Return features that together add at most `tolerance` [m], and their outcome.

    The error is that of the worst start. The largest saving is tried first. A feature stays removed
    if that saves more work within the tolerance, or if the motion stays bit-identical and no work
    is added. If two features exclude each other (a cone, and no friction at all), the larger saving
    wins. Features of one kind, such as the limits of joints, never exclude each other. They are
    tried all at once, and after a failure in halves, down to single features.

    removals: the features to try.
    alone: the outcome of each feature removed alone.
    whole: the outcome of the whole model.
    tolerance: the largest error added [m].
    measure: runs the model without some features.
    keep: is called with every larger set of features, and its outcome.
    """
    order = sorted(range(len(removals)), key=lambda i: alone[i].work)
    chosen: list[Removal] = []
    best = whole

    def remove(group: Sequence[int]) -> None:
        nonlocal chosen, best
        more = [*chosen, *(removals[i] for i in group)]
        tried = measure(more)
        unused = all(alone[i].worst == 0.0 for i in group)
        if tried.worst <= tolerance and _saves(tried, best, unused):
            chosen, best = more, tried
            keep(chosen, best)
        elif len(group) > 1:
            remove(group[: len(group) // 2])
            remove(group[len(group) // 2 :])

    kinds: dict[str, list[int]] = {}
    for i in order:
        if alone[i].worst <= tolerance and _saves(alone[i], whole, alone[i].worst == 0.0):
            kinds.setdefault(removals[i].kind, []).append(i)
    for group in kinds.values():
        remove(group)
    return chosen, best


def _saves(outcome: VariantOutcome, before: VariantOutcome, unused: bool) -> bool:
    """Return whether there is less work; for a feature without effect, whether no work is added."""
    return outcome.work < before.work or (unused and outcome.work == before.work)


def confirmed(
    chosen: Sequence[Removal],
    tolerance: float,
    measure: Measure,
    reduced: Callable[[Removal], Removal | None],
) -> tuple[list[Removal], VariantOutcome, list[Removal]]:
    """Return the features that stay removed on other starts, the outcome there, and those restored.

    chosen: the features that the smallest model leaves out.
    tolerance: the largest error added [m].
    measure: runs the other starts.
    reduced: returns a group of features without those that the other starts use.

    If the error exceeds the tolerance, groups are reduced. If that is not enough, features are
    restored in the order of the errors that each adds there alone. Bisection finds the smallest
    number to restore.
    """
    removed: list[Removal] = list(chosen)
    outcome = measure(removed)
    restored: list[Removal] = []
    if outcome.worst > tolerance:
        fewer = [(removal, reduced(removal)) for removal in removed]
        restored = [removal for removal, smaller in fewer if smaller != removal]
        removed = [smaller for _, smaller in fewer if smaller is not None]
        outcome = measure(removed) if restored else outcome
    if outcome.worst > tolerance:
        alone = {removal: measure([removal]).worst for removal in removed}
        order = sorted(removed, key=lambda removal: -alone[removal])
        # With nothing restored the error is too large; with everything restored the error is 0.
        few, enough = 0, len(order)
        fewest: VariantOutcome | None = None
        while enough - few > 1:
            middle = (few + enough) // 2
            tried = measure([removal for removal in removed if removal in order[middle:]])
            if tried.worst <= tolerance:
                enough, fewest = middle, tried
            else:
                few = middle
        restored += order[:enough]
        removed = [removal for removal in removed if removal in order[enough:]]
        outcome = measure([]) if fewest is None else fewest
    return removed, outcome, restored
