"""The settings that `converge` compares, and what their runs show.

The settings are time steps, splits of equal work into steps and sweeps, and converged forces.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim
from stepcore.experiment.failure import failure
from stepcore.experiment.run import Probe, Run, distance
from stepcore.experiment.runner import Runner
from stepcore.experiment.sizes import scene_size
from stepcore.measure.convergence.sweeps import MotionState, solved
from stepcore.scene.scene import Scene

# Sweeps in a period of equal work, and their splits into steps × sweeps.
WORK = 64
SPLITS = ((64, 1), (16, 4), (4, 16), (1, 64))
# Time steps that are tried at the settings' own sweeps, relative to the settings' own.
FACTORS = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8)
# The most that one run of the reference may cost, in steps × (dofs + 2).
BUDGET = 4e6
# Limits of runs whose forces only sweeps can converge: the residual, relative to the velocity that
# gravity gives in a step; the row updates of a run; and the fewest and most sweeps of a step.
TOLERANCE, MOST_UPDATES, FEWEST, MOST = 1e-5, 1e8, 500, 100_000
# A motion has at least this many periods.
PERIODS = 4
# A solver without a number of sweeps is split like one with this number.
USUAL = 16
# The reference at two time steps this far apart, over the scene's size, is unknown from there on.
APART = 1e-2


class Split(NamedTuple):
    """One split of equal work into steps × sweeps, and its settings."""

    steps: int
    sweeps: int
    settings: Settings


@dataclass(frozen=True)
class Candidates:
    """All settings that are run.

    own: the scene's settings.
    period: the control period [s].
    dts: the settings at each time step.
    splits: the splits of equal work.
    more: four times the sweeps; None if the settings have no number of sweeps.
    converged: the own time step with converged forces, then the reference, then the reference at
        twice its time step; empty until `with_converged`.
    """

    own: Settings
    period: float
    dts: list[Settings]
    splits: list[Split]
    more: Settings | None
    converged: tuple[Settings, ...] = ()

    @property
    def tried(self) -> list[Settings]:
        """All settings but the converged ones, each once."""
        some = [*self.dts, *(split.settings for split in self.splits)]
        return list(dict.fromkeys([*some, *([self.more] if self.more else [])]))

    @property
    def solved(self) -> Settings:
        """The own settings with converged forces."""
        return self.converged[0]

    @property
    def references(self) -> tuple[Settings, ...]:
        """The reference that all runs are compared with, and the one at twice its time step."""
        return self.converged[1:]

    @property
    def quarter(self) -> Settings | None:
        """The own settings at a quarter of their time step, if that is tried."""
        return next((s for s in self.dts if math.isclose(s.dt, self.own.dt / 4)), None)


def candidates(own: Settings, period: float | None, horizon: float) -> Candidates:
    """The settings to compare with `own`.

    period: the control period [s], None if the motion leaves it open. One of the splits has the own
    time step, with the nearest of 1, 4, 16 and 64 sweeps.
    """
    sweeps = USUAL
    if own.solver == "pgs" and own.sweeps != "auto":
        sweeps = max(1, int(own.sweeps))
    frame = own.dt * WORK / min((1, 4, 16, 64), key=lambda n: abs(math.log(n / sweeps)))
    if period is None:
        period = max(frame, 4 * own.dt)
        while period > horizon / PERIODS * (1 + 1e-9) and period > own.dt:
            period /= 2
        frame = min(frame, period)
    else:
        frame = period / max(1, round(period / frame))
    dts = [own if f == 1 else own.replace(dt=own.dt * f) for f in FACTORS]
    plain = own.replace(solver="pgs", tolerance=0.0, sweeps=1)
    fixed = own.solver == "pgs" and own.sweeps != "auto" and own.sweeps > 0
    return Candidates(
        own=own,
        period=period,
        dts=[s for s in dts if s.dt <= period * (1 + 1e-9) and divides(s.dt, period)],
        splits=[Split(n, k, plain.replace(dt=frame / n, sweeps=k)) for n, k in SPLITS],
        more=own.replace(sweeps=4 * own.sweeps) if fixed else None,
    )


def divides(dt: float, period: float) -> bool:
    """Whether a period is a whole number of steps."""
    count = period / dt
    return round(count) >= 1 and abs(count - round(count)) <= 1e-6 * count


def with_converged(some: Candidates, runner: Runner, rows: int) -> Candidates:
    """The candidates with their converged settings; rows: the most that were active at once."""
    own, horizon = some.own, runner.schedule.horizon
    budget = BUDGET / (runner.model.nv + 2)
    dt = min(some.splits[0].settings.dt, own.dt / 8)
    if horizon / dt <= budget / 4:
        dt /= 4
    while horizon / dt > budget and dt < own.dt / 4:
        dt *= 2
    speed = float(np.linalg.norm(runner.bodies.gravity)) or 1.0
    steps = (own.dt, dt, 2 * dt)
    return replace(some, converged=tuple(_solved(own, dt, speed, rows, horizon) for dt in steps))


def _solved(own: Settings, dt: float, speed: float, rows: int, horizon: float) -> Settings:
    """The settings with converged forces; speed: the velocity after a second's fall [m/s]."""
    own = own.replace(dt=dt)
    if own.law == "solref":
        return solved(own, speed * dt, rows)
    sweeps = round(min(max(MOST_UPDATES / (max(rows, 1) * horizon / dt), FEWEST), MOST))
    tolerance = TOLERANCE * speed * dt
    return solved(own, speed * dt, rows, sweeps=sweeps, tolerance=tolerance, warm_start=True)


