"""Plot of a stability map: accurate, inaccurate and exploded cells, and theory's boundary."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import FONT, ORANGE, legend, log_ticks, new_figure

if TYPE_CHECKING:
    from stepcore.measure.stability import MapPanel, StabilityMap

# Colours by state: light, middle and dark, so that they differ without colour too.
ACCURATE, FINITE = "accurate", "finite"
FILLS = {ACCURATE: "#A9D8F5", "inaccurate": ORANGE, "exploded": "#4A3B52"}
UNJUDGED = "finite, not judged"


def stability(result: StabilityMap) -> Any:
    """Draw a panel for each setting: the value across and dt up, both on log axes."""
    count = len(result.panels)
    columns = count if count <= 3 else 2 if count == 4 else 3
    rows = math.ceil(count / columns)
    figure = new_figure(width=max(5.5, 3.0 * columns + 0.8), height=2.5 * rows + 1.5)
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel, ax in zip(result.panels, axes.flat, strict=False):
        _panel(ax, result, panel)
    for ax in axes.flat[count:]:
        ax.set_visible(False)
    for k, ax in enumerate(axes.flat[:count]):
        if k + columns >= count:
            ax.set_xlabel(result.path)
            ax.tick_params(labelbottom=True)
        if k % columns == 0:
            ax.set_ylabel("dt [s]")
    figure.suptitle(
        f"{result.title}, {result.horizon:g} s", fontsize=FONT["title"], x=0.01, ha="left"
    )
    _legend(figure, result)
    return figure


def _panel(axes: Any, result: StabilityMap, panel: MapPanel) -> None:
    from matplotlib.colors import ListedColormap

    shape = (len(result.values), len(result.dts))
    states = list(FILLS)
    filled = [cell.state if cell.state in FILLS else ACCURATE for cell in panel.cells]
    grid = np.array([states.index(state) for state in filled]).reshape(shape).T
    across, up = _edges(result.values), _edges(result.dts)
    colours = ListedColormap(list(FILLS.values()))
    axes.pcolormesh(across, up, grid, cmap=colours, vmin=-0.5, vmax=2.5, edgecolors="none")
    unknown = np.array([cell.state not in FILLS for cell in panel.cells]).reshape(shape).T
    if unknown.any():
        masked = np.ma.masked_where(~unknown, grid)
        axes.pcolor(across, up, masked, hatch="///", alpha=0.0, zorder=2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(across[0], across[-1])
    axes.set_ylim(up[0], up[-1])
    log_ticks(axes.xaxis)
    log_ticks(axes.yaxis)
    if panel.boundary is not None:
        limits = np.asarray(panel.boundary)
        line = result.values, np.where((limits > 0) & np.isfinite(limits), limits, np.nan)
        # A white line under the black line is visible on every colour.
        axes.plot(*line, color="white", lw=3.5, zorder=4, solid_capstyle="butt")
        axes.plot(*line, color="black", lw=1.5, ls=(0, (4, 2)), zorder=4)
    axes.set_title(_named(panel), loc="left", fontsize=9.5)


def _named(panel: MapPanel) -> str:
    """Return the setting, with the theory in words: of the dashed line, or if there is no line."""
    ends = set(panel.boundary or ())
    if ends == {0.0}:
        return f"{panel.label} (theory: grows at any dt)"
    if ends == {np.inf}:
        return f"{panel.label} (theory: never grows)"
    return f"{panel.label}\ndashed: limit of springs" if ends else panel.label


def _edges(points: Any) -> np.ndarray:
    """Return the borders between points on a log axis, half-way between neighbours."""
    logs = np.log(np.asarray(points, float))
    if len(logs) == 1:
        return np.exp(np.array([logs[0] - 0.3, logs[0] + 0.3]))
    middle = (logs[1:] + logs[:-1]) / 2
    first, last = logs[0] - (middle[0] - logs[0]), logs[-1] + (logs[-1] - middle[-1])
    return np.exp(np.concatenate([[first], middle, [last]]))


def _legend(figure: Any, result: StabilityMap) -> None:
    from matplotlib.patches import Patch

    entries: list[Any] = [Patch(fc=fill, ec="black", lw=0.4, label=s) for s, fill in FILLS.items()]
    if any(cell.state == FINITE for cell in result.rows):
        entries.append(Patch(fc=FILLS[ACCURATE], ec="black", lw=0.4, hatch="///", label=UNJUDGED))
    legend(figure, entries, len(entries) if len(entries) < 4 or figure.get_figwidth() > 7 else 2)
