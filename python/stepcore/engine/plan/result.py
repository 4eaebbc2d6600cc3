"""`Plan`: the work of a step and the omitted work, as text, data and a plot."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

from stepcore._core import Settings
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import seconds

# The number of elements of an entry that are printed.
NAMES = 4
# The number of costliest entries in the answer, and of entries in a table without --all.
COSTLY, PRINTED = 3, 9
LEGEND = (
    "flops: floating-point operations of the entry's own stage, or those saved by removing the "
    "entry. They do not add up, because some work serves several entries."
)
LESS = " A negative number: without the entry the solver takes more iterations."


@dataclass(frozen=True)
class PlanEntry:
    """One entry of a plan: work that a step does or omits.

    stage: "files", "place", "detect", "solve" or "commit".
    kind: "file", "term", "pair" or "row".
    name: the name of the work.
    names, count: the elements concerned, and their number.
    used: whether the step does the work.
    why: the reason for the omission, or a remark.
    rows: the number of rows at the state.
    stages: the stages of `Sim.stage_flops` that the entry represents, if any.
    flops, micros: operations and time [µs] per step; None if they were not measured.
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


@dataclass(eq=False, repr=False)
class Plan(Result):
    """The work that a step does and omits; the result of `stepcore.plan`.

    entries: all entries.
    flops: operations of a complete step at the state `at`.
    stages: operations by stage.
    micros: time of a complete step [µs]; None if it was not measured.

    >>> from stepcore import lesson, plan
    >>> plan(lesson.drop())
    <Plan of tower: 7 used, 10 left out>
    """

    kind = "plan"
    units: ClassVar = {"flops": "1", "micros": "µs"}

    settings: Settings
    entries: list[PlanEntry]
    flops: float
    stages: dict[str, float] = field(default_factory=dict)
    micros: float | None = None
    at: str = "the initial pose"
    # Size of the mesh and height-field files that are read, and of all such files [bytes].
    read_bytes: int = 0
    asset_bytes: int = 0

    @property
    def title(self) -> str:
        """Title of the plan."""
        return f"{self.name}: what a step does and what it leaves out"

    @property
    def setup(self) -> str:
        """The settings in one line."""
        s = self.settings
        return f"{s.integrator}, {s.solver}, law {s.law}, {s.cone} cone, dt {seconds(s.dt)}."

    @property
    def rows(self) -> list[PlanEntry]:
        """All entries, by stage."""
        return self.entries

    @property
    def used(self) -> list[PlanEntry]:
        """Entries of the work that a step does."""
        return [entry for entry in self.entries if entry.used]

    @property
    def left_out(self) -> list[PlanEntry]:
        """Entries of the work that a step omits, with the reasons."""
        return [entry for entry in self.entries if not entry.used]

    @property
    def sentences(self) -> list[str]:
        """The cost of a step, the costliest entries, the pairs tested and the data read."""
        time = "" if self.micros is None else f" and {self.micros:.3g} µs"
        sentences = [f"A step at {self.at} takes {self.flops:.0f} floating-point operations{time}."]
        costs = [(entry.flops, entry.name) for entry in self.used if entry.flops]
        if costs and self.flops > 0:
            named = [f"{name} ({flops:.0f})" for flops, name in sorted(costs)[: -COSTLY - 1 : -1]]
            sentences.append(f"Most of it: {'; '.join(named)}.")
        pairs = [entry for entry in self.entries if entry.kind == "pair"]
        if pairs:
            tested = sum(entry.count for entry in pairs if entry.used)
            every = sum(entry.count for entry in pairs)
            sentences.append(f"It tests {tested} of {every} pairs of geoms.")
        if self.asset_bytes:
            read, whole = self.read_bytes / 1e6, self.asset_bytes / 1e6
            sentences.append(
                f"Of {whole:.3g} MB of meshes and height fields it needs {read:.3g} MB."
            )
        return sentences

    @property
    def table(self) -> Table:
        """All entries; see `PlanEntry`."""
        return Table(map(vars, self.entries))

    def tables(self, full: bool) -> list[Table]:
        """Return tables of used and omitted work; `full`: all entries and elements."""
        used, left_out = self.used, self.left_out
        if not full:
            used, left_out = (
                _most(used, lambda e: e.flops or 0.0),
                _most(left_out, lambda e: e.count),
            )
        does = _table(used, "Computed in a step", len(self.used))
        less = LESS * any((entry.flops or 0) < 0 for entry in used)
        does.legend = f"{does.legend} {LEGEND}{less}".strip()
        tables = [does, _table(left_out, "Left out of a step", len(self.left_out))]
        if full:
            elements = [
                {"used": "yes" if entry.used else "no", "what": entry.name, "element": name}
                for entry in self.entries
                for name in entry.names
            ]
            tables.append(Table(elements, heading="The elements of each entry"))
        return tables

    def details(self) -> dict[str, Any]:
        """Return the data of the complete step."""
        return {
            "at": self.at,
            "flops": self.flops,
            "stages": self.stages,
            "micros": self.micros,
        }

    def __repr__(self) -> str:
        return f"<Plan of {self.name}: {len(self.used)} used, {len(self.left_out)} left out>"


def _most(entries: list[PlanEntry], size: Callable[[PlanEntry], float]) -> list[PlanEntry]:
    """Return the largest entries in stage order, or all if there are few."""
    if len(entries) <= PRINTED + 1:
        return entries
    largest = sorted(entries, key=size, reverse=True)[:PRINTED]
    return [entry for entry in entries if any(entry is large for large in largest)]


def _table(entries: list[PlanEntry], heading: str, every: int) -> Table:
    """Return a table of some entries; every: the total number of entries."""
    numbers = ("n", "rows", "flops", "µs")
    rows = [_cells(entry) for entry in entries]
    columns = list(rows[0]) if rows else []
    columns = [c for c in columns if c not in numbers or any(row[c] for row in rows)]
    left = every - len(entries)
    legend = f"Not shown: {left} smaller ones (--all; in Python text(full=True))." if left else ""
    return Table(rows, columns, dict.fromkeys(numbers, ""), heading=heading, legend=legend)


def _cells(entry: PlanEntry) -> dict[str, str]:
    """Return the printed cells of an entry."""
    names = entry.names[:NAMES]
    if entry.kind == "file":
        names = tuple(os.path.basename(name) for name in names)
    which = ", ".join(names)
    if which and entry.count > len(names):
        which += f" and {entry.count - len(names)} more"
    return {
        "stage": entry.stage,
        "what": entry.name,
        "n": str(entry.count),
        "rows": "" if entry.rows is None else str(entry.rows),
        "flops": "" if entry.flops is None else f"{entry.flops:.0f}",
        "µs": "" if entry.micros is None else f"{entry.micros:.2f}",
        "which" if entry.used else "why": entry.why
        + (f" ({which})" if which and entry.why else which),
    }
