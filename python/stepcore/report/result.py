"""`Result`: the base of what every measurement returns."""

from __future__ import annotations

import io
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from stepcore import checks, files
from stepcore.report.outputs import MARK
from stepcore.report.page import picture
from stepcore.report.report import Report
from stepcore.report.table import Table, jsonable


class Result(ABC):
    """The result of a measurement: it prints itself, and can be a plot, a page or data.

    name: the name of the scene.
    ran: what motion was run, in words; "" where none was.
    notes: remarks on how the figures were obtained, and on their limits.
    batches: notes on the time saved by running worlds as batches. They are no part of the data,
        which is the same on every machine.

    A subclass defines what it measured and how (`title`, `setup`), the answer (`sentences`), and
    the figures (`table`, and `tables` as they are printed); everything else is made from these.
    """

    # What was measured, and the units of the columns of `table`.
    kind: ClassVar[str]
    units: ClassVar[Mapping[str, str]] = {}

    name: str
    notes: list[str]
    batches: Sequence[str] = ()
    ran: str = ""

    @property
    @abstractmethod
    def title(self) -> str:
        """What was measured, in a few words."""

    @property
    def setup(self) -> str:
        """How it was measured, in a line."""
        return ""

    @property
    @abstractmethod
    def sentences(self) -> list[str]:
        """What was found, the answer first."""

    @property
    @abstractmethod
    def table(self) -> Table:
        """The rows as data."""

    def tables(self, full: bool) -> list[Table]:
        """The tables as they are printed; `full`: nothing is left out."""
        return [self.table]

    def details(self) -> dict[str, Any]:
        """Data that only this measurement has; it is converted to plain data."""
        return {}

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """The plot as a matplotlib Figure; written to `path`, in the format of its extension.

        Raises ImportError without matplotlib.
        """
        from stepcore.report.plot import plot

        return plot(self.kind, self, path)

    @property
    def head(self) -> str:
        """The lines below the answer: what motion was run, and how it was measured."""
        ran = f"The motion: {self.ran}." if self.ran else ""
        return "\n".join(filter(None, (ran, self.setup)))

    def report(self, full: bool = False) -> Report:
        """The sentences, tables and notes; `full`: nothing is left out of the tables."""
        notes = [*self.notes, *self.batches]
        return Report(self.title, self.sentences, self.tables(full), notes, self.head)

    def text(self, width: int | None = None, full: bool = False) -> str:
        """The report in lines of at most `width` >= 20 characters (default: the terminal's).

        full: every row and every note; else about a screen.
        """
        return self.report(full).text(width, full)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data; what is not finite is None.

        "kind", "model", "motion", "ran", "settings", "sentences", "rows", "units", "notes" and
        "generator" are the same for every measurement; "rows" are the records of `table`.
        """
        plain: dict[str, Any] = jsonable(
            {
                "kind": self.kind,
                "model": self.name,
                "motion": getattr(self, "motion", None),
                "ran": self.ran,
                "settings": getattr(self, "settings", None),
                "sentences": self.sentences,
                "rows": self.table.records,
                "units": self.units,
                "notes": self.notes,
                **self.details(),
                "generator": MARK,
            }
        )
        return plain

    def to_json(self, indent: int | None = 2) -> str:
        """`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=indent)

    def to_html(self, path: str | os.PathLike[str] | None = None) -> str:
        """The plot and the report as one page that needs no other file. Needs matplotlib.

        Written to `path` if given.
        """
        target = None if path is None else files.path("path", path)
        page = self.report(full=True).page(self._drawn())
        if target is not None:
            Path(target).write_text(page, encoding="utf-8")
        return page

    def __str__(self) -> str:
        return self.text()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {checks.cut(self.title)}>"

    def _repr_html_(self) -> str:
        """The report as a notebook shows it, with its plot where matplotlib is installed."""
        try:
            drawn = picture(self._drawn(), self.title)
        except ImportError:
            drawn = ""
        return self.report().html(drawn)

    def _drawn(self) -> bytes:
        """The plot as SVG."""
        drawn = io.BytesIO()
        self.plot().savefig(drawn, format="svg")
        return drawn.getvalue()
