"""`StabilityMap`: which cells of a grid of dt and a value are finite, inaccurate or exploded."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from stepcore._core import Settings
from stepcore.experiment.motion import Motion
from stepcore.measure.stability.reference import Tolerance
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, seconds

FINITE, INACCURATE, EXPLODED = "finite", "inaccurate", "exploded"
SYMBOLS = {FINITE: "·", INACCURATE: "o", EXPLODED: "X"}
UNJUDGED = "?"


@dataclass(frozen=True)
class MapCell:
    """One run of a stability map.

    error: its largest distance from the true motion over the size of the motion; nan if not known.
    judged: whether there is a true motion with which it can be compared.
    reason: why it failed.
    """

    value: float
    dt: float
    state: str
    error: float
    judged: bool = True
    reason: str | None = None


@dataclass(frozen=True)
class MapPanel:
    """The cells of one setting, values outermost, and its theory.

    boundary: by value, the dt [s] at which theory says that the cells change: 0 if no step is
        stable, inf if all are; None without a theory.
    beyond: what happens beyond the boundary.
    reference: what the cells are compared with.
    """

    label: str
    cells: list[MapCell]
    reference: str
    boundary: list[float] | None = None
    beyond: str = ""

    def at(self, value: float) -> list[MapCell]:
        """The cells of one value, by dt."""
        return [cell for cell in self.cells if cell.value == value]


@dataclass(eq=False, repr=False)
class StabilityMap(Result):
    """A map of stability and accuracy over dt and one value; `stepcore.stability_map` returns it.

    path: the value that is varied.
    axis: how the plot names it, with its unit.
    values, dts [s]: the grid.
    tolerance: a run with a larger error is inaccurate.
    far: a run with an error above this many sizes of the motion has exploded.
    panels: one for each setting.

    >>> from stepcore import stability_map
    >>> stability_map(values=[100.0], dts=[0.001, 0.5], progress=False)
    <StabilityMap of spring: 16 cells in 8 panels>
    """

    kind = "stability"
    units: ClassVar = {"dt": "s", "error": "1", "theory": "s"}

    name: str
    settings: Settings
    motion: Motion
    path: str
    axis: str
    values: Sequence[float]
    dts: Sequence[float]
    horizon: float
    tolerance: Tolerance
    far: float
    panels: list[MapPanel]
    notes: list[str] = field(default_factory=list)
    ran: str = ""

    def __post_init__(self) -> None:
        unjudged = sum(not c.judged and c.state == FINITE for c in self.rows)
        if unjudged:
            self.notes.append(
                f"{counted(unjudged, 'finite run')}, marked {UNJUDGED}, cannot be judged for "
                "accuracy, because no converged run was found"
            )

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: stability and accuracy over dt × {self.axis}"

    @property
    def setup(self) -> str:
        """How cells are told apart."""
        return (
            f"{_word(FINITE)}: the error stays within {self.tolerance}; "
            f"{_word(INACCURATE)}: it is larger; {_word(EXPLODED)}: it is larger than "
            f"{self.far:g} sizes of the motion, or the run failed."
        )

    @property
    def sentences(self) -> list[str]:
        """How many runs of each setting are finite, inaccurate and exploded; the scene's first."""
        sentences = []
        for panel in sorted(self.panels, key=lambda panel: panel is not self._first):
            count = Counter(cell.state for cell in panel.cells)
            states = ", ".join(f"{count[state]} {state}" for state in SYMBOLS if count[state])
            sentences.append(f"{panel.label}: of {counted(len(panel.cells), 'run')}, {states}.")
        return sentences

    @property
    def rows(self) -> list[MapCell]:
        """The cells of all panels."""
        return [cell for panel in self.panels for cell in panel.cells]

    @property
    def table(self) -> Table:
        """One row for each cell: setting, value, dt [s], state, error, theory's dt [s], reason."""
        return Table(record for panel in self.panels for record in self._records(panel))

    def _records(self, panel: MapPanel) -> Iterator[dict[str, Any]]:
        theory = dict(zip(self.values, panel.boundary or [], strict=False))
        for cell in panel.cells:
            yield {
                "setting": panel.label,
                "value": cell.value,
                "dt": cell.dt,
                "state": cell.state,
                "error": cell.error,
                "judged": cell.judged,
                "theory": theory.get(cell.value),
                "reason": cell.reason,
            }

    def tables(self, full: bool) -> list[Table]:
        """The panels: one row for each value, one mark for each dt; not `full`: one panel."""
        if full or len(self.panels) == 1:
            return [self._table(panel) for panel in self.panels]
        table = self._table(self._first)
        left = counted(len(self.panels) - 1, "other setting")
        table.legend = f"Not shown: the maps of {left} (--all; in Python text(full=True))."
        return [table]

    @property
    def _first(self) -> MapPanel:
        """The panel of the scene's integrator, or the first."""
        own = (panel for panel in self.panels if panel.label == self.settings.integrator)
        return next(own, self.panels[0])

    def _table(self, panel: MapPanel) -> Table:
        across = f"dt {seconds(self.dts[0])} to {seconds(self.dts[-1])}"
        rows = []
        for k, value in enumerate(self.values):
            cells = panel.at(value)
            marks = "".join(_mark(cell) for cell in cells)
            good = [cell.dt for cell in cells if cell.state == FINITE and cell.judged]
            unknown = not good and UNJUDGED in marks
            row = {
                "value": value,
                across: marks,
                "largest finite": "unknown" if unknown else _dt(max(good, default=0.0)),
            }
            if panel.boundary is not None:
                row[panel.beyond] = _dt(panel.boundary[k])
            rows.append(row)
        heading = f"{panel.label} (compared with the {panel.reference})"
        # A column with a format is not cut to fit.
        return Table(rows, formats={"value": ".3g", across: ""}, heading=heading)

    def details(self) -> dict[str, Any]:
        """The grid, and the panels' theory."""
        return {
            "value": self.path,
            "values": list(self.values),
            "dts": list(self.dts),
            "error": str(self.tolerance),
            "tolerance": self.tolerance.number,
            "far": self.far,
            "panels": [
                {
                    "setting": panel.label,
                    "reference": panel.reference,
                    "theory": panel.beyond or None,
                    "boundary": panel.boundary,
                }
                for panel in self.panels
            ],
        }

    def __repr__(self) -> str:
        return f"<StabilityMap of {self.name}: {len(self.rows)} cells in {len(self.panels)} panels>"


def _word(state: str) -> str:
    """A state and its mark."""
    return f"{state} ({SYMBOLS[state]})"


def _mark(cell: MapCell) -> str:
    return SYMBOLS[cell.state] if cell.judged or cell.state == EXPLODED else UNJUDGED


def _dt(value: float) -> str:
    if value == 0:
        return "none"
    return seconds(value) if math.isfinite(value) else "any"
