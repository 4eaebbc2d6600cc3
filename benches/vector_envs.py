"""Environments for training: actions a second against gymnasium's own vector environments.

    python benches/vector_envs.py

Both sides take the same random actions, from the same seeds; episodes end and begin anew in the
next step. Checked first: the observations of both after one action. Wall time, as gymnasium's
"async" runs a process a world and stepcore a thread a core. gymnasium gets as many worlds as it is
fast with (16; more processes than cores only wait), stepcore `WORLDS`; figures are of one world's
action. The share at the end is what of stepcore's time is spent in its compiled steps; the rest
are readings, resets and the tasks' functions.
"""

from __future__ import annotations

import time

import gymnasium
import numpy as np
import record
from timing import Side, duel

from stepcore.engine.batch import Batch
from stepcore.gymnasium import register_envs

TASKS = ("HalfCheetah", "Hopper", "Walker2d", "Swimmer", "InvertedPendulum", "Ant", "Humanoid")
WORLDS, THEIRS, SAME = 1024, 16, 1e-6
# PGS of so few sweeps differs by what it leaves.
UNSOLVED = {"Humanoid": 0.1}


class Played:
    """A vector environment under random actions."""

    def __init__(self, envs: gymnasium.vector.VectorEnv) -> None:
        self.envs = envs
        self.envs.reset(seed=0)
        self.envs.action_space.seed(0)
        self.actions = [envs.action_space.sample() for _ in range(16)]
        self.taken = 0

    def step(self) -> np.ndarray:
        self.taken += 1
        return self.envs.step(self.actions[self.taken % len(self.actions)])[0]


def apart(task: str) -> float:
    """How far both observations are apart after an action, the farthest of 16 worlds."""
    ours = gymnasium.make_vec(f"stepcore/{task}-v0", num_envs=THEIRS)
    theirs = gymnasium.make_vec(f"{task}-v5", num_envs=THEIRS, vectorization_mode="sync")
    sides = [Played(envs).step() for envs in (ours, theirs)]
    return float(np.abs(sides[0] - sides[1]).max())


def share(side: Played) -> float:
    """What part of an action's time is spent in compiled steps."""
    spent = 0.0
    step = Batch.step

    def timed(batch: Batch, n: int = 1) -> None:
        nonlocal spent
        start = time.perf_counter()
        step(batch, n)
        spent += time.perf_counter() - start

    Batch.step = timed  # type: ignore[method-assign]
    try:
        start = time.perf_counter()
        for _ in range(5):
            side.step()
        return spent / (time.perf_counter() - start)
    finally:
        Batch.step = step  # type: ignore[method-assign]


def compare(task: str, options, report: record.Report) -> None:
    """A line for each kind of gymnasium's vector environments."""
    difference = apart(task)
    if not difference <= UNSOLVED.get(task, SAME):
        report.say(f"{task:18}no ratio: observations {difference:.1e} apart after an action")
        report.add(task=task, apart=difference, refused="not the same physics")
        return
    worlds = 64 if options.quick else WORLDS
    ours = Played(gymnasium.make_vec(f"stepcore/{task}-v0", num_envs=worlds))
    inside = share(ours)
    for mode in ("sync", "async"):
        envs = gymnasium.make_vec(f"{task}-v5", num_envs=THEIRS, vectorization_mode=mode)
        theirs = Played(envs)
        sides = (Side("stepcore", ours.step, worlds), Side(mode, theirs.step, THEIRS))
        found = duel(*sides, options.pairs, options.sample, wall=True)
        low, high = found.ratio_spread
        speeds = "".join(f"{1e3 / np.median(side):11.1f} k" for side in (found.ours, found.theirs))
        report.say(
            f"{task:18}{mode:8}{difference:10.1e}{speeds}{found.ratio:9.2f} ({low:.2f}–{high:.2f})"
            f"{100 * inside:8.0f} %"
        )
        report.add(task=task, against=mode, apart=difference, inside=inside, **found.record())
        envs.close()


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    note = f"{WORLDS} worlds of stepcore, {THEIRS} of gymnasium; actions a second"
    report = record.Report("vector_envs", options, note)
    report.say()
    report.say(
        f"{'task':18}{'mode':8}{'apart':>10}{'stepcore':>13}{'gymnasium':>13}"
        f"{'ratio':>9} (quartiles)  in steps"
    )
    register_envs()
    for task in TASKS:
        if options.only.lower() in task.lower():
            compare(task, options, report)
    report.close()


if __name__ == "__main__":
    main()
