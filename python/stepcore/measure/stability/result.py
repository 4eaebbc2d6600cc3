"""`StabilityMap`: a grid of dt × parameter with accurate, inaccurate and exploded cells."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from stepcore.experiment.engines import FAR
from stepcore.experiment.motion import Motion
from stepcore.report.report import not_shown
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, metres, seconds

# The states of a cell, and their marks; "finite" is used only if the accuracy is unknown.
ACCURATE, INACCURATE, EXPLODED, FINITE = "accurate", "inaccurate", "exploded", "finite"
UNTRIED = "not run"
SYMBOLS = {ACCURATE: "·", INACCURATE: "o", EXPLODED: "X", FINITE: "?", UNTRIED: " "}


@dataclass(frozen=True)
class MapCell:
    """One run of a stability map.

    state: "accurate", "inaccurate" or "exploded"; "finite" if the accuracy is unknown.
    error: RMS position error against the true motion [m], never below what that is sure of; NaN if
        unknown.
    reason: why the run failed.
    asked: the accuracy asked for [m], in a map over accuracies.
    """

    value: float
    dt: float
    state: str
    error: float = math.nan
    reason: str | None = None
    asked: float | None = None

    @property
    def over(self) -> float:
        """The error delivered over the one asked for; NaN if unknown, or nothing was asked for."""
        return self.error / self.asked if self.asked else math.nan


@dataclass(frozen=True)
class MapPanel:
    """The cells of one setting, values outermost, and the theory.

    boundary: the theoretical limit of dt for each value [s]: 0 if no step is stable, inf if all
        are; None without a theory.
    beyond: the behaviour beyond the boundary.
    """

    label: str
    cells: list[MapCell]
    boundary: list[float] | None = None
    beyond: str = ""

    def at(self, value: float) -> list[MapCell]:
        """Return the cells of one value, by dt."""
        return [cell for cell in self.cells if cell.value == value]


@dataclass(eq=False, repr=False)
class StabilityMap(Result):
    """A map of stability and accuracy over dt, or over the accuracy asked for, and one parameter.

    `stepcore.stability_map` returns this map.

    path: the parameter that is varied.
    axis: the label of the parameter's axis, with the unit.
    values, dts [s]: the grid.
    accuracies: of the grid in place of dts [m], which then is the control period; or empty.
    deviation: the error above which a run is inaccurate [m].
    panels: one panel for each setting.

    >>> from stepcore import stability_map
    >>> stability_map(values=[100.0], dts=[0.001, 0.5], progress=False)
    <StabilityMap of spring: 16 cells in 8 panels>
    """

    kind = "stability"
    units: ClassVar = {"dt": "s", "theory": "s"} | dict.fromkeys(("error", "asked"), "m")

    settings: Any
    motion: Motion
    path: str
    axis: str
    values: Sequence[float]
    dts: Sequence[float]
    horizon: float
    deviation: float
    panels: list[MapPanel]
    accuracies: Sequence[float] = ()

    def __post_init__(self) -> None:
        unjudged = sum(cell.state == FINITE for cell in self.rows)
        if unjudged:
            self.notes.append(
                f"{counted(unjudged, 'finite run')}, marked {SYMBOLS[FINITE]}, cannot be judged "
                "for accuracy, because the true motion is not known well enough"
            )

    @property
    def title(self) -> str:
        """The quantity measured, in a few words."""
        what = "error delivered over asked" if self.accuracies else "stability and accuracy over dt"
        return f"{self.name}: {what} × {self.axis}"

    @property
    def setup(self) -> str:
        """The meaning of the cells' marks."""
        accurate, inaccurate, exploded = (f"{s} ({SYMBOLS[s]})" for s in list(SYMBOLS)[:3])
        if self.accuracies:
            return (
                f"Steps of {seconds(self.dts[0])} that keep an accuracy over {self.horizon:g} s. "
                f"{accurate}: the error is at most what was asked for; {inaccurate}: it is larger; "
                f"{exploded}: the run failed."
            )
        return (
            f"{accurate}: the RMS position error is at most {metres(self.deviation)}; "
            f"{inaccurate}: it is larger; {exploded}: the run failed, a body went further than "
            f"{FAR:g} times the scene's size, or a hinge turned {FAR:g} times too fast."
        )

    @property
    def sentences(self) -> list[str]:
        """The number of cells in each state for each setting, the scene's integrator first."""
        sentences = []
        for panel in sorted(self.panels, key=lambda panel: panel is not self._first):
            count = Counter(cell.state for cell in panel.cells)
            states = ", ".join(f"{count[state]} {state}" for state in SYMBOLS if count[state])
            sentences.append(f"{panel.label}: of {counted(len(panel.cells), 'run')}, {states}.")
            if worst := [cell for cell in panel.cells if math.isfinite(cell.over)]:
                cell = max(worst, key=lambda cell: cell.over)
                sentences.append(
                    f"The most of what was asked for is {cell.over:.2g}, at {cell.value:.3g} where "
                    f"{metres(cell.asked or 0.0)} were."
                )
        return sentences

    @property
    def rows(self) -> list[MapCell]:
        """The cells of all panels."""
        return [cell for panel in self.panels for cell in panel.cells]

    @property
    def table(self) -> Table:
        """One row for each cell; theory: the largest stable dt of the cell's value [s]."""
        rows: list[dict[str, Any]] = []
        for panel in self.panels:
            theory = dict(zip(self.values, panel.boundary or [], strict=False))
            for cell in panel.cells:
                row = {"setting": panel.label, "value": cell.value, "dt": cell.dt}
                row |= {"state": cell.state, "error": cell.error, "theory": theory.get(cell.value)}
                row["reason"] = cell.reason
                if cell.asked:
                    row |= {"asked": cell.asked, "delivered over asked": cell.over}
                rows.append(row)
        return Table(rows)

    def tables(self, full: bool) -> list[Table]:
        """Return the panels with one row for each value and one mark for each dt.

        full: whether to return all panels rather than the first.
        """
        if full or len(self.panels) == 1:
            return [self._table(panel) for panel in self.panels]
        table, left = self._table(self._first), len(self.panels) - 1
        table.legend = not_shown(f"the maps of {counted(left, 'other setting')}")
        return [table]

    @property
    def _first(self) -> MapPanel:
        """The panel of the scene's integrator, or the first."""
        own = (panel for panel in self.panels if panel.label == self.settings.integrator)
        return next(own, self.panels[0])

    def _table(self, panel: MapPanel) -> Table:
        across = f"dt {seconds(self.dts[0])} to {seconds(self.dts[-1])}"
        if self.accuracies:
            across = f"asked {metres(self.accuracies[0])} to {metres(self.accuracies[-1])}"
        rows: list[dict[str, Any]] = []
        for k, value in enumerate(self.values):
            cells = panel.at(value)
            row = {"value": value, across: "".join(SYMBOLS[cell.state] for cell in cells)}
            if self.accuracies:
                shares = ("?" if math.isnan(c.over) else f"{c.over:.1g}" for c in cells)
                row["delivered over asked"] = " ".join(shares)
            else:
                good = [cell.dt for cell in cells if cell.state == ACCURATE]
                unknown = not good and any(cell.state == FINITE for cell in cells)
                most = _dt(max(good, default=0.0))
                row["largest accurate"] = "unknown" if unknown else most
            if panel.boundary is not None:
                row[panel.beyond] = _dt(panel.boundary[k])
            rows.append(row)
        # A column with a format is not truncated.
        return Table(rows, formats={"value": ".3g", across: ""}, heading=panel.label)

    def details(self) -> dict[str, Any]:
        """Return the grid and the panels' theory as plain data."""
        return {
            "value": self.path,
            "values": list(self.values),
            "dts": list(self.dts),
            "accuracies": list(self.accuracies),
            "deviation": self.deviation,
            "panels": [
                {"setting": p.label, "theory": p.beyond or None, "boundary": p.boundary}
                for p in self.panels
            ],
        }

    def __repr__(self) -> str:
        return f"<StabilityMap of {self.name}: {len(self.rows)} cells in {len(self.panels)} panels>"


def _dt(value: float) -> str:
    if value == 0:
        return "none"
    return seconds(value) if math.isfinite(value) else "any"
