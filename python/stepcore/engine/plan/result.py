"""`Plan`: what a step does and what it leaves out, as text, data and a picture."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from stepcore._core import Settings
from stepcore.report.result import Result
from stepcore.report.table import WIDTH, Table, jsonable

# The printed plan names this many elements of an entry.
NAMES = 4
LEGEND = (
    "flops: floating-point operations of one step at {at}: of the entry's own stage, or those "
    "saved by removing the entry. They do not add up, because some work serves several entries."
)


@dataclass(frozen=True)
class PlanEntry:
    """One thing that a step does, or leaves out.

    stage: "files", "place", "detect", "solve" or "commit". kind: "file", "term", "pair" or "row".
    name: of the work; names: the elements it is done for, count: how many. used: whether the step
    does it. why: the reason for leaving it out, or a remark. rows: how many the state has. stages:
    of `Sim.stage_flops`, where the entry is those. flops: operations per step; micros [µs per
    step]; None where they were not measured.
    """

    stage: str
    kind: str
    name: str
    names: tuple[str, ...] = ()
    used: bool = True
    why: str = ""
    count: int = 0
    rows: int | None = None
    stages: tuple[str, ...] = ()
    flops: float | None = None
    micros: float | None = None


@dataclass
class Plan(Result):
    """What a step does and what it leaves out; made by `stepcore.plan`.

    entries: all of it. flops: of a whole step at the state `at`; stages: the same by stage.
    micros: [µs] of a whole step, None if not timed.

    >>> from stepcore import lesson, plan
    >>> plan(lesson.drop())
    <Plan of tower: 7 used, 10 left out>
    """

    name: str
    settings: Settings
    entries: list[PlanEntry]
    flops: float
    stages: dict[str, float] = field(default_factory=dict)
    micros: float | None = None
    at: str = "the initial pose"

    @property
    def title(self) -> str:
        """What was listed, in a few words."""
        return f"{self.name}: what a step does and what it leaves out"

    @property
    def used(self) -> list[PlanEntry]:
        """What the step does."""
        return [entry for entry in self.entries if entry.used]

    @property
    def left_out(self) -> list[PlanEntry]:
        """What the step leaves out, with the reasons."""
        return [entry for entry in self.entries if not entry.used]

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        plain: dict[str, Any] = jsonable(
            {
                "model": self.name,
                "settings": self.settings.as_dict(),
                "at": self.at,
                "flops": self.flops,
                "stages": self.stages,
                "micros": self.micros,
                "used": [vars(entry) for entry in self.used],
                "left_out": [vars(entry) for entry in self.left_out],
            }
        )
        return plain

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Bars of what each entry costs; written to `path` if given. Needs matplotlib."""
        from stepcore.report.plot.plan import plot_plan

        return plot_plan(self, path)

    def text(self, width: int | None = None, full: bool = False) -> str:
        """The printed plan, at most `width` characters wide; `full`: with every name."""
        s = self.settings
        head = f"{self.name}: {s.integrator}, {s.solver}, law {s.law}, {s.cone} cone, dt {s.dt:g} s"
        cost = f"{self.flops:.0f} floating-point operations"
        if self.micros is not None:
            cost += f", {self.micros:.2f} µs"
        parts = [head, f"one step at {self.at}: {cost}"]
        parts += ["", "A step does:", self._table(self.used, full, width)]
        parts += ["", "It leaves out:", self._table(self.left_out, full, width)]
        parts += ["", textwrap.fill(LEGEND.format(at=self.at), width or WIDTH)]
        return "\n".join(parts)

    def _table(self, entries: Sequence[PlanEntry], full: bool, width: int | None) -> str:
        formats = dict.fromkeys(("n", "rows", "flops", "µs"), "")
        rows = [self._cells(entry, full) for entry in entries]
        for name in ("rows", "flops", "µs"):
            if not any(row[name] for row in rows):
                for row in rows:
                    del row[name]
        return Table(rows, formats=formats).text(10_000 if full else width)

    def _cells(self, entry: PlanEntry, full: bool) -> dict[str, Any]:
        names = entry.names if full else entry.names[:NAMES]
        if entry.kind == "file" and not full:
            names = tuple(os.path.basename(name) for name in names)
        which = ", ".join(names)
        more = entry.count - len(names)
        if which and more > 0:
            which += f" and {more} more"
        why = entry.why + (f" ({which})" if which and entry.why else which)
        return {
            "stage": entry.stage,
            "what": entry.name,
            "n": str(entry.count),
            "rows": "" if entry.rows is None else str(entry.rows),
            "flops": "" if entry.flops is None else f"{entry.flops:.0f}",
            "µs": "" if entry.micros is None else f"{entry.micros:.2f}",
            "which" if entry.used else "why": why,
        }

    def __repr__(self) -> str:
        return f"<Plan of {self.name}: {len(self.used)} used, {len(self.left_out)} left out>"
