"""LQR from `Sim.linearize`: a pole on a cart stays up, and a push does not fell it.

The cart and pole of gymnasium, whose upright pose is unstable. The gain comes from one exact
linearisation and scipy's Riccati equation: pip install ".[gymnasium]" gymnasium[mujoco] scipy
"""

from __future__ import annotations

import time

import numpy as np
from scipy.linalg import solve_discrete_are

import stepcore as sc

HOLD = np.diag([10.0, 10.0, 1.0, 1.0])  # of place [m], angle [rad] and their rates
PUSH = 0.1


def gain(sim: sc.Sim) -> np.ndarray:
    """The feedback of x = (dq, dv) that costs least."""
    linear = sim.linearize()
    effort = PUSH * np.eye(linear.B.shape[1])
    cost = solve_discrete_are(linear.A, linear.B, HOLD, effort)
    curved = effort + linear.B.T @ cost @ linear.B
    feedback: np.ndarray = np.linalg.solve(curved, linear.B.T @ cost @ linear.A)
    return feedback


def main() -> float:
    sim = sc.Sim("gymnasium:inverted_pendulum", dt=0.01)
    radius = sim.linearize().spectral_radius
    began = time.perf_counter()
    feedback = gain(sim)
    took = time.perf_counter() - began
    print(f"upright, a perturbation grows {radius:.3f} times a step; gain in {1e3 * took:.1f} ms")

    def control(now: float, sim: sc.Sim) -> np.ndarray:
        low, high = sim.model.actuator_ctrlrange[0]
        command: np.ndarray = np.clip(-feedback @ np.concatenate([sim.qpos, sim.qvel]), low, high)
        return command

    sim.qpos[1] = 0.2
    run = sim.run(5.0, control=control, record=("qpos",))
    farthest, left = np.abs(run.qpos[:, 1]).max(), float(np.abs(run.qpos[-1]).max())
    print(f"from 0.2 rad it leans {farthest:.2f} rad at most; after 5 s {left:.1e} is left")
    return left


if __name__ == "__main__":
    main()
