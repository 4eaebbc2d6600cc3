"""`Ablation`: the table of features, what it means in sentences, and the smallest model."""

from __future__ import annotations

import math
import os
import shutil
import textwrap
from dataclasses import dataclass, field
from typing import Any

from stepcore._core import Settings
from stepcore.measure.ablation.changes import Change
from stepcore.measure.ablation.run import Measured
from stepcore.measure.ablation.smallest import saved, work
from stepcore.measure.trade.settings import label
from stepcore.report.result import Result
from stepcore.report.table import WIDTH, Table, jsonable
from stepcore.report.units import metres, seconds
from stepcore.scene.scene import Scene

LEGEND = (
    "saved: share of the work per simulated second ({work}), negative: it costs more; µs: "
    "computing time saved per simulated second; added: error added to the motion, rms of "
    "positions in the worst start, m; max: of any body and sample, m; error: against the "
    "converged motion, rms, worst start, m"
)


@dataclass(frozen=True)
class Row:
    """One feature switched off. cost [µs per simulated second]."""

    change: Change
    measured: Measured
    cost: float


@dataclass(eq=False, repr=False)
class Ablation(Result):
    """What each modelled feature costs and matters; made by `stepcore.ablate`.

    whole: the model as it is; rows: each feature switched off alone. chosen: what the smallest
    model goes without, best: that model on the starts it was chosen on, held: on others, back:
    what had to come back because the others did not hold. smallest: its Scene. error: the
    tolerance [m]; reference: error of the converged motion [m], None where there is none.

    >>> from stepcore import ablate, lesson
    >>> result = ablate(lesson.drop(), horizon=0.2, starts=1, progress=False)
    >>> isinstance(result, Ablation), result.best.measured.worst <= result.error
    (True, True)
    """

    name: str
    settings: Settings
    horizon: float
    starts: int
    error: float
    whole: Row
    rows: list[Row]
    chosen: list[Change]
    best: Row
    held: Measured
    back: list[Change]
    smallest: Scene
    reference: float | None
    notes: list[str] = field(default_factory=list)

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: what each feature costs and matters"

    def saved(self, row: Row) -> float:
        """The share of the whole model's work that a row saves."""
        return saved(row.measured, self.whole.measured)

    @property
    def counted(self) -> bool:
        """Work is floating-point operations; else it is row updates."""
        return self.whole.measured.flops is not None

    @property
    def table(self) -> Table:
        """All rows, the largest saving first; work, µs and lengths as in `Row` and `Measured`."""
        return Table(self.record(row) for row in [self.whole, *self.sorted(), self.best])

    def sorted(self) -> list[Row]:
        """Rows, the largest saving first; failures last."""
        key = [
            (math.isnan(self.saved(row)), -self.saved(row), i) for i, row in enumerate(self.rows)
        ]
        return [self.rows[i] for *_, i in sorted(key)]

    def record(self, row: Row) -> dict[str, Any]:
        """One row as plain data."""
        m = row.measured
        failed = m.failure is not None
        return {
            "feature": row.change.kind,
            "name": row.change.name,
            "saved": self.saved(row),
            "flops": None if failed else m.flops,
            "row_updates": None if failed else m.row_updates,
            "cost": None if math.isnan(row.cost) else row.cost,
            "added": None if failed else m.worst,
            "added_median": None if failed else m.median,
            "added_max": None if failed else m.added_max,
            "error": max(m.error) if m.error else None,
            "left_out": row.change in self.chosen,
            "failure": m.failure,
        }

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        plain: dict[str, Any] = jsonable(
            {
                "model": self.name,
                "settings": self.settings.as_dict(),
                "horizon": self.horizon,
                "starts": self.starts,
                "tolerance": self.error,
                "reference_error": self.reference,
                "whole": self.record(self.whole),
                "rows": [self.record(row) for row in self.rows],
                "smallest": {
                    **self.record(self.best),
                    "without": [change.label for change in self.chosen],
                    "came_back": [change.label for change in self.back],
                    "confirmed": self.held.worst,
                    "mjcf": self.smallest.to_mjcf(),
                },
                "notes": self.notes,
                "summary": self.sentences(),
            }
        )
        return plain

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Bars of work saved and error added; written to `path` if given. Needs matplotlib."""
        from stepcore.report.plot.ablation import plot_ablation

        return plot_ablation(self, path)

    def text(self, width: int | None = None) -> str:
        """The printed ablation, at most `width` characters wide."""
        starts = f"{self.starts} start" + "s" * (self.starts != 1)
        known = "" if self.reference is None else f"; reference known to {metres(self.reference)}"
        kind = "floating-point operations" if self.counted else "row updates"
        table = Table(
            [self._cells(row) for row in [self.whole, *self.sorted(), self.best]],
            formats=dict.fromkeys(("saved", "µs", "added", "max", "error"), ""),
        )
        head = (
            f"{self.name}: {len(self.rows)} features over {seconds(self.horizon)}, {starts}, "
            f"{label(self.settings)}{known}"
        )
        said = self.sentences()
        said += [f"failed: {row.change.label}: {row.measured.failure}" for row in self._failed()]
        notes = [f"note: {note}" for note in self.notes]
        parts = [head, "", table.text(width), "", LEGEND.format(work=kind), "", *said, "", *notes]
        size = width or shutil.get_terminal_size((WIDTH, 40)).columns
        # The table is as wide as it was made.
        return "\n".join(part if "\n" in part else textwrap.fill(part, size) for part in parts)

    def _failed(self) -> list[Row]:
        return [row for row in self.rows if row.measured.failure]

    def _cells(self, row: Row) -> dict[str, Any]:
        m = row.measured
        left = "*" if row.change in self.chosen else ""
        cells: dict[str, Any] = {"": left, "without": row.change.label}
        share = self.saved(row)
        if row is self.whole:
            cells |= {"without": "nothing (the whole model)", "saved": "", "µs": ""}
        else:
            if row is self.best:
                cells["without"] = f"all {len(self.chosen)} marked *"
            cells["saved"] = "failed" if math.isnan(share) else _percent(share)
            gain = self.whole.cost - row.cost
            cells["µs"] = "" if math.isnan(gain) else f"{gain:.0f}"
        added = "" if m.failure else _small(m.worst)
        largest = "" if m.failure else _small(m.added_max)
        cells |= {"added": added, "max": largest, "error": _small(max(m.error)) if m.error else ""}
        return cells

    def sentences(self) -> list[str]:
        """What the table says."""
        said = []
        if self.chosen:
            ratio = self.whole.cost / self.best.cost if self.best.cost > 0 else math.nan
            quicker = "" if math.isnan(ratio) else f", {ratio:.2f}× as quick in this measurement"
            said.append(
                f"The smallest model within {metres(self.error)} goes without "
                f"{'; '.join(change.label for change in self.chosen)}: "
                f"{_percent(self.saved(self.best))} less work{quicker}, "
                f"{length(self.best.measured.worst)} added in the worst start, "
                f"{length(self.held.worst)} in the worst of {len(self.held.added)} starts that it "
                "was not chosen on."
            )
        else:
            said.append(
                f"Nothing can be left out within {metres(self.error)}: every feature that costs "
                "work matters more."
            )
        if self.back:
            said.append(
                "Other starts needed more, and it came back from: "
                f"{'; '.join(change.label for change in self.back)}."
            )
        idle = [
            row.change.label
            for row in self.rows
            if row.measured.worst == 0.0 and work(row.measured) < work(self.whole.measured)
        ]
        if idle:
            said.append(f"No bit of the motion depends on: {'; '.join(idle)}.")
        matters = max(
            self.rows, key=lambda r: -1.0 if r.measured.failure else r.measured.worst, default=None
        )
        if (
            matters is not None
            and matters.measured.worst > self.error
            and not matters.measured.failure
        ):
            said.append(
                f"What matters most: {matters.change.label}, "
                f"{metres(matters.measured.worst)} in the worst start."
            )
        return said

    def __repr__(self) -> str:
        return (
            f"<Ablation {self.name}: {len(self.rows)} features, {len(self.chosen)} left out "
            f"within {metres(self.error)}>"
        )


def length(value: float) -> str:
    """An error in words; what is below 1 pm is rounding."""
    if 0 < value < 1e-12:
        return "< 1 pm"
    return "0" if value == 0 else metres(value)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if abs(share) < 0.1 else f"{100 * share:.0f} %"


def _small(value: float) -> str:
    return "0" if value == 0 else f"{value:.2g}"
