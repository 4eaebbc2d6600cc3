"""iLQR on `Batch`: gymnasium's hopper lands, stands up straight and stays so (Tassa et al. 2012).

Each control period improves a plan of half a second by one Newton-like step: all its steps are
linearised as the worlds of one batch, contacts included, and the line search rolls out its step
sizes as the worlds of another. pip install ".[gymnasium]" gymnasium[mujoco]
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

import stepcore as sc

AHEAD, PERIOD, FIRST, PERIODS = 50, 0.01, 10, 300
STEPS = np.array([0.0, *0.6 ** np.arange(9)])  # step sizes of the line search; 0 keeps the plan
PLACES, RATES = [2.0, 20.0, 10.0, 0.5, 0.5, 0.5], [0.5, 0.5, 0.2, 0.02, 0.02, 0.02]
COST, EFFORT, END = np.diag(PLACES + RATES), 1e-2 * np.eye(3), 10.0


class Plan(NamedTuple):
    """States (AHEAD + 1, nx) and controls (AHEAD, nu), and what these change by."""

    x: np.ndarray
    u: np.ndarray
    shift: np.ndarray  # (AHEAD, nu): a whole step of the line search
    gain: np.ndarray  # (AHEAD, nu, nx): feedback of the distance from x


class Planner:
    """iLQR towards a pose at rest."""

    def __init__(self, model: sc.Model, goal: np.ndarray) -> None:
        self.nq, self.goal = model.nq, goal
        self.low, self.high = model.actuator_ctrlrange.T
        self.states, self.tries = sc.Batch(model, AHEAD), sc.Batch(model, len(STEPS))

    def improved(self, plan: Plan) -> Plan:
        """The shift and gain of each step, by dynamic programming backward (Riccati)."""
        self.states.qpos, self.states.qvel = np.split(plan.x[:-1], [self.nq], axis=1)
        self.states.ctrl = plan.u
        slope, curve = (1 + END) * COST @ (plan.x[-1] - self.goal), (1 + END) * COST
        linear = self.states.linearize()
        for t in range(AHEAD - 1, -1, -1):
            A, B = linear.A[t], linear.B[t]
            by_u, by_x = EFFORT @ plan.u[t] + B.T @ slope, COST @ (plan.x[t] - self.goal)
            uu, ux = EFFORT + B.T @ curve @ B + 1e-3 * np.eye(len(by_u)), B.T @ curve @ A
            whole = -np.linalg.solve(uu, by_u)
            shift = np.clip(whole, self.low - plan.u[t], self.high - plan.u[t])
            # A control at the end of its range does not answer the state.
            gain = -np.linalg.solve(uu, ux) * (shift == whole)[:, None]
            slope = by_x + A.T @ slope + gain.T @ (uu @ shift + by_u) + ux.T @ shift
            curve = COST + A.T @ curve @ A + gain.T @ uu @ gain + gain.T @ ux + ux.T @ gain
            plan.shift[t], plan.gain[t] = shift, gain
        return plan

    def searched(self, start: np.ndarray, plan: Plan) -> Plan:
        """The best of the rollouts with each step size, from this state."""
        x, u = np.zeros((len(STEPS), AHEAD + 1, len(start))), np.zeros((len(STEPS), *plan.u.shape))
        self.tries.reset(qpos=start[: self.nq], qvel=start[self.nq :])
        x[:, 0] = start
        for t in range(AHEAD):
            answer = (x[:, t] - plan.x[t]) @ plan.gain[t].T
            u[:, t] = (plan.u[t] + STEPS[:, None] * plan.shift[t] + answer).clip(
                self.low, self.high
            )
            self.tries.ctrl = u[:, t]
            self.tries.step()
            x[:, t + 1] = np.concatenate([self.tries.qpos, self.tries.qvel], axis=1)
        off = x - self.goal
        each = np.einsum("wti,ij,wtj->wt", off, COST, off)
        cost = each.sum(axis=1) + END * each[:, -1] + np.einsum("wti,ij,wtj->w", u, EFFORT, u)
        best = int(cost.argmin())
        return Plan(x[best], u[best], np.zeros_like(plan.shift), np.zeros_like(plan.gain))


def main() -> tuple[float, float]:
    """Return the torso's least height [m] and largest lean [rad] in the last two seconds."""
    model = sc.load("gymnasium:hopper").compile()
    planner = Planner(
        model.with_settings(dt=PERIOD, integrator="euler"),
        np.concatenate([model.qpos0, np.zeros(model.nv)]),
    )
    # The hopper itself steps with its file's settings; it falls 5 cm, leaning, and drifts forward.
    sim = sc.Sim(model)
    sim.qpos[1:3], sim.qvel[0] = (1.3, 0.08), 0.3
    nx, nu = model.nq + model.nv, model.nu
    plan = Plan(
        np.zeros((AHEAD + 1, nx)),
        np.zeros((AHEAD, nu)),
        np.zeros((AHEAD, nu)),
        np.zeros((AHEAD, nu, nx)),
    )
    torso, began, linearised = [], time.perf_counter(), 0.0
    for period in range(PERIODS):
        start = np.concatenate([sim.qpos, sim.qvel])
        plan = planner.searched(start, plan)
        for _ in range(1 if period else FIRST):
            before = time.perf_counter()
            plan = planner.improved(plan)
            linearised += time.perf_counter() - before
            plan = planner.searched(start, plan)
        sim.ctrl[:] = plan.u[0]
        sim.step(round(PERIOD / model.settings.dt))
        torso.append(sim.qpos[1:3].copy())
        plan = Plan(*(np.concatenate([rows[1:], rows[-1:]]) for rows in plan))
    took, plans = time.perf_counter() - began, PERIODS - 1 + FIRST
    print(f"{plans / took:.0f} plans a second of {AHEAD} steps, {len(STEPS)} step sizes each;")
    print(f"{plans * AHEAD / linearised:.0f} steps linearised a second, backward pass included")
    height, lean = np.array(torso[-200:]).T
    low, most = float(height.min()), float(np.abs(lean).max())
    print(f"in the last 2 s the torso is above {low:.2f} m and leans {most:.3f} rad at most")
    return low, most


if __name__ == "__main__":
    main()
