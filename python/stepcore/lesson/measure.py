"""The lesson's figures: one function for each, on either engine.

The argument `make` of these functions makes a Sim of a Scene, at key "start" (see `run.maker`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore.lesson.scenes import HEIGHT, G, drop, grasp, slip, spring, stack


def spring_energy(make: Any, integrator: str, k: float = 100.0, steps: int = 2000) -> float:
    """Return the final energy of a mass on a spring, divided by its initial energy.

    k: stiffness [N/m]. steps: the number of steps.
    """
    sim = make(spring(k, integrator=integrator))
    start = _spring_energy(sim, k)
    sim.step(steps)
    return _spring_energy(sim, k) / start


def _spring_energy(sim: Any, k: float) -> float:
    return 0.5 * float(sim.qvel[0] ** 2 + k * sim.qpos[0] ** 2)


def spring_invariant(make: Any, k: float = 100.0, steps: int = 2000) -> float:
    """Return the largest relative change of semi-implicit Euler's invariant.

    The invariant is v² + k x² - dt k x v, for a mass of 1 kg. k: stiffness [N/m].
    """
    scene = spring(k)
    sim, dt = make(scene), scene.options["dt"]
    values: list[float] = []
    for _ in range(steps + 1):
        x, v = float(sim.qpos[0]), float(sim.qvel[0])
        values.append(v * v + k * x * x - dt * k * x * v)
        sim.step()
    return max(abs(value / values[0] - 1) for value in values)


@dataclass
class Bounce:
    """The motion of a ball dropped on a penalty floor.

    deepest: the largest overlap [m].
    flight: the largest energy in flight, relative to the initial energy m·g·h.
    counted: the largest energy including that of the contact spring, relative to m·g·h.
    rebound: the largest height after the first impact [m].
    """

    deepest: float
    flight: float
    counted: float
    rebound: float

    @property
    def verdict_by_height(self) -> str:
        """The lesson's verdict: stable if the ball stays below 10 m."""
        return "stable" if self.rebound <= 10 else "exploded"

    @property
    def verdict_by_energy(self) -> str:
        """Verdict by energy in flight, where the contact spring stores none.

        A passive scene must not gain energy.
        """
        return "stable" if self.flight <= 1.001 else "gains energy"


def bounce(make: Any, k: float, time: float = 2.0) -> Bounce:
    """Drop the ball on a penalty floor with damping ratio 0.1, and measure its motion.

    k: stiffness of the floor [N/m]. time: simulated time [s].
    """
    scene = drop("penalty", penalty_stiffness=k, penalty_damping_ratio=0.1)
    sim, full = make(scene), G * HEIGHT
    got, touched = Bounce(0.0, 0.0, 0.0, 0.0), False
    for _ in range(round(time / scene.options["dt"])):
        sim.step()
        y, v = float(sim.qpos[0]), float(sim.qvel[0])
        energy = 0.5 * v * v + G * y
        touched = touched or y < 0
        got.deepest = max(got.deepest, -y)
        if y >= 0:
            got.flight = max(got.flight, energy / full)
        got.counted = max(got.counted, (energy + 0.5 * k * min(y, 0.0) ** 2) / full)
        if touched:
            got.rebound = max(got.rebound, y)
    return got


def stiff_enough(depth: float, m: float = 1.0) -> tuple[float, float]:
    """Return the stiffness [N/m] that stops the ball within a depth, and the largest stable dt [s].

    The stiffness follows from k d²/2 = m g h. Semi-implicit Euler is stable for dt < 2/ω.

    depth: d, the largest overlap [m]. m: mass of the ball [kg].
    """
    k = 2 * m * G * HEIGHT / depth**2
    return k, 2 / math.sqrt(k / m)


def impact_depth(make: Any, k: float, dt: float = 1e-6) -> float:
    """Return the largest overlap [m] of a ball that arrives at the drop's speed, without damping.

    k: stiffness of the floor [N/m]. dt: time step [s].
    """
    sim = make(drop("penalty", penalty_stiffness=k, penalty_damping_ratio=0.0, dt=dt))
    sim.qpos[0], sim.qvel[0] = 0.0, -math.sqrt(2 * G * HEIGHT)
    deepest = 0.0
    while sim.qvel[0] < 0:
        sim.step()
        deepest = max(deepest, -float(sim.qpos[0]))
    return deepest


