"""The lesson's figures: one function each, on a Sim of either engine.

make: of a Scene, a Sim at its key "start" (see `run.maker`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepcore.lesson.scenes import HEIGHT, G, drop, grasp, slip, spring, stack


def spring_energy(make: Any, integrator: str, k: float = 100.0, steps: int = 2000) -> float:
    """Final energy of a mass on a spring over its initial energy."""
    sim = make(spring(k, integrator=integrator))
    start = _spring_energy(sim, k)
    sim.step(steps)
    return _spring_energy(sim, k) / start


def _spring_energy(sim: Any, k: float) -> float:
    return 0.5 * float(sim.qvel[0] ** 2 + k * sim.qpos[0] ** 2)


def spring_invariant(make: Any, k: float = 100.0, steps: int = 2000) -> float:
    """Largest relative change of v² + k x² - dt k x v (m = 1), semi-implicit Euler's invariant."""
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
    """A ball dropped on a penalty floor.

    deepest: the largest overlap [m]. flight: the largest energy in flight, counted: the largest
    with the spring's energy, both over that of the drop, m·g·h. rebound: the highest return [m].
    """

    deepest: float
    flight: float
    counted: float
    rebound: float

    @property
    def verdict_by_height(self) -> str:
        """The lesson's criterion: stable if it stays below 10 m."""
        return "stable" if self.rebound <= 10 else "exploded"

    @property
    def verdict_by_energy(self) -> str:
        """A passive scene may not gain energy; judged in flight, where the spring holds none."""
        return "stable" if self.flight <= 1.001 else "gains energy"


def bounce(make: Any, k: float, time: float = 2.0) -> Bounce:
    """The ball dropped on a floor of stiffness k [N/m] and damping ratio 0.1, for `time` [s]."""
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
    """Stiffness [N/m] that stops a drop of m [kg] within `depth` [m]; its largest stable dt [s].

    All of m g h goes into k d²/2; semi-implicit Euler is stable while dt < 2/ω.
    """
    k = 2 * m * G * HEIGHT / depth**2
    return k, 2 / math.sqrt(k / m)


def impact_depth(make: Any, k: float, dt: float = 1e-6) -> float:
    """Largest overlap [m] of a ball that arrives at the speed of the drop, without damping."""
    sim = make(drop("penalty", penalty_stiffness=k, penalty_damping_ratio=0.0, dt=dt))
    sim.qpos[0], sim.qvel[0] = 0.0, -math.sqrt(2 * G * HEIGHT)
    deepest = 0.0
    while sim.qvel[0] < 0:
        sim.step()
        deepest = max(deepest, -float(sim.qpos[0]))
    return deepest


def rest(make: Any, time: float, **changes: Any) -> float:
    """Height of the lesson's ball after `time` [s]; a negative height is overlap [m]."""
    scene = drop(**changes)
    sim = make(scene)
    sim.step(round(time / scene.options["dt"]))
    return float(sim.qpos[0])


def stack_depths(
    make: Any, time: float, sweeps: int, law: str, softness: float
) -> tuple[float, float]:
    """Overlap of the lower and the upper contact after `time` [s], in m."""
    scene = stack(sweeps, law, softness=softness)
    sim = make(scene)
    sim.step(round(time / scene.options["dt"]))
    lower, upper = (float(q) for q in sim.qpos[:2])
    return -lower, lower - upper


def equal(n: int) -> float:
    """Contraction per sweep of n equal balls on a floor: cos²(π/2n)."""
    return math.cos(math.pi / (2 * n)) ** 2


# name, masses from the floor up [kg], sweeps before measuring, contraction
STACKS: tuple[tuple[str, tuple[float, ...], int, float], ...] = (
    ("two equal balls", (1.0, 1.0), 10, 0.5),
    ("10 kg on 1 kg", (1.0, 10.0), 50, 10 / 11),
    ("1 kg on 10 kg", (10.0, 1.0), 2, 1 / 11),
    ("ten equal balls", (1.0,) * 10, 300, equal(10)),
)
# name, masses, sweeps before measuring, sweeps for an error of 1e-6
COUNTS: tuple[tuple[str, tuple[float, ...], int, int], ...] = (
    ("10 equal balls", (1.0,) * 10, 300, 558),
    ("100 equal balls", (1.0,) * 100, 5000, 55990),
    ("1000 kg on nine of 1 kg", (1.0,) * 9 + (1000.0,), 2000, 124715),
)


def statics(masses: Sequence[float], dt: float) -> Any:
    """Exact impulse of each contact of a resting tower: the weight above it, times dt [N·s]."""
    return G * dt * np.cumsum(np.asarray(masses, float)[::-1])[::-1]


def error_after(make: Any, masses: Sequence[float], sweeps: int) -> float:
    """Largest relative error of the impulses of a resting tower after some cold sweeps.

    The balls overlap by 1 nm, within the slop: every contact has a row, and none is pushed apart.
    """
    scene = stack(sweeps, "rigid", masses, slop=1e-6)
    sim = make(scene)
    sim.qpos[:] = -1e-9 * np.arange(1, len(masses) + 1)
    sim.forward()
    exact = statics(masses, scene.options["dt"])
    return float(np.max(np.abs(np.asarray(sim.rows["impulse"]) / exact - 1)))


def contraction(make: Any, masses: Sequence[float], after: int, over: int = 5) -> float:
    """Factor by which one more sweep reduces the error once `after` sweeps are done."""
    before, later = (error_after(make, masses, n) for n in (after, after + over))
    return float((later / before) ** (1 / over))


def sweeps_for(make: Any, masses: Sequence[float], after: int, error: float) -> float:
    """Sweeps that reduce an error by the factor `error`, from the measured contraction."""
    # Measured over many sweeps, so that a contraction near 1 has enough digits.
    return math.log(error) / math.log(contraction(make, masses, after, over=after))


def hold(make: Any, steps: int, **changes: Any) -> tuple[str, float]:
    """The grasp held for some steps: its rows that push, resist sliding and limit; the slip [m]."""
    sim = make(grasp(**changes))
    start = np.array(sim.qpos)
    sim.step(steps)
    kinds, blocks = np.asarray(sim.rows["kind"]), np.asarray(sim.rows["block"])
    # A contact counts as one push and, for both directions together, one row against sliding.
    pushes = len(np.unique(blocks[kinds == "contact"]))
    slidings = ((kinds == "contact").sum() - pushes) // 2
    return f"{pushes} {slidings} {(kinds == 'limit').sum()}", slip(sim, start)
