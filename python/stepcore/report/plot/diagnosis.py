"""The plot of a diagnosis: the largest stable dt of each element, by integrator."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import (
    COLOURS,
    GREY,
    frame,
    legend,
    line,
    log_ticks,
    name_places,
    new_figure,
    patches,
)
from stepcore.report.units import seconds

if TYPE_CHECKING:
    from stepcore.measure.diagnosis.result import Diagnosis

# The elements drawn, stiffest first, and how many letters of a name.
MOST, LETTERS = 10, 28
# Height of a group of bars, over the distance between two groups.
GROUP = 0.8

Groups = list[tuple[str, dict[str, float]]]


def draw(result: Diagnosis) -> Any:
    """A group of bars for each element on its own, the last group for all of them together.

    A bar with an arrow at the right edge has no limit; the vertical line is the wanted dt.
    """
    names = list(result.limits)
    groups: Groups = [(row.name, row.limits) for row in result.rows[:MOST]]
    groups.append(("all together", {name: limit.dt for name, limit in result.limits.items()}))
    figure = new_figure(8.0, 1.9 + 0.62 * len(groups))
    axes = figure.add_subplot()
    low, high = _range(result.wanted, groups)
    height = GROUP / len(names)
    for group, (_, limits) in enumerate(groups):
        for k, name in enumerate(names):
            place = group - GROUP / 2 + (k + 0.5) * height
            _bar(axes, place, limits[name], (low, high), 0.85 * height, COLOURS.get(name, GREY))
    axes.axvline(result.wanted, color="black", lw=1.3, zorder=4)
    name_places(axes, [name for name, _ in groups], range(len(groups)), LETTERS)
    axes.set_ylim(len(groups) - 0.4, -0.6)
    axes.axhline(len(groups) - 1.5, color="#BBBBBB", lw=0.8)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    log_ticks(axes.xaxis, seconds)
    axes.set_xlabel("largest stable dt")
    drawn = "" if len(result.rows) <= MOST else f" ({MOST} stiffest of {len(result.rows)} elements)"
    frame(axes, f"{result.name}: what limits the time step{drawn}")
    axes.grid(False, axis="y")
    entries = patches({name: COLOURS.get(name, GREY) for name in names})
    entries.append(line(f"dt {seconds(result.wanted)}", color="black", lw=1.3))
    entries.append(line("no limit", marker=">", ls="none", ms=5, color=GREY))
    legend(figure, entries, columns=4)
    return figure


def _range(wanted: float, groups: Groups) -> tuple[float, float]:
    """Whole decades around all finite limits and the wanted dt."""
    values = [x for _, limits in groups for x in limits.values() if math.isfinite(x) and x > 0]
    values.append(wanted)
    low = 10.0 ** math.floor(math.log10(0.7 * min(values)))
    high = 10.0 ** math.ceil(math.log10(1.5 * max(values)))
    return max(low, high / 1e9), high


def _bar(
    axes: Any, place: float, dt: float, limits: tuple[float, float], height: float, colour: str
) -> None:
    low, high = limits
    if dt <= low:
        axes.plot(low, place, "x", ms=5, mew=1.6, color=colour, clip_on=False, zorder=5)
        return
    axes.barh(place, min(dt, high) - low, left=low, height=height, color=colour, zorder=3)
    if math.isinf(dt):
        axes.plot(high, place, ">", ms=4.5, color=colour, clip_on=False, zorder=5)
