"""One cell of the extremes: a run, its law, and what came out; and the tables they make."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

from stepcore._core import SimulationError

EPS = {"f64": 2.0**-52, "f32": 2.0**-23}
PRECISIONS = ("f64", "f32")
STEPS_OF_TIME = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)


@dataclass(frozen=True)
class Outcome:
    """What a run came to: whether its law held, in a few characters, and which law it was.

    law: "finite" where nothing more was asked than finite numbers. kind: "law" or "error".
    value: how far from the law, where that is a number.
    """

    ok: bool
    text: str
    law: str
    kind: str = "law"
    value: float | None = None


@dataclass(frozen=True)
class Cell:
    """An outcome and its place. table: a title, and the law on a line of its own."""

    table: str
    row: str
    column: str
    precision: str
    ok: bool
    text: str
    law: str
    kind: str
    value: float | None

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for --json."""
        return asdict(self)


@dataclass(frozen=True)
class Case:
    """A cell still to be run."""

    table: str
    row: str
    column: str
    precision: str
    go: Callable[[], Outcome]

    def run(self) -> Cell:
        """The cell; an error that the run did not ask for is a miss that shows its text."""
        try:
            outcome = self.go()
        except (ValueError, SimulationError) as error:
            outcome = Outcome(False, f"error: {error}", "no error", "error")
        where = (self.table, self.row, self.column, self.precision)
        return Cell(*where, **asdict(outcome))


def within(value: float, bound: float, law: str, word: str = "ok") -> Outcome:
    """The law holds while `value` is at most `bound`."""
    ok = math.isfinite(value) and value <= bound
    text = f"{word} {value:.0e}" if ok else f"{value:.1e} > {bound:.0e}"
    return Outcome(ok, text, law, value=value)


def all_of(*outcomes: Outcome) -> Outcome:
    """The first that failed; or the worst of the first one's law, with the names of them all."""
    for outcome in outcomes:
        if not outcome.ok:
            return outcome
    alike = [outcome for outcome in outcomes if outcome.law == outcomes[0].law]
    worst = max(alike, key=lambda outcome: outcome.value or 0.0)
    law = ", ".join(dict.fromkeys(outcome.law for outcome in outcomes))
    return replace(worst, law=law)


def named_error(error: SimulationError, among: Iterable[str] | None = None) -> Outcome:
    """A run beyond its limit ended with an error, which must name an element.

    among: words of which its text must hold one; None: any element's kind and name.
    """
    text = str(error)
    blamed = re.search(r"what drove it is ([^;]*)", text)
    name = blamed.group(1) if blamed else ""
    ok = "`" in name if among is None else any(word in name for word in among)
    short = name.replace("`", "")
    return Outcome(ok, f"error: {short or text}", "a named error", "error")


def report(cells: Iterable[Cell]) -> str:
    """The cells as text: one table a scene and question, misses marked, and the count of laws."""
    cells = list(cells)
    lines: list[str] = []
    for table in dict.fromkeys(cell.table for cell in cells):
        mine = [cell for cell in cells if cell.table == table]
        lines += ["", *table.splitlines(), *_grid(mine)]
    by_law = sum(cell.kind == "law" and cell.law != "finite" for cell in cells)
    errors = sum(cell.kind == "error" for cell in cells)
    finite = sum(cell.law == "finite" for cell in cells)
    missed = [cell for cell in cells if not cell.ok]
    lines += [
        "",
        "<ulp: what the law asks for is below what the numbers resolve, and stays there.",
        f"{len(cells)} cells: {by_law} by their law, {errors} by an error that names the element, "
        f"{finite} finite and no more; {len(missed)} missed.",
    ]
    for cell in missed:
        title = cell.table.splitlines()[0]
        place = f"{title}; {cell.row}, {cell.column}, {cell.precision}"
        lines.append(f"  missed: {place}: {cell.text} ({cell.law})")
    return "\n".join(lines[1:])


def _grid(cells: list[Cell]) -> list[str]:
    columns = list(dict.fromkeys(cell.column for cell in cells))
    rows = list(dict.fromkeys((cell.precision, cell.row) for cell in cells))
    place = {(cell.precision, cell.row, cell.column): cell for cell in cells}
    grid = [["", "", *columns]]
    for precision, row in rows:
        found = (place.get((precision, row, column)) for column in columns)
        grid.append([precision, row, *(_shown(cell) for cell in found)])
    widths = [max(len(line[i]) for line in grid) for i in range(len(grid[0]))]
    return ["  " + _line(line, widths) for line in grid]


def _shown(cell: Cell | None, most: int = 20) -> str:
    if cell is None:
        return ""
    text = cell.text if len(cell.text) <= most else cell.text[: most - 1] + "…"
    return text if cell.ok else f"{text} <--"


def _line(line: list[str], widths: list[int]) -> str:
    return "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
