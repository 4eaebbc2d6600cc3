"""The grasp: what sweeps, time steps and a cube's mass do to a hold by friction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from extreme_cases.cells import (
    EPS,
    TIME_STEPS,
    Case,
    Outcome,
    all_of,
    named_error,
    table_cases,
    within,
)
from extreme_cases.step_laws import step_is_balanced
from stepcore._core import SimulationError
from stepcore.engine.sim import Sim, unwatched
from stepcore.lesson import scenes

MASSES = {f"cube {mass:.0e} kg": mass for mass in (1e-6, 1e-3, 1e-1, 1.0, 1e3, 1e6)}
SWEEPS = {f"{sweeps} sweeps": sweeps for sweeps in (0, 1, 10, 100, 1000)}
STEPS = 200
GRIP = 3.0
# A pad's friction is 1. The lighter pad's damper is explicit: stable below dt = 2 m/c.
HELD_MASS = 2 * GRIP / scenes.G
DAMPER_LIMIT = 2 * 0.05 / 5.0


def cases() -> Iterator[Case]:
    """Sweeps by time step, and by the mass of the cube."""
    every = "momentum is balanced, no row pulls; "
    yield from table_cases(
        "grasp",
        every + "with 0 sweeps free fall; held while dt < 2 m/c = 20 ms, beyond which a damper "
        "throws it apart; shown: slip [m]",
        lambda dt, sweeps, precision: hold(0.1, dt, sweeps, precision),
        TIME_STEPS,
        SWEEPS,
    )
    yield from table_cases(
        "grasp of another mass",
        every + "held below 2 μ grip/g = 0.61 kg with enough sweeps, lost above; shown: slip [m]",
        lambda mass, sweeps, precision: hold(mass, 0.002, sweeps, precision),
        MASSES,
        SWEEPS,
    )


def hold(mass: float, dt: float, sweeps: int, precision: str) -> Outcome:
    """The lesson's grasp of a cube of this mass [kg]."""
    scene = scenes.grasp(GRIP, dt=dt, sweeps=sweeps, tolerance=0.0, precision=precision)
    scene.geom("cube").mass = mass
    sim = unwatched(Sim(scene.compile()))
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
    """Held or lost; with too few sweeps for so light a cube neither is asked for."""
    still = 100 * EPS[precision] * 0.2
    if mass > HELD_MASS:
        return Outcome(bool(slip > 1e-2), f"lost {slip:.0e}", "lost")
    # A sweep gives a cube between pads of 50 g about mass/pad of the impulse that is missing.
    if sweeps * min(1.0, mass / 0.05) < 5:
        return Outcome(bool(np.isfinite(slip)), f"slips {slip:.0e}", "balance of momentum")
    fall = 0.5 * scenes.G * (STEPS * dt) ** 2
    return within(slip, 1e-6 * fall + still, "held", "slip")
