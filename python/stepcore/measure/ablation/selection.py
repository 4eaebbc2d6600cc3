"""The smallest model within a tolerance: chosen on some starts, confirmed on others."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from stepcore.engine.features import MotionUsage, RemovableFeatures, Removal
from stepcore.experiment.arguments import Workers
from stepcore.experiment.runner import Runner
from stepcore.measure.ablation.variants import Baseline, VariantOutcome, outcome_of, usage_of
from stepcore.report.progress import Progress

Measure = Callable[[Sequence[Removal]], VariantOutcome]


class Selection:
    """Features removed one at a time, and those of them that can be removed together.

    removed: what the smallest model goes without; chosen_on: that model's outcome on the starts
    that it was chosen on; confirmed_on: on the last other starts that it was tried on; restored:
    what had to be restored because of other starts; restored_on: its outcome on the last of those.
    """

    def __init__(
        self, baseline: Baseline, features: RemovableFeatures, error: float, workers: Workers
    ) -> None:
        self.baseline, self.features, self.error = baseline, features, error
        self.workers = workers
        self.known: dict[Removal, VariantOutcome] = {}
        self.removed: list[Removal] = []
        self.restored: list[Removal] = []
        self.chosen_on = self.confirmed_on = VariantOutcome()
        self.restored_on: VariantOutcome | None = None

    def alone(self, removal: Removal) -> VariantOutcome:
        """One feature removed, on the starts that are chosen on."""
        if removal not in self.known:
            self.known[removal] = outcome_of(self.baseline, [removal], self.workers)
        return self.known[removal]

    def choose(self, removals: Sequence[Removal], whole: VariantOutcome, bar: Progress) -> None:
        """Removes features together, greedily, on the starts of the baseline."""

        def measure(chosen: Sequence[Removal]) -> VariantOutcome:
            bar.advance()
            return outcome_of(self.baseline, chosen, self.workers)

        alone = [self.alone(removal) for removal in removals]
        self.removed, self.chosen_on = greedy(removals, alone, whole, self.error, measure)

    def confirm(self, others: Iterable[tuple[Runner, Baseline]]) -> None:
        """Tries the smallest model on other starts, until a set of them needs nothing restored."""
        for runner, baseline in others:
            # Run only where something has to be restored.
            usage = functools.cache(partial(usage_of, runner, runner.model.settings, self.workers))
            self.removed, self.confirmed_on, restored = confirmed(
                self.removed,
                self.error,
                partial(outcome_of, baseline, workers=self.workers),
                partial(_reduced, self.features, usage),
            )
            self.restored += restored
            if not restored:
                break
            self.restored_on = self.confirmed_on
        if self.restored:
            self.chosen_on = outcome_of(self.baseline, self.removed, self.workers)


def _reduced(
    features: RemovableFeatures, usage: Callable[[], MotionUsage], removal: Removal
) -> Removal | None:
    return features.reduced(removal, usage())


def work(outcome: VariantOutcome) -> float:
    """What a variant costs, by count: operations where they can be counted, else row updates."""
    return outcome.row_updates if outcome.flops is None else outcome.flops


def saved(outcome: VariantOutcome, whole: VariantOutcome) -> float:
    """The share of the work that a variant saves; negative: it costs more."""
    before = work(whole)
    return (before - work(outcome)) / before if before > 0 and not outcome.failure else math.nan


def greedy(
    removals: Sequence[Removal],
    alone: Sequence[VariantOutcome],
    whole: VariantOutcome,
    error: float,
    measure: Measure,
) -> tuple[list[Removal], VariantOutcome]:
    """What can be removed together for at most `error` [m] in the worst start.

    The largest saving first. Each stays removed that still saves work and leaves the error within
    the tolerance, and each that changes no bit of the motion and costs no work. Of two that exclude
    each other (a cone, and no friction at all) the one that saves more is tried first. Features of
    one kind, such as the limits of joints, exclude none of each other: they are tried all at once,
    and where that is too much in halves, down to single ones.
    """
    order = sorted(range(len(removals)), key=lambda i: work(alone[i]))
    chosen: list[Removal] = []
    best = whole

    def remove(group: Sequence[int]) -> None:
        nonlocal chosen, best
        more = [*chosen, *(removals[i] for i in group)]
        tried = measure(more)
        unused = all(alone[i].worst == 0.0 for i in group)
        if tried.worst <= error and _saves(tried, best, unused):
            chosen, best = more, tried
        elif len(group) > 1:
            remove(group[: len(group) // 2])
            remove(group[len(group) // 2 :])

    kinds: dict[str, list[int]] = {}
    for i in order:
        if alone[i].worst <= error and _saves(alone[i], whole, alone[i].worst == 0.0):
            kinds.setdefault(removals[i].kind, []).append(i)
    for group in kinds.values():
        remove(group)
    return chosen, best


def _saves(outcome: VariantOutcome, before: VariantOutcome, unused: bool) -> bool:
    """Whether there is less work; for a feature that does nothing, no more of it."""
    return work(outcome) < work(before) or (unused and work(outcome) == work(before))


def confirmed(
    chosen: Sequence[Removal],
    error: float,
    measure: Measure,
    reduced: Callable[[Removal], Removal | None],
) -> tuple[list[Removal], VariantOutcome, list[Removal]]:
    """What may stay removed on other starts, the outcome there, and what had to be restored.

    `measure` runs those starts. Where the error is beyond the tolerance, the groups lose what those
    starts use (`reduced`). Where that is not enough, features are restored, those first that add
    the largest errors there by themselves: as few as will do, which bisection finds. (In the starts
    that were chosen on what is unused adds no error, and would be restored in any order.)
    """
    removed: list[Removal] = list(chosen)
    outcome = measure(removed)
    restored: list[Removal] = []
    if outcome.worst > error:
        fewer = [(removal, reduced(removal)) for removal in removed]
        restored = [removal for removal, smaller in fewer if smaller != removal]
        removed = [smaller for _, smaller in fewer if smaller is not None]
        outcome = measure(removed) if restored else outcome
    if outcome.worst > error:
        alone = {removal: measure([removal]).worst for removal in removed}
        order = sorted(removed, key=lambda removal: -alone[removal])
        # With none restored the error is too large, with all of them there is none.
        few, enough = 0, len(order)
        fewest: VariantOutcome | None = None
        while enough - few > 1:
            middle = (few + enough) // 2
            tried = measure([removal for removal in removed if removal in order[middle:]])
            if tried.worst <= error:
                enough, fewest = middle, tried
            else:
                few = middle
        restored += order[:enough]
        removed = [removal for removal in removed if removal in order[enough:]]
        outcome = measure([]) if fewest is None else fewest
    return removed, outcome, restored
