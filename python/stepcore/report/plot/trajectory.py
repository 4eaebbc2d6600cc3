"""The plot of a run over time: energy and overlap, or whatever was recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import BLUE, COLOURS, ORANGE, TEXT, frame, new_figure

if TYPE_CHECKING:
    from stepcore.engine.trajectory import Trajectory

# In the order in which lines of one quantity are drawn.
LINES = tuple(COLOURS.values())
# More lines than this cannot be told apart by colour, and have no legend.
NAMED = len(LINES)
# Panels are at least this high [inches], and a figure of few panels not lower than usual.
PANEL = 2.2
UNITS = {"overlap": "deepest overlap [m]", "residual": "residual [m/s]"}


def draw(run: Trajectory) -> Any:
    """Energy and deepest overlap over time, or else all that was recorded, one panel each.

    Raises ValueError for a run that recorded nothing.
    """
    wanted: list[str] = [name for name in ("energy", "overlap") if name in run.data]
    names = wanted or list(run.data)
    if not names:
        raise ValueError("the run recorded nothing that can be drawn")
    figure = new_figure(height=max(4.0, PANEL * len(names)))
    panels = figure.subplots(len(names), sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        if name == "energy":
            _energy(axes, run)
        else:
            _lines(axes, run.time, name, np.asarray(run.data[name], float))
        frame(axes)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(float(run.time[0]), float(run.time[-1]) or None)
    return figure


def _energy(axes: Any, run: Trajectory) -> None:
    kinetic, potential = np.asarray(run.data["energy"], float).T
    axes.plot(run.time, kinetic, color=BLUE, lw=1.2, label="kinetic")
    axes.plot(run.time, potential, color=ORANGE, lw=1.2, label="potential")
    axes.plot(run.time, kinetic + potential, color="black", lw=1.6, label="total")
    axes.set_ylabel("energy [J]")
    _legend(axes)


def _lines(axes: Any, time: np.ndarray, name: str, values: np.ndarray) -> None:
    columns = values.reshape(len(time), -1)
    count = columns.shape[1]
    for k in range(count):
        index = ", ".join(map(str, np.unravel_index(k, values.shape[1:])))
        label = f"[{index}]" if 1 < count <= NAMED else None
        axes.plot(time, columns[:, k], color=LINES[k % NAMED], lw=1.2, label=label)
    axes.set_ylabel(UNITS.get(name, name))
    if name == "overlap":
        axes.set_ylim(bottom=0)
    if 1 < count <= NAMED:
        _legend(axes)


def _legend(axes: Any) -> None:
    """At the right of the panel, where it covers nothing."""
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=TEXT, frameon=False)
