"""Plots: for each kind of result, a function that returns a matplotlib Figure.

matplotlib is imported only when something is drawn.
"""

from __future__ import annotations

import importlib
import os
from typing import Any

from stepcore import escapes, files
from stepcore.report.outputs import remark

# The module of the plotting function, by kind of result.
MODULES = {
    **dict.fromkeys(("ablation", "check", "comparison", "diagnosis", "plan", "tuning"), "bars"),
    **dict.fromkeys(
        ("answer", "convergence", "postmortem", "predictability", "trajectory"), "curves"
    ),
    **{kind: kind for kind in ("identification", "outcomes", "stability", "trade")},
}


def plot(kind: str, result: Any, path: str | os.PathLike[str] | None) -> Any:
    """Return the Figure of a result, written to `path` if given."""
    target = None if path is None else files.as_path("path", path)
    module = importlib.import_module(f"stepcore.report.plot.{MODULES[kind]}")
    figure = getattr(module, kind)(result)
    # Fonts lack control characters, which names may have.
    for text in figure.findobj(importlib.import_module("matplotlib.text").Text):
        text.set_text(escapes.printable(text.get_text()))
    if target is not None:
        figure.savefig(target, **remark(target))
    return figure
