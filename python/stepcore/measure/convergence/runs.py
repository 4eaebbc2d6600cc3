"""The settings that `converge` compares, and the results of their runs.

The settings are time steps, splits of equal work into steps and sweeps, and converged forces.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.run_settings import converged_settings
from stepcore.engine.sim import Sim
from stepcore.experiment.errors import errors
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.reference import Reference
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import divides
from stepcore.measure.convergence.sweeps import MotionState

# Sweeps in a period of equal work, and their splits into steps × sweeps.
WORK = 64
SPLITS = ((64, 1), (16, 4), (4, 16), (1, 64))
# Time steps tried at the shipped sweeps, relative to the shipped one.
FACTORS = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8)
# Least number of periods of a motion.
PERIODS = 4
# The number of sweeps assumed for a solver that has none.
USUAL = 16


class Split(NamedTuple):
    """One split of equal work into steps × sweeps, and its settings."""

    steps: int
    sweeps: int
    settings: Settings


@dataclass(frozen=True)
class Candidates:
    """All settings that are run.

    shipped: the scene's settings.
    period: the control period [s].
    dts: the settings at each time step.
    splits: the splits of equal work.
    more: four times the sweeps; None if the settings have no number of sweeps.
    solved: the shipped settings with converged forces.
    """

    shipped: Settings
    period: float
    dts: list[Settings]
    splits: list[Split]
    more: Settings | None
    solved: Settings

    @property
    def all(self) -> list[Settings]:
        """All settings, without repetition."""
        first = [self.shipped, self.solved]
        some = [*first, *self.dts, *(split.settings for split in self.splits), self.more]
        return list(dict.fromkeys(settings for settings in some if settings is not None))

    def only(self, known: Collection[Settings]) -> Candidates:
        """Return the candidates that are among some settings."""
        return dataclasses.replace(
            self,
            dts=[settings for settings in self.dts if settings in known],
            splits=[split for split in self.splits if split.settings in known],
            more=self.more if self.more in known else None,
        )

    @property
    def quarter(self) -> Settings | None:
        """The shipped settings at a quarter of their time step; None if not tried."""
        return next((s for s in self.dts if math.isclose(s.dt, self.shipped.dt / 4)), None)


def candidates(shipped: Settings, period: float | None, horizon: float) -> Candidates:
    """Return the settings to compare with `shipped`.

    period: the control period [s]; None if the motion has none.
    horizon: the simulated time [s].

    One of the splits has the shipped time step, with the nearest of 1, 4, 16 and 64 sweeps.
    """
    sweeps = USUAL
    if shipped.solver == "pgs" and shipped.sweeps != "auto":
        sweeps = max(1, int(shipped.sweeps))
    frame = shipped.dt * WORK / min((1, 4, 16, 64), key=lambda n: abs(math.log(n / sweeps)))
    if period is None:
        period = max(frame, 4 * shipped.dt)
        while period > horizon / PERIODS * (1 + 1e-9) and period > shipped.dt:
            period /= 2
        frame = min(frame, period)
    else:
        frame = period / max(1, round(period / frame))
    dts = [shipped if f == 1 else shipped.replace(dt=shipped.dt * f) for f in FACTORS]
    plain = shipped.replace(solver="pgs", tolerance=0.0, cost_tolerance=0.0, sweeps=1)
    fixed = shipped.solver == "pgs" and shipped.sweeps != "auto" and shipped.sweeps > 0
    return Candidates(
        shipped=shipped,
        period=period,
        dts=[s for s in dts if s.dt <= period * (1 + 1e-9) and divides(s.dt, period)],
        splits=[Split(n, k, plain.replace(dt=frame / n, sweeps=k)) for n, k in SPLITS],
        more=shipped.replace(sweeps=4 * shipped.sweeps, cost_tolerance=0.0) if fixed else None,
        solved=converged_settings(shipped, warm_start=True),
    )


@dataclass(frozen=True)
class CandidateRun:
    """The result of one setting over all starts.

    error: RMS position error over samples and bodies against the reference, in the worst start [m],
        as in a trade; nan if the setting failed.
    overlap, joint: the deepest overlap and the widest gap of a connection [m].
    residual: the largest residual [m/s].
    updates: row updates per simulated second.
    failure: the reason why a run ended early.
    """

    settings: Settings
    error: float = math.nan
    overlap: float = math.nan
    joint: float | None = None
    residual: float = math.nan
    updates: float = math.nan
    failure: str | None = None


@dataclass(frozen=True)
class Ending:
    """The difference between the ends of the motion under shipped sweeps and with converged forces.

    start, body: the start and the body for which the distance is largest.
    apart: that distance [m].
    speed, solved_speed: the body's mean speed over the last tenth of both motions [m/s].
    solver: RMS distance over the whole motion [m].
    """

    start: int
    body: str
    apart: float
    speed: float
    solved_speed: float
    solver: float


def run_of(
    experiment: Experiment, settings: Settings, runs: list[Run], reference: Reference
) -> CandidateRun:
    """Return the result of one setting."""
    failure = experiment.failure(runs, reference)
    if failure is not None:
        return CandidateRun(settings, failure=failure)
    found = experiment.errors(runs, reference)
    return CandidateRun(
        settings,
        error=found.high,
        overlap=found.overlap,
        joint=found.joint,
        residual=found.residual,
        updates=float(np.mean([run.row_updates for run in runs])) / experiment.schedule.horizon,
    )


def ending(
    experiment: Experiment, shipped: Sequence[Run], solved: Sequence[Run], scored: np.ndarray
) -> Ending:
    """Compare the ends of the motion in the start where converged forces matter most."""
    times, moving = experiment.schedule.times, experiment.runner.bodies.moving
    over = errors(shipped, solved, scored).high
    last = max(1, len(times) // 10)
    span = float(times[-1] - times[-1 - last]) if len(times) > last else math.nan
    endings: list[Ending] = []
    for start, runs in enumerate(zip(shipped, solved, strict=True)):
        gap = np.linalg.norm(runs[0].com[-1] - runs[1].com[-1], axis=-1)
        at = int(gap.argmax())
        speed = solved_speed = math.nan
        if len(times) > last:
            moved = [run.com[-1, at] - run.com[-1 - last, at] for run in runs]
            speed, solved_speed = (float(np.linalg.norm(way)) / span for way in moved)
        body = experiment.model.element_name("body", moving[at])
        endings.append(Ending(start, body, float(gap[at]), speed, solved_speed, over))
    return max(endings, key=lambda end: end.apart)


class RowStates(Probe):
    """A probe that records snapshots of states from which steps with rows are made.

    The snapshots are one of each sample, and the state whose step has the worst residual.
    """

    def __init__(self, every: int, start: int) -> None:
        self.every, self.start = every, start
        self.states: list[MotionState] = []
        self.worst: MotionState | None = None
        self.wanted = False

    def stride(self, steps: int) -> int:
        return 1

    def period(self, sim: Sim, period: int) -> None:
        self.wanted = period % self.every == 0
        self._snapshot(sim)

    def _snapshot(self, sim: Sim) -> None:
        self.before = float(sim.time), sim.state()

    def step(self, sim: Sim) -> None:
        if sim.row_updates:
            residual = sim.residual
            state = MotionState(self.start, *self.before, residual)
            if self.wanted and len(sim.rows):
                self.states.append(state)
                self.wanted = False
            if residual > (self.worst.residual if self.worst else 0.0):
                self.worst = state
        self._snapshot(sim)


def row_states(runner: Runner, settings: Settings, start: int) -> list[MotionState]:
    """Return states with rows along the motion from one start, until any failure; worst last."""
    probe = RowStates(runner.schedule.every, start)
    with contextlib.suppress(SimulationError):
        runner.follow(runner.sim(settings), start, [probe])
    return [*probe.states, *([probe.worst] if probe.worst else [])]
