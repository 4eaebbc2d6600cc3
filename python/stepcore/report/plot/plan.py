"""The picture of a plan: what each entry costs, a bar each."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import COLOURS, bare, figure, saved

if TYPE_CHECKING:
    from stepcore.engine.plan.result import Plan

STAGES = {
    "place": COLOURS["rk4"],
    "detect": COLOURS["euler"],
    "solve": COLOURS["semi-implicit"],
    "commit": COLOURS["implicitfast"],
}


def plot_plan(plan: Plan, path: str | os.PathLike[str] | None = None) -> Any:
    """Draws a plan; writes it to `path`, in the format of its extension.

    A bar is the operations saved by removing the entry, or the time where that was measured;
    colours are stages. Returns the
    matplotlib Figure. Raises ImportError without matplotlib.
    """
    entries = [entry for entry in plan.used if entry.stage in STAGES]
    kind = "micros" if plan.micros is not None else "flops"
    words = {"micros": "µs per step", "flops": "floating-point operations per step"}
    bars = [(entry, getattr(entry, kind)) for entry in entries]
    bars = [(entry, float(value)) for entry, value in bars if value is not None]
    drawn = figure(8.0, 1.4 + 0.3 * max(1, len(bars)))
    axes = drawn.add_subplot()
    places = range(len(bars))[::-1]
    for place, (entry, value) in zip(places, bars, strict=True):
        axes.barh(place, value, color=STAGES[entry.stage], height=0.7)
        shown = f"{value:.2f}" if kind == "micros" else f"{value:.0f}"
        axes.annotate(
            shown,
            (max(value, 0.0), place),
            (3, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    axes.set_yticks(list(places), [_short(entry.name) for entry, _ in bars], fontsize=8)
    axes.set_xlim(right=1.12 * max([1e-3, *(value for _, value in bars)]))
    axes.set_xlabel(words[kind])
    bare(axes, f"{plan.name}: what a step does")
    _legend(axes, {entry.stage for entry, _ in bars})
    return saved(drawn, path)


def _legend(axes: Any, stages: set[str]) -> None:
    from matplotlib.patches import Patch

    patches = [Patch(color=colour, label=name) for name, colour in STAGES.items() if name in stages]
    if patches:
        axes.figure.legend(handles=patches, loc="outside right upper", fontsize=8, frameon=False)


def _short(name: str) -> str:
    return name if len(name) <= 48 else name[:47] + "…"
