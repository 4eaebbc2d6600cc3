"""The motion under settings that differ in sweeps and time step, and how wrong each run is."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim
from stepcore.experiment.path import Path, distance
from stepcore.experiment.probe import Probe
from stepcore.experiment.runner import Runner
from stepcore.measure.convergence.closing import Moment, converged

# Sweeps in a period of equal work, and how they are split: steps × sweeps.
WORK = 64
SPLITS = ((64, 1), (16, 4), (4, 16), (1, 64))
# Time steps that are tried at the settings' own sweeps, over the settings' own.
FACTORS = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8)
# What one run of the reference may cost, in steps × (dofs + 2).
BUDGET = 4e6
# Where only sweeps can converge the forces of a run: the residual aimed at, over what gravity
# gives in a step; what that may cost in row updates; and the fewest and most sweeps of a step.
FINE, UPDATES, LEAST, LONGEST = 1e-5, 1e8, 500, 100_000
# The two references this far apart, over the scene's size, say nothing from there on.
APART = 1e-2
# The least number of periods in a motion.
PERIODS = 4
# Further from the reference than this many times the scene's size is no error, but a failure.
FAR = 3.0
# Sweeps that a solver without a number of them is split as.
USUAL = 16


class Split(NamedTuple):
    """Steps × sweeps of equal work, and the settings that do it."""

    steps: int
    sweeps: int
    settings: Settings


class Plan(NamedTuple):
    """What is run: by time step, by split, with more sweeps, solved, and two references."""

    period: float
    dts: list[Settings]
    splits: list[Split]
    more: Settings | None
    truth: tuple[Settings, ...] = ()

    @property
    def tried(self) -> list[Settings]:
        """Every setting but the converged ones, once."""
        some = [*self.dts, *(split.settings for split in self.splits)]
        return list(dict.fromkeys([*some, *([self.more] if self.more else [])]))

    @property
    def solved(self) -> Settings:
        """The settings' own with converged forces."""
        return self.truth[0]

    @property
    def references(self) -> tuple[Settings, ...]:
        """The converged run that all are compared with, and one of twice its time step."""
        return self.truth[1:]


def plan(own: Settings, period: float | None, horizon: float) -> Plan:
    """What to run for these settings. period: of the control, if it is given [s].

    One of the splits has the settings' own time step, with the nearest of 1, 4, 16 and 64 sweeps.
    """
    count = _sweeps(own)
    frame = own.dt * WORK / min((1, 4, 16, 64), key=lambda n: abs(math.log(n / count)))
    factors: Sequence[float] = FACTORS
    if period is None:
        period = max(frame, 4 * own.dt)
        while period > horizon / PERIODS * (1 + 1e-9) and period > own.dt:
            period /= 2
        frame = min(frame, period)
    else:
        frame = period / max(1, round(period / frame))
    factors = [
        f for f in factors if f * own.dt <= period * (1 + 1e-9) and _divides(f * own.dt, period)
    ]
    swept = own.replace(solver="pgs", tolerance=0.0, sweeps=1)
    splits = [Split(n, k, swept.replace(dt=frame / n, sweeps=k)) for n, k in SPLITS]
    fixed = own.solver == "pgs" and own.sweeps != "auto" and own.sweeps > 0
    return Plan(
        period=period,
        dts=[own.replace(dt=own.dt * f) if f != 1 else own for f in factors],
        splits=splits,
        more=own.replace(sweeps=4 * own.sweeps) if fixed else None,
    )


def converging(todo: Plan, own: Settings, runner: Runner, rows: int) -> Plan:
    """The plan with its converged runs. rows: the most at once, in what was run so far."""
    horizon, most = runner.schedule.horizon, BUDGET / (runner.model.nv + 2)
    dt = min(todo.splits[0].settings.dt, own.dt / 8)
    if horizon / dt <= most / 4:
        dt /= 4
    while horizon / dt > most and dt < own.dt / 4:
        dt *= 2
    speed = float(np.linalg.norm(runner.bodies.gravity)) or 1.0
    truth = [_solved(own, step, speed, rows, horizon) for step in (own.dt, dt, 2 * dt)]
    return todo._replace(truth=tuple(truth))


def _sweeps(own: Settings) -> int:
    if own.solver == "pgs" and own.sweeps != "auto":
        return max(1, int(own.sweeps))
    return USUAL


def _divides(dt: float, period: float) -> bool:
    count = period / dt
    return round(count) >= 1 and abs(count - round(count)) <= 1e-6 * count


