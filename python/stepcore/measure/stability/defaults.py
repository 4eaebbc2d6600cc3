"""The maps of the lesson: its spring under every integrator, and a heavy ball on a light one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from stepcore import lesson
from stepcore.engine.model import Model
from stepcore.lesson.scenes import RADIUS, G, tower
from stepcore.measure.stability import theory
from stepcore.measure.stability.course import Bodies
from stepcore.measure.stability.truth import Form

# A boundary in dt [s], a value of the grid each.
Boundary = Callable[[Sequence[float]], list[float]]


@dataclass
class Setting:
    """What one panel runs, and what is known of it. truth: None for a converged run."""

    label: str
    settings: dict[str, Any] = field(default_factory=dict)
    truth: Form | None = None
    boundary: Boundary | None = None
    says: str = ""


@dataclass
class Case:
    """A scene, the value that is varied, and the grid. size: what errors are relative to [m]."""

    model: Model
    path: str
    words: str
    values: list[float]
    dts: list[float]
    settings: list[Setting]
    key: str | int | None
    horizon: float | None = None
    size: float | None = None


INTEGRATORS = ("explicit", "semi-implicit", "euler", "implicitfast", "midpoint", "rk4")
STABLE = "motion grows beyond"
# ω·dt at that boundary, undamped, where there is one.
PHASE = {"semi-implicit": "2", "euler": "2", "implicitfast": "2", "rk4": "2√2"}


def spring(size: float | None) -> Case:
    """The lesson's mass on a spring: stiffness against dt, by integrator."""
    model = lesson.spring().compile()
    bodies = Bodies(model)

    def truth(stiffness: float, times: np.ndarray) -> np.ndarray:
        points = np.zeros((len(times), 1, 4, 3))
        points[..., 0] = np.cos(np.sqrt(stiffness) * times)[:, None, None]
        points[:, 0, 1:] += bodies.radius[0] * np.eye(3)
        return points

    def boundary(integrator: str) -> Boundary:
        def of(values: Sequence[float]) -> list[float]:
            one, none = np.eye(1), np.zeros((1, 1))
            return [theory.limit(integrator, one, value * one, none, none) for value in values]

        return of

    def says(integrator: str) -> str:
        phase = PHASE.get(integrator)
        return f"{STABLE} ω dt = {phase}" if phase else STABLE

    settings = [
        Setting(name, {"integrator": name}, truth, boundary(name), says(name))
        for name in INTEGRATORS
    ]
    values = np.geomspace(1.0, 1e6, 19).tolist()
    dts = np.geomspace(1e-4, 1e-1, 25).tolist()
    words = "stiffness [N/m]"
    return Case(model, "joint/spring/stiffness", words, values, dts, settings, "start", 2.5, size)


PENALTY = 1e6  # [N/m]
RATIO = 0.1
BETA = 0.2
SINKS = "sinks too deep at rest beyond"
HOPS = "what is carried over grows beyond"


def stack(tolerance: float, size: float | None) -> Case:
    """A ball on a ball of 1 kg, at rest: the upper one's mass against dt, by how it is held.

    size: what errors are relative to [m]; by default a tenth of the balls' radius.
    """
    size = RADIUS / 10 if size is None else size
    scene = tower([1.0, 1.0])
    # A hair within one another: a row is there where the guess overlaps, and balls that only
    # touch and fall alike would part in the first step.
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
        Setting(f"penalty, {PENALTY:.0e} N/m", penalty, None, penalised, STABLE),
        Setting(
            "rows, 4 sweeps, cold",
            rest | {"sweeps": 4, "warm_start": False},
            at_rest,
            partial(_each, partial(sinking, sweeps=4, depth=tolerance * size)),
            SINKS,
        ),
        Setting(
            "rows, 64 sweeps, cold",
            rest | {"sweeps": 64, "warm_start": False},
            at_rest,
            partial(_each, partial(sinking, sweeps=64, depth=tolerance * size)),
            SINKS,
        ),
        Setting(
            "rows, 4 sweeps, warm",
            rest | {"sweeps": 4, "warm_start": True},
            at_rest,
            partial(_each, partial(carried, sweeps=4)),
            HOPS,
        ),
    ]
    values = np.geomspace(1.0, 1e3, 16).tolist()
    dts = np.geomspace(1e-4, 3e-2, 21).tolist()
    words = "mass ratio, heavy on light"
    path = "geom/shape1/mass"
    return Case(model, path, words, values, dts, settings, "start", 1.0, size)


def at_rest(ratio: float, times: np.ndarray) -> np.ndarray:
    """Rigid balls that touch stay where they are."""
    around = RADIUS * np.sqrt(0.6) * np.vstack([np.zeros(3), np.eye(3)])
    points = np.zeros((2, 4, 3)) + around
    points[:, :, 2] += RADIUS * np.array([[1.0], [3.0]])
    return np.broadcast_to(points, (len(times), 2, 4, 3)).copy()


def penalised(values: Sequence[float]) -> list[float]:
    """Where two balls on springs under their surfaces begin to shake, both contacts closed.

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
    """A = J M⁻¹ Jᵀ, and what so many sweeps leave of an error of the impulses: Gⁿ.

    One sweep of Gauss-Seidel takes an error e to G e, G = −(L + D)⁻¹U of A = L + D + U.
    """
    row = np.array([[1.0, -1.0], [-1.0, 1.0 + 1.0 / ratio]])
    once = -np.linalg.solve(np.tril(row), np.triu(row, 1))
    return row, np.linalg.matrix_power(once, sweeps)


def sinking(ratio: float, sweeps: int, depth: float) -> float:
    """The dt [s] at which unfinished sweeps let the balls sink by `depth` [m], at rest.

    Begun from zero, sweeps end with λ = (1 − Gⁿ) λ*. At rest λ is the weight, so the rows must
    ask for more than that: for the velocities β d / dt with which overlaps d are pushed out.
    """
    row, left = _sweeps(ratio, sweeps)
    # Per dt: the weight on each row, and the guess's velocity along it.
    weight = G * np.array([1.0 + ratio, ratio])
    sunk = (row @ np.linalg.solve(np.eye(2) - left, weight) - [G, 0.0]) / BETA
    deepest = max(sunk[0], sunk.sum())
    return float(np.sqrt(depth / deepest)) if deepest > 0 else np.inf


def carried(ratio: float, sweeps: int) -> float:
    """0 where impulses carried over from step to step grow, else inf: dt does not matter.

    With closed contacts a step is linear in relative velocities w, overlaps p / dt and impulses
    λ: λ⁺ = Gⁿ λ + (1 − Gⁿ) λ*, A λ* = −β p / dt − w, then w⁺ = w + A λ⁺ and p⁺ = p + dt w⁺.
    """
    row, left = _sweeps(ratio, sweeps)
    one = np.eye(2)
    solved = -(one - left) @ np.linalg.inv(row)
    # One line a quantity: w⁺ and p⁺/dt repeat what λ⁺ does to the velocities.
    change = np.hstack([solved, BETA * solved, left])
    kept = np.hstack([one, np.zeros((2, 4))])
    after = kept + row @ change
    moved = np.hstack([np.zeros((2, 2)), one, np.zeros((2, 2))]) + after
    radius = np.abs(np.linalg.eigvals(np.vstack([after, moved, change]))).max()
    return 0.0 if radius > theory.GROWS else np.inf
