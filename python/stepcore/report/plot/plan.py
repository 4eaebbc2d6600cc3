"""The plot of a plan: what each entry costs, a bar each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import (
    BLUE,
    GREEN,
    ORANGE,
    RED,
    bar,
    frame,
    legend,
    name_places,
    new_figure,
    patches,
)

if TYPE_CHECKING:
    from stepcore.engine.plan.result import Plan

STAGES = {"place": BLUE, "detect": ORANGE, "solve": RED, "commit": GREEN}
LETTERS = 48


def draw(plan: Plan) -> Any:
    """Bars of the operations of each entry, or of its time where that was measured, by stage."""
    timed = plan.micros is not None
    bars = []
    for entry in plan.used:
        value = entry.micros if timed else entry.flops
        if entry.stage in STAGES and value is not None:
            bars.append((entry, float(value)))
    figure = new_figure(8.0, 1.6 + 0.3 * max(1, len(bars)))
    axes = figure.add_subplot()
    places = range(len(bars))[::-1]
    for place, (entry, value) in zip(places, bars, strict=True):
        bar(axes, place, value, STAGES[entry.stage], f"{value:.2f}" if timed else f"{value:.0f}")
    name_places(axes, [entry.name for entry, _ in bars], places, LETTERS)
    axes.set_xlim(right=1.12 * max([1e-3, *(value for _, value in bars)]))
    axes.set_xlabel("time per step [µs]" if timed else "floating-point operations per step")
    frame(axes, f"{plan.name}: what a step does")
    used = {entry.stage for entry, _ in bars}
    legend(figure, patches({name: STAGES[name] for name in STAGES if name in used}), columns=4)
    return figure
