"""The grasp: what sweeps, steps of time and a cube's mass do to a hold by friction."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.sim import Sim
from stepcore.lesson import scenes
from stepcore.lesson.extremes.cells import (
    EPS,
    PRECISIONS,
    STEPS_OF_TIME,
    Case,
    Outcome,
    all_of,
    named_error,
    within,
)
from stepcore.lesson.extremes.motion import step_is_balanced

MASSES = (1e-6, 1e-3, 1e-1, 1.0, 1e3, 1e6)
SWEEPS = (0, 1, 10, 100, 1000)
STEPS = 200
GRIP = 3.0
# A pad's friction is 1. The lighter pad's damper, taken explicitly, is stable below dt = 2 m/c.
HELD_MASS = 2 * GRIP / scenes.G
DAMPER_LIMIT = 2 * 0.05 / 5.0


def cases() -> Iterator[Case]:
    """Sweeps by steps of time, and by the mass of the cube."""
    by_dt = (
        "grasp\n  law: momentum balanced, no row pulls; 0 sweeps are free fall; held while "
        "dt < 2 m/c = 20 ms, beyond which a damper throws it apart; shown: slip [m]"
    )
    by_mass = (
        "grasp of another mass\n  law: momentum balanced, no row pulls; held below "
        "2 μ grip/g = 0.61 kg by enough sweeps, lost above; shown: slip [m]"
    )
    for precision in PRECISIONS:
        for dt in STEPS_OF_TIME:
            for sweeps in SWEEPS:
                yield Case(
                    by_dt,
                    f"dt {dt:.0e}",
                    f"{sweeps} sweeps",
                    precision,
                    partial(cell, 0.1, dt, sweeps, precision),
                )
        for mass in MASSES:
            for sweeps in SWEEPS:
                yield Case(
                    by_mass,
                    f"cube {mass:.0e} kg",
                    f"{sweeps} sweeps",
                    precision,
                    partial(cell, mass, 0.002, sweeps, precision),
                )


def cell(mass: float, dt: float, sweeps: int, precision: str) -> Outcome:
    """The lesson's grasp with a cube of this mass."""
    scene = scenes.grasp(GRIP, dt=dt, sweeps=sweeps, tolerance=0.0, precision=precision)
    scene.geom("cube").mass = mass
    sim = Sim(scene.compile())
    sim.reset("start")
    start = np.array(sim.qpos)
    try:
        checks = []
        for _ in range(4):
            checks.append(step_is_balanced(sim, precision))
            sim.step(STEPS // 4)
        if dt > DAMPER_LIMIT:
            sim.step(20_000)
            return Outcome(False, "no error", "thrown apart by a damper")
    except SimulationError as error:
        if dt > DAMPER_LIMIT:
            return named_error(error)
        raise
    slip = scenes.slip(sim, start)
    if sweeps == 0:
        # dofs: wrist, two pads, then the cube's x, y, z.
        miss = abs(float(sim.qvel[5]) / (-scenes.G * dt * STEPS) - 1)
        return all_of(within(miss, 2 * STEPS * EPS[precision], "free fall", "falls"), *checks)
    return all_of(judged(slip, mass, dt, sweeps, precision), *checks)


def judged(slip: float, mass: float, dt: float, sweeps: int, precision: str) -> Outcome:
    """Held or lost; with too few sweeps for a cube this light neither is asked."""
    still = 100 * EPS[precision] * 0.2
    if mass > HELD_MASS:
        return Outcome(bool(slip > 1e-2), f"lost {slip:.0e}", "lost")
    # Beside a pad of 50 g a sweep gives the cube about mass/pad of what it is still owed.
    if sweeps * min(1.0, mass / 0.05) < 5:
        return Outcome(bool(np.isfinite(slip)), f"slips {slip:.0e}", "balance of momentum")
    fall = 0.5 * scenes.G * (STEPS * dt) ** 2
    return within(slip, 1e-6 * fall + still, "held", "slip")
