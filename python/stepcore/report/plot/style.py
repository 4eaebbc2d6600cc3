"""What all pictures share: colours, a blank figure, words in place."""

from __future__ import annotations

import os
from typing import Any

# Colours that a colour-blind reader can tell apart (Okabe and Ito), in a fixed order so that an
# integrator looks the same in every picture.
COLOURS = {
    "rk4": "#0072B2",
    "implicitfast": "#009E73",
    "euler": "#E69F00",
    "semi-implicit": "#D55E00",
    "explicit": "#CC79A7",
    "midpoint": "#56B4E9",
}
GREY = "#666666"


def figure(width: float = 8.0, height: float = 4.8) -> Any:
    """An empty figure [inches]; ImportError with the way out where matplotlib is missing."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ImportError("a plot needs matplotlib: pip install 'stepcore[plot]'") from None
    return Figure(figsize=(width, height), dpi=150, layout="constrained")


def bare(axes: Any, title: str = "") -> None:
    """A light grid behind the points, no box around them, the title at the left."""
    axes.grid(True, which="major", color="#E5E5E5", lw=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if title:
        axes.set_title(title, loc="left", fontsize=11)


def saved(drawn: Any, path: str | os.PathLike[str] | None) -> Any:
    """The figure, written where `path` says in the format of its ending."""
    if path is not None:
        drawn.savefig(path)
    return drawn
