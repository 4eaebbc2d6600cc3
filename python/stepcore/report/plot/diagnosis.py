"""The picture of a diagnosis: the largest stable dt of every element, by integrator."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import COLOURS, GREY, bare, figure, saved
from stepcore.report.units import seconds

if TYPE_CHECKING:
    from stepcore.measure.diagnosis.result import Diagnosis

# The elements drawn, stiffest first, and how many letters of a name.
MOST, LETTERS = 10, 28
BAR = 0.8


def plot_diagnosis(d: Diagnosis, path: str | os.PathLike[str] | None = None) -> Any:
    """Draws a diagnosis; writes it where `path` says, in the format of its ending.

    A group of bars is an element alone, the last group all of them together; a bar that reaches
    the right edge with an arrow is one that nothing limits. The line is the wanted dt.
    Returns the matplotlib Figure. Raises ImportError without matplotlib.
    """
    names = list(d.limits)
    groups = [(_short(one.key.label), one.limits) for one in d.elements[:MOST]]
    groups.append(("all together", {name: limit.dt for name, limit in d.limits.items()}))
    drawn = figure(8.0, 1.9 + 0.62 * len(groups))
    axes = drawn.add_subplot()
    low, high = _limits(d, groups)
    step = BAR / len(names)
    for at, (_, limits) in enumerate(groups):
        for k, name in enumerate(names):
            y = at - BAR / 2 + (k + 0.5) * step
            _bar(axes, y, limits[name], low, high, 0.85 * step, COLOURS.get(name, GREY))
    axes.axvline(d.wanted, color="black", lw=1.3, zorder=4)
    axes.set_yticks(range(len(groups)), [name for name, _ in groups])
    axes.set_ylim(len(groups) - 0.4, -0.6)
    axes.axhline(len(groups) - 1.5, color="#BBBBBB", lw=0.8)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.xaxis.set_major_formatter(lambda value, _: seconds(value))
    axes.set_xlabel("largest stable dt")
    bare(axes, f"{d.name}: what limits the time step")
    axes.grid(False, axis="y")
    _legend(drawn, d, names)
    return saved(drawn, path)


def _short(name: str) -> str:
    return name if len(name) <= LETTERS else name[: LETTERS - 1] + "…"


def _limits(d: Diagnosis, groups: list[tuple[str, dict[str, float]]]) -> tuple[float, float]:
    """Whole decades around all finite limits and the wanted dt."""
    values = [x for _, limits in groups for x in limits.values() if math.isfinite(x) and x > 0]
    values.append(d.wanted)
    low = 10.0 ** math.floor(math.log10(0.7 * min(values)))
    high = 10.0 ** math.ceil(math.log10(1.5 * max(values)))
    return max(low, high / 1e9), high


def _bar(
    axes: Any, y: float, dt: float, low: float, high: float, height: float, colour: str
) -> None:
    if dt <= low:
        axes.plot(low, y, "x", ms=5, mew=1.6, color=colour, clip_on=False, zorder=5)
        return
    end = min(dt, high)
    axes.barh(y, end - low, left=low, height=height, color=colour, zorder=3)
    if math.isinf(dt):
        axes.plot(high, y, ">", ms=4.5, color=colour, clip_on=False, zorder=5)


def _legend(drawn: Any, d: Diagnosis, names: list[str]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[Any] = [Patch(color=COLOURS.get(name, GREY), label=name) for name in names]
    entries.append(Line2D([], [], color="black", lw=1.3, label=f"dt {seconds(d.wanted)}"))
    none = Line2D([], [], marker=">", ls="none", ms=5, color=GREY, label="no limit")
    drawn.legend(handles=[*entries, none], loc="outside lower center", ncols=4, frameon=False)
