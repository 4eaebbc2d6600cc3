"""`Convergence`: what `converge` returns, its findings in sentences, tables and data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from stepcore.measure.convergence import sentences
from stepcore.measure.convergence.findings import ConvergenceFindings
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import counted, metres, seconds

# Residuals below this share of the largest are rounding.
ROUNDING = 1e-13
# The rows that are printed.
PRINTED = 5


@dataclass(eq=False, repr=False)
class Convergence(ConvergenceFindings, Result):
    """Whether a scene's rows are solved, and whether sweeps or smaller steps gain more accuracy.

    candidates: the settings that were run.
    runs: the result of each of them.
    histories: the residual by sweeps at states of the motion.
    reference: the converged motion that all runs are compared with.
    ending: where the motion ends; None if a run fails.
    findings: what the settings show from the first start, such as creep; see `Finding`.

    >>> from stepcore import converge, lesson
    >>> tower = lesson.stack(50, "rigid", (1.0, 1.0))
    >>> result = converge(tower, horizon=0.2, starts=1, states=2, progress=False)
    >>> result
    <Convergence of tower: solved>
    >>> print(f"{result.contraction:.3f}, theory", result.theory.formula)
    0.500, theory m_top/(m_top + m_bottom) = 1/(1 + 1)
    """

    kind = "convergence"
    units: ClassVar = {
        "missing": "m/s",
        "residual": "m/s",
        "force": "N or N·m",
        "solved": "N or N·m",
        "error": "m",
        "overlap": "m",
        "joint": "m",
        "updates": "1/s",
    }

    def __post_init__(self) -> None:
        self.notes = [*self.reference.notes, *self.notes, *sentences.cautions(self)]

    @property
    def title(self) -> str:
        """What was measured."""
        return f"{self.name}: convergence of contact forces and other rows"

    @property
    def setup(self) -> str:
        """What was run."""
        return (
            f"Settings: {label(self.settings)}. The reference has dt "
            f"{seconds(self.candidates.references[0].dt)} and an error of "
            f"{metres(self.reference.error)}."
        )

    @property
    def sentences(self) -> list[str]:
        """The verdict, what limits it, how fast sweeps converge, and what gains more."""
        return sentences.of(self)

    @property
    def table(self) -> Table:
        """The rows; see `RowForce`."""
        names = ["name", "missing", "residual", "force", "solved", "states"]
        formats = dict.fromkeys(("missing", "residual"), ".2e")
        return Table(
            [vars(row) for row in self.rows],
            names,
            formats,
            heading="Rows after the shipped sweeps, the largest missing impulse first",
            legend=(
                "missing: missing impulse as a speed [m/s]; residual [m/s]; force reached and "
                "converged force (solved) [N or N·m]; states: number of states in which it has rows"
            ),
        )

    @property
    def sweeps(self) -> Table:
        """Residual by the number of sweeps, cold and warm: median and worst of the states [m/s]."""
        histories = [h for h in self.at(self.settings.dt) if h.cold]
        records = []
        for k, count in enumerate(histories[0].sweeps if histories else ()):
            record: dict[str, Any] = {"sweeps": count}
            for kind in ("cold", "warm"):
                values = [getattr(history, kind)[k] for history in histories]
                record[kind], record[f"{kind} worst"] = float(np.median(values)), max(values)
            records.append(record)
        names = ("cold", "cold worst", "warm", "warm worst")
        heading = "Residual by sweeps, median and worst of the states [m/s]"
        return Table(records, ["sweeps", *names], dict.fromkeys(names, ".2e"), heading=heading)

    @property
    def steps(self) -> Table:
        """By time step, all else as it is.

        residual: the worst along the motion [m/s]; contraction: at the slowest state; error: RMS
        position error [m]; updates: of rows per simulated second.
        """
        records = []
        for settings in self.candidates.dts:
            run = self.runs[settings]
            known = [h.contraction for h in self.at(settings.dt) if h.contraction is not None]
            records.append(
                {
                    "dt": settings.dt,
                    "residual": run.residual,
                    "contraction": max(known, default=math.nan),
                    "error": run.error,
                    "updates": run.updates,
                    "failure": run.failure,
                }
            )
        heading = "By time step, all else as shipped: residual [m/s], RMS position error [m]"
        return _numbers(records, heading)

    @property
    def work(self) -> Table:
        """Equal row updates as steps × sweeps, under pgs; and four times the settings' own work.

        error: RMS position error [m]; overlap, joint: the deepest and the widest gap [m].
        """
        some = self.candidates
        named = [(f"{s.steps}x{s.sweeps}", s.settings) for s in some.splits]
        named.append(("shipped", self.settings))
        named += [("shipped, 4 x sweeps", some.more)] if some.more else []
        named += [("shipped, 1/4 dt", some.quarter)] if some.quarter else []
        named.append(("shipped dt, converged", some.solved))
        records = []
        for name, settings in named:
            run = self.runs[settings]
            solver = settings.solver
            records.append(
                {
                    "steps x sweeps": name,
                    "dt": settings.dt,
                    "sweeps": settings.sweeps if solver == "pgs" else solver,
                    "error": run.error,
                    "overlap": run.overlap,
                    "joint": run.joint,
                    "updates": run.updates,
                    "failure": run.failure,
                }
            )
        heading = "Equal row updates, steps x sweeps under pgs, and the shipped settings"
        return _numbers(records, heading)

    def tables(self, full: bool) -> list[Table]:
        """Rows and time steps; `full`: every row, equal work and residuals by sweeps too."""
        if not self.histories:
            return [self.steps]
        rows, sweeps = self.table, self.sweeps
        if not full and len(rows) > PRINTED:
            left = len(rows) - PRINTED
            more = f"{counted(left, 'row')} (--all; in Python text(full=True))"
            legend = f"{rows.legend}. Not shown: {more}"
            rows = rows[:PRINTED]
            rows.legend = legend
        if not full:
            return [rows, self.steps]
        # Up to where the residual is rounding.
        worst = [max(r["cold worst"], r["warm worst"]) for r in sweeps]
        done = [k for k, value in enumerate(worst) if value <= ROUNDING * max(worst)]
        sweeps = sweeps[: done[0] + 1] if done else sweeps
        return [rows, self.steps, self.work, sweeps]

    def details(self) -> dict[str, Any]:
        """The verdict, the contraction beside its theory, and the other tables."""
        return {
            "verdict": self.verdict,
            "better": self.better,
            "contraction": self.contraction,
            "theory": self.theory.radius,
            "closed_form": self.theory.formula,
            "closed_form_value": self.theory.closed,
            "slowest_time": self.slowest.time if self.slowest else None,
            "reference": self.candidates.references[0],
            "reference_error": self.reference.error,
            "size": self.reference.size,
            "ending": self.ending,
            "findings": self.findings,
            "sweeps": self.sweeps.records,
            "steps": self.steps.records,
            "work": self.work.records,
        }

    def __repr__(self) -> str:
        return f"<Convergence of {self.name}: {self.verdict}>"


def _numbers(records: list[dict[str, Any]], heading: str) -> Table:
    """A table without empty columns; errors in two digits."""
    columns = [n for n in records[0] if any(r[n] not in (None, "") for r in records)]
    short = ("residual", "error", "overlap", "joint", "updates")
    formats = dict.fromkeys(short, ".2e") | {"contraction": ".4f"}
    return Table(records, columns, formats, heading=heading)
