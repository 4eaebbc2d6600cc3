"""The extremes: the lesson's scenes and two models far outside of what they were made for.

Each cell of a table is one run. It states the law that the run must keep (an invariant, a resting
depth, a rate of convergence, the balance of energy or momentum) or the limit beyond which it must
not, and holds when the engine does exactly that, or stops with an error that names an element.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stepcore.lesson.extremes.cells import Case, Cell, report
from stepcore.report.progress import Choice, Progress

__all__ = ["Cell", "report", "run"]


def cases() -> Iterator[Case]:
    """Every cell to be run, table after table."""
    from stepcore.lesson.extremes import contact, grasp, models, spring

    for part in (spring, contact, grasp, models):
        yield from part.cases()


def run(progress: Choice = None, chosen: Sequence[Case] | None = None) -> list[Cell]:
    """Runs the matrix.

    progress: as for `stepcore.sweep`: None (a bar on a terminal), False, or a function.
    chosen: some of `cases()`; all of them by default.
    """
    todo = list(cases() if chosen is None else chosen)
    done = []
    with Progress("extremes", len(todo), progress) as bar:
        for case in todo:
            done.append(case.run())
            bar.advance()
    return done
