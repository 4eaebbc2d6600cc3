"""Stability theory for the maps: the largest stable dt of a linear system, and the lesson's two
maps.

The lesson maps a spring by integrator, and a heavy ball on a light ball by contact law.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from stepcore.engine.linear_maps import INTEGRATORS, implicit_kinds, step_matrix
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.lesson import scenes
from stepcore.lesson.scenes import RADIUS, G
from stepcore.measure.stability.result import Tolerance
from stepcore.measure.stability.runs import Form, Step

# Spectral radius above which motion grows: rounding moves a double eigenvalue by the square root of
# rounding.
GROWING = 1.0 + 1e-6
# Kinds of elements in the linear system of a scene.
LINEAR = ("spring", "damper", "actuator")
# A function from the values of the grid to the limits of dt [s].
Boundary = Callable[[Sequence[float]], list[float]]


@dataclass
class MapSetting:
    """The settings of one panel, with their theory.

    form: the closed form of the motion; None for a converged run.
    boundary: the theoretical limit of dt [s] for each value.
    beyond: the behaviour beyond the boundary.
    """

    label: str
    settings: dict[str, Any] = field(default_factory=dict)
    form: Form | None = None
    boundary: Boundary | None = None
    beyond: str = ""


@dataclass
class MapCase:
    """A scene, the parameter that is varied, and the grid.

    axis: the label of the parameter's axis.
    size: the length that errors are relative to [m].
    accuracies: those asked for over a run [m]; then dts is the control period alone.
    """

    model: Model
    path: str
    axis: str
    values: list[float]
    dts: list[float]
    settings: list[MapSetting]
    key: str | int | None
    horizon: float | None = None
    size: float | None = None
    accuracies: list[float] = field(default_factory=list)

    @property
    def steps(self) -> list[Step]:
        """The steps of each value's cells."""
        if self.accuracies:
            return [Step(self.dts[0], asked) for asked in self.accuracies]
        return [Step(dt) for dt in self.dts]


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
    if grows(steps[0]):
        return 0.0
    first = next((k for k, dt in enumerate(steps) if grows(dt)), None)
    if first is None:
        return np.inf
    low, high = steps[first - 1], steps[first]
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if grows(middle) else (middle, high)
    return float(low)


def limit_of_springs(model: Model, key: str | int | None, integrator: str) -> float | None:
    """Return the largest stable dt of a scene's joint springs, dampers and servos at its start [s].

    None if the scene has none of these elements. Contacts, limits, gravity and Coriolis terms are
    left out.
    """
    sim = unwatched(Sim(model))
    sim.reset(key=key)
    slopes = {e: s for e, s in sim.element_slopes().items() if e.kind in LINEAR}
    implicit = implicit_kinds(integrator, model.scene.features.eulerdamp)
    none = np.zeros((model.nv, model.nv))
    stiffness = sum((s.stiffness for s in slopes.values()), none)
    damping = sum((s.damping for s in slopes.values()), none)
    late = sum((s.damping for e, s in slopes.items() if e.kind in implicit), none)
    if not (stiffness.any() or damping.any()):
        return None
    return largest_stable_dt(integrator, sim.mass_matrix(), stiffness, damping, late)


GROWS = "motion grows beyond"
# ω·dt at the stability limit of an undamped motion.
PHASE = {"semi-implicit": "2", "euler": "2", "implicitfast": "2", "implicit": "2"}
PHASE["rk4"] = "2√2"


def spring(size: float | None) -> MapCase:
    """Return the lesson's map of a mass on a spring: stiffness against dt, by integrator."""
    model = scenes.spring().compile()
    # Radius of gyration: the inertia is 1 kg·m² about every axis.
    radius = np.sqrt(1.5)

    def motion(stiffness: float, times: np.ndarray) -> np.ndarray:
        points = np.zeros((len(times), 1, 4, 3))
        points[..., 0] = np.cos(np.sqrt(stiffness) * times)[:, None, None]
        points[:, 0, 1:] += radius * np.eye(3)
        return points

    def boundary(integrator: str, values: Sequence[float]) -> list[float]:
        one, none = np.eye(1), np.zeros((1, 1))
        return [largest_stable_dt(integrator, one, value * one, none, none) for value in values]

    settings = []
    for name in INTEGRATORS:
        beyond = f"{GROWS} ω dt = {PHASE[name]}" if name in PHASE else GROWS
        chosen = {"integrator": name}
        settings.append(MapSetting(name, chosen, motion, partial(boundary, name), beyond))
    values = np.geomspace(1.0, 1e6, 19).tolist()
    dts = np.geomspace(1e-4, 1e-1, 25).tolist()
    path, axis = "joint/spring/stiffness", "stiffness [N/m]"
    return MapCase(model, path, axis, values, dts, settings, "start", 2.5, size)


