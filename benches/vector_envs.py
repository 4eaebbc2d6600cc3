"""Environments for training: actions a second against gymnasium's environments and EnvPool.

    pip install envpool          # for the lines "envpool", which are left out without it
    python benches/vector_envs.py

Both sides take the same random actions; episodes end and begin anew in the next step. Figures are
of one world's action; the lines come worst first.

gymnasium: from the same seeds; "async" runs a process a world, stepcore a thread a core. gymnasium
gets as many worlds as it is fast with (16; more processes than cores only wait), stepcore `WORLDS`.
Wall time. "single" is one environment on both sides, with the resets of its episodes, in processor
time; the difference is that of "sync". EnvPool: as many worlds on both sides (`POOLED`), one thread
each, and processor time of all threads of the process.

Checked first: the observations of both after one action, which for EnvPool are positions and
velocities after an action from the states where its episodes began. The share at the end is what of
stepcore's time is spent in its compiled steps; the rest are readings, resets and the tasks'
functions.
"""

from __future__ import annotations

import sys
import time
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
import record
from timing import Side, duel

from stepcore.engine.batch import Batch
from stepcore.engine.sim import Sim
from stepcore.gymnasium import register_envs
from stepcore.gymnasium.tasks import TASKS as ALL

TASKS = ("HalfCheetah", "Hopper", "Walker2d", "Swimmer", "InvertedPendulum", "Ant", "Humanoid")
WORLDS, THEIRS, POOLED, SAME = 1024, 16, 256, 1e-6
# PGS of so few sweeps differs by what it leaves, and MuJoCo ends Newton at its tolerance.
UNSOLVED = {"Humanoid": 0.1, "Ant": 1e-4}
# How many of the first positions are not observed.
UNSEEN = {"InvertedPendulum": 0, "Swimmer": 2, "Ant": 2, "Humanoid": 2}


class Played:
    """A vector environment under random actions."""

    def __init__(self, envs: Any, space: gymnasium.Space | None = None) -> None:
        """space: that of the actions of all worlds, where the environment has that of one."""
        self.envs = envs
        self.envs.reset(**({"seed": 0} if space is None else {}))
        space = envs.action_space if space is None else space
        space.seed(0)
        samples = [space.sample() for _ in range(16)]
        self.actions = [sample.astype(np.float64) for sample in samples]
        self.taken = 0

    def step(self) -> np.ndarray:
        self.taken += 1
        return self.envs.step(self.actions[self.taken % len(self.actions)])[0]


class PlayedAlone(Played):
    """A single environment under random actions, which begins a new episode after each."""

    def step(self) -> np.ndarray:
        self.taken += 1
        observation, _, terminated, truncated, _ = self.envs.step(
            self.actions[self.taken % len(self.actions)]
        )
        return self.envs.reset()[0] if terminated or truncated else observation


def apart(task: str) -> float:
    """How far both observations are apart after an action, the farthest of 16 worlds."""
    ours = gymnasium.make_vec(f"stepcore/{task}-v0", num_envs=THEIRS)
    theirs = gymnasium.make_vec(f"{task}-v5", num_envs=THEIRS, vectorization_mode="sync")
    sides = [Played(envs).step() for envs in (ours, theirs)]
    return float(np.abs(sides[0] - sides[1]).max())


def pool(task: str, worlds: int) -> Any:
    """EnvPool's worlds on one thread."""
    import envpool

    return envpool.make_gymnasium(f"{task}-v5", num_envs=worlds, num_threads=1, seed=0)


def apart_from_pool(task: str) -> float:
    """How far positions and velocities are apart after an action from EnvPool's first states."""
    theirs, ours = pool(task, THEIRS), gymnasium.make_vec(f"stepcore/{task}-v0", num_envs=THEIRS)
    first = theirs.reset()[0]
    ours.reset(seed=0)
    batch, unseen = ours.unwrapped.batch, UNSEEN.get(task, 1)
    seen = batch.qpos.shape[1] - unseen
    batch.qpos[:, unseen:] = first[:, :seen]
    batch.qvel[:] = first[:, seen : seen + batch.qvel.shape[1]]
    ours.action_space.seed(0)
    actions = ours.action_space.sample()
    both = ours.step(actions)[0], theirs.step(actions.astype(np.float64))[0]
    width = seen + batch.qvel.shape[1]
    return float(np.abs(both[0][:, :width] - both[1][:, :width]).max())


