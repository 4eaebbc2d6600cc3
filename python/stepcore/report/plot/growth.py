"""The picture of a predictability: how far twins grow apart over time."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.experiment.growth import GROWTH
from stepcore.report.plot.style import COLOURS, GREY, bare, figure, saved
from stepcore.report.units import seconds

if TYPE_CHECKING:
    from stepcore.measure.predictability import Predictability


def plot_growth(found: Predictability, path: str | os.PathLike[str] | None = None) -> Any:
    """Draws growth on a log axis, a line a start; a dot where a start can no longer be predicted.

    Written where `path` says, in the format of its ending. Returns the matplotlib Figure. Raises
    ImportError without matplotlib.
    """
    drawn = figure()
    axes = drawn.add_subplot()
    times = np.concatenate([[0.0], found.growth.times])
    for k, factor in enumerate(found.growth.factor):
        line = np.concatenate([[1.0], np.maximum(factor, 1e-3)])
        first = k == 0
        colour = COLOURS["rk4"] if first else GREY
        name = "start 0, the keyframe" if first else "other starts" if k == 1 else None
        style: dict[str, Any] = {"lw": 1.8, "zorder": 4} if first else {"lw": 0.9, "alpha": 0.7}
        axes.plot(times, line, color=colour, label=name, **style)
        end = float(found.growth.ends[k])
        if math.isfinite(end):
            axes.plot(end, GROWTH, "o", ms=5, color=colour, zorder=5)
    axes.axhline(GROWTH, color=COLOURS["semi-implicit"], lw=1.2, ls="--", zorder=2)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, 3 * GROWTH))
    axes.set_xlim(0, found.horizon)
    said = f"beyond {GROWTH:g} times: not to be predicted"
    axes.text(0.01, GROWTH * 1.15, said, transform=axes.get_yaxis_transform(), fontsize=9)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("twins' distance over that at the start")
    until = "all of it" if math.isinf(found.time) else f"{seconds(found.time)} of it"
    bare(axes, f"{found.name}: {seconds(found.horizon)}, {until} predictable")
    if len(found.growth.factor) > 1:
        drawn.legend(loc="outside right center", fontsize=9, frameon=False)
    return saved(drawn, path)
