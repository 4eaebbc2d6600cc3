"""The picture of a run over time: energy and overlap, or whatever was recorded."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import COLOURS, bare, figure, saved

if TYPE_CHECKING:
    from stepcore.engine.trajectory import Trajectory

# In the order in which lines of one quantity are drawn.
LINES = tuple(COLOURS.values())
# More lines than this cannot be told apart by colour, and have no legend.
NAMED = len(LINES)
# Panels are at least this high [inches], and a figure of few panels not lower than usual.
PANEL = 2.2
UNITS = {"overlap": "deepest overlap [m]", "residual": "residual [m/s]"}


def plot_trajectory(run: Trajectory, path: str | os.PathLike[str] | None = None) -> Any:
    """Draws energy and deepest overlap, or all that was recorded, one panel each, over time.

    Written where `path` says, in the format of its ending. Returns the matplotlib Figure. Raises
    ImportError without matplotlib, ValueError for a run that recorded nothing.
    """
    wanted: list[str] = [name for name in ("energy", "overlap") if name in run.data]
    names = wanted or list(run.data)
    if not names:
        raise ValueError("the run recorded nothing that could be drawn")
    drawn = figure(height=max(4.0, PANEL * len(names)))
    panels = drawn.subplots(len(names), sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        if name == "energy":
            _energy(axes, run)
        else:
            _lines(axes, run.time, name, np.asarray(run.data[name], float))
        bare(axes)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(float(run.time[0]), float(run.time[-1]) or None)
    return saved(drawn, path)


def _energy(axes: Any, run: Trajectory) -> None:
    kinetic, potential = np.asarray(run.data["energy"], float).T
    axes.plot(run.time, kinetic, color=COLOURS["rk4"], lw=1.2, label="kinetic")
    axes.plot(run.time, potential, color=COLOURS["euler"], lw=1.2, label="potential")
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
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9, frameon=False)
