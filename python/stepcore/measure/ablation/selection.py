"""The smallest model within a tolerance: chosen on some starts, confirmed on others."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from stepcore.engine.features import MotionUsage, RemovableFeatures, Removal
from stepcore.experiment.runner import Runner
from stepcore.measure.ablation.variants import Baseline, VariantOutcome, outcome_of, usage_of
from stepcore.report.progress import Progress

Measure = Callable[[Sequence[Removal]], VariantOutcome]


class Selection:
    """Features removed one at a time, and those of them that can be removed together.

    removed: what the smallest model goes without; chosen_on: that model's outcome on the starts
    that it was chosen on; confirmed_on: on the last other starts that it was tried on; restored:
    what had to be restored because of those.
    """

    def __init__(self, baseline: Baseline, features: RemovableFeatures, error: float) -> None:
        self.baseline, self.features, self.error = baseline, features, error
        self.known: dict[Removal, VariantOutcome] = {}
        self.removed: list[Removal] = []
        self.restored: list[Removal] = []
        self.chosen_on = self.confirmed_on = VariantOutcome()

    def alone(self, removal: Removal) -> VariantOutcome:
        """One feature removed, on the starts that are chosen on."""
        if removal not in self.known:
            self.known[removal] = outcome_of(self.baseline, [removal])
        return self.known[removal]

    def choose(self, removals: Sequence[Removal], whole: VariantOutcome, bar: Progress) -> None:
        """Removes features together, greedily, on the starts of the baseline."""

        def measure(chosen: Sequence[Removal]) -> VariantOutcome:
            bar.advance()
            return outcome_of(self.baseline, chosen)

        alone = [self.alone(removal) for removal in removals]
        self.removed, self.chosen_on = greedy(removals, alone, whole, self.error, measure)

    def confirm(self, others: Iterable[tuple[Runner, Baseline]]) -> None:
        """Tries the smallest model on other starts, until a set of them needs nothing restored."""
        for runner, baseline in others:
            # Run only where something has to be restored.
            usage = functools.cache(partial(usage_of, runner, runner.model.settings))
            self.removed, self.confirmed_on, restored = confirmed(
                self.removed,
                self.alone,
                self.error,
                partial(outcome_of, baseline),
                partial(_reduced, self.features, usage),
            )
            self.restored += restored
            if not restored:
                break
        if self.restored:
            self.chosen_on = outcome_of(self.baseline, self.removed)


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

    One feature after the other, the largest saving first. Each stays removed that still saves work
    and leaves the error within the tolerance, and each that changes no bit of the motion and costs
    no work. Of two that exclude each other (a cone, and no friction at all) the one that saves more
    is tried first.
    """
    order = sorted(range(len(removals)), key=lambda i: work(alone[i]))
    chosen: list[Removal] = []
    best = whole
    for i in order:
        unused = alone[i].worst == 0.0
        if alone[i].worst > error or not _saves(alone[i], whole, unused):
            continue
        tried = measure([*chosen, removals[i]])
        if tried.worst <= error and _saves(tried, best, unused):
            chosen, best = [*chosen, removals[i]], tried
    return chosen, best


def _saves(outcome: VariantOutcome, before: VariantOutcome, unused: bool) -> bool:
    """Whether there is less work; for a feature that does nothing, no more of it."""
    return work(outcome) < work(before) or (unused and work(outcome) == work(before))


def confirmed(
    chosen: Sequence[Removal],
    alone: Callable[[Removal], VariantOutcome],
    error: float,
    measure: Measure,
    reduced: Callable[[Removal], Removal | None],
) -> tuple[list[Removal], VariantOutcome, list[Removal]]:
    """What may stay removed on other starts, the outcome there, and what had to be restored.

    `measure` runs those starts. Where the error is beyond the tolerance, the groups lose what those
    starts use (`reduced`); then, as long as that is not enough, the feature that adds the largest
    error is restored.
    """
    removed: list[Removal] = list(chosen)
    outcome = measure(removed)
    restored: list[Removal] = []
    if outcome.worst > error:
        fewer = [(removal, reduced(removal)) for removal in removed]
        restored = [removal for removal, smaller in fewer if smaller != removal]
        removed = [smaller for _, smaller in fewer if smaller is not None]
        outcome = measure(removed) if restored else outcome
    while outcome.worst > error and removed:
        worst = max(removed, key=lambda removal: alone(removal).worst)
        removed.remove(worst)
        restored.append(worst)
        outcome = measure(removed)
    return removed, outcome, restored
