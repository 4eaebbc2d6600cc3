"""A ball on a floor and on another ball: resting depth, the trap of penalties, convergence."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

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
from stepcore.lesson import measure, scenes
from stepcore.lesson.scenes import RADIUS, G

MASSES = {f"m {m:.0e}": m for m in (1e-6, 1e-3, 1.0, 1e3, 1e6)}
STIFFNESSES = {f"k {k:.0e}": k for k in (1.0, 1e3, 1e6, 1e9, 1e12)}
RATIOS = {f"top/bottom {ratio:.0e}": ratio for ratio in (1e-6, 1e-3, 1.0, 1e3, 1e6)}
SWEEPS = (0, 1, 2, 5, 10, 100, 1000)
SOFTNESS, BETA, DAMPING = 0.5, 0.2, 0.1


def cases() -> Iterator[Case]:
    """A soft constraint, a penalty and a stack."""
    yield from table_cases(
        "drop on a soft constraint",
        f"rest at depth s m g dt²/β, s = {SOFTNESS} 1/kg, β = {BETA}; shown: the relative error",
        rest,
        TIME_STEPS,
        MASSES,
    )
    yield from table_cases(
        "drop on a penalty",
        f"rest at depth m g/k while (ω dt)² + 4 ζ ω dt < 4, ζ = {DAMPING}; beyond, energy is "
        "gained; shown: the largest excursion over the initial displacement",
        penalty,
        TIME_STEPS,
        STIFFNESSES,
    )
    yield from table_cases(
        "stack of two",
        "each sweep leaves m_top/(m_top + m_bottom) of the error, with 0 sweeps free fall; shown: "
        "the remaining error",
        stack,
        {f"dt {dt:.0e}, {n} sweeps": (dt, n) for dt in (1e-6, 1e-3, 1e-1) for n in SWEEPS},
        RATIOS,
    )


def position_rounding(precision: str) -> float:
    """What the distance of two surfaces is rounded to [m]: the ball's centre is 0.1 m high."""
    return EPS[precision] * RADIUS


def rest(dt: float, m: float, precision: str) -> Outcome:
    """A ball of m [kg] under the law `lesson`, at rest or on the way there."""
    scene = scenes.drop(m=m, dt=dt, softness=SOFTNESS, beta=BETA, precision=precision)
    sim = unwatched(Sim(scene.compile()))
    sim.reset("start")
    depth, slow = SOFTNESS * m * G * dt**2 / BETA, 1 + SOFTNESS * m
    # It settles as (1 - 1/slow)^(n/2) or (1 - β)^n; where that takes too long, it starts at rest
    # and must stay there.
    settles = slow < 600
    sim.qpos[0] = 0.0 if settles else -depth
    sim.step(int(80 * slow + 40 / BETA) if settles else 2000)
    error = abs(float(sim.qpos[0]) + depth)
    bound = 100 * EPS[precision] * slow * depth + 8 * position_rounding(precision)
    outcome = within(error / max(depth, bound), bound / max(depth, bound), "depth")
    return outcome if depth > bound else within(error, bound, "depth within rounding", "<ulp")


def penalty(dt: float, k: float, precision: str) -> Outcome:
    """1 kg on a floor spring k [N/m], put a thousandth off its rest."""
    settings = {"penalty_stiffness": k, "penalty_damping_ratio": DAMPING}
    sim = unwatched(Sim(scenes.drop("penalty", dt=dt, precision=precision, **settings).compile()))
    depth, phase = G / k, math.sqrt(k) * dt
    stable = phase**2 + 4 * DAMPING * phase < 4
    ulp = position_rounding(precision)
    push = max(1e-3 * depth, 4 * ulp)
    sim.qpos[0] = -depth - push
    farthest, most = 0.0, 0.0
    # The energy of the push, or what one rounding of the overlap puts in.
    scale = 0.5 * k * max(push, 2 * ulp) ** 2
    try:
        for _ in range(1500):
            sim.step()
            y, v = float(sim.qpos[0]), float(sim.qvel[0])
            farthest = max(farthest, abs(y + depth))
            if not stable and farthest > 1e3 * push:
                return Outcome(True, "gain", "gains energy beyond the limit")
            most = max(most, 0.5 * v * v)
    except SimulationError as error:
        return named_error(error)
    if not stable:
        return Outcome(False, "no gain", "gains energy beyond the limit")
    if depth < 16 * ulp:
        # A depth that the numbers do not resolve: no more than the energy of roundings.
        return within(most / scale, 64.0, "energy within rounding", "<ulp")
    return within(farthest / push, 1.6, "stays at its depth")


def stack(row: tuple[float, int], ratio: float, precision: str) -> Outcome:
    """Impulses after cold sweeps against the exact iterates of Gauss-Seidel on two balls.

    row: the time step [s] and the number of sweeps.

    Rows floor, ball on ball. With q = m_top/(m_top + m_bottom) and e the error of the upper
    impulse at the start, after n sweeps e_upper = qⁿ e and e_floor = qⁿ⁻¹ e.
    """
    (dt, sweeps), bottom, top = row, 1.0, ratio
    settings = {"slop": 1e-4, "dt": dt, "precision": precision}
    sim = unwatched(Sim(scenes.stack(sweeps, "rigid", (bottom, top), **settings).compile()))
    # Overlaps within the slop, so that both rows exist and neither pushes apart.
    sim.qpos[:] = (-1e-5, -2e-5)
    sim.forward()
    if sweeps == 0:
        fall = float(np.max(np.abs(np.asarray(sim.qacc) / -G - 1)))
        return within(fall, 16 * EPS[precision], "free fall")
    exact = measure.statics((bottom, top), dt)
    q, start = top / (top + bottom), -exact[1]
    expected = exact + start * np.array([q ** (sweeps - 1), q**sweeps])
    got = np.asarray(sim.rows["impulse"])
    left = float(np.max(np.abs(got / exact - 1)))
    # A sweep rounds once an update; a row's velocity is the difference of two large ones.
    bound = 16 * EPS[precision] * min(sweeps, 1 / (1 - q) if q < 1 else sweeps) * exact[0]
    miss = float(np.max(np.abs(got - expected)))
    outcome = within(miss, bound + 16 * EPS[precision] * exact[0], "contraction")
    return Outcome(outcome.ok, f"left {left:.0e}" if outcome.ok else outcome.text, "contraction")
