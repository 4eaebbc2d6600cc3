"""The plot of an identification: what was measured and what is predicted, over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import BLUE, GREY, ORANGE, frame, legend, line, stacked

if TYPE_CHECKING:
    from stepcore.measure.identification.result import Curve, Identification


def identification(result: Identification) -> Any:
    """Draw measured and predicted numbers of the log with the largest residual.

    A panel shows one quantity; if there are many, the ones with the largest relative residuals.
    """
    worst = max(result.curves, key=_share)
    curves = [curve for curve in result.curves if curve.log == worst.log]
    kept = sorted(range(len(curves)), key=lambda k: -_share(curves[k]))[:8]
    drawn = [curves[k] for k in sorted(kept)]
    figure, panels = stacked(len(drawn))
    for axes, curve in zip(panels, drawn, strict=True):
        axes.plot(curve.time, curve.before, color=GREY, lw=1.0, ls=":")
        axes.plot(curve.time, curve.measured, ls="none", marker=".", ms=3, color=ORANGE)
        axes.plot(curve.time, curve.after, color=BLUE, lw=1.2)
        # A poor first guess does not decide the range of the panel.
        every = np.concatenate([curve.measured, curve.after])
        low, high = float(np.nanmin(every)), float(np.nanmax(every))
        room = 0.25 * (high - low) or 1e-9 + 0.1 * abs(high)
        axes.set_ylim(low - room, high + room)
        name, word, unit = result.named(curve.quantity)
        frame(axes, y=f"{name}\n{word} [{unit}]" if unit else f"{name}\n{word}")
    log = f", logs[{worst.log}]" if result.logs > 1 else ""
    more = f", {len(drawn)} of {len(curves)} quantities" if len(drawn) < len(curves) else ""
    frame(panels[0], f"{result.title}{log}{more}")
    frame(panels[-1], x="time [s]")
    entries = [
        line("measured", color=ORANGE, ls="none", marker="."),
        line("predicted", color=BLUE),
        line("predicted before", color=GREY, ls=":"),
    ]
    legend(figure, entries, columns=3)
    return figure


def _share(curve: Curve) -> float:
    """Return the RMS residual over the spread of what was measured."""
    off = curve.after - curve.measured
    if not np.isfinite(off).any():
        return 0.0
    return float(np.sqrt(np.nanmean(off**2)) / (np.nanstd(curve.measured) or 1.0))
