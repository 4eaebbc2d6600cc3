"""`NotebookFigure`: a matplotlib Figure that a notebook displays as the last value of a cell.

Plots are created without pyplot, so the notebook has no display hook for a plain Figure.
"""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A Figure with an SVG picture for notebooks."""

    def _repr_svg_(self) -> str:
        drawn = io.StringIO()
        self.savefig(drawn, format="svg")
        return drawn.getvalue()
