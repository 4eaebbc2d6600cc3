"""The extremes: the lesson's scenes and two models, far outside the values they were made for.

Each cell of a table is one run. It states the law that the run must keep (an invariant, a resting
depth, a rate of convergence, the balance of energy or momentum), or the limit beyond which the run
must fail with an error that names an element. The cell holds if the engine does exactly that.

    python benches/extremes.py          # how many cells keep their law, and those that do not
    python benches/extremes.py --all    # every cell
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence

from extreme_cases import contact, grasp, models, spring
from extreme_cases.cells import Case, Cell, report

from stepcore.report.progress import Choice, Progress


def cases() -> Iterator[Case]:
    """Every cell to be run, one table after the other."""
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


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--all", action="store_true", help="print every cell")
    full = parser.parse_args().all
    cells = run()
    print(report(cells, full=full))
    return 0 if all(cell.ok for cell in cells) else 1


if __name__ == "__main__":
    sys.exit(main())