def _solved(own: Settings, dt: float, speed: float, rows: int, horizon: float) -> Settings:
    """The settings with converged forces. speed: that gravity gives in a second [m/s]."""
    settings = converged(own.replace(dt=dt), speed * dt, rows)
    if settings.solver == "newton":
        return settings
    most = UPDATES / (max(rows, 1) * horizon / dt)
    sweeps = round(min(max(most, LEAST), LONGEST))
    return settings.replace(sweeps=sweeps, tolerance=FINE * speed * dt, warm_start=True)


@dataclass(frozen=True)
class Run:
    """One setting over all starts.

    error: position, rms over samples and bodies, median of starts, from the reference [m]; nan
    where it failed. solver: the same from the run with converged forces at the same step, for
    the settings' own. overlap, joint [m]; residual [m/s]: the worst. updates: of rows, per
    simulated second. failure: why it ended early.
    """

    settings: Settings
    error: float = math.nan
    overlap: float = math.nan
    joint: float | None = None
    residual: float = math.nan
    updates: float = math.nan
    failure: str | None = None


class Job(NamedTuple):
    """One run to make."""

    settings: Settings
    start: int


def ride(runner: Runner, job: Job) -> Path:
    """One run of the motion."""
    return runner.run(job.settings, job.start)


class Moments(Probe):
    """Snapshots where there are rows: one a sample, and the step with the worst residual."""

    def __init__(self, start: int, every: int) -> None:
        self.start, self.every = start, every
        self.sampled: list[Moment] = []
        self.worst: Moment | None = None

    def stride(self, steps: int) -> int:
        return 1

    def period(self, sim: Sim, period: int) -> None:
        self.sought = period % self.every == 0
        self.before = sim.state(), float(sim.time)

    def step(self, sim: Sim) -> None:
        (snapshot, time), self.before = self.before, (sim.state(), float(sim.time))
        if not sim.row_updates:
            return
        residual = sim.residual
        if self.sought and len(sim.rows):
            self.sampled.append(Moment(self.start, time, snapshot, residual))
            self.sought = False
        if residual > (self.worst.residual if self.worst else 0.0):
            self.worst = Moment(self.start, time, snapshot, residual)


def moments(runner: Runner, settings: Settings, start: int) -> list[Moment]:
    """The moments of one run, as far as it comes."""
    seen = Moments(start, runner.schedule.every)
    with contextlib.suppress(SimulationError):
        runner.follow(runner.sim(settings), start, [seen])
    return [*seen.sampled, *([seen.worst] if seen.worst else [])]


@dataclass
class Truth:
    """The reference's runs by start, and which samples of each they agree on."""

    paths: list[Path]
    scored: list[Floats]
    error: float
    size: float
    notes: list[str] = field(default_factory=list)


def truth(fine: list[Path], coarse: list[Path], size: float) -> Truth:
    """The reference from its two runs: error is twice their distance."""
    masks, apart = [], []
    for one, other in zip(fine, coarse, strict=True):
        gap = distance(one, other)
        mask = np.cumsum(gap.max(axis=1, initial=0.0) > APART * size) == 0
        mask[:1] = True
        masks.append(mask)
        apart.append(rms(gap[mask]))
    found = Truth(fine, masks, 2 * float(np.median(apart)), size)
    short = sum(not mask.all() for mask in masks)
    if short:
        found.notes.append(
            f"{short} of {len(masks)} starts are compared only until the reference at two time "
            f"steps is {APART:.0%} of the scene's size apart"
        )
    return found


def run_of(settings: Settings, paths: list[Path], true: Truth, horizon: float) -> Run:
    """One setting's numbers."""
    failure = next((f"start {i}: {p.failure}" for i, p in enumerate(paths) if p.failure), None)
    if failure is None:
        failure = _far(paths, true)
    if failure is not None:
        return Run(settings, failure=failure)
    joints = [path.joint for path in paths if path.joint is not None]
    return Run(
        settings,
        error=error(paths, true.paths, true.scored),
        overlap=max(path.overlap for path in paths),
        joint=max(joints, default=None),
        residual=max(path.residual for path in paths),
        updates=float(np.mean([path.row_updates for path in paths])) / horizon,
    )


def _far(paths: list[Path], true: Truth) -> str | None:
    """Why runs that left the scene failed, or None. All samples count: chaos is no reason."""
    for start, (path, other) in enumerate(zip(paths, true.paths, strict=True)):
        apart = float(distance(path, other).max(initial=0.0))
        if not apart <= FAR * true.size:
            return f"start {start}: far off ({apart:.2g} m from the reference)"
    return None


def error(paths: Sequence[Path], others: Sequence[Path], scored: Sequence[Floats]) -> float:
    """Positions, rms over scored samples and bodies, median of the starts [m]."""
    parts = [rms(distance(a, b)[mask]) for a, b, mask in zip(paths, others, scored, strict=True)]
    return float(np.median(parts))


def rms(values: Floats) -> float:
    """The root mean square; 0 of nothing."""
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