@dataclass(frozen=True)
class CandidateRun:
    """The result of one setting over all starts.

    error: RMS position error over samples and bodies against the reference, in the median start
        [m]; nan if it failed.
    overlap, joint: the deepest overlap and the widest gap of a connection [m].
    residual: the largest residual [m/s].
    updates: row updates per simulated second.
    failure: why it ended early.
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
    """Where the motion ends under the own sweeps, beside where it ends with converged forces.

    start, body: where the two are furthest apart.
    apart: the distance there [m].
    speed, solved_speed: the body's mean speed over the last tenth of both motions [m/s].
    solver: RMS distance over the whole motion [m].
    """

    start: int
    body: str
    apart: float
    speed: float
    solved_speed: float
    solver: float


@dataclass(frozen=True)
class HalvedReference:
    """The converged motion, and how much halving its time step changed it.

    paths: the run of each start.
    scored: which samples of each start count: those before the runs at the two steps separate.
    error: twice the distance of these runs [m].
    size: the scene's size [m].
    """

    paths: list[Run]
    scored: list[Floats]
    error: float
    size: float

    @property
    def notes(self) -> list[str]:
        """Limits of comparisons with this reference."""
        short = sum(not mask.all() for mask in self.scored)
        if not short:
            return []
        return [
            f"{short} of {len(self.scored)} starts are compared only until the reference at two "
            f"time steps is {APART:.0%} of the scene's size apart"
        ]


def halved_reference(fine: list[Run], coarse: list[Run], scene: Scene) -> HalvedReference:
    """The reference from its runs at two time steps. Raises ValueError if one of them failed."""
    for path in (*fine, *coarse):
        if path.failure:
            raise ValueError(f"the reference fails: {path.failure}")
    size = scene_size(scene, fine)
    masks, apart = [], []
    for path, other in zip(fine, coarse, strict=True):
        gap = distance(path, other)
        mask = np.cumsum(gap.max(axis=1, initial=0.0) > APART * size) == 0
        mask[:1] = True
        masks.append(mask)
        apart.append(rms(gap[mask]))
    return HalvedReference(fine, masks, 2 * float(np.median(apart)), size)


def run_of(
    settings: Settings, paths: list[Run], truth: HalvedReference, horizon: float, weight: float
) -> CandidateRun:
    """One setting's numbers. weight: of all bodies [N]."""
    failed = failure(paths, truth.paths, truth.size, weight)
    if failed is not None:
        return CandidateRun(settings, failure=failed)
    joints = [path.joint for path in paths if path.joint is not None]
    return CandidateRun(
        settings,
        error=median_error(paths, truth.paths, truth.scored),
        overlap=max(path.overlap for path in paths),
        joint=max(joints, default=None),
        residual=max(path.residual for path in paths),
        updates=float(np.mean([path.row_updates for path in paths])) / horizon,
    )


def ending(
    runner: Runner, own: Sequence[Run], solved: Sequence[Run], reference: HalvedReference
) -> Ending:
    """Where the motion ends, in the start in which converged forces make the largest difference."""
    times = runner.schedule.times
    over = median_error(own, solved, reference.scored)
    last = max(1, len(times) // 10)
    span = float(times[-1] - times[-1 - last]) if len(times) > last else math.nan
    endings: list[Ending] = []
    for start, paths in enumerate(zip(own, solved, strict=True)):
        gap = np.linalg.norm(paths[0].com[-1] - paths[1].com[-1], axis=-1)
        at = int(gap.argmax())
        speed = solved_speed = math.nan
        if len(times) > last:
            moved = [path.com[-1, at] - path.com[-1 - last, at] for path in paths]
            speed, solved_speed = (float(np.linalg.norm(way)) / span for way in moved)
        body = runner.model.element_name("body", runner.bodies.moving[at])
        endings.append(Ending(start, body, float(gap[at]), speed, solved_speed, over))
    return max(endings, key=lambda end: end.apart)


def median_error(paths: Sequence[Run], others: Sequence[Run], scored: Sequence[Floats]) -> float:
    """RMS distance over scored samples and bodies, median of the starts [m]."""
    parts = [rms(distance(a, b)[mask]) for a, b, mask in zip(paths, others, scored, strict=True)]
    return float(np.median(parts))


def rms(values: Floats) -> float:
    """The root mean square; 0 of nothing."""
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


class RowStates(Probe):
    """Snapshots of the states from which steps with rows are made.

    One of each sample, and the one whose step has the worst residual.
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
    """States with rows along the motion from one start, the worst last; up to where it fails."""
    probe = RowStates(runner.schedule.every, start)
    with contextlib.suppress(SimulationError):
        runner.follow(runner.sim(settings), start, [probe])
    return [*probe.states, *([probe.worst] if probe.worst else [])]
