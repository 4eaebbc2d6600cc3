"""The plot of a predictability: how far perturbed runs grow apart over time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import BLUE, GREY, RED, TEXT, frame, legend, log_ticks, new_figure
from stepcore.report.units import seconds

if TYPE_CHECKING:
    from stepcore.measure.predictability import Predictability


def draw(result: Predictability) -> Any:
    """Growth on a log axis, a line for each start, with a dot where a start is lost."""
    figure = new_figure()
    axes = figure.add_subplot()
    times = np.concatenate([[0.0], result.growth.times])
    for start, factor in enumerate(result.growth.factor):
        values = np.concatenate([[1.0], np.maximum(factor, 1e-3)])
        colour, label = (BLUE, "start 0, the keyframe") if start == 0 else (GREY, None)
        style: dict[str, Any] = {"lw": 0.9, "alpha": 0.7} if start else {"lw": 1.8, "zorder": 4}
        axes.plot(
            times, values, color=colour, label="other starts" if start == 1 else label, **style
        )
        end = float(result.growth.ends[start])
        if math.isfinite(end):
            axes.plot(end, result.limit, "o", ms=5, color=colour, zorder=5)
    axes.axhline(result.limit, color=RED, lw=1.2, ls="--", zorder=2)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, 3 * result.limit))
    log_ticks(axes.yaxis)
    axes.set_xlim(0, result.horizon)
    text = f"above {result.limit:g}: not predictable"
    place = {"transform": axes.get_yaxis_transform(), "fontsize": TEXT}
    axes.text(0.01, result.limit * 1.15, text, **place)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("growth of a perturbation")
    until = "all of it" if math.isinf(result.time) else f"{seconds(result.time)} of it"
    frame(axes, f"{result.name}: {seconds(result.horizon)}, {until} predictable")
    if len(result.growth.factor) > 1:
        legend(figure)
    return figure
