"""`NotebookFigure`: a matplotlib Figure that a notebook shows where it is a cell's last value.

Plots are made without pyplot, so nothing has told the notebook how to show a Figure.
"""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A Figure with a picture for notebooks."""

    def _repr_svg_(self) -> str:
        drawn = io.StringIO()
        self.savefig(drawn, format="svg")
        return drawn.getvalue()
