"""`Ablation`: the table of features, what it means in sentences, and the smallest model."""

from __future__ import annotations

import math
import os
import shutil
import textwrap
from dataclasses import dataclass, field
from typing import Any

from stepcore._core import Settings
from stepcore.engine.features import Removal
from stepcore.measure.ablation.selection import saved, work
from stepcore.measure.ablation.variants import Outcome
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import WIDTH, Table, jsonable
from stepcore.report.units import metres, percent, seconds
from stepcore.scene.scene import Scene

LEGEND = (
    "saved: share of the work per simulated second ({work}), negative if the variant costs more; "
    "µs: computing time saved per simulated second; added: RMS position error added to the motion "
    "in the worst start [m]; max: the largest of any body and sample [m]; error: RMS position "
    "error against the converged motion in the worst start [m]"
)


@dataclass(frozen=True)
class FeatureEffect:
    """One feature removed. cost [µs per simulated second]."""

    removal: Removal
    outcome: Outcome
    cost: float


@dataclass(eq=False, repr=False)
class Ablation(Result):
    """What each modelled feature costs and what it adds to accuracy; made by `stepcore.ablate`.

    whole: the model as it is; rows: each feature removed alone. removed: what the smallest model
    goes without; best: that model on the starts it was chosen on, confirmed: on others, restored:
    what had to be restored because of those. smallest: its Scene. error: the tolerance [m];
    reference: error of the converged motion [m], None where there is none.

    >>> from stepcore import ablate, lesson
    >>> result = ablate(lesson.drop(), horizon=0.2, starts=1, progress=False)
    >>> isinstance(result, Ablation), result.best.outcome.worst <= result.error
    (True, True)
    """

    name: str
    settings: Settings
    horizon: float
    starts: int
    error: float
    whole: FeatureEffect
    rows: list[FeatureEffect]
    removed: list[Removal]
    best: FeatureEffect
    confirmed: Outcome
    restored: list[Removal]
    smallest: Scene
    reference: float | None
    notes: list[str] = field(default_factory=list)

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: cost and effect of each modelled feature"

    def saved(self, row: FeatureEffect) -> float:
        """The share of the whole model's work that a row saves."""
        return saved(row.outcome, self.whole.outcome)

    @property
    def counted(self) -> bool:
        """Work is floating-point operations; else it is row updates."""
        return self.whole.outcome.flops is not None

    @property
    def table(self) -> Table:
        """All rows, the largest saving first; units as in `FeatureEffect` and `Outcome`."""
        return Table(self.record(row) for row in [self.whole, *self.sorted(), self.best])

    def sorted(self) -> list[FeatureEffect]:
        """Rows, the largest saving first; failures last."""
        shares = [(self.saved(row), i) for i, row in enumerate(self.rows)]
        order = sorted((math.isnan(share), -share, i) for share, i in shares)
        return [self.rows[i] for *_, i in order]

    def record(self, row: FeatureEffect) -> dict[str, Any]:
        """One row as plain data."""
        outcome = row.outcome
        failed = outcome.failure is not None
        return {
            "feature": row.removal.kind,
            "name": row.removal.name,
            "saved": self.saved(row),
            "flops": None if failed else outcome.flops,
            "row_updates": None if failed else outcome.row_updates,
            "cost": None if math.isnan(row.cost) else row.cost,
            "added": None if failed else outcome.worst,
            "added_median": None if failed else outcome.median,
            "added_max": None if failed else outcome.added_max,
            "error": max(outcome.error) if outcome.error else None,
            "left_out": row.removal in self.removed,
            "failure": outcome.failure,
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
                    "without": [removal.label for removal in self.removed],
                    "restored": [removal.label for removal in self.restored],
                    "confirmed": self.confirmed.worst,
                    "mjcf": self.smallest.to_mjcf(),
                },
                "notes": self.notes,
                "sentences": self.sentences,
            }
        )
        return plain

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Bars of work saved and error added; written to `path` if given. Needs matplotlib."""
        from stepcore.report.plot.ablation import plot_ablation

        return plot_ablation(self, path)

    def text(self, width: int | None = None, full: bool = False) -> str:
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
        failed = [
            f"failed: {row.removal.label}: {row.outcome.failure}"
            for row in self.rows
            if row.outcome.failure
        ]
        notes = [f"note: {note}" for note in self.notes]
        legend = LEGEND.format(work=kind)
        parts = [head, "", table.text(width), "", legend, "", *self.sentences, *failed, "", *notes]
        size = width or shutil.get_terminal_size((WIDTH, 40)).columns
        # The table is as wide as it was made.
        return "\n".join(part if "\n" in part else textwrap.fill(part, size) for part in parts)

    def _cells(self, row: FeatureEffect) -> dict[str, Any]:
        outcome = row.outcome
        mark = "*" if row.removal in self.removed else ""
        cells: dict[str, Any] = {"": mark, "without": row.removal.label}
        share = self.saved(row)
        if row is self.whole:
            cells |= {"without": "nothing (the whole model)", "saved": "", "µs": ""}
        else:
            if row is self.best:
                cells["without"] = f"all {len(self.removed)} marked *"
            cells["saved"] = "failed" if math.isnan(share) else percent(share)
            gain = self.whole.cost - row.cost
            cells["µs"] = "" if math.isnan(gain) else f"{gain:.0f}"
        cells["added"] = "" if outcome.failure else _small(outcome.worst)
        cells["max"] = "" if outcome.failure else _small(outcome.added_max)
        cells["error"] = _small(max(outcome.error)) if outcome.error else ""
        return cells

    @property
    def sentences(self) -> list[str]:
        """What the table says."""
        sentences = [self._smallest()]
        if self.restored:
            names = "; ".join(removal.label for removal in self.restored)
            sentences.append(f"Other starts exceed the tolerance, so these were restored: {names}.")
        unused = [
            row.removal.label
            for row in self.rows
            if row.outcome.worst == 0.0 and work(row.outcome) < work(self.whole.outcome)
        ]
        if unused:
            sentences.append(f"The motion is bit-identical without: {'; '.join(unused)}.")
        ran = [row for row in self.rows if not row.outcome.failure]
        largest = max(ran, key=lambda row: row.outcome.worst, default=None)
        if largest is not None and largest.outcome.worst > self.error:
            sentences.append(
                f"The largest effect has {largest.removal.label}: without it the worst start is "
                f"off by {metres(largest.outcome.worst)}."
            )
        return sentences

    def _smallest(self) -> str:
        """What the smallest model goes without, and how good it is."""
        within = metres(self.error)
        if not self.removed:
            return (
                f"No feature can be removed within {within}: each that costs work adds more error."
            )
        ratio = self.whole.cost / self.best.cost if self.best.cost > 0 else math.nan
        faster = "" if math.isnan(ratio) else f" ({ratio:.2f}× as fast as measured here)"
        names = "; ".join(removal.label for removal in self.removed)
        return (
            f"The smallest model within {within} saves {percent(self.saved(self.best))} of the "
            f"work{faster}. It goes without {names}. It adds {metres(self.best.outcome.worst)} in "
            f"the worst start, and {metres(self.confirmed.worst)} in the worst of "
            f"{len(self.confirmed.added)} starts that it was not chosen on."
        )

    def __repr__(self) -> str:
        return (
            f"<Ablation {self.name}: {len(self.rows)} features, {len(self.removed)} removed "
            f"within {metres(self.error)}>"
        )


def _small(value: float) -> str:
    return "0" if value == 0 else f"{value:.2g}"
