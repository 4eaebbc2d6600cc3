"""`Answer`: the answer to a user's question, as text, table, JSON, page and plot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stepcore.experiment.motion import Motion
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import metres, seconds

# How cells of these units are printed.
WORDS: Mapping[str, Callable[[float], str]] = {"m": metres, "s": seconds}


@dataclass(eq=False, repr=False)
class Answer(Result):
    """The answer to a user's question; `Study.answer` returns it.

    subject: the quantity measured. answer: the answer in sentences. rows: the numbers, by column;
    an infinite number marks a failed run.
    of_columns: the units of columns. axes: the columns along the axes of the plot.
    motion: the motion of the study. settings: the settings as shipped.
    """

    kind = "answer"

    subject: str
    answer: list[str]
    rows: Sequence[Mapping[str, Any]]
    of_columns: Mapping[str, str]
    axes: tuple[str, str]
    motion: Motion
    settings: Any

    @property
    def title(self) -> str:
        """The scene and the quantity measured."""
        return f"{self.name}: {self.subject}"

    @property
    def sentences(self) -> list[str]:
        """The answer."""
        return self.answer

    @property
    def table(self) -> Table:
        """The numbers."""
        return Table(self.rows)

    def tables(self, full: bool) -> list[Table]:
        """Return the table with lengths and times in readable units."""
        named = {name: self.label(name) for name in self.table.columns}
        cells = [{named[name]: self._cell(name, row[name]) for name in row} for row in self.table]
        return [Table(cells, formats=dict.fromkeys(named.values(), ".4g"))]

    def _cell(self, column: str, value: Any) -> Any:
        words = WORDS.get(self.of_columns.get(column, ""))
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            return "none" if value is None else "failed"
        return words(value) if words else value

    def label(self, column: str) -> str:
        """Return a column's name with its unit, unless the cells themselves have units."""
        unit = self.of_columns.get(column, "")
        return column if not unit or unit in WORDS else f"{column} [{unit}]"

    def details(self) -> dict[str, Any]:
        """Return the units of the columns."""
        return {"units": dict(self.of_columns)}
