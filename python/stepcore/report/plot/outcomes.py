"""Plot of outcomes: differences of the mean against cost, and the distributions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import COLOURS, GREY, frame, legend, line, log_ticks, new_figure
from stepcore.report.units import counted, seconds

if TYPE_CHECKING:
    from stepcore.measure.trade.outcomes import Outcomes


def outcomes(result: Outcomes) -> Any:
    """Draw the difference of each setting's mean with its 95 % interval, and distributions.

    Left: difference against cost; the band is the allowed difference. Right: the cumulative
    distributions of the reference, the shipped and the recommended settings.
    """
    figure = new_figure(10.0, 4.6)
    left, right = figure.subplots(1, 2)
    used = dict[str, str]()
    least = max(result.error, result.shipped.difference.half)
    for row in result.rows:
        d, name = row.difference, row.settings.integrator
        # Settings far outside would flatten the others.
        if row.failed or not np.isfinite(d.half) or abs(d.value) - d.half > 20 * least:
            continue
        colour = used.setdefault(name, COLOURS.get(name, GREY))
        bars = [[d.value - d.low], [d.high - d.value]]
        left.errorbar(row.cost / 1e3, d.value, bars, fmt="o", ms=4, lw=1, capsize=2, color=colour)
        for mark, other in (("as shipped", result.shipped), ("recommended", result.chosen)):
            if other is not None and row.change == other.change:
                left.annotate(mark, (row.cost / 1e3, d.high), ha="center", va="bottom", fontsize=8)
    left.axhspan(-result.error, result.error, color="#DDDDDD", zorder=0)
    left.set_xscale("log")
    log_ticks(left.xaxis, "{:g}".format)
    name, unit = result.measure.quantity.name, result.measure.in_unit
    ran = f"{seconds(result.horizon)}, {counted(result.starts, 'start')}"
    cost = "computing time per simulated second, by counted work [ms]"
    frame(left, f"{result.name}: {ran}", cost, f"difference of the mean of {name}{unit}")
    drawn = {"reference": (result.reference, "black"), "as shipped": (result.shipped, "#CC4444")}
    if result.chosen is not None and result.chosen.change != result.shipped.change:
        drawn["recommended"] = (result.chosen, "#117733")
    for row, colour in drawn.values():
        numbers = np.sort(row.numbers[np.isfinite(row.numbers)])
        if len(numbers):
            share = np.arange(1, len(numbers) + 1) / len(numbers)
            right.step(numbers, share, where="post", color=colour, lw=1.3)
    frame(right, "", f"{name}{unit}", "share of runs with at most this")
    entries = [line(text, marker="o", color=colour, ls="none") for text, colour in used.items()]
    entries += [line(text, color=colour, lw=1.3) for text, (_, colour) in drawn.items()]
    legend(figure, entries)
    return figure
