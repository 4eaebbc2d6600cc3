"""Sampling MPC on `Batch`: an SO-101 arm reaches one place after another (MPPI).

    python examples/reach.py robotstudio_so101/so101.xml    # of MuJoCo Menagerie

A plan is a target of each servo, held for a tenth of a second. Its samples step side by side, and
the noise shrinks with the distance, so that the arm arrives within millimetres.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import stepcore as sc

WORLDS, AHEAD, PERIODS, EVERY = 96, 20, 75, 4  # the last two: plans a target, steps a plan
NOISE, FINEST, HEAT = 1.0, 0.003, 0.2  # [rad] a metre of distance; [rad]; of the spread of costs
TARGETS = np.array([[0.30, 0.10, 0.15], [0.25, -0.15, 0.25], [0.30, 0.0, 0.08]])  # [m]


class Reacher:
    """MPPI for a place of a site."""

    def __init__(self, model: sc.Model, site: str) -> None:
        self.site, self.batch = model.index("site", site), sc.Batch(model, WORLDS)
        self.low, self.high = model.actuator_ctrlrange.T
        self.rng, self.steps = np.random.default_rng(0), 0

    def improved(self, sim: sc.Sim, plan: np.ndarray, target: np.ndarray) -> np.ndarray:
        """The mean of the plans (nu) nearby, by how close to the target they come."""
        distance = float(np.linalg.norm(sim.site_xpos[self.site] - target))
        noise = self.rng.normal(0, max(NOISE * distance, FINEST), (WORLDS, len(plan)))
        noise[0] = 0.0
        tried = (plan + noise).clip(self.low, self.high)
        self.batch.reset(qpos=sim.qpos, qvel=sim.qvel)
        run = self.batch.rollout(np.repeat(tried[:, None], AHEAD, axis=1), record="site_xpos")
        off = np.linalg.norm(run.recorded["site_xpos"][:, :, self.site] - target, axis=-1)
        # Come close, and be at rest there.
        cost = off.mean(axis=1) + off[:, -1] + 0.01 * np.abs(run.qvel[:, -1]).mean(axis=-1)
        self.steps += off.size
        weight = np.exp(-(cost - cost.min()) / (HEAT * cost.std() + 1e-12))
        mean: np.ndarray = np.einsum("w,wu->u", weight / weight.sum(), tried)
        return mean


def main(given: Sequence[str] | None = None) -> float:
    """Return by how much the farthest target was missed [m]."""
    parser = argparse.ArgumentParser(description="An SO-101 arm reaches one place after another.")
    parser.add_argument("model", type=Path, help="robotstudio_so101/so101.xml of MuJoCo Menagerie")
    parser.add_argument("--site", default="gripperframe", help="what reaches: %(default)s")
    options = parser.parse_args(given)
    if not options.model.is_file():
        parser.error(f"{options.model}: no such file; get robotstudio_so101 of MuJoCo Menagerie")
    model = sc.load(options.model).compile()
    sim, reacher = sc.Sim(model), Reacher(model, options.site)
    missed, spent = [], 0.0
    for target in TARGETS:
        plan = np.array(sim.ctrl)
        for _ in range(PERIODS):
            sim.forward()
            began = time.perf_counter()
            plan = reacher.improved(sim, plan, target)
            spent += time.perf_counter() - began
            sim.ctrl[:] = plan
            sim.step(EVERY)
        sim.forward()
        missed.append(float(np.linalg.norm(sim.site_xpos[reacher.site] - target)))
        print(f"target {target}: missed by {1e3 * missed[-1]:.1f} mm")
    plans = PERIODS * len(TARGETS)
    print(f"{plans / spent:.0f} plans a second, {reacher.steps / spent:,.0f} steps a second")
    return max(missed)


if __name__ == "__main__":
    main()
