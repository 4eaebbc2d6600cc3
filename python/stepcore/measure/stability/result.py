"""`StabilityMap`: which cells of a grid of dt and a value are finite, inaccurate or exploded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from stepcore.report.result import Result
from stepcore.report.table import Table, jsonable
from stepcore.report.units import seconds

FINITE, INACCURATE, EXPLODED = "finite", "inaccurate", "exploded"
SYMBOLS = {FINITE: "·", INACCURATE: "o", EXPLODED: "X"}
UNJUDGED = "?"


@dataclass(frozen=True)
class Cell:
    """One run. error: its largest distance from the truth over the size of the motion, nan where
    that is not known. judged: there is a truth to judge it by. reason: why it exploded."""

    value: float
    dt: float
    state: str
    error: float
    judged: bool = True
    reason: str | None = None


@dataclass
class Panel:
    """The cells of one setting, values outermost, and what theory says of it.

    boundary: the dt [s] at which theory says that the cells change, a value each: 0 where none is
    stable, inf where all are; None without a theory. says: what the boundary is. truth: what
    the cells are judged against.
    """

    label: str
    cells: list[Cell]
    truth: str
    boundary: list[float] | None = None
    says: str = ""

    def at(self, value: float) -> list[Cell]:
        """The cells of one value, by dt."""
        return [cell for cell in self.cells if cell.value == value]


@dataclass(repr=False)
class StabilityMap(Result):
    """A map of stability; made by `stepcore.stability_map`.

    name: of the scene. path: the value that is varied; words: the same as an axis says it.
    values, dts [s]: the grid. horizon [s]. tolerance: a larger error is inaccurate. far: one
    beyond it has exploded. panels: one a setting.
    """

    kind = "stability"

    name: str
    path: str
    words: str
    values: Sequence[float]
    dts: Sequence[float]
    horizon: float
    tolerance: float
    far: float
    panels: list[Panel] = field(default_factory=list)

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: dt against {self.words}"

    @property
    def table(self) -> Table:
        """One row a cell: setting, value, dt [s], state, error, theory's dt [s], reason."""
        return Table(record for panel in self.panels for record in self._records(panel))

    def _records(self, panel: Panel) -> Iterator[dict[str, Any]]:
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

    @property
    def law(self) -> str:
        """How cells are told apart, in words."""
        return (
            f"finite: within {self.tolerance:.3g} of the size of the true motion, all the way; "
            f"inaccurate: further off; exploded: more than {self.far:g} sizes off, or the run "
            f"ended in an error. Over {seconds(self.horizon)}."
        )

    def text(self, width: int | None = None, full: bool = False) -> str:
        """The printed result: a line a value, a mark a dt."""
        legend = ", ".join(f"{mark} {state}" for state, mark in SYMBOLS.items())
        if any(not cell.judged for panel in self.panels for cell in panel.cells):
            legend += f", {UNJUDGED} finite, but without a converged run to judge by"
        lines = [self.title, self.law, legend]
        for panel in self.panels:
            lines += ["", *self._panel(panel)]
        return "\n".join(lines)

    def _panel(self, panel: Panel) -> list[str]:
        first = f"{panel.label} (against {panel.truth})"
        left = max(len(f"{value:.3g}") for value in self.values)
        span = f"dt {seconds(self.dts[0])} to {seconds(self.dts[-1])}"
        across = max(len(self.dts), len(span))
        head = f"{'':>{left}}  {span:<{across}}  largest finite"
        theory = panel.boundary is not None
        lines = [first, head + (f"  {panel.says}" if theory else "")]
        for k, value in enumerate(self.values):
            cells = panel.at(value)
            marks = "".join(_mark(cell) for cell in cells)
            good = [cell.dt for cell in cells if cell.state == FINITE and cell.judged]
            unknown = not good and UNJUDGED in marks
            most = "unknown" if unknown else _dt(max(good, default=0.0))
            line = f"{value:>{left}.3g}  {marks:<{across}}  {most:<14}"
            if panel.boundary is not None:
                line += f"  {_dt(panel.boundary[k])}"
            lines.append(line.rstrip())
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data; what is not finite is None."""
        plain: dict[str, Any] = jsonable(
            {
                "model": self.name,
                "value": self.path,
                "values": list(self.values),
                "dts": list(self.dts),
                "horizon": self.horizon,
                "tolerance": self.tolerance,
                "far": self.far,
                "law": self.law,
                "panels": [
                    {
                        "setting": panel.label,
                        "truth": panel.truth,
                        "theory": panel.says or None,
                        "boundary": panel.boundary,
                    }
                    for panel in self.panels
                ],
                "cells": self.table.records,
                "units": {"dt": "s", "horizon": "s", "boundary": "s", "error": "1"},
            }
        )
        return plain

    def __repr__(self) -> str:
        cells = sum(len(panel.cells) for panel in self.panels)
        return f"<StabilityMap of {self.name}: {cells} cells in {len(self.panels)} panels>"


def _mark(cell: Cell) -> str:
    return SYMBOLS[cell.state] if cell.judged or cell.state == EXPLODED else UNJUDGED


def _dt(value: float) -> str:
    if value == 0:
        return "none"
    return seconds(value) if math.isfinite(value) else "any"
