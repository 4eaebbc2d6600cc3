"""The motion under each of the candidates: the states that it visits, and its error."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.sim import Sim
from stepcore.experiment.errors import extent, far_off
from stepcore.experiment.path import Path, distance
from stepcore.experiment.probe import Probe
from stepcore.experiment.runner import Runner
from stepcore.measure.convergence.residuals import MotionState
from stepcore.report.units import joules
from stepcore.scene.scene import Scene

# The reference at two time steps this far apart, over the scene's size, is unknown from there on.
APART = 1e-2
# A run that is further from the reference than this many times the scene's size has failed.
FAR = 3.0
# So has one that gains more energy than lifts the scene by so many times its size, and so many
# times what the reference ever has in motion: an integrator's own energy error is less.
GAIN = 10.0
CLIMB = 1.0


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
class HalvedReference:
    """The converged motion, and what halving its time step changed.

    paths: by start. scored: the samples of each start that count: until the runs at the two steps
    are apart. error: twice their distance [m]. size: of the scene [m].
    """

    paths: list[Path]
    scored: list[Floats]
    error: float
    size: float

    @property
    def notes(self) -> list[str]:
        """Limits of the comparison with it."""
        short = sum(not mask.all() for mask in self.scored)
        if not short:
            return []
        return [
            f"{short} of {len(self.scored)} starts are compared only until the reference at two "
            f"time steps is {APART:.0%} of the scene's size apart"
        ]


def halved_reference(fine: list[Path], coarse: list[Path], scene: Scene) -> HalvedReference:
    """The reference from its runs at two time steps. Raises ValueError if one of them failed."""
    for path in (*fine, *coarse):
        if path.failure:
            raise ValueError(f"the reference fails: {path.failure}")
    size = extent(fine, scene)
    masks, apart = [], []
    for path, other in zip(fine, coarse, strict=True):
        gap = distance(path, other)
        mask = np.cumsum(gap.max(axis=1, initial=0.0) > APART * size) == 0
        mask[:1] = True
        masks.append(mask)
        apart.append(rms(gap[mask]))
    return HalvedReference(fine, masks, 2 * float(np.median(apart)), size)


def run_of(
    settings: Settings, paths: list[Path], truth: HalvedReference, horizon: float, weight: float
) -> CandidateRun:
    """One setting's numbers. weight: of all bodies [N]."""
    failures = (f"start {i}: {path.failure}" for i, path in enumerate(paths) if path.failure)
    failure = next(failures, None) or far_off(paths, truth.paths, truth.size, FAR)
    failure = failure or _climbs(paths, truth, weight)
    if failure is not None:
        return CandidateRun(settings, failure=failure)
    joints = [path.joint for path in paths if path.joint is not None]
    return CandidateRun(
        settings,
        error=median_error(paths, truth.paths, truth.scored),
        overlap=max(path.overlap for path in paths),
        joint=max(joints, default=None),
        residual=max(path.residual for path in paths),
        updates=float(np.mean([path.row_updates for path in paths])) / horizon,
    )


def _climbs(paths: Sequence[Path], truth: HalvedReference, weight: float) -> str | None:
    """What fails a run with energy that nothing in the scene gave it: rows that push too much."""
    for start, (path, true) in enumerate(zip(paths, truth.paths, strict=True)):
        given = max(float(true.balance.max(initial=0.0)), 0.0)
        moving = float(true.kinetic.max(initial=0.0)) + float(
            np.ptp(true.balance) if len(true.balance) else 0.0
        )
        gained = float(path.balance.max(initial=0.0)) - given
        if not gained <= GAIN * moving + CLIMB * weight * truth.size:
            return f"start {start}: gains {joules(gained)} of energy that nothing gives it"
    return None


def median_error(paths: Sequence[Path], others: Sequence[Path], scored: Sequence[Floats]) -> float:
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
