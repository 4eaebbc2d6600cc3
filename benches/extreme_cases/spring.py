"""A mass on a spring: the invariant of the discrete motion, and the limit ω·dt = 2."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

from extreme_cases.cells import (
    EPS,
    TIME_STEPS,
    Case,
    Outcome,
    named_error,
    table_cases,
    within,
)
from stepcore._core import SimulationError
from stepcore.engine.sim import Sim, unwatched
from stepcore.lesson import scenes

# The columns: k [N/m]; or ω dt, a little inside the limit and a little beyond.
STIFFNESSES = {f"k {k:.0e}": (k, 0.0) for k in (1.0, 1e2, 1e4, 1e6, 1e8, 1e10, 1e12)}
EDGES = {f"ω dt {phase}": (0.0, phase) for phase in (1.999, 2.001)}
STEPS = 2000
LAWS = {
    "semi-implicit": "v² + ω²x² - dt ω² x v is constant while ω dt < 2; beyond, growth to an error",
    "midpoint": "energy is constant at any ω dt",
}


def cases() -> Iterator[Case]:
    """Semi-implicit and midpoint: stiffness by dt."""
    for integrator, law in LAWS.items():
        title = f"spring, {integrator}, {STEPS} steps"
        law += "; shown: the relative drift"
        measure = partial(drift_or_growth, integrator)
        yield from table_cases(title, law, measure, TIME_STEPS, STIFFNESSES | EDGES)


def drift_or_growth(
    integrator: str, dt: float, stiffness: tuple[float, float], precision: str
) -> Outcome:
    """One spring with 1 kg on it; its stiffness [N/m] is given itself or by ω dt."""
    k = stiffness[0] or (stiffness[1] / dt) ** 2
    sim = unwatched(
        Sim(scenes.spring(k, integrator=integrator, dt=dt, precision=precision).compile())
    )
    sim.reset("start")
    phase = math.sqrt(k) * dt
    if integrator == "semi-implicit" and phase > 2:
        return growth(sim, phase, precision)
    twist = dt * k if integrator == "semi-implicit" else 0.0

    def invariant() -> float:
        x, v = float(sim.qpos[0]), float(sim.qvel[0])
        return v * v + k * x * x - twist * x * v

    start, drift = invariant(), 0.0
    for _ in range(STEPS // 10):
        sim.step(10)
        drift = max(drift, abs(invariant() / start - 1))
    # One rounding a step. Near the limit the invariant is a thin ellipse, which magnifies it;
    # beyond half a period a midpoint step moves x by the small mean of two large velocities.
    magnified = 1 / max(1 - (phase / 2) ** 2, 1e-3) if twist else max(1.0, phase)
    bound = 4 * STEPS * EPS[precision] * magnified
    if bound > 0.5:
        return Outcome(math.isfinite(drift), "finite", "finite")
    return within(drift, bound, "invariant" if twist else "energy")


def growth(sim: Sim, phase: float, precision: str) -> Outcome:
    """Beyond the limit the amplitude grows by the larger root of ρ² + (φ² - 2)ρ + 1, each step."""
    half = phase**2 / 2 - 1
    rate = half + math.sqrt(half**2 - 1)
    big = 1e25 if precision == "f32" else 1e150
    last, ratio = abs(float(sim.qvel[0])), 0.0
    try:
        for _ in range(400):
            sim.step()
            now = abs(float(sim.qvel[0]))
            last, ratio = now, now / last if last else 0.0
            if now > big:
                break
        if rate > 1.1 or not abs(ratio / rate - 1) < 1e3 * EPS[precision]:
            sim.step(100_000)
    except SimulationError as error:
        return named_error(error, "spring")
    if rate > 1.1:
        return Outcome(False, "no error", "growth until an error names the spring")
    return Outcome(True, f"gain x{ratio:.3f}", "growth")