PENALTY = 1e6  # [N/m]
RATIO = 0.1
BETA = 0.2
SINKS = "sinks too deep at rest beyond"
BOUNCES = "warm-started impulses grow beyond"


def stack(tolerance: Tolerance, size: float | None) -> MapCase:
    """Return the map of a ball at rest on a ball of 1 kg: upper mass against dt, by contact law.

    tolerance: the tolerance of the map.
    size: the length that errors are relative to [m]; by default a tenth of the balls' radius.
    """
    size = RADIUS / 10 if size is None else size
    depth = tolerance.share(size) * size
    scene = scenes.tower([1.0, 1.0])
    # The balls overlap slightly, because a row exists only if the guess overlaps: balls that only
    # touch and fall together would separate in the first step.
    scene.add_key("start", qpos=[-1e-6, -2e-6])
    scene.name = "stack"
    scene.options = {"integrator": "semi-implicit", "solver": "pgs", "tolerance": 0.0}
    model = scene.compile()
    rest = {"law": "rigid", "beta": BETA, "acceleration": "none"}
    penalty = {
        "law": "penalty",
        "penalty_stiffness": PENALTY,
        "penalty_damping_ratio": RATIO,
    }
    settings = [
        MapSetting(f"penalty, {PENALTY:.0e} N/m", penalty, None, penalised, GROWS),
        *(
            MapSetting(
                f"rows, {sweeps} sweeps, cold",
                rest | {"sweeps": sweeps, "warm_start": False},
                at_rest,
                partial(_each, partial(sinking, sweeps=sweeps, depth=depth)),
                SINKS,
            )
            for sweeps in (4, 64)
        ),
        MapSetting(
            "rows, 4 sweeps, warm",
            rest | {"sweeps": 4, "warm_start": True},
            at_rest,
            partial(_each, partial(warm_starting, sweeps=4)),
            BOUNCES,
        ),
    ]
    values = np.geomspace(1.0, 1e3, 16).tolist()
    dts = np.geomspace(1e-4, 3e-2, 21).tolist()
    path, axis = "geom/shape1/mass", "mass ratio, heavy on light"
    # An under-solved stack that launches itself needs 3 s to move far.
    return MapCase(model, path, axis, values, dts, settings, "start", 3.0, size)


def at_rest(ratio: float, times: np.ndarray) -> np.ndarray:
    """Return the constant points of two rigid balls that touch at rest."""
    around = RADIUS * np.sqrt(0.6) * np.vstack([np.zeros(3), np.eye(3)])
    points = np.zeros((2, 4, 3)) + around
    points[:, :, 2] += RADIUS * np.array([[1.0], [3.0]])
    return np.broadcast_to(points, (len(times), 2, 4, 3)).copy()


def penalised(values: Sequence[float]) -> list[float]:
    """Return the largest stable dt of two balls on contact springs, if both contacts are closed.

    Each contact has a stiffness k and an explicit damping 2 ratio √(k / A), A = J M⁻¹ Jᵀ
    (docs/method.md).
    """
    rows = np.array([[1.0, 0.0], [-1.0, 1.0]])
    limits = []
    for ratio in values:
        mass = np.diag([1.0, ratio])
        easy = np.diag(rows @ np.linalg.inv(mass) @ rows.T)
        damping = rows.T @ np.diag(2 * RATIO * np.sqrt(PENALTY / easy)) @ rows
        stiffness = PENALTY * rows.T @ rows
        none = np.zeros((2, 2))
        limits.append(largest_stable_dt("semi-implicit", mass, stiffness, damping, none))
    return limits


def _each(limit: Callable[[float], float], values: Sequence[float]) -> list[float]:
    return [limit(value) for value in values]


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
