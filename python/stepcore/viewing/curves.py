"""Curves over time in a live view, drawn by viser's plots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.viewing.frames import Instant
from stepcore.viewing.needs import need

Points = tuple[NDArray[Any], NDArray[Any]]

ORANGE, BLUE, GREY, RED = "#e07a1f", "#2a7de1", "#7a7f87", "#d1495b"
ENERGY = (("kinetic", ORANGE), ("Δ potential", BLUE), ("Δ total", GREY))
# A residual of zero, of which a logarithm is drawn [m/s].
LEAST = 1e-20
# How many points a curve keeps, and how often it is sent to the page [s].
POINTS, PAUSE = 1000, 0.2


class Curves:
    """One plot: a few curves over time.

    names: of the curves, each with its colour. span: the times of the ends of its axis [s]; by
    default those of what is drawn.
    """

    def __init__(
        self,
        gui: Any,
        title: str,
        names: Sequence[tuple[str, str]],
        span: tuple[float, float] | None = None,
    ) -> None:
        uplot = need("viser.uplot", "a view")
        series = [uplot.Series(label="time [s]")]
        series += [uplot.Series(label=name, stroke=colour, width=2) for name, colour in names]
        scales = {"x": uplot.Scale(time=False, auto=True)}
        if span is not None:
            scales["x"] = uplot.Scale(time=False, range=span)
        nothing = tuple(np.array([0.0]) for _ in series)
        self.plot = gui.add_uplot(
            nothing, tuple(series), title=title, scales=scales, aspect=2.0, height=150
        )
        self.sent = 0.0

    def draw(self, made: Callable[[], Points], now: bool = True) -> None:
        """Draw the curves; without `now` only if they were not drawn lately.

        made: makes the times, and the values of shape (names, times), where they are drawn.
        """
        if not (now or monotonic() - self.sent > PAUSE):
            return
        time, values = made()
        self.sent = monotonic()
        pick = np.unique(np.linspace(0, len(time) - 1, min(len(time), POINTS)).astype(int))
        self.plot.data = tuple(np.ascontiguousarray(row[pick], float) for row in (time, *values))


def energies(instants: Sequence[Instant]) -> Points:
    """Return times, and kinetic energy and the changes of potential and total energy, (3, n)."""
    kinetic, potential = np.array([instant.energy for instant in instants]).T
    total = kinetic + potential
    # Potential energy has no zero of its own.
    values = np.array([kinetic, potential - potential[0], total - total[0]])
    return _times(instants), values


def residuals(instants: Sequence[Instant]) -> Points:
    """Return times and the decimal logarithm of each instant's residual in m/s, shape (1, n)."""
    found = np.maximum([[instant.residual for instant in instants]], LEAST)
    return _times(instants), np.log10(found)


def _times(instants: Sequence[Instant]) -> NDArray[Any]:
    return np.array([instant.time for instant in instants])
