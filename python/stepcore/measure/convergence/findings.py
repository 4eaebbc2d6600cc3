"""What a convergence found: the runs, the residuals by sweeps, and whether the rows are solved."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.motion import Motion
from stepcore.measure.convergence.candidates import Candidates
from stepcore.measure.convergence.residuals import ResidualHistory, RowForce
from stepcore.measure.convergence.runs import CandidateRun, HalvedReference
from stepcore.measure.convergence.theory import SweepTheory
from stepcore.measure.findings import Finding

# A difference below this share of the scene's size is none.
NOTABLE = 1e-5
# Unconverged forces matter where they move bodies by more than this share of what the time step
# does, and by more than `NOTABLE` of the scene's size.
SHARE = 1.0
# A residual moves a body no further than its speed times the duration of the motion, times this
# factor where small differences grow.
GROWTH = 100.0
# Errors that differ by less than this factor count as equal.
ALIKE = 1.2


@dataclass(frozen=True)
class Ending:
    """Where the motion ends under the settings' own sweeps and with converged forces.

    body: the one furthest apart, by `apart` [m], in which start. speed, solved_speed: its mean
    over the last tenth of the motion [m/s]. solver: RMS distance over the whole motion [m].
    """

    start: int
    body: str
    apart: float
    speed: float
    solved_speed: float
    solver: float


@dataclass(eq=False, repr=False)
class ConvergenceFindings:
    """The fields of a `Convergence`, which says what each is, and the questions they answer."""

    name: str
    settings: Settings
    motion: Motion
    horizon: float
    starts: int
    candidates: Candidates
    runs: dict[Settings, CandidateRun]
    histories: list[ResidualHistory]
    reference: HalvedReference
    ending: Ending | None
    notes: list[str] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    ran: str = ""

    @property
    def own(self) -> CandidateRun:
        """The run under the scene's own settings."""
        return self.runs[self.settings]

    @property
    def solved(self) -> CandidateRun:
        """The same with converged forces."""
        return self.runs[self.candidates.solved]

    @property
    def verdict(self) -> str:
        """ "diverging", "under-solved", "no rows" or "solved"."""
        if self.ending is None:
            return "diverging"
        if not self.histories:
            return "no rows"
        apart, notable = self.ending.solver, NOTABLE * self.reference.size
        matters = apart > max(SHARE * self.solved.error, notable)
        able = apart < GROWTH * self.own.residual * self.horizon
        return "under-solved" if matters and able else "solved"

    @property
    def better(self) -> str:
        """ "smaller steps", "more sweeps" or "neither": more accurate at equal row updates."""
        if not self.histories:
            return "neither"
        steps, sweeps = (min(errors, default=math.inf) for errors in self.at_equal_work)
        if steps * ALIKE < sweeps:
            return "smaller steps"
        return "more sweeps" if sweeps * ALIKE < steps else "neither"

    @property
    def at_equal_work(self) -> tuple[list[float], list[float]]:
        """Errors [m] of the splits with more steps than sweeps, and of those with fewer.

        Splits that fail have none.
        """
        splits = [(split, self.runs[split.settings]) for split in self.candidates.splits]
        done = [(split, run.error) for split, run in splits if not run.failure]
        steps = [error for split, error in done if split.steps > split.sweeps]
        return steps, [error for split, error in done if split.steps < split.sweeps]

    @property
    def slowest(self) -> ResidualHistory | None:
        """The state at which sweeps converge slowest, at the settings' own time step."""
        known = [h for h in self.at(self.settings.dt) if h.contraction is not None]
        return max(known, key=lambda h: h.contraction or 0.0, default=None)

    @property
    def contraction(self) -> float | None:
        """The share of the error that a sweep leaves in the end, at the slowest state, measured."""
        return self.slowest.contraction if self.slowest else None

    @property
    def theory(self) -> SweepTheory:
        """The same by theory, at the same state."""
        return self.slowest.theory if self.slowest else SweepTheory(why="no two rows act at once")

    def at(self, dt: float) -> list[ResidualHistory]:
        """The residual histories at one time step."""
        return [history for history in self.histories if history.dt == dt]

    def residual(self, dt: float, sweeps: int, warm: bool = False) -> float:
        """After this number of sweeps (one of `ResidualHistory.sweeps`), median of states [m/s]."""
        values = []
        for history in self.at(dt):
            if history.cold:
                residuals = history.warm if warm else history.cold
                values.append(residuals[history.sweeps.index(sweeps)])
        return float(np.median(values)) if values else math.nan

    @property
    def rows(self) -> list[RowForce]:
        """Elements that have rows, the furthest from its converged force first.

        After the settings' own sweeps, each at the state where most is missing.
        """
        worst: dict[str, RowForce] = {}
        count: dict[str, int] = {}
        for history in self.at(self.settings.dt):
            for force in history.forces:
                name = force.name
                if name not in worst or force.missing > worst[name].missing:
                    worst[name] = force
                count[name] = count.get(name, 0) + 1
        order = sorted(worst.values(), key=lambda force: -force.missing)
        return [replace(force, states=count[force.name]) for force in order]
