"""The colours of plots, views and pictures; the common parts of all plots."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np

from stepcore.needs import installing

# Colours for colour-blind readers (Okabe and Ito), in a fixed order so that an integrator has the
# same colour in every plot.
COLOURS = {
    "rk4": "#0072B2",
    "implicitfast": "#009E73",
    "euler": "#E69F00",
    "semi-implicit": "#D55E00",
    "explicit": "#CC79A7",
    "midpoint": "#56B4E9",
    "implicit": "#000000",
    "discrete": "#999933",
}
BLUE, GREEN, ORANGE = COLOURS["rk4"], COLOURS["implicitfast"], COLOURS["euler"]
RED = COLOURS["semi-implicit"]
GREY = "#666666"
# Colours of pages, views and pictures, on light and on dark grounds.
VIEW = {
    "contact": "#F4A300",
    "force": "#D7263D",
    "tendon": "#C0392B",
    "link": "#D1495B",
    "kinetic": "#E07A1F",
    "potential": "#2A7DE1",
    "total": "#7A7F87",
    "residual": "#D1495B",
    "fixed": "#8C8C8C",
    "ground": "#9EA8B3",
}
# Bodies of a scene without colours, by their index.
BODIES = ("#4582B5", "#ED993D", "#59A166", "#B85C80")
# Colours of runs that are drawn over another, which keeps its colours.
TINTS = ("#f2731a", "#338cf2", "#994dcc")
# Behind everything, above and below.
SKY = ("#EDF2FA", "#D1DEED")
# Font sizes [points].
FONT = {"title": 11, "text": 9, "small": 8}
# The sides of a mark where a text may stand, the first one first: below and left of the front of a
# trade there is nothing.
SIDES = tuple(product((-1, 1), (-1, 0, 1)))


def rgb(colour: str) -> tuple[float, float, float]:
    """Return a colour of this table as numbers from 0 to 1."""
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue


def new_figure(width: float = 8.0, height: float = 4.8) -> Any:
    """Create an empty figure [inches]; raise a helpful ImportError without matplotlib."""
    try:
        from stepcore.report.plot.notebook_figure import NotebookFigure
    except ImportError:
        raise ImportError(f"a plot needs matplotlib: {installing('plot')}") from None
    return NotebookFigure(figsize=(width, height), dpi=150, layout="constrained")


def named_bars(
    names: Sequence[str], letters: int, panels: int = 1, width: float = 8.0, room: float = 1.6
) -> tuple[Any, Any, range]:
    """Return a figure for bars by name from above, its panels, and the places of the bars.

    All places are within the panels, whether they have a bar or not.

    room: height in addition to the bars [inches].
    """
    figure = new_figure(width, room + 0.3 * max(1, len(names)))
    axes = figure.subplots(1, panels, sharey=True, squeeze=False)[0]
    places = range(len(names))[::-1]
    name_places(axes[0], names, places, letters)
    axes[0].set_ylim(-0.6, len(names) - 0.4)
    return figure, axes, places


def stacked(panels: int) -> tuple[Any, Any]:
    """Return a figure of panels above each other that share their time, and the panels."""
    figure = new_figure(height=max(4.0, 2.0 * panels))
    every = figure.subplots(panels, sharex=True, squeeze=False)[:, 0]
    for axes in every:
        axes.ticklabel_format(useOffset=False)
    return figure, every


def frame(axes: Any, title: str = "", x: str = "", y: str = "") -> None:
    """Draw a light grid behind the data and the title at the left, without a box.

    x, y: the words along the axes.
    """
    axes.grid(True, which="major", color="#E5E5E5", lw=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if title:
        axes.set_title(title, loc="left", fontsize=FONT["title"])
    if x:
        axes.set_xlabel(x)
    if y:
        axes.set_ylabel(y)


def log_ticks(axis: Any, words: Callable[[float], str] | None = None) -> None:
    """Set the ticks of a log axis so that labels do not collide.

    Two decades and more have a tick at each; below there are ticks at 1, 2 and 5, and below half a
    decade evenly spaced ones.

    axis: `axes.xaxis` or `axes.yaxis`, whose limits are set. words: a function that formats a tick.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    low, high = sorted(axis.get_view_interval())
    decades = math.log10(high / low) if 0 < low < high else 0.0
    if decades < 0.5:
        axis.set_major_locator(MaxNLocator(4))
    else:
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if decades < 2 else (1,), numticks=9))
    axis.set_minor_formatter(NullFormatter())
    if decades < 2:
        words = words or "{:.3g}".format
    if words is not None:
        axis.set_major_formatter(FuncFormatter(lambda value, _: words(value)))


