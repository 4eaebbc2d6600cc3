"""Which features the smallest model goes without: chosen on some starts, confirmed on others."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from stepcore.experiment.runner import Course
from stepcore.measure.ablation.changes import Change, Features, Seen
from stepcore.measure.ablation.run import Measured, Motive, measured, watched
from stepcore.measure.ablation.smallest import confirmed, greedy
from stepcore.report.progress import Progress


class Selection:
    """Features measured alone, and what of them goes together.

    kept: the changes that are kept; best: all of them on the starts they were chosen on; held:
    on the last starts they were tried on; back: what had to come back.
    """

    def __init__(self, motive: Motive, features: Features, error: float) -> None:
        self.motive, self.features, self.error = motive, features, error
        self.known: dict[Change, Measured] = {}
        self.kept: list[Change] = []
        self.back: list[Change] = []
        self.best = self.held = Measured()

    def alone(self, change: Change) -> Measured:
        """One feature switched off, on the starts that are chosen on."""
        if change not in self.known:
            self.known[change] = measured(self.motive, [change])
        return self.known[change]

    def choose(self, changes: Sequence[Change], whole: Measured, bar: Progress) -> None:
        """Greedily, on the starts of the motive."""

        def measure(chosen: Sequence[Change]) -> Measured:
            bar.advance()
            return measured(self.motive, chosen)

        alone = [self.alone(change) for change in changes]
        self.kept, self.best = greedy(changes, alone, whole, self.error, measure)

    def confirm(self, others: Iterable[tuple[Course, Motive]]) -> None:
        """On other starts, set by set, until nothing has to come back."""
        for course, motive in others:
            # Looked at only where something has to come back.
            seen = functools.cache(partial(watched, course, course.model.settings))
            less = partial(_lessened, self.features, seen)
            measure = partial(measured, motive)
            self.kept, self.held, back = confirmed(self.kept, self.alone, self.error, measure, less)
            self.back += back
            if not back:
                break
        if self.back:
            self.best = measured(self.motive, self.kept)


def _lessened(features: Features, seen: Callable[[], Seen], change: Change) -> Change | None:
    return features.lessened(change, seen())
