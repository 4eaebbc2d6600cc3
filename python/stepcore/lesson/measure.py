"""The lesson's figures: one function for each, on either engine.

The argument `make` of these functions makes a Sim of a Scene, at key "start" (see `run.maker`).
Units are SI units; `k` is a stiffness, `time` a simulated time, `masses` go from the floor
up, and `sweeps` are the solver's in each step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from stepcore.lesson.scenes import HEIGHT, G, drop, grasp, slip, spring, stack


def first_body_path(sim: Any, steps: int) -> np.ndarray:
    """Make some steps; return position and velocity of the first body after each, (2, steps)."""
    points = []
    for _ in range(steps):
        sim.step()
        points.append((float(sim.qpos[0]), float(sim.qvel[0])))
    return np.array(points).T


def run_for(make: Any, scene: Any, time: float) -> Any:
    """Return the Sim of a scene after some time."""
    sim = make(scene)
    sim.step(round(time / scene.options["dt"]))
    return sim


def spring_energy(make: Any, integrator: str, k: float = 100.0, time: float = 20.0) -> float:
    """Return the final energy of a mass on a spring stretched by 1 m, over its initial energy."""
    sim = run_for(make, spring(k, integrator=integrator), time)
    return 0.5 * float(sim.qvel[0] ** 2 + k * sim.qpos[0] ** 2) / (0.5 * k)


def spring_invariant(make: Any, k: float = 100.0, steps: int = 2000) -> float:
    """Return the largest relative change of semi-implicit Euler's v² + k x² - dt k x v, at 1 kg."""
    scene = spring(k)
    x, v = first_body_path(make(scene), steps)
    values = v * v + k * x * x - scene.options["dt"] * k * x * v
    # At the start x = 1 m and v = 0.
    return float(np.abs(values / k - 1).max())


class Bounce(NamedTuple):
    """The motion of a ball dropped on a penalty floor.

    deepest: the largest overlap [m].
    flight: the largest energy in flight, where the contact stores none, relative to m·g·h. A
        passive scene must not gain energy.
    counted: the largest energy, contact spring included, relative to m·g·h.
    rebound: the largest height after the first impact [m].
    """

    deepest: float
    flight: float
    counted: float
    rebound: float


def bounce(make: Any, k: float, time: float = 2.0) -> Bounce:
    """Drop the ball on a penalty floor with damping ratio 0.1, and measure its motion."""
    scene = drop("penalty", penalty_stiffness=k, penalty_damping_ratio=0.1)
    y, v = first_body_path(make(scene), round(time / scene.options["dt"]))
    energy = 0.5 * v * v + G * y
    counted = (energy + 0.5 * k * np.minimum(y, 0.0) ** 2) / (G * HEIGHT)
    flight, rebound = energy[y >= 0] / (G * HEIGHT), y[np.maximum.accumulate(y < 0)]
    return Bounce(*(float(each.max(initial=0.0)) for each in (-y, flight, counted, rebound)))


def impact_depth(make: Any, k: float, dt: float = 1e-6) -> float:
    """Return the largest overlap [m] of a ball with the drop's speed, without damping."""
    sim = make(drop("penalty", penalty_stiffness=k, penalty_damping_ratio=0.0, dt=dt))
    sim.qpos[0], sim.qvel[0] = 0.0, -math.sqrt(2 * G * HEIGHT)
    deepest = 0.0
    while sim.qvel[0] < 0:
        sim.step()
        deepest = max(deepest, -float(sim.qpos[0]))
    return deepest


def stack_depths(
    make: Any, time: float, sweeps: int, law: str, softness: float
) -> tuple[float, float]:
    """Return the overlaps of the lower and the upper contact of two balls after some time [m]."""
    sim = run_for(make, stack(sweeps, law, softness=softness), time)
    lower, upper = (float(q) for q in sim.qpos[:2])
    return -lower, lower - upper


def statics(masses: Sequence[float], dt: float) -> Any:
    """Return the exact impulse at each contact of a resting tower: the weight above it, in dt."""
    return G * dt * np.cumsum(np.asarray(masses, float)[::-1])[::-1]


def error_after(make: Any, masses: Sequence[float], sweeps: int) -> float:
    """Return the largest relative error of a resting tower's impulses after some cold sweeps.

    Each contact overlaps by 1 nm, which is less than the slop: every contact has a row, and no row
    corrects the overlap.
    """
    scene = stack(sweeps, "rigid", masses, slop=1e-6)
    sim = make(scene)
    sim.qpos[:] = -1e-9 * np.arange(1, len(masses) + 1)
    sim.forward()
    exact = statics(masses, scene.options["dt"])
    return float(np.max(np.abs(np.asarray(sim.rows["impulse"]) / exact - 1)))


def contraction(make: Any, masses: Sequence[float], after: int, over: int = 5) -> float:
    """Return the factor by which one more sweep multiplies the error.

    after: sweeps before the measurement. over: sweeps over which the factor is averaged.
    """
    before, later = (error_after(make, masses, n) for n in (after, after + over))
    return float((later / before) ** (1 / over))


def sweeps_for(make: Any, masses: Sequence[float], after: int, error: float) -> float:
    """Return the number of sweeps that reduce the error to a share, by measured contraction."""
    # Averaging over many sweeps gives a contraction near 1 enough digits.
    return math.log(error) / math.log(contraction(make, masses, after, over=after))


def hold(make: Any, steps: int, **changes: Any) -> tuple[str, float]:
    """Run the grasp, and return its numbers of rows and the slip of the cube [m].

    The text has the numbers of normal rows, friction rows and limit rows. changes: arguments of
    `grasp`.
    """
    sim = make(grasp(**changes))
    start = np.array(sim.qpos)
    sim.step(steps)
    kinds, blocks = np.asarray(sim.rows["kind"]), np.asarray(sim.rows["block"])
    # A contact counts as one normal row, and both friction directions together as one row.
    pushes = len(np.unique(blocks[kinds == "contact"]))
    slidings = ((kinds == "contact").sum() - pushes) // 2
    return f"{pushes} {slidings} {(kinds == 'limit').sum()}", slip(sim, start)
