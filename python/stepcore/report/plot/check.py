"""The plot of a check: that of its diagnosis, the largest stable dt of every element."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stepcore.report.plot import diagnosis
from stepcore.report.plot.style import frame, new_figure, say

if TYPE_CHECKING:
    from stepcore.measure.check import Check


def draw(check: Check) -> Any:
    """The diagnosis' plot."""
    if check.diagnosis is not None:
        return diagnosis.draw(check.diagnosis)
    figure = new_figure(8.0, 2.0)
    axes = figure.add_subplot()
    frame(axes, check.title)
    say(axes, "the time step was not diagnosed")
    return figure
