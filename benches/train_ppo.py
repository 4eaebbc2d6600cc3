"""half_cheetah learns to run by PPO of stable-baselines3: return against wall time, here and there.

    pip install torch stable-baselines3 ".[gymnasium,plot]" "gymnasium[mujoco]"
    python benches/train_ppo.py                 # trains; rows go to benches/results as they come
    python benches/train_ppo.py --draw          # draws docs/ppo.png from the kept rows

The same algorithm with the same numbers trains in two vector environments of as many worlds:
`stepcore/HalfCheetah-v0`, whose worlds are one `Batch` on two threads, and gymnasium's
`HalfCheetah-v5`, stepped one by one ("sync") or in a process a world ("async"), whichever is
quicker here. They learn in turn, an iteration each, in one process on two cores, so that what else
the machine does falls on both alike. Time is wall time, of which "playing" is the part spent in the
environment and the rest is the network's. The return is the mean of the last episodes' sums of
rewards while learning.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = Path(__file__).parent / "results" / "train_ppo.json"
PICTURE = Path(__file__).parents[1] / "docs" / "ppo.png"
CORES = 2
WORLDS, STEPS = 64, 64
# Played so many actions to choose between gymnasium's two kinds.
TRIED = 50


def worlds(name: str, **options: Any) -> Any:
    """A vector environment for stable-baselines3; it keeps the time that playing takes."""
    import gymnasium
    from gymnasium.vector import AutoresetMode
    from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor

    from stepcore.gymnasium.adapters import stable_baselines3

    class Timed(VecEnvWrapper):
        playing = 0.0

        def reset(self) -> Any:
            return self.venv.reset()

        def step_wait(self) -> Any:
            begin = time.perf_counter()
            step = self.venv.step_wait()
            self.playing += time.perf_counter() - begin
            return step

    if "vectorization_mode" in options:
        options["vector_kwargs"] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    else:
        options["autoreset_mode"] = AutoresetMode.SAME_STEP.value
    envs = gymnasium.make_vec(name, num_envs=WORLDS, **options)
    return VecMonitor(Timed(stable_baselines3(envs)))


class Learner:
    """PPO in one of the two, an iteration at a time."""

    def __init__(self, played: Any) -> None:
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecNormalize
        from torch import nn

        self.played, self.spent, self.curve = played, 0.0, []
        self.ppo = PPO(
            "MlpPolicy",
            VecNormalize(played, gamma=0.98),
            n_steps=STEPS,
            batch_size=1024,
            n_epochs=8,
            learning_rate=5e-4,
            gamma=0.98,
            gae_lambda=0.92,
            clip_range=0.15,
            max_grad_norm=0.8,
            policy_kwargs={"log_std_init": -1.0, "net_arch": [64, 64], "activation_fn": nn.Tanh},
            seed=0,
            device="cpu",
        )

    def iteration(self) -> None:
        """One more: plays, learns, and keeps a point of the curve."""
        begin = time.perf_counter()
        self.ppo.learn(WORLDS * STEPS, reset_num_timesteps=False)
        self.spent += time.perf_counter() - begin
        ended = [episode["r"] for episode in self.ppo.ep_info_buffer or ()]
        returned = sum(ended) / len(ended) if ended else None
        self.curve.append((self.ppo.num_timesteps, self.spent, self.played.venv.playing, returned))


def quicker() -> str:
    """Which kind of gymnasium's vector environments plays quicker here."""
    spent = {}
    for kind in ("sync", "async"):
        played = worlds("HalfCheetah-v5", vectorization_mode=kind)
        played.reset()
        actions = np.stack([played.action_space.sample() for _ in range(WORLDS)])
        for _ in range(TRIED):
            played.step_async(actions)
            played.step_wait()
        spent[kind] = played.venv.playing
        played.close()
    return min(spent, key=lambda kind: spent[kind])


def train(total: int) -> None:
    """Both learn in turn until each has taken so many actions."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    import torch

    import stepcore.gymnasium

    # So small a network gains nothing from a second thread.
    torch.set_num_threads(1)
    stepcore.gymnasium.register_envs()
    kind = quicker()
    learners = {
        "stepcore": Learner(worlds("stepcore/HalfCheetah-v0", threads=CORES)),
        f"gymnasium ({kind})": Learner(worlds("HalfCheetah-v5", vectorization_mode=kind)),
    }
    for k in range(-(-total // (WORLDS * STEPS))):
        for learner in learners.values():
            learner.iteration()
        if k % 10 == 9:
            curves = {name: learner.curve for name, learner in learners.items()}
            RESULTS.write_text(json.dumps({"worlds": WORLDS, "cores": CORES, "curves": curves}))
            for name, learner in learners.items():
                actions, spent, playing, returned = learner.curve[-1]
                shown = "" if returned is None else f"return {returned:8.0f}"
                print(f"{name:20}{actions:9} {spent:7.1f} s, playing {playing:7.1f} s  {shown}")


def draw() -> None:
    """docs/ppo.png: the return against wall time."""
    import matplotlib.pyplot as plt

    kept = json.loads(RESULTS.read_text())
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for name, curve in kept["curves"].items():
        # Episodes of all worlds end together: between their ends the mean stays.
        new = [now for last, now in pairwise(curve) if now[3] != last[3]]
        points = [(spent, returned) for _, spent, _, returned in new]
        axes.plot(*zip(*points, strict=True), "o-", markersize=3, label=name)
    axes.set_xlabel(f"wall time on {kept['cores']} cores [s]")
    axes.set_ylabel("return of an episode")
    axes.set_title(f"half_cheetah, PPO, {kept['worlds']} worlds", fontsize=10)
    axes.legend(frameon=False)
    figure.savefig(PICTURE, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--total", type=int, default=500_000, help="actions of each side")
    parser.add_argument("--draw", action="store_true", help="draw docs/ppo.png and end")
    options = parser.parse_args()
    if options.draw:
        draw()
    else:
        train(options.total)


if __name__ == "__main__":
    main()
