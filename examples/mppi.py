"""Sampling MPC on `Batch`: a pole swings up on its cart (MPPI, Williams et al. 2017).

Each control period rolls out many worlds from the present state under noisy controls, and takes
the mean of the controls, weighted by how well their worlds did. The worlds step side by side in
vector lanes. pip install ".[gymnasium]" gymnasium[mujoco]
"""

from __future__ import annotations

import time

import numpy as np

import stepcore as sc

SCENE = """<mujoco model="cartpole"><option timestep="0.02" integrator="RK4"/><worldbody>
 <body name="cart"><joint name="slider" type="slide" axis="1 0 0" damping=".5"/>
  <geom type="box" size=".1 .1 .05" mass="1" contype="0" conaffinity="0"/>
  <body name="pole"><joint name="hinge" axis="0 1 0" damping=".002"/>
   <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5" mass=".1" contype="0"
    conaffinity="0"/></body></body></worldbody>
 <actuator><motor joint="slider" ctrlrange="-10 10"/></actuator></mujoco>"""
WORLDS, AHEAD, NOISE, HEAT, PERIODS = 256, 50, 4.0, 0.05, 250


def cost(qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Of each state: the pole hangs at 0, and should stand at pi above the origin."""
    place, angle = np.moveaxis(qpos, -1, 0)
    found: np.ndarray = (1 + np.cos(angle)) + 0.1 * place**2 + 0.01 * (qvel**2 * [1.0, 1.0]).sum(-1)
    return found


def main() -> float:
    model = sc.loads(SCENE).compile()
    sim, batch = sc.Sim(model), sc.Batch(model, WORLDS)
    rng, plan = np.random.default_rng(0), np.zeros((AHEAD, 1))
    low, high = model.actuator_ctrlrange[0]
    up, began = 0, time.perf_counter()
    for _ in range(PERIODS):
        tried = plan + rng.normal(0, NOISE, (WORLDS, AHEAD, 1))
        tried[0] = plan
        tried = tried.clip(low, high)
        batch.reset(qpos=sim.qpos, qvel=sim.qvel)
        run = batch.rollout(tried)
        worth = cost(run.qpos, run.qvel).mean(axis=1)
        weight = np.exp(-(worth - worth.min()) / HEAT)
        plan = np.einsum("w,wtu->tu", weight / weight.sum(), tried)
        sim.ctrl[:] = plan[0]
        sim.step()
        plan = np.concatenate([plan[1:], plan[-1:]])
        up = up + 1 if np.cos(sim.qpos[1]) < -0.95 else 0
    took = time.perf_counter() - began
    steps = PERIODS * AHEAD * WORLDS / took
    print(f"{PERIODS / took:.0f} plans a second, {steps / 1e6:.1f} million steps a second")
    print(f"the pole has stood for the last {up * 0.02:.1f} s of {PERIODS * 0.02:.0f} s")
    return up * 0.02


if __name__ == "__main__":
    main()
