"""Plots: a module for each kind of result, with `draw(result)`, which returns a matplotlib Figure.

matplotlib is imported only where something is drawn.
"""

from __future__ import annotations

import importlib
import os
from typing import Any


def plot(kind: str, result: Any, path: str | os.PathLike[str] | None) -> Any:
    """The Figure that `draw` of the module `kind` makes; written to `path` if given."""
    figure = importlib.import_module(f"stepcore.report.plot.{kind}").draw(result)
    if path is not None:
        figure.savefig(path)
    return figure
