"""The smallest model within a tolerance: features are switched off together, greedily."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from stepcore.measure.ablation.changes import Change
from stepcore.measure.ablation.run import Measured

Measure = Callable[[Sequence[Change]], Measured]


def work(measured: Measured) -> float:
    """What a variant costs, by count: operations where they can be counted, else row updates."""
    return measured.row_updates if measured.flops is None else measured.flops


def greedy(
    changes: Sequence[Change],
    alone: Sequence[Measured],
    whole: Measured,
    error: float,
    measure: Measure,
) -> tuple[list[Change], Measured]:
    """What can be switched off together for at most `error` [m] in the worst start.

    One after the other, what saves most first; each is kept that still saves work and leaves the
    error within the tolerance, and each on which no bit of the motion depends and that costs no
    work. Of two that exclude each other (a cone, and no friction at all) the one that saves more
    is tried first.
    """
    order = sorted(range(len(changes)), key=lambda i: work(alone[i]))
    chosen: list[Change] = []
    best = whole
    for i in order:
        idle = alone[i].worst == 0.0
        if alone[i].worst > error or not _less(alone[i], whole, idle):
            continue
        tried = measure([*chosen, changes[i]])
        if tried.worst <= error and _less(tried, best, idle):
            chosen, best = [*chosen, changes[i]], tried
    return chosen, best


def _less(one: Measured, other: Measured, idle: bool) -> bool:
    """Less work; for a feature that does nothing no more of it."""
    return work(one) < work(other) or (idle and work(one) == work(other))


def confirmed(
    chosen: Sequence[Change],
    alone: Callable[[Change], Measured],
    error: float,
    measure: Measure,
    lessened: Callable[[Change], Change | None],
) -> tuple[list[Change], Measured, list[Change]]:
    """What also holds on starts it was not chosen on, how well, and what had to come back.

    `measure` runs those starts. Where the error is beyond the tolerance, what they use after all
    comes back from the groups (`lessened`); then, as long as that is not enough, the feature that
    adds most.
    """
    kept: list[Change] = list(chosen)
    found = measure(kept)
    back: list[Change] = []
    if found.worst > error:
        less = [(change, lessened(change)) for change in kept]
        back = [change for change, smaller in less if smaller != change]
        kept = [smaller for _, smaller in less if smaller is not None]
        found = measure(kept) if back else found
    while found.worst > error and kept:
        worst = max(kept, key=lambda change: alone(change).worst)
        kept.remove(worst)
        back.append(worst)
        found = measure(kept)
    return kept, found, back


def saved(measured: Measured, whole: Measured) -> float:
    """The share of the work that a variant saves; negative: it costs more."""
    before = work(whole)
    return (before - work(measured)) / before if before > 0 and not measured.failure else math.nan
