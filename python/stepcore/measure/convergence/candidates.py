"""The settings that `converge` compares: time steps, splits of equal work, converged forces."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.runner import Runner
from stepcore.measure.convergence.residuals import solved

# Sweeps in a period of equal work, and how they are split: steps × sweeps.
WORK = 64
SPLITS = ((64, 1), (16, 4), (4, 16), (1, 64))
# Time steps that are tried at the settings' own sweeps, over the settings' own.
FACTORS = (4, 2, 1, 1 / 2, 1 / 4, 1 / 8)
# What one run of the reference may cost, in steps × (dofs + 2).
BUDGET = 4e6
# Where only sweeps can converge the forces of a run: the residual aimed at, over the velocity that
# gravity gives in a step; the most row updates; and the fewest and most sweeps of a step.
TOLERANCE, MOST_UPDATES, FEWEST, MOST = 1e-5, 1e8, 500, 100_000
# The least number of periods in a motion.
PERIODS = 4
# A solver without a number of sweeps is split as one with this number.
USUAL = 16


class Split(NamedTuple):
    """Steps × sweeps of equal work, and the settings that do it."""

    steps: int
    sweeps: int
    settings: Settings


@dataclass(frozen=True)
class Candidates:
    """All settings that are run. period: of the control [s].

    own: the scene's. dts: those at each time step; splits: of equal work; more: with four times the
    sweeps, None where there is no number of them. converged: the settings' own step with converged
    forces, then the reference and one of twice its step; empty until `with_converged`.
    """

    own: Settings
    period: float
    dts: list[Settings]
    splits: list[Split]
    more: Settings | None
    converged: tuple[Settings, ...] = ()

    @property
    def tried(self) -> list[Settings]:
        """Every setting but the converged ones, once."""
        some = [*self.dts, *(split.settings for split in self.splits)]
        return list(dict.fromkeys([*some, *([self.more] if self.more else [])]))

    @property
    def solved(self) -> Settings:
        """The settings' own with converged forces."""
        return self.converged[0]

    @property
    def references(self) -> tuple[Settings, ...]:
        """The reference that all are compared with, and one of twice its time step."""
        return self.converged[1:]

    @property
    def quarter(self) -> Settings | None:
        """The settings at a quarter of their own time step, if they are tried."""
        return next((s for s in self.dts if math.isclose(s.dt, self.own.dt / 4)), None)


def candidates(own: Settings, period: float | None, horizon: float) -> Candidates:
    """What to run for these settings. period: of the control, if it is given [s].

    One of the splits has the settings' own time step, with the nearest of 1, 4, 16 and 64 sweeps.
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
    """The candidates with their converged runs. rows: the most at once in what ran so far."""
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
    """The settings with converged forces. speed: what gravity gives in a second [m/s]."""
    own = own.replace(dt=dt)
    if own.law == "solref":
        return solved(own, speed * dt, rows)
    sweeps = round(min(max(MOST_UPDATES / (max(rows, 1) * horizon / dt), FEWEST), MOST))
    tolerance = TOLERANCE * speed * dt
    return solved(own, speed * dt, rows, pgs=sweeps, tolerance=tolerance, warm_start=True)
