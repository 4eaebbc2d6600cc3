"""Plots: a module for each kind of result, with `draw(result)`, which returns a matplotlib Figure.

matplotlib is imported only where something is drawn.
"""

from __future__ import annotations

import importlib
import os
from typing import Any

from stepcore import escapes, files
from stepcore.report.outputs import remark


def plot(kind: str, result: Any, path: str | os.PathLike[str] | None) -> Any:
    """The Figure that `draw` of the module `kind` makes; written to `path` if given."""
    target = None if path is None else files.path("path", path)
    figure = importlib.import_module(f"stepcore.report.plot.{kind}").draw(result)
    _make_printable(figure)
    if target is not None:
        figure.savefig(target, **remark(target))
    return figure


def _make_printable(figure: Any) -> None:
    """Names in titles, axes and legends as they stand in texts: fonts lack control characters."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        shown = escapes.printable(text.get_text())
        if shown != text.get_text():
            text.set_text(shown)
