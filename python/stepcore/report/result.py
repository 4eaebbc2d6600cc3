"""`Result`: the base class of all results of measurements."""

from __future__ import annotations

import io
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from stepcore import checks, files
from stepcore.report.outputs import MARK
from stepcore.report.report import Report, inline_picture
from stepcore.report.table import Table, jsonable


@dataclass(eq=False, repr=False, kw_only=True)
class Result(ABC):
    """The result of a measurement, as text, a plot, a page or data.

    name: the name of the scene.
    ran: the simulated motion in words; "" without a motion.
    notes: remarks on how the figures were obtained, and on their limits.
    unfinished: what was not done because the time was over (`seconds`, or Ctrl-C), and how to go
        on; "" if everything was done. not_done: the same as a list. interrupted: whether Ctrl-C
        ended the measurement.
    batches: notes on the time saved by running worlds as batches. These notes are not part of the
        data, which are the same on every machine.

    A subclass defines the subject and the method of the measurement (`title`, `setup`), the answer
    (`sentences`), and the numbers (`table`, and `tables` for printing). All other methods use these
    members.
    """

    # The kind of measurement, and the units of the columns of `table`.
    kind: ClassVar[str]
    units: ClassVar[Mapping[str, str]] = {}

    name: str
    ran: str = ""
    notes: list[str] = field(default_factory=list)
    batches: Sequence[str] = field(default=(), compare=False)
    unfinished: str = ""
    not_done: Sequence[str] = ()
    interrupted: bool = False

    @property
    @abstractmethod
    def title(self) -> str:
        """Short description of the measurement."""

    @property
    def setup(self) -> str:
        """One-line description of the method."""
        return ""

    @property
    @abstractmethod
    def sentences(self) -> list[str]:
        """The findings, the answer first."""

    @property
    @abstractmethod
    def table(self) -> Table:
        """The numbers as rows."""

    def tables(self, full: bool) -> list[Table]:
        """Return the tables for printing; `full`: every row."""
        return [self.table]

    def details(self) -> dict[str, Any]:
        """Return data specific to this measurement, for conversion to plain data."""
        return {}

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Plot the result as a matplotlib Figure.

        path: a file to write; the extension selects the format.

        Raises ImportError without matplotlib.
        """
        from stepcore.report.plot import plot

        return plot(self.kind, self, path)

    @property
    def head(self) -> str:
        """The lines below the answer: the simulated motion and the method."""
        ran = f"The motion: {self.ran}." if self.ran else ""
        return "\n".join(filter(None, (ran, self.setup)))

    def report(self, full: bool = False) -> Report:
        """Return the sentences, tables and notes; `full`: every row of the tables."""
        notes = [*self.notes, *self.batches]
        below = "\n".join(filter(None, (self.unfinished, self.head)))
        return Report(self.title, self.sentences, self.tables(full), notes, below)

    def text(self, width: int | None = None, full: bool = False) -> str:
        """Return the report in lines of at most `width` >= 20 characters (default: the terminal's).

        full: every row and every note; else about a screen.
        """
        return self.report(full).text(width, full)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain data; non-finite numbers become None.

        "kind", "model", "motion", "ran", "settings", "sentences", "rows", "units", "notes",
        "unfinished" and "generator" exist for every measurement; "rows" are the records of `table`.
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
                "unfinished": self.unfinished,
                **self.details(),
                "generator": MARK,
            }
        )
        return plain

    def to_json(self, indent: int | None = 2) -> str:
        """Return `to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=indent)

    def to_pandas(self) -> Any:
        """Return `table` as a pandas DataFrame. Needs pandas (the extra "data")."""
        return self.table.to_pandas()

    def to_html(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return the plot and the report as a self-contained page.

        path: a file to write the page to.

        Needs matplotlib.
        """
        target = None if path is None else files.as_path("path", path)
        page = self.report(full=True).page(self._drawn())
        if target is not None:
            Path(target).write_text(page, encoding="utf-8")
        return page

    def __str__(self) -> str:
        return self.text()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {checks.cut(self.title)}>"

    def _repr_html_(self) -> str:
        try:
            drawn = inline_picture(self._drawn(), self.title)
        except ImportError:
            drawn = ""
        return self.report().html(drawn)

    def _drawn(self) -> bytes:
        drawn = io.BytesIO()
        self.plot().savefig(drawn, format="svg")
        return drawn.getvalue()
