"""The plot of an ablation: work saved and error added, a bar for each feature."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import (
    GREEN,
    GREY,
    RED,
    bar,
    frame,
    legend,
    log_ticks,
    name_places,
    new_figure,
    patches,
)
from stepcore.report.units import metres

if TYPE_CHECKING:
    from stepcore.measure.ablation.result import Ablation, FeatureEffect

# The features drawn, those that save most first, and how many letters of a name.
MOST, LETTERS = 24, 46
# An error this much smaller than the tolerance has no bar, only its number.
SMALL = 1e-3


def draw(result: Ablation) -> Any:
    """Left, the share of the work that removing a feature saves; right, the error that it adds."""
    rows = [row for row in result.sorted() if not row.outcome.failure][:MOST]
    rows = [result.best, *rows]
    figure = new_figure(9.0, 2.0 + 0.27 * (len(rows) + 1))
    work, error = figure.subplots(1, 2, sharey=True)
    places = list(range(len(rows)))[::-1]
    low = _floor([row.outcome.worst for row in rows], result.tolerance)
    for place, row in zip(places, rows, strict=True):
        share, added, colour = 100 * result.saved(row), row.outcome.worst, _colour(result, row)
        bar(work, place, share, colour, f"{share:.1f}" if abs(share) < 10 else f"{share:.0f}")
        bar(error, place, added, colour, metres(added), left=low)
    error.set_xscale("log")
    error.set_xlim(low, 40 * max(*(row.outcome.worst for row in rows), result.tolerance))
    log_ticks(error.xaxis)
    error.axvline(result.tolerance, color=GREY, ls="--", lw=1)
    names = [f"all {len(result.removed)} that are not needed"]
    names += [row.removal.label for row in rows[1:]]
    name_places(work, names, places, LETTERS)
    work.set_xlim(right=1.25 * max(1.0, *(100 * result.saved(row) for row in rows)))
    kind = "operations" if result.by_flops else "row updates"
    work.set_xlabel(f"work saved [% of {kind}]")
    error.set_xlabel(f"RMS position error added [m]; dashed: {metres(result.tolerance)}")
    error.tick_params(axis="y", length=0)
    frame(work, f"{result.name}: without …")
    frame(error)
    figure.get_layout_engine().set(wspace=0.06)
    colours = {
        f"not needed within {metres(result.tolerance)}": GREEN,
        "kept": RED,
        "the smallest model": "black",
    }
    legend(figure, patches(colours), columns=3)
    return figure


def _colour(result: Ablation, row: FeatureEffect) -> str:
    if row is result.best:
        return "black"
    return GREEN if row.removal in result.removed else RED


def _floor(errors: Sequence[float], tolerance: float) -> float:
    """Where the axis of errors begins: a decade below the smallest that matters."""
    least = min([error for error in errors if error > 0], default=tolerance)
    return float(10.0 ** math.floor(math.log10(max(least, SMALL * tolerance)) - 1))
