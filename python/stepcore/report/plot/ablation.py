"""The picture of an ablation: work saved and error added, a bar a feature."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import COLOURS, GREY, bare, figure, saved
from stepcore.report.units import metres

if TYPE_CHECKING:
    from stepcore.measure.ablation.result import Ablation

# More features than this are not drawn; those that save or matter least go first.
BARS = 24
LEFT_OUT, KEPT = COLOURS["implicitfast"], COLOURS["semi-implicit"]


def plot_ablation(result: Ablation, path: str | os.PathLike[str] | None = None) -> Any:
    """Draws an ablation; writes it to `path`, in the format of its extension.

    Left: the share of the work that removing a feature saves; right: the error that it adds; green:
    what the smallest model goes without. Returns the matplotlib Figure.
    Raises ImportError without matplotlib.
    """
    rows = [row for row in result.sorted() if not row.outcome.failure][:BARS]
    rows = [result.best, *rows]
    drawn = figure(9.0, 2.0 + 0.27 * (len(rows) + 1))
    work, error = drawn.subplots(1, 2, sharey=True)
    places = list(range(len(rows)))[::-1]
    for place, row in zip(places, rows, strict=True):
        out = row.removal in result.removed
        colour = "black" if row is result.best else LEFT_OUT if out else KEPT
        share = 100 * result.saved(row)
        work.barh(place, share, color=colour, height=0.7)
        work.annotate(
            f"{share:.1f}" if abs(share) < 10 else f"{share:.0f}",
            (max(share, 0.0), place),
            (3, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    added = [row.outcome.worst for row in rows]
    low = _floor(added, result.error)
    for place, row, value in zip(places, rows, added, strict=True):
        out = row.removal in result.removed
        colour = "black" if row is result.best else LEFT_OUT if out else KEPT
        if value > low:
            error.barh(place, value - low, left=low, color=colour, height=0.7)
        text = metres(value)
        error.annotate(
            text,
            (max(value, low), place),
            (3, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    error.set_xscale("log")
    error.set_xlim(low, 40 * max(*added, result.error))
    error.axvline(result.error, color=GREY, ls="--", lw=1)
    names = [
        f"all {len(result.removed)} that are not needed",
        *(row.removal.label for row in rows[1:]),
    ]
    work.set_yticks(places, [_short(name) for name in names], fontsize=8)
    work.set_xlim(right=1.25 * max(1.0, *(100 * result.saved(row) for row in rows)))
    kind = "operations" if result.by_flops else "row updates"
    work.set_xlabel(f"work saved [% of {kind}]")
    error.set_xlabel(f"RMS position error added [m]; dashed: {metres(result.error)}")
    error.tick_params(axis="y", length=0)
    bare(work, f"{result.name}: without …")
    bare(error)
    drawn.get_layout_engine().set(wspace=0.06)
    _legend(drawn, result)
    return saved(drawn, path)


def _floor(values: Sequence[float], tolerance: float) -> float:
    """Where the axis of errors begins: a decade below the smallest, but not far below what
    matters; a smaller error has no bar, only its number."""
    least = min([value for value in values if value > 0], default=tolerance)
    return float(10.0 ** math.floor(math.log10(max(least, 1e-3 * tolerance)) - 1))


def _legend(drawn: Any, result: Ablation) -> None:
    from matplotlib.patches import Patch

    patches = [
        Patch(color=LEFT_OUT, label=f"not needed within {metres(result.error)}"),
        Patch(color=KEPT, label="kept"),
        Patch(color="black", label="the smallest model"),
    ]
    drawn.legend(handles=patches, loc="outside lower center", ncols=3, fontsize=9, frameon=False)


def _short(name: str) -> str:
    return name if len(name) <= 46 else name[:45] + "…"