def rest(make: Any, time: float, **changes: Any) -> float:
    """Return the height of the lesson's ball after some time [m]; overlap is negative.

    time: simulated time [s]. changes: arguments of `drop`.
    """
    scene = drop(**changes)
    sim = make(scene)
    sim.step(round(time / scene.options["dt"]))
    return float(sim.qpos[0])


def stack_depths(
    make: Any, time: float, sweeps: int, law: str, softness: float
) -> tuple[float, float]:
    """Return the overlaps of the lower and the upper contact of two balls after some time [m].

    time: simulated time [s]. sweeps, law, softness: settings of the scene.
    """
    scene = stack(sweeps, law, softness=softness)
    sim = make(scene)
    sim.step(round(time / scene.options["dt"]))
    lower, upper = (float(q) for q in sim.qpos[:2])
    return -lower, lower - upper


def equal(n: int) -> float:
    """Return the contraction per sweep of a stack of n equal balls: cos²(π/2n)."""
    return math.cos(math.pi / (2 * n)) ** 2


# Name, masses from the floor up [kg], sweeps before the measurement, contraction per sweep.
STACKS: tuple[tuple[str, tuple[float, ...], int, float], ...] = (
    ("two equal balls", (1.0, 1.0), 10, 0.5),
    ("10 kg on 1 kg", (1.0, 10.0), 50, 10 / 11),
    ("1 kg on 10 kg", (10.0, 1.0), 2, 1 / 11),
    ("ten equal balls", (1.0,) * 10, 300, equal(10)),
)
# Name, masses [kg], sweeps before the measurement, sweeps for an error of 1e-6.
COUNTS: tuple[tuple[str, tuple[float, ...], int, int], ...] = (
    ("10 equal balls", (1.0,) * 10, 300, 558),
    ("100 equal balls", (1.0,) * 100, 5000, 55990),
    ("1000 kg on nine of 1 kg", (1.0,) * 9 + (1000.0,), 2000, 124715),
)


def statics(masses: Sequence[float], dt: float) -> Any:
    """Return the exact impulse at each contact of a resting tower, from the floor up [N·s].

    The impulse is the weight of the balls above the contact, times dt [s]. masses: [kg].
    """
    return G * dt * np.cumsum(np.asarray(masses, float)[::-1])[::-1]


def error_after(make: Any, masses: Sequence[float], sweeps: int) -> float:
    """Return the largest relative error of a resting tower's impulses after some cold sweeps.

    Each contact overlaps by 1 nm, which is less than the slop: every contact has a row, and no row
    corrects the overlap.

    masses: from the floor up [kg]. sweeps: of the solver, without warm start.
    """
    scene = stack(sweeps, "rigid", masses, slop=1e-6)
    sim = make(scene)
    sim.qpos[:] = -1e-9 * np.arange(1, len(masses) + 1)
    sim.forward()
    exact = statics(masses, scene.options["dt"])
    return float(np.max(np.abs(np.asarray(sim.rows["impulse"]) / exact - 1)))


def contraction(make: Any, masses: Sequence[float], after: int, over: int = 5) -> float:
    """Return the factor by which one more sweep multiplies the error.

    masses: from the floor up [kg]. after: sweeps before the measurement. over: sweeps over which
    the factor is averaged.
    """
    before, later = (error_after(make, masses, n) for n in (after, after + over))
    return float((later / before) ** (1 / over))


def sweeps_for(make: Any, masses: Sequence[float], after: int, error: float) -> float:
    """Return the number of sweeps that reduce the error to a given share, by measured contraction.

    masses: from the floor up [kg]. after: sweeps before the measurement. error: the share.
    """
    # Averaging over many sweeps gives a contraction near 1 enough digits.
    return math.log(error) / math.log(contraction(make, masses, after, over=after))


def hold(make: Any, steps: int, **changes: Any) -> tuple[str, float]:
    """Run the grasp, and return its numbers of rows and the slip of the cube [m].

    The text has the numbers of normal rows, friction rows and limit rows.

    steps: the number of steps. changes: arguments of `grasp`.
    """
    sim = make(grasp(**changes))
    start = np.array(sim.qpos)
    sim.step(steps)
    kinds, blocks = np.asarray(sim.rows["kind"]), np.asarray(sim.rows["block"])
    # A contact counts as one normal row, and both friction directions together as one row.
    pushes = len(np.unique(blocks[kinds == "contact"]))
    slidings = ((kinds == "contact").sum() - pushes) // 2
    return f"{pushes} {slidings} {(kinds == 'limit').sum()}", slip(sim, start)
