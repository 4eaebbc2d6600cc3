"""The extremes: the lesson's scenes and two models, far outside the values they were made for.

Each cell of a table is one run. It states the law that the run must keep (an invariant, a resting
depth, a rate of convergence, the balance of energy or momentum), or the limit beyond which the run
must fail with an error that names an element. The cell holds if the engine does exactly that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stepcore.lesson.extremes.cells import Case, Cell, report
from stepcore.report.progress import Choice, Progress

__all__ = ["Cell", "report", "run"]


def cases() -> Iterator[Case]:
    """Every cell to be run, one table after the other."""
    from stepcore.lesson.extremes import contact, grasp, models, spring

    for part in (spring, contact, grasp, models):
        yield from part.cases()


def run(progress: Choice = None, chosen: Sequence[Case] | None = None) -> list[Cell]:
    """Runs the cells, in order.

    progress: as for `stepcore.sweep`. chosen: some of `cases()`; all of them by default.
    """
    chosen = list(cases() if chosen is None else chosen)
    done = []
    with Progress("extremes", len(chosen), progress) as bar:
        for case in chosen:
            done.append(case.run())
            bar.advance()
    return done
