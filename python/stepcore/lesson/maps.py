"""The lesson's maps of stability: a spring by integrator, and a heavy ball on a light one by law.

`stepcore.stability_map` draws them. Beside them stands theory: the largest stable step of a linear
system, and what too few sweeps do to a stack.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepcore.engine.linear_maps import INTEGRATORS, step_matrix
from stepcore.engine.model import Model
from stepcore.lesson import scenes
from stepcore.lesson.scenes import RADIUS, G

# Spectral radius above which motion grows: rounding moves a double eigenvalue by the square root of
# rounding.
GROWING = 1.0 + 1e-6
# A function from the values of the grid to the limits of dt [s].
Boundary = Callable[[Sequence[float]], list[float]]
GROWS = "motion grows beyond"


@dataclass
class MapSetting:
    """The settings of one panel of a map, with their theory.

    settings: an integrator, and other settings that make a scene of its own.
    boundary: the theoretical limit of dt [s] for each value. beyond: what happens beyond it.
    """

    label: str
    settings: dict[str, Any] = field(default_factory=dict)
    boundary: Boundary | None = None
    beyond: str = ""


@dataclass
class MapCase:
    """A map to make: a scene, the parameter that is varied, and the grid.

    model: None for a scene that MuJoCo alone can load. axis: the label of the parameter's axis.
    horizon: the simulated time [s], by default that of any map. size: the length that errors are
    relative to [m], by default the scene's. period: which the steps divide [s].
    truth: settings of the scene whose motion is the true one for all panels; None for each panel's
    own.
    """

    model: Model | None
    path: str
    axis: str
    values: list[float]
    dts: list[float]
    settings: list[MapSetting]
    key: str | int | None
    horizon: float | None = None
    size: float | None = None
    period: float | None = None
    truth: dict[str, Any] | None = None


def largest_stable_dt(
    integrator: str,
    mass: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    implicit: np.ndarray,
) -> float:
    """Return the dt [s] beyond which the motion grows: 0 if always, inf if never."""

    def grows(dt: float) -> bool:
        matrix = step_matrix(integrator, dt, mass, stiffness, damping, implicit)
        return bool(np.abs(np.linalg.eigvals(matrix)).max() > GROWING)

    rates = np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)))
    drags = np.abs(np.linalg.eigvals(np.linalg.solve(mass, damping)))
    fastest = max(float(np.sqrt(rates.max())), float(drags.max()))
    if fastest == 0.0:
        return np.inf
    steps = np.geomspace(2e-2, 1e3, 200) / fastest
    first = next((k for k, dt in enumerate(steps) if grows(dt)), None)
    if not first:
        return 0.0 if first == 0 else np.inf
    low, high = steps[first - 1], steps[first]
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if grows(middle) else (middle, high)
    return float(low)


# ω·dt at the stability limit of an undamped motion.
PHASE = dict.fromkeys(("semi-implicit", "euler", "implicitfast", "implicit"), "2") | {"rk4": "2√2"}


def divisors(period: float, dts: np.ndarray) -> list[float]:
    """Return the steps nearest to some that divide a period [s], ascending: runs can be compared.

    >>> divisors(0.2, np.array([0.04, 0.07, 0.1]))
    [0.04, 0.06666666666666667, 0.1]
    """
    counts = {round(period / dt) for dt in dts.tolist()}
    return [period / count for count in sorted(counts, reverse=True)]


def spring() -> MapCase:
    """Return the lesson's map of a mass on a spring: stiffness against dt, by integrator."""

    def boundary(stiffness: float, integrator: str) -> float:
        one, none = np.eye(1), np.zeros((1, 1))
        return largest_stable_dt(integrator, one, stiffness * one, none, none)

    settings = []
    for name in INTEGRATORS:
        beyond = f"{GROWS} ω dt = {PHASE[name]}" if name in PHASE else GROWS
        settings.append(MapSetting(name, {"integrator": name}, _each(boundary, name), beyond))
    return MapCase(
        model=scenes.spring().compile(),
        path="joint/spring/stiffness",
        axis="stiffness [N/m]",
        values=np.geomspace(1.0, 1e6, 19).tolist(),
        dts=divisors(0.2, np.geomspace(1e-4, 1e-1, 25)),
        settings=settings,
        key="start",
        horizon=2.5,
        period=0.2,
        # It swings from 1 m to -1 m.
        size=2.0,
    )


PENALTY, RATIO = 1e6, 0.1  # of the contact springs: stiffness [N/m], and damping
BETA: float = scenes.PLAIN["beta"]
# Errors of the stack are relative to a tenth of its balls' radius [m].
SMALL = RADIUS / 10
SINKS = "sinks too deep at rest beyond"
BOUNCES = "warm-started impulses grow beyond"


