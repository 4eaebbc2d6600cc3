"""`Convergence`: the result of `converge`: the verdict, in sentences, tables and data."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.motion import Motion
from stepcore.experiment.reference import Reference
from stepcore.measure.convergence.numbers import NO_RATE, length, numbers, share
from stepcore.measure.convergence.runs import CandidateRun, Candidates, Ending
from stepcore.measure.convergence.sweeps import ResidualHistory, RowForce, SweepTheory
from stepcore.measure.monitors import Finding
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import counted, metres, seconds, speed

# Position differences below this, relative to the scene's size, do not affect the verdict.
NOTABLE = 1e-5
# A residual displaces a body by at most its speed times the duration of the motion, times this
# factor if small differences grow.
GROWTH = 100.0
# Errors that differ by less than this factor count as equal.
ALIKE = 1.2
# A body at rest moves less than this share of the distance during the whole motion.
STILL = 0.1
# Residuals below this share of the largest are rounding.
ROUNDING = 1e-13
# Number of rows printed; number of rows named in a sentence; and the least missing share of force,
# relative to the largest, of a named row.
PRINTED, NAMED, LACKING = 5, 3, 0.1


@dataclass(eq=False, repr=False)
class Convergence(Result):
    """The convergence of a scene's rows, and whether sweeps or smaller steps gain more accuracy.

    candidates: the settings that were run.
    runs: the result of each setting.
    histories: the residual by sweeps at states of the motion.
    reference: the converged motion that all runs are compared with.
    size: the size of the scene and its motion [m].
    ending: where the motion ends; None if a run fails.
    findings: problems of the settings in the first start, such as creep; see `Finding`.

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

    settings: Settings
    motion: Motion
    horizon: float
    starts: int
    candidates: Candidates
    runs: dict[Settings, CandidateRun]
    histories: list[ResidualHistory]
    reference: Reference
    size: float
    ending: Ending | None
    findings: list[Finding] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.notes = [*self.notes, *self._cautions()]

    # --- the questions ---------------------------------------------------------------------------

    @property
    def shipped(self) -> CandidateRun:
        """The run under the scene's settings."""
        return self.runs[self.settings]

    @property
    def solved(self) -> CandidateRun:
        """The run under the scene's settings with converged forces."""
        return self.runs[self.candidates.solved]

    @property
    def verdict(self) -> str:
        """ "diverging", "under-solved", "no rows" or "solved"."""
        if self.ending is None:
            return "diverging"
        if not self.histories:
            return "no rows"
        apart, notable = self.ending.solver, NOTABLE * self.size
        # Unconverged forces matter if they move bodies further than the time step does.
        matters = apart > max(self.solved.error, notable)
        able = apart < GROWTH * self.shipped.residual * self.horizon
        return "under-solved" if matters and able else "solved"

    @property
    def better(self) -> str:
        """The more accurate at equal row updates: "smaller steps", "more sweeps" or "neither"."""
        if not self.histories:
            return "neither"
        steps, sweeps = (min(errors, default=math.inf) for errors in self.at_equal_work)
        if steps * ALIKE < sweeps:
            return "smaller steps"
        return "more sweeps" if sweeps * ALIKE < steps else "neither"

    @property
    def at_equal_work(self) -> tuple[list[float], list[float]]:
        """Errors [m] of the splits with more steps than sweeps, and of those with fewer.

        Splits that fail are left out.
        """
        splits = [(split, self.runs[split.settings]) for split in self.candidates.splits]
        done = [(split, run.error) for split, run in splits if not run.failure]
        steps = [error for split, error in done if split.steps > split.sweeps]
        return steps, [error for split, error in done if split.steps < split.sweeps]

    @property
    def slowest(self) -> ResidualHistory | None:
        """The state at which sweeps converge slowest, at the shipped time step."""
        return self._slowest(self.settings.dt)

    def _slowest(self, dt: float) -> ResidualHistory | None:
        known = [h for h in self.at(dt) if h.contraction is not None]
        return max(known, key=lambda h: h.contraction or 0.0, default=None)

    @property
    def contraction(self) -> float | None:
        """The asymptotic share of the error that each sweep leaves, measured at `slowest`."""
        return self.slowest.contraction if self.slowest else None

    @property
    def theory(self) -> SweepTheory:
        """The theoretical contraction at `slowest`."""
        return self.slowest.theory if self.slowest else SweepTheory(why="no two rows act at once")

    def at(self, dt: float) -> list[ResidualHistory]:
        """Return the residual histories at one time step."""
        return [history for history in self.histories if history.dt == dt]

    def residual(self, dt: float, sweeps: int, warm: bool = False) -> float:
        """Return the median residual of the states after a number of sweeps [m/s].

        dt: the time step [s].
        sweeps: one of `ResidualHistory.sweeps`.
        warm: whether the sweeps start from the impulses of the previous step rather than from zero.
        """
        values = []
        for history in self.at(dt):
            if history.cold:
                residuals = history.warm if warm else history.cold
                values.append(residuals[history.sweeps.index(sweeps)])
        return float(np.median(values)) if values else math.nan

    @property
    def rows(self) -> list[RowForce]:
        """Elements that have rows, the one furthest from its converged force first.

        Each element is shown after the shipped sweeps, at the state where its force is furthest
        off.
        """
        by_name: dict[str, list[RowForce]] = {}
        for history in self.at(self.settings.dt):
            for force in history.forces:
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
        reference = self.reference.settings
        return (
            f"Settings: {label(self.settings)}. The reference is {reference.integrator} at dt "
            f"{seconds(reference.dt)}; its uncertainty is {metres(self.reference.high)}."
        )

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
        """The residual by sweeps, cold and warm: median and worst of the states [m/s]."""
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
        """One row for each time step; other settings are as shipped.

        residual: the worst along the motion [m/s].
        contraction: at the slowest state.
        error: RMS position error [m].
        updates: row updates per simulated second.
        """

        def record(settings: Settings) -> dict[str, Any]:
            run, slowest = self.runs[settings], self._slowest(settings.dt)
            rate = slowest.contraction if slowest and self._sweeps_made else None
            return {
                "dt": settings.dt,
                "residual": run.residual,
                "contraction": rate,
                "error": run.error,
                "updates": run.updates,
                "failure": run.failure,
            }

        heading = "By time step, all else as shipped: residual [m/s], RMS position error [m]"
        return numbers(map(record, self.candidates.dts), heading)

    @property
    def work(self) -> Table:
        """Equal row updates as steps × sweeps, under pgs, and four times the shipped work.

        error: RMS position error [m].
        overlap, joint: the deepest overlap and the widest gap [m].
        """
        some = self.candidates
        named = [(f"{s.steps}x{s.sweeps}", s.settings) for s in some.splits]
        named.append(("shipped", self.settings))
        named += [("shipped, 4 x sweeps", some.more)] if some.more else []
        named += [("shipped, 1/4 dt", some.quarter)] if some.quarter else []
        named.append(("shipped dt, converged", some.solved))

        def record(name: str, settings: Settings) -> dict[str, Any]:
            run = self.runs[settings]
            return {
                "steps x sweeps": name,
                "dt": settings.dt,
                "sweeps": settings.sweeps if settings.solver == "pgs" else settings.solver,
                "error": run.error,
                "overlap": run.overlap,
                "joint": run.joint,
                "updates": run.updates,
                "failure": run.failure,
            }

        heading = "Equal row updates, steps x sweeps under pgs, and the shipped settings"
        return numbers((record(*each) for each in named), heading)

    @property
    def _sweeps_made(self) -> bool:
        """Whether the shipped solver makes sweeps; Newton makes none."""
        return self.settings.solver != "newton"

    def tables(self, full: bool) -> list[Table]:
        """Return the tables of rows and time steps.

        Rows that Newton has solved are printed with `full` alone.

        full: whether to include every row, equal work and residuals by sweeps.
        """
        solved = self.verdict == "solved" and not self._sweeps_made
        if not self.histories or (solved and not full):
            return [self.steps]
        rows, sweeps = self.table, self.sweeps
        if not full and len(rows) > PRINTED:
            more = f"{counted(len(rows) - PRINTED, 'row')} (--all; in Python text(full=True))"
            legend = f"{rows.legend}. Not shown: {more}"
            rows = rows[:PRINTED]
            rows.legend = legend
        if not full:
            return [rows, self.steps]
        # Show residuals until they are rounding.
        worst = [max(r["cold worst"], r["warm worst"]) for r in sweeps]
        done = [k for k, value in enumerate(worst) if value <= ROUNDING * max(worst)]
        sweeps = sweeps[: done[0] + 1] if done else sweeps
        return [rows, self.steps, self.work, sweeps]

    def details(self) -> dict[str, Any]:
        """Return the verdict, the contraction with its theory, and the other tables."""
        return {
            "verdict": self.verdict,
            "better": self.better,
            "contraction": self.contraction,
            "theory": self.theory.radius,
            "closed_form": self.theory.formula,
            "closed_form_value": self.theory.closed,
            "slowest_time": self.slowest.time if self.slowest else None,
            "reference": self.reference.settings,
            "reference_error": self.reference.high,
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
        said = [self._verdict()]
        if self.histories:
            said += [self._forces(), self._convergence(), self._equal_work(), self._four_times()]
        said += [finding.text for finding in self.findings]
        return [sentence for sentence in said if sentence]

    def _verdict(self) -> str:
        if self.ending is None:
            return self._diverging()
        if self.verdict == "no rows":
            return "No contact, limit or other row was ever active, so sweeps have no effect."
        solver, size = self.ending.solver, self.size
        error = length(self.solved.error, size)
        apart = f"{length(solver, size)} (RMS) from the motion with converged forces"
        if self.verdict == "under-solved":
            where = self._where_it_ends(self.ending)
            step = f"The time step itself causes an error of {error}{self._worst}."
            return f"Under-solved: {where} Over the motion it is {apart}. {step}"
        fine = "the solver is fine." if solver < 1e-9 * size else f"the motion is {apart}."
        step = f"The time step causes an error of {error}{self._worst}"
        return f"Solved: {fine} {step}; reduce dt to lower it."

    @property
    def _worst(self) -> str:
        return f" in the worst of {counted(self.starts, 'start')}" if self.starts > 1 else ""

    def _where_it_ends(self, ending: Ending) -> str:
        """Describe where an under-solved motion ends."""
        apart = f"{metres(ending.apart)} from where converged forces take it"
        slow = STILL * ending.apart / self.horizon
        if ending.apart <= NOTABLE * self.size:
            return "the motion differs on the way, but ends in the same place."
        if ending.speed <= slow:
            return f"{ending.body} settles at a wrong fixed point, {apart}."
        if ending.solved_speed <= max(slow, STILL * ending.speed):
            return (
                f"{ending.body} still moves at {speed(ending.speed)} where converged forces hold "
                f"it, and ends {apart}."
            )
        return f"{ending.body} ends {apart}."

    def _diverging(self) -> str:
        if not self.shipped.failure:
            return (
                f"Diverging: with converged forces the motion fails ({self.solved.failure}); it "
                "runs only because sweeps are too few."
            )
        why = f"Diverging: {self.shipped.failure}."
        if not self.solved.failure:
            return f"{why} With converged forces at the same time step it runs: use more sweeps."
        steps = [s.dt for s in self.candidates.dts if not self.runs[s].failure]
        smaller = [dt for dt in steps if dt < self.settings.dt]
        if smaller:
            return (
                f"{why} Converged forces do not help; a time step of {seconds(max(smaller))} does. "
                "`stepcore diagnose` names the element that limits it."
            )
        return f"{why} Neither converged forces nor the smaller time steps tried help."

    def _forces(self) -> str:
        """Describe the rows that are furthest from their converged force."""
        rows = [row for row in self.rows if row.missing > 0]
        if not rows or self.verdict == "solved":
            return ""
        most = max(abs(row.solved - row.force) for row in rows)
        limiting = [
            f"{row.name} ({row.force:.3g} of {row.solved:.3g}, residual {row.residual:.2g} m/s)"
            for row in rows
            if row.missing >= LACKING * rows[0].missing
            or abs(row.solved - row.force) >= LACKING * most
        ]
        return f"Force reached, of the converged force: {', '.join(limiting[:NAMED])}."

    def _convergence(self) -> str:
        """Describe how fast sweeps converge, compared with theory; Newton makes no sweeps."""
        rate = self.contraction
        if not self._sweeps_made:
            return ""
        if rate is None:
            return "No two rows act at once, so one sweep solves them."
        if rate >= 1 - 1e-9:
            return f"Sweeps do not converge: each leaves {rate:.6g} of the error."
        said = f"Each sweep leaves {share(rate)} of the solver's error"
        if rate > NO_RATE:
            said += f" ({math.log(10) / -math.log(rate):.3g} sweeps reduce it tenfold)"
        theory, parts = self.theory, []
        if theory.radius is not None:
            parts.append(f"theory for this state gives {share(theory.radius)}")
        elif theory.why:
            parts.append(f"no theory applies here, because {theory.why}")
        if theory.closed is not None:
            parts.append(f"theory for rigid rows gives {share(theory.closed)}, {theory.formula}")
        return f"{'; '.join([said, *parts])}."

    def _equal_work(self) -> str:
        errors = []
        for split in self.candidates.splits:
            run = self.runs[split.settings]
            error = "fails" if run.failure else metres(run.error)
            step, sweep = counted(split.steps, "step"), counted(split.sweeps, "sweep")
            errors.append(f"{step} of {sweep} {error}")
        steps, sweeps = self.at_equal_work
        if not (steps or sweeps):
            answer = "both smaller steps and more sweeps fail"
        elif not (steps and sweeps):
            answer = f"only {'smaller steps' if steps else 'more sweeps'} do not fail"
        else:
            answer = {
                "smaller steps": "smaller steps are more accurate than more sweeps",
                "more sweeps": "more sweeps are more accurate than smaller steps",
                "neither": "smaller steps and more sweeps are equally accurate",
            }[self.better]
        solver = "" if self.settings.solver == "pgs" else "Under pgs, a"
        return f"{solver or 'A'}t equal work (row updates) {answer}: {', '.join(errors)}."

    def _four_times(self) -> str:
        """Describe the gain from four times the work."""
        more, quarter = self.candidates.more, self.candidates.quarter
        if more is None or quarter is None or self.shipped.failure:
            return ""
        sweeps, steps = self.runs[more], self.runs[quarter]
        if sweeps.failure or steps.failure:
            return ""
        return (
            f"The shipped settings have an error of {metres(self.shipped.error)}; four times the "
            f"sweeps give {metres(sweeps.error)}, a quarter of the time step {metres(steps.error)}."
        )

    def _cautions(self) -> list[str]:
        """Return notes on a reference that is too inaccurate."""
        said = list(self.reference.notes)
        residual = max(run.residual for run in self.reference.runs)
        if self.verdict != "no rows" and residual > 1e-3 * max(self.shipped.residual, 1e-9):
            said.append(
                f"the reference's own residual is {residual:.2g} m/s: its sweeps do not converge "
                "within their limit"
            )
        errors = (run.error for run in self.runs.values() if math.isfinite(run.error))
        least = min(errors, default=math.inf)
        if self.reference.high * 10 > least:
            said.append(
                f"errors near {metres(self.reference.high)}, the uncertainty of the reference, are "
                f"uncertain (the smallest one shown is {metres(least)})"
            )
        return said