def bar(
    axes: Any,
    place: float,
    value: float,
    colour: str,
    text: str = "",
    left: float = 0.0,
    after: float = 0.0,
) -> None:
    """Draw a horizontal bar from `left` to a larger `value`, and a text at its end.

    after: the text is placed after this value too.
    """
    if value > left:
        axes.barh(place, value - left, left=left, color=colour, height=0.7)
    if text:
        at = (max(value, left, after), place)
        style: dict[str, Any] = {"textcoords": "offset points", "va": "center", "zorder": 5}
        axes.annotate(text, at, (3, 0), fontsize=FONT["small"], path_effects=halo(), **style)


def halo() -> list[Any]:
    """Return what makes lines behind a text pale around its letters."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.0, foreground="white")]


def write_beside(axes: Any, marks: Sequence[tuple[tuple[float, float], str]]) -> None:
    """Place texts next to marks, where they cover the least of lines and other texts.

    The limits of the axes are set. marks: a point of the data each, and its text.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(axes.figure)
    renderer = canvas.get_renderer()
    axes.figure.draw_without_rendering()
    drawn = np.concatenate([*map(_pixels, axes.lines), np.empty((0, 2))])
    for at, text in marks:
        style: dict[str, Any] = {"textcoords": "offset points", "path_effects": halo(), "zorder": 6}
        written = axes.annotate(text, at, (0, 0), fontsize=FONT["text"], **style)
        written.set_in_layout(False)

        def box(side: tuple[int, int], written: Any = written) -> Any:
            """Put the text to this side of its mark, and return where it is."""
            x, y = side
            written.set(x=9 * x, y=9 * y, ha=("left", "right")[x < 0])
            written.set_va(("center", "bottom", "top")[y])
            return written.get_window_extent(renderer)

        def covered(side: tuple[int, int], box: Any = box, drawn: Any = drawn) -> int:
            """Count the pixels of lines that are covered; more of them outside of the axes."""
            place = box(side)
            outside = not all(axes.bbox.contains(*corner) for corner in (place.min, place.max))
            over = (drawn > place.min) & (drawn < place.max)
            return int(over.all(axis=1).sum()) + outside * len(drawn)

        chosen = box(min(SIDES, key=covered))
        within = np.stack(np.meshgrid(*np.linspace(chosen.min, chosen.max, 9).T), -1)
        drawn = np.concatenate([drawn, within.reshape(-1, 2)])


def _pixels(line: Any) -> np.ndarray:
    """Return the points of a line on the canvas, or of its marks, one for each pixel or so."""
    points = line.get_transform().transform(np.column_stack(line.get_data()).astype(float))
    points = points[np.isfinite(points).all(axis=1)]
    if line.get_linestyle() == "None":
        size = line.get_markersize()
        return (points[:, None] + size * np.array([(0, 0), *SIDES])).reshape(-1, 2)
    along = [np.linspace(a, b, 2 + int(np.abs(b - a).max())) for a, b in pairwise(points)]
    return np.concatenate([*along, np.empty((0, 2))])


def name_places(axes: Any, names: Sequence[str], places: Sequence[float], letters: int) -> None:
    """Write names along the vertical axis, without quotes, cut to `letters` letters."""
    plain = [name.replace("`", "") for name in names]
    short = [name if len(name) <= letters else name[: letters - 1] + "…" for name in plain]
    axes.set_yticks(list(places), short, fontsize=FONT["small"])


def patches(colours: dict[str, str]) -> list[Any]:
    """Return legend entries: names and the colours of their areas."""
    from matplotlib.patches import Patch

    return [Patch(color=colour, label=name) for name, colour in colours.items()]


def line(label: str, **style: Any) -> Any:
    """Return a legend entry: a line, or with `marker` and ls="none" a point."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


def legend(figure: Any, entries: Sequence[Any] | None = None, columns: int = 0) -> None:
    """Draw the legend outside the axes: below in `columns` columns, or at the right."""
    place: dict[str, Any] = {"loc": "outside right center"}
    if columns:
        place = {"loc": "outside lower center", "ncols": columns}
    if entries is not None:
        place["handles"] = entries
    figure.legend(fontsize=FONT["text"], frameon=False, **place)


def write_centred(axes: Any, text: str) -> None:
    """Write a text in the middle of otherwise empty axes."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color=GREY)