def share(side: Played) -> float:
    """What part of an action's time is spent in compiled steps."""
    spent = 0.0
    kind: Any = Sim if isinstance(side, PlayedAlone) else Batch
    step, actions = kind.step, 500 if kind is Sim else 5

    def timed(world: Any, n: int = 1) -> None:
        nonlocal spent
        start = time.perf_counter()
        step(world, n)
        spent += time.perf_counter() - start

    kind.step = timed
    try:
        start = time.perf_counter()
        for _ in range(actions):
            side.step()
        return spent / (time.perf_counter() - start)
    finally:
        kind.step = step


def against(task: str, mode: str, quick: bool) -> tuple[float, Played, Played, int, int]:
    """How far both are apart, both sides, and the worlds of each."""
    if mode == "envpool":
        worlds = 64 if quick else POOLED
        own = gymnasium.make_vec(f"stepcore/{task}-v0", num_envs=worlds, threads=1)
        theirs = Played(pool(task, worlds), own.action_space)
        return apart_from_pool(task), Played(own), theirs, worlds, worlds
    if mode == "single":
        both = (gymnasium.make(name) for name in (f"stepcore/{task}-v0", f"{task}-v5"))
        ours, alone = (PlayedAlone(env) for env in both)
        return apart(task), ours, alone, 1, 1
    worlds = 64 if quick else WORLDS
    own = gymnasium.make_vec(f"stepcore/{task}-v0", num_envs=worlds)
    envs = gymnasium.make_vec(f"{task}-v5", num_envs=THEIRS, vectorization_mode=mode)
    return apart(task), Played(own), Played(envs), worlds, THEIRS


def compare(task: str, mode: str, options, report: record.Report) -> tuple[float, str]:
    """The ratio and the line of a task against one kind of vector environments."""
    difference, ours, theirs, worlds, of_theirs = against(task, mode, options.quick)
    if not difference <= UNSOLVED.get(task, SAME):
        report.add(task=task, against=mode, apart=difference, refused="not the same physics")
        text = f"no ratio: observations {difference:.1e} apart after an action"
        return 0.0, f"{task:18}{mode:8}{text}"
    inside = share(ours)
    sides = (Side("stepcore", ours.step, worlds), Side(mode, theirs.step, of_theirs))
    process = mode in ("single", "envpool")
    found = duel(*sides, options.pairs, options.sample, wall=not process, process=process)
    low, high = found.ratio_spread
    speeds = "".join(f"{1e3 / np.median(side):11.1f} k" for side in (found.ours, found.theirs))
    report.add(task=task, against=mode, apart=difference, inside=inside, **found.record())
    theirs.envs.close()
    return found.ratio, (
        f"{task:18}{mode:8}{difference:10.1e}{speeds}{found.ratio:9.2f} ({low:.2f}–{high:.2f})"
        f"{100 * inside:8.0f} %"
    )


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    note = f"{WORLDS} worlds of stepcore, {THEIRS} of gymnasium; {POOLED} beside EnvPool"
    report = record.Report("vector_envs", options, note)
    report.say()
    report.say(
        f"{'task':18}{'mode':8}{'apart':>10}{'stepcore':>13}{'theirs':>13}"
        f"{'ratio':>9} (quartiles)  in steps"
    )
    register_envs()
    modes = ["single", "sync", "async"] + ["envpool"] * (find_spec("envpool") is not None)
    lines = []
    for task in ALL:
        for mode in modes if task in TASKS else ["single"]:
            if options.only.lower() in f"{task} {mode}".lower():
                lines.append(compare(task, mode, options, report))
                print(lines[-1][1], file=sys.stderr, flush=True)
    for _, line in sorted(lines):
        report.say(line)
    report.close()


if __name__ == "__main__":
    main()
