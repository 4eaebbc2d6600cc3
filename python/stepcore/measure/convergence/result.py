"""`Convergence`: the result of `converge`: the verdict, in sentences, tables and data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from stepcore.experiment.motion import Motion
from stepcore.experiment.trial import Trial
from stepcore.experiment.truth import Truth
from stepcore.measure.convergence.sweeps import ROUNDING, SWEEPS, ResidualHistory, RowForce
from stepcore.measure.monitors import Finding
from stepcore.report.report import SHORT, not_shown
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, metres, seconds, speed

# Distances below this share of the scene's size do not make a motion under-solved: iterative
# solvers stop at tolerances that leave as much. Errors that differ by less than the factor count as
# equal. A body at rest moves less than the last share of the distance during the whole motion.
NOTABLE, ALIKE, STILL = 1e-5, 1.2, 0.1
# The number of rows that a sentence names.
NAMED = 3


class Split(NamedTuple):
    """Equal work as steps × sweeps, and its trial."""

    steps: int
    sweeps: int
    trial: Trial


@dataclass(frozen=True)
class Ending:
    """The difference between the ends of the motion as shipped and with converged forces.

    start, body: the start and the body for which the distance is largest.
    apart: that distance [m].
    speed: the body's mean speed over the last tenth of the motion as shipped [m/s].
    solver: RMS distance over the whole motion in the worst start [m].
    """

    start: int
    body: str
    apart: float
    speed: float
    solver: float


@dataclass(eq=False, repr=False)
class Convergence(Result):
    """The convergence of a scene's rows, and whether sweeps or smaller steps gain more accuracy.

    shipped, solved: the trials of the scene's settings, and of these with converged forces.
    dts: those of other time steps. splits: those of equal work. more: that of four times the
        sweeps; None where the settings have no number of sweeps.
    histories: the residual by sweeps at states of the motion. has_rows: whether any row acts.
    reference: the converged motion that all trials are compared with.
    size: the size of the scene [m].
    ending: where the motion ends; None if a run fails.
    findings: problems of the settings in the first start, such as creep; see `Finding`.

    >>> from stepcore import converge, lesson
    >>> tower = lesson.stack(50, "rigid", (1.0, 1.0))
    >>> result = converge(tower, horizon=0.2, starts=1, states=2, progress=False)
    >>> result
    <Convergence of tower: solved>
    >>> print(f"{result.contraction:.3f}")
    0.500
    """

    kind = "convergence"
    units: ClassVar = {"missing": "m/s", "force": "N or N·m", "solved": "N or N·m"}

    settings: Any
    motion: Motion
    horizon: float
    shipped: Trial
    solved: Trial
    dts: list[Trial]
    splits: list[Split]
    more: Trial | None
    histories: list[ResidualHistory]
    has_rows: bool
    reference: Truth
    size: float
    ending: Ending | None
    findings: list[Finding] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """ "diverging", "under-solved", "no rows" or "solved"."""
        if self.ending is None:
            return "diverging"
        if not self.has_rows:
            return "no rows"
        # Unconverged forces matter if they move bodies further than the time step does.
        least = max(self.solved.error, NOTABLE * self.size)
        return "under-solved" if self.ending.solver > least else "solved"

    @property
    def better(self) -> str:
        """The more accurate at equal work: "smaller steps", "more sweeps" or "neither".

        Of the equal row updates and of four times the shipped work, those that reach the smaller
        error decide.
        """
        pairs = [self.at_equal_work]
        if self.more is not None and self.quarter is not None:
            pairs.append((self.quarter.error, self.more.error))
        return _better(*min(pairs, key=min)) if self.has_rows else "neither"

    @property
    def at_equal_work(self) -> tuple[float, float]:
        """Least errors [m] of the splits with more steps than sweeps, and of those with fewer.

        They are inf where all fail.
        """
        steps = [split.trial.error for split in self.splits if split.steps > split.sweeps]
        sweeps = [split.trial.error for split in self.splits if split.steps < split.sweeps]
        return min(steps, default=math.inf), min(sweeps, default=math.inf)

    @property
    def quarter(self) -> Trial | None:
        """The shipped settings at a quarter of their time step; None if not tried."""
        return next((t for t in self.dts if math.isclose(t.dt, self.shipped.dt / 4)), None)

    @property
    def contraction(self) -> float | None:
        """The share of the error that each sweep leaves in the end, at the slowest state."""
        known = (history.contraction for history in self.histories)
        return max((share for share in known if share is not None), default=None)

    @property
    def rows(self) -> list[RowForce]:
        """Elements that have rows, the one furthest from its converged force first.

        Each element is shown after the shipped sweeps, at the state where its force is furthest
        off.
        """
        by_name: dict[str, list[RowForce]] = {}
        for force in (force for history in self.histories for force in history.forces):
            by_name.setdefault(force.name, []).append(force)
        rows = [
            replace(max(forces, key=lambda force: force.missing), states=len(forces))
            for forces in by_name.values()
        ]
        return sorted(rows, key=lambda row: -row.missing)

    # --- tables and data -------------------------------------------------------------------------

    @property
    def title(self) -> str:
        """The scene measured."""
        return f"{self.name}: convergence of contact forces and other rows"

    @property
    def setup(self) -> str:
        """The runs that were made."""
        return f"Settings: {label(self.settings)}. {self.reference.words}"

    @property
    def table(self) -> Table:
        """The rows; see `RowForce`."""
        return Table(
            [vars(row) for row in self.rows],
            ["name", "missing", "force", "solved", "states"],
            {"missing": ".2e"},
            heading="Rows after the shipped sweeps, the largest missing impulse first",
            legend=(
                "missing: missing impulse as a speed [m/s]; force reached and converged force "
                "(solved) [N or N·m]; states: number of states in which it has rows."
            ),
        )

    @property
    def sweeps(self) -> Table:
        """The residual by sweeps, cold and warm: median and worst of the states [m/s]."""
        records = []
        for k, count in enumerate(SWEEPS if self.histories else ()):
            record: dict[str, Any] = {"sweeps": count}
            for kind in ("cold", "warm"):
                values = [getattr(history, kind)[k] for history in self.histories]
                record[kind], record[f"{kind} worst"] = float(np.median(values)), max(values)
            records.append(record)
        names = ("cold", "cold worst", "warm", "warm worst")
        heading = "Residual by sweeps, median and worst of the states [m/s]"
        return Table(records, ["sweeps", *names], dict.fromkeys(names, ".2e"), heading=heading)

    @property
    def steps(self) -> Table:
        """One row for each time step; other settings are as shipped; errors in metres.

        work: counted operations per simulated second.
        """
        rows = [(seconds(trial.dt), trial) for trial in self.dts]
        return _table("dt", rows, "By time step, all else as shipped: RMS position error [m]")

    @property
    def work(self) -> Table:
        """Equal row updates as steps × sweeps, under pgs, and four times the shipped work."""
        named = [(f"{steps}x{sweeps}", trial) for steps, sweeps, trial in self.splits]
        named.append(("shipped", self.shipped))
        named += [("shipped, 4 x sweeps", self.more)] if self.more else []
        named += [("shipped, 1/4 dt", self.quarter)] if self.quarter else []
        named.append(("shipped dt, converged", self.solved))
        heading = "Equal row updates, steps x sweeps under pgs, and the shipped settings"
        return _table("steps x sweeps", named, heading)

    def tables(self, full: bool) -> list[Table]:
        """Return the tables of rows and time steps; rows that Newton has solved only with `full`.

        full: whether to include every row, equal work and residuals by sweeps.
        """
        rows, known = self.table, bool(self.histories)
        if full:
            return [rows, self.steps, self.work, self.sweeps] if known else [self.steps, self.work]
        if not known or (self.verdict == "solved" and self.settings.solver != "pgs"):
            return [self.steps]
        few = rows[:SHORT]
        if len(rows) > SHORT:
            few.legend += f" {not_shown(counted(len(rows) - SHORT, 'row'))}"
        return [few, self.steps]

    def details(self) -> dict[str, Any]:
        """Return the verdict, the contraction and the other tables."""
        return {
            "verdict": self.verdict,
            "better": self.better,
            "contraction": self.contraction,
            "reference": self.reference.settings.as_dict(),
            "reference_error": self.reference.error,
            "size": self.size,
            "ending": self.ending,
            "findings": [finding.record() for finding in self.findings],
            "sweeps": self.sweeps.records,
            "steps": self.steps.records,
            "work": self.work.records,
        }

    def __repr__(self) -> str:
        return f"<Convergence of {self.name}: {self.verdict}>"

    # --- sentences -------------------------------------------------------------------------------

    @property
    def sentences(self) -> list[str]:
        """The verdict, the cause, the convergence of sweeps, and what would gain more accuracy."""
        said = [self._diverging() if self.ending is None else self._verdict(self.ending)]
        if self.has_rows:
            said += [self._forces(), self._convergence(), self._equal_work(), self._four_times()]
        said += [finding.text for finding in self.findings]
        return [sentence for sentence in said if sentence]

    def _verdict(self, ending: Ending) -> str:
        if not self.has_rows:
            return "No contact, limit or other row was ever active, so sweeps have no effect."
        solver, starts = ending.solver, len(self.shipped.starts)
        worst = f" in the worst of {counted(starts, 'start')}" if starts > 1 else ""
        error = f"{metres(self.solved.error)}{worst}"
        apart = f"{metres(solver)} (RMS) from the motion with converged forces"
        if self.verdict == "under-solved":
            where, step = self._where_it_ends(ending), "The time step itself causes an error of"
            return f"Under-solved: {where} Over the motion it is {apart}. {step} {error}."
        fine = "the solver is fine." if solver < 1e-9 * self.size else f"the motion is {apart}."
        return f"Solved: {fine} The time step causes an error of {error}; reduce dt to lower it."

    def _where_it_ends(self, ending: Ending) -> str:
        """Describe where an under-solved motion ends."""
        apart = f"{metres(ending.apart)} from where converged forces take it"
        if ending.apart <= NOTABLE * self.size:
            return "the motion differs on the way, but ends in the same place."
        if ending.speed <= STILL * ending.apart / self.horizon:
            return f"{ending.body} settles at a wrong fixed point, {apart}."
        return f"{ending.body} ends {apart}, at {speed(ending.speed)}."

    def _diverging(self) -> str:
        if not self.shipped.failure:
            return (
                f"Diverging: with converged forces the motion fails ({self.solved.failure}); it "
                "runs only because sweeps are too few."
            )
        why = f"Diverging: {self.shipped.failure}."
        if not self.solved.failure:
            return f"{why} With converged forces at the same time step it runs: use more sweeps."
        steps = [trial.dt for trial in self.dts if not trial.failure]
        smaller = [dt for dt in steps if dt < self.shipped.dt]
        if smaller:
            return (
                f"{why} Converged forces do not help; a time step of {seconds(max(smaller))} does. "
                "`stepcore diagnose` names the element that limits it."
            )
        return f"{why} Neither converged forces nor the smaller time steps tried help."

    def _forces(self) -> str:
        """Describe the rows that are furthest from their converged force."""
        rows = [row for row in self.rows if row.missing > 0][:NAMED]
        if not rows or self.verdict == "solved":
            return ""
        said = [
            f"{row.name} ({row.force:.3g} of {row.solved:.3g}; {compact(row.missing)} m/s missing)"
            for row in rows
        ]
        return f"Force reached, of the converged force: {', '.join(said)}."

    def _convergence(self) -> str:
        """Describe how fast sweeps converge; Newton makes no sweeps."""
        rate = self.contraction
        if self.settings.solver != "pgs" or not self.histories:
            return ""
        if rate is None:
            return "No two rows act at once, so one sweep solves them."
        if rate >= 1 - 1e-9:
            return f"Sweeps do not converge: each leaves {rate:.6g} of the error."
        if rate <= ROUNDING:
            return "Each sweep leaves nothing of the solver's error."
        # Enough digits to tell a number near 1 from 1.
        digits = 4 if rate < 0.99 else 2 + math.ceil(-math.log10(1 - rate))
        tenfold = math.log(10) / -math.log(rate)
        share = f"{rate:.1e}" if rate < 1e-3 else f"{rate:.{digits}f}"
        gains = f"({tenfold:.3g} sweeps reduce it tenfold)"
        return f"Each sweep leaves {share} of the solver's error {gains}."

    def _equal_work(self) -> str:
        if not self.splits:
            return ""
        errors = [
            f"{counted(steps, 'step')} of {counted(sweeps, 'sweep')} "
            + ("fails" if trial.failure else metres(trial.error))
            for steps, sweeps, trial in self.splits
        ]
        answer = {
            (True, True): {
                "smaller steps": "smaller steps are more accurate than more sweeps",
                "more sweeps": "more sweeps are more accurate than smaller steps",
                "neither": "smaller steps and more sweeps are equally accurate",
            }[_better(*self.at_equal_work)],
            (True, False): "only smaller steps do not fail",
            (False, True): "only more sweeps do not fail",
            (False, False): "both smaller steps and more sweeps fail",
        }
        steps, sweeps = map(math.isfinite, self.at_equal_work)
        begin = "At" if self.settings.solver == "pgs" else "Under pgs, at"
        return f"{begin} equal work (row updates) {answer[steps, sweeps]}: {', '.join(errors)}."

    def _four_times(self) -> str:
        """Describe the gain from four times the work."""
        more, quarter = self.more, self.quarter
        if more is None or quarter is None:
            return ""
        if self.shipped.failure or more.failure or quarter.failure:
            return ""
        return (
            f"The shipped settings have an error of {metres(self.shipped.error)}; four times the "
            f"sweeps give {metres(more.error)}, a quarter of the time step {metres(quarter.error)}."
        )


def _better(steps: float, sweeps: float) -> str:
    """Return which of two errors is notably smaller, in words."""
    if steps * ALIKE < sweeps:
        return "smaller steps"
    return "more sweeps" if sweeps * ALIKE < steps else "neither"


def _table(name: str, rows: Sequence[tuple[str, Trial]], heading: str) -> Table:
    """Return a table of trials; without failures it has no column for them."""
    names = ("error", "median", "largest", "work", "failure")
    records = [{name: said} | trial.record() for said, trial in rows]
    failed = any(record["failure"] for record in records)
    columns = [name, *(names if failed else names[:-1])]
    return Table(records, columns, dict.fromkeys(names[:-1], ".2e"), heading=heading)
