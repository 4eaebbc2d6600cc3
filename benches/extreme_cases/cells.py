"""One cell of the extremes: a run, its law and its outcome; and the tables made of cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from stepcore._core import SimulationError

EPS = {"f64": 2.0**-52, "f32": 2.0**-23}
# The time steps of most tables [s], by the name of their row.
TIME_STEPS = {f"dt {dt:.0e}": dt for dt in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)}


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run.

    ok: its law held. text: what came out, in a few characters. law: which law it was; "finite"
    where only finite numbers were asked for. kind: "law" or "error". value: how far it was from the
    law, where that is a number.
    """

    ok: bool
    text: str
    law: str
    kind: str = "law"
    value: float | None = None


@dataclass(frozen=True)
class Cell(Outcome):
    """An outcome and its place. table: a title, and the law on a line of its own."""

    table: str = ""
    row: str = ""
    column: str = ""
    precision: str = ""

    def to_dict(self) -> dict[str, Any]:
        """The cell as plain data."""
        return asdict(self)


@dataclass(frozen=True)
class Case:
    """A cell that is still to be run. measure: runs it."""

    table: str
    row: str
    column: str
    precision: str
    measure: Callable[[], Outcome]

    def run(self) -> Cell:
        """The cell; an error that the case did not expect is a miss that shows its text."""
        try:
            outcome = self.measure()
        except (ValueError, SimulationError) as error:
            outcome = Outcome(False, f"error: {error}", "no error", "error")
        place = {name: getattr(self, name) for name in ("table", "row", "column", "precision")}
        return Cell(**asdict(outcome), **place)


def table_cases(
    title: str,
    law: str,
    measure: Callable[[Any, Any, str], Outcome],
    rows: Mapping[str, Any],
    columns: Mapping[str, Any],
) -> Iterator[Case]:
    """The cases of a table, in both precisions.

    measure: of the row's value, the column's value and the precision. rows, columns: the values by
    the name that the table prints.
    """
    for precision in EPS:
        for row, first in rows.items():
            for column, second in columns.items():
                run = partial(measure, first, second, precision)
                yield Case(f"{title}\n  law: {law}", row, column, precision, run)


def within(value: float, bound: float, law: str, word: str = "ok") -> Outcome:
    """The law that `value` is at most `bound`."""
    ok = math.isfinite(value) and value <= bound
    text = f"{word} {value:.0e}" if ok else f"{value:.1e} > {bound:.0e}"
    return Outcome(ok, text, law, value=value)


def all_of(*outcomes: Outcome) -> Outcome:
    """The first outcome that failed; or else the worst of the first law, with all laws' names."""
    for outcome in outcomes:
        if not outcome.ok:
            return outcome
    alike = [outcome for outcome in outcomes if outcome.law == outcomes[0].law]
    worst = max(alike, key=lambda outcome: outcome.value or 0.0)
    law = ", ".join(dict.fromkeys(outcome.law for outcome in outcomes))
    return replace(worst, law=law)


def named_error(error: SimulationError, kind: str | None = None) -> Outcome:
    """A run beyond its limit ended with an error, which must name an element.

    kind: of the element that it must name; None: any but gravity.
    """
    named = error.element_id[0] if error.element_id else "gravity"
    ok = named != "gravity" if kind is None else named == kind
    return Outcome(ok, f"error: {error.element.replace('`', '')}", "a named error", "error")


def report(cells: Iterable[Cell], full: bool = False) -> str:
    """The cells as text: how many keep their law first, then those that do not.

    full: every cell, in its table.
    """
    cells = list(cells)
    by_law = sum(cell.kind == "law" and cell.law != "finite" for cell in cells)
    errors = sum(cell.kind == "error" for cell in cells)
    finite = sum(cell.law == "finite" for cell in cells)
    missed = [cell for cell in cells if not cell.ok]
    lines = [
        f"{len(cells)} cells: {by_law} checked against a law, {errors} against an error that must "
        f"name an element, {finite} only for finite numbers; {len(missed)} missed.",
    ]
    for cell in missed:
        title = cell.table.splitlines()[0]
        place = f"{title}; {cell.row}, {cell.column}, {cell.precision}"
        lines.append(f"  missed: {place}: {cell.text} ({cell.law})")
    tables = dict.fromkeys(cell.table for cell in cells)
    if not full:
        lines.append("")
    for table in tables:
        own = [cell for cell in cells if cell.table == table]
        if full:
            lines += ["", *table.splitlines(), *_grid(own)]
        else:
            kept = sum(cell.ok for cell in own)
            lines.append(f"{table.splitlines()[0]}: {kept} of {len(own)}")
    if full:
        ulp = "the value that the law requires is below the rounding of the numbers, and stays so."
        lines += ["", f"<ulp: {ulp}"]
    else:
        lines += ["", "--all (in Python report(cells, full=True)) prints every cell."]
    return "\n".join(lines)


def _grid(cells: list[Cell]) -> list[str]:
    columns = list(dict.fromkeys(cell.column for cell in cells))
    rows = list(dict.fromkeys((cell.precision, cell.row) for cell in cells))
    shown = {(cell.precision, cell.row, cell.column): _shown(cell) for cell in cells}
    grid = [["", "", *columns]]
    grid += [[*row, *(shown.get((*row, column), "") for column in columns)] for row in rows]
    widths = [max(map(len, column)) for column in zip(*grid, strict=True)]
    return ["  " + _line(line, widths) for line in grid]


def _shown(cell: Cell, most: int = 20) -> str:
    text = cell.text if len(cell.text) <= most else cell.text[: most - 1] + "…"
    return text if cell.ok else f"{text} <--"


def _line(line: list[str], widths: list[int]) -> str:
    return "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
