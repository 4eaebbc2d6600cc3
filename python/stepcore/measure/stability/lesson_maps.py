"""The two maps of the lesson: its spring by integrator, and a heavy ball on a light one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from stepcore.engine.linear_maps import INTEGRATORS
from stepcore.engine.model import Model
from stepcore.lesson import scenes
from stepcore.lesson.scenes import RADIUS, G
from stepcore.measure.stability import theory
from stepcore.measure.stability.points import BodyPoints
from stepcore.measure.stability.reference import Form, Tolerance

# A boundary in dt [s] for each value of the grid.
Boundary = Callable[[Sequence[float]], list[float]]


@dataclass
class MapSetting:
    """What one panel runs, and its theory: the boundary, and what lies beyond it.

    form: the closed form of the motion; None for a converged run.
    """

    label: str
    settings: dict[str, Any] = field(default_factory=dict)
    form: Form | None = None
    boundary: Boundary | None = None
    beyond: str = ""


@dataclass
class MapCase:
    """A scene, the value that is varied, and the grid.

    axis: the value as an axis names it. size: what errors are relative to [m].
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


GROWS = "motion grows beyond"
# ω·dt at that boundary, undamped, where there is one.
PHASE = {"semi-implicit": "2", "euler": "2", "implicitfast": "2", "implicit": "2"}
PHASE["rk4"] = "2√2"


def spring(size: float | None) -> MapCase:
    """The lesson's mass on a spring: stiffness against dt, by integrator."""
    model = scenes.spring().compile()
    radius = BodyPoints(model).radius[0]

    def motion(stiffness: float, times: np.ndarray) -> np.ndarray:
        points = np.zeros((len(times), 1, 4, 3))
        points[..., 0] = np.cos(np.sqrt(stiffness) * times)[:, None, None]
        points[:, 0, 1:] += radius * np.eye(3)
        return points

    def boundary(integrator: str, values: Sequence[float]) -> list[float]:
        one, none = np.eye(1), np.zeros((1, 1))
        return [theory.limit(integrator, one, value * one, none, none) for value in values]

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
    """A ball on a ball of 1 kg, at rest: the upper one's mass against dt, by how contacts act.

    size: what errors are relative to [m]; by default a tenth of the balls' radius.
    """
    size = RADIUS / 10 if size is None else size
    depth = tolerance.share(size) * size
    scene = scenes.tower([1.0, 1.0])
    # They overlap slightly: a row exists where the guess overlaps, and balls that only touch and
    # fall alike would separate in the first step.
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
        MapSetting(
            "rows, 4 sweeps, cold",
            rest | {"sweeps": 4, "warm_start": False},
            at_rest,
            partial(_each, partial(sinking, sweeps=4, depth=depth)),
            SINKS,
        ),
        MapSetting(
            "rows, 64 sweeps, cold",
            rest | {"sweeps": 64, "warm_start": False},
            at_rest,
            partial(_each, partial(sinking, sweeps=64, depth=depth)),
            SINKS,
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
    return MapCase(model, path, axis, values, dts, settings, "start", 1.0, size)


def at_rest(ratio: float, times: np.ndarray) -> np.ndarray:
    """Rigid balls that touch stay where they are: the points of both."""
    around = RADIUS * np.sqrt(0.6) * np.vstack([np.zeros(3), np.eye(3)])
    points = np.zeros((2, 4, 3)) + around
    points[:, :, 2] += RADIUS * np.array([[1.0], [3.0]])
    return np.broadcast_to(points, (len(times), 2, 4, 3)).copy()


def penalised(values: Sequence[float]) -> list[float]:
    """The limit of two balls on contact springs, both contacts closed.

    k on each contact, and damping 2 ratio √(k / A) with A = J M⁻¹ Jᵀ (docs/method.md), explicit.
    """
    rows = np.array([[1.0, 0.0], [-1.0, 1.0]])
    limits = []
    for ratio in values:
        mass = np.diag([1.0, ratio])
        easy = np.diag(rows @ np.linalg.inv(mass) @ rows.T)
        damping = rows.T @ np.diag(2 * RATIO * np.sqrt(PENALTY / easy)) @ rows
        stiffness = PENALTY * rows.T @ rows
        none = np.zeros((2, 2))
        limits.append(theory.limit("semi-implicit", mass, stiffness, damping, none))
    return limits


def _each(limit: Callable[[float], float], values: Sequence[float]) -> list[float]:
    return [limit(value) for value in values]


def _sweeps(ratio: float, sweeps: int) -> tuple[np.ndarray, np.ndarray]:
    """A = J M⁻¹ Jᵀ, and the map of so many sweeps on an error of the impulses: Gⁿ.

    One sweep of Gauss-Seidel takes an error e to G e, G = −(L + D)⁻¹U of A = L + D + U.
    """
    row = np.array([[1.0, -1.0], [-1.0, 1.0 + 1.0 / ratio]])
    once = -np.linalg.solve(np.tril(row), np.triu(row, 1))
    return row, np.linalg.matrix_power(once, sweeps)


def sinking(ratio: float, sweeps: int, depth: float) -> float:
    """The dt [s] at which too few sweeps let the balls sink by `depth` [m], at rest.

    From zero, sweeps end with λ = (1 − Gⁿ) λ*. At rest λ is the weight, so the rows must
    ask for more than that: for the velocities β d / dt with which overlaps d are pushed out.
    """
    row, left = _sweeps(ratio, sweeps)
    # Per dt: the weight on each row, and the guess's velocity along it.
    weight = G * np.array([1.0 + ratio, ratio])
    sunk = (row @ np.linalg.solve(np.eye(2) - left, weight) - [G, 0.0]) / BETA
    deepest = max(sunk[0], sunk.sum())
    return float(np.sqrt(depth / deepest)) if deepest > 0 else np.inf


def warm_starting(ratio: float, sweeps: int) -> float:
    """0 where warm-started impulses grow from step to step, else inf: dt does not matter.

    With closed contacts a step is linear in relative velocities w, overlaps p / dt and impulses
    λ: λ⁺ = Gⁿ λ + (1 − Gⁿ) λ*, A λ* = −β p / dt − w, then w⁺ = w + A λ⁺ and p⁺ = p + dt w⁺.
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
    return 0.0 if radius > theory.GROWS else np.inf