def stack(depth: float) -> MapCase:
    """Return the map of a ball at rest on a ball of 1 kg: upper mass against dt, by contact law.

    All laws are compared with rigid balls. depth: the error above which a run is inaccurate [m].
    """
    scene = scenes.tower([1.0, 1.0])
    # The balls overlap slightly, because a row exists only if the guess overlaps: balls that only
    # touch and fall together would separate in the first step.
    scene.add_key("start", qpos=[-1e-6, -2e-6])
    scene.name = "stack"
    scene.options = {"integrator": "semi-implicit", "solver": "pgs", "tolerance": 0.0}
    model = scene.compile()
    rest = {"law": "rigid", "beta": BETA, "acceleration": "none"}
    cold, warm = rest | {"warm_start": False}, rest | {"warm_start": True, "sweeps": 4}
    penalty = {"penalty_stiffness": PENALTY, "penalty_damping_ratio": RATIO}
    settings = [
        MapSetting(
            f"penalty, {PENALTY:.0e} N/m", {"law": "penalty", **penalty}, _each(penalised), GROWS
        ),
        *(
            MapSetting(
                f"rows, {n} sweeps, cold", cold | {"sweeps": n}, _each(sinking, n, depth), SINKS
            )
            for n in (4, 64)
        ),
        MapSetting("rows, 4 sweeps, warm", warm, _each(warm_starting, 4), BOUNCES),
    ]
    return MapCase(
        model,
        path="geom/shape1/mass",
        axis="mass ratio, heavy on light",
        values=np.geomspace(1.0, 1e3, 16).tolist(),
        dts=divisors(0.06, np.geomspace(1e-4, 3e-2, 21)),
        settings=settings,
        key="start",
        # An under-solved stack that launches itself needs 3 s to move far.
        horizon=3.0,
        size=SMALL,
        period=0.06,
        truth=rest,
    )


def penalised(ratio: float) -> float:
    """Return the largest stable dt of two balls on contact springs, if both contacts are closed.

    Each contact has a stiffness k and an explicit damping 2 ratio √(k / A), A = J M⁻¹ Jᵀ
    (docs/method.md).
    """
    rows, mass = np.array([[1.0, 0.0], [-1.0, 1.0]]), np.diag([1.0, ratio])
    easy = np.diag(rows @ np.linalg.inv(mass) @ rows.T)
    damping = rows.T @ np.diag(2 * RATIO * np.sqrt(PENALTY / easy)) @ rows
    stiffness = PENALTY * rows.T @ rows
    return largest_stable_dt("semi-implicit", mass, stiffness, damping, np.zeros((2, 2)))


def _each(limit: Callable[..., float], *further: Any) -> Boundary:
    return lambda values: [limit(value, *further) for value in values]


def _sweeps(ratio: float, sweeps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A = J M⁻¹ Jᵀ, and Gⁿ, the factor of n sweeps on an error of the impulses.

    A Gauss-Seidel sweep maps an error e to G e, where G = −(L + D)⁻¹U and A = L + D + U.
    """
    row = np.array([[1.0, -1.0], [-1.0, 1.0 + 1.0 / ratio]])
    once = -np.linalg.solve(np.tril(row), np.triu(row, 1))
    return row, np.linalg.matrix_power(once, sweeps)


def sinking(ratio: float, sweeps: int, depth: float) -> float:
    """Return the dt [s] at which too few sweeps let the balls sink by `depth` [m], at rest.

    Sweeps from zero impulses end with λ = (1 − Gⁿ) λ*. At rest λ equals the weight, so the rows
    must demand more than the weight: velocities β d / dt that push overlaps d out.
    """
    row, left = _sweeps(ratio, sweeps)
    # Per dt: the weight on each row, and the velocity of the guess along the row.
    weight = G * np.array([1.0 + ratio, ratio])
    sunk = (row @ np.linalg.solve(np.eye(2) - left, weight) - [G, 0.0]) / BETA
    deepest = max(sunk[0], sunk.sum())
    return float(np.sqrt(depth / deepest)) if deepest > 0 else np.inf


def warm_starting(ratio: float, sweeps: int) -> float:
    """Return 0 if warm-started impulses grow from step to step, else inf: dt has no effect.

    With closed contacts a step is linear in relative velocities w, overlaps p / dt and impulses λ:
    λ⁺ = Gⁿ λ + (1 − Gⁿ) λ*, A λ* = −β p / dt − w, then w⁺ = w + A λ⁺ and p⁺ = p + dt w⁺.
    """
    row, left = _sweeps(ratio, sweeps)
    one = np.eye(2)
    solved = -(one - left) @ np.linalg.inv(row)
    # One block row for each quantity; w⁺ and p⁺/dt follow from λ⁺.
    change = np.hstack([solved, BETA * solved, left])
    kept = np.hstack([one, np.zeros((2, 4))])
    after = kept + row @ change
    moved = np.hstack([np.zeros((2, 2)), one, np.zeros((2, 2))]) + after
    radius = np.abs(np.linalg.eigvals(np.vstack([after, moved, change]))).max()
    return 0.0 if radius > GROWING else np.inf
