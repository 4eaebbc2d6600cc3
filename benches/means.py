"""How far recommendations for means are from the requested errors, from new starts.

    python benches/means.py [--new 1024] [--out benches/results/means.jsonl]

Each case is a robot under a random linear feedback policy, and the mean of one number of a run: the
return of a task of gymnasium from its resets, or the distance that a robot of dm_control moves. A
difference of 0.3 standard deviations of that number is requested. The means under the recommended
settings and under rk4 with an eighth of the shipped step are computed again from new starts, by
loops that share nothing with `trade` but the worlds. Cases in the file are not run again.

2026-12-01, 1,024 new starts: the bias was within the error in 20 of 20 cases, and within the
interval of the recommendation in 20 of 20.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

import stepcore as sc
from stepcore.experiment import Motion
from stepcore.experiment.schedule import scheduled
from stepcore.gymnasium import Return, VectorEnv

TASKS = ("Swimmer", "Hopper", "Walker2d", "Ant", "Reacher", "InvertedDoublePendulum")
ROBOTS = ("walker", "hopper", "cheetah", "swimmer")
# The requested error in standard deviations; the reference's step as a share of the shipped one.
REQUESTED, FINE = 0.3, 8
PERIOD, HORIZON = 0.02, 1.0


class Linear:
    """A random linear policy of n inputs."""

    def __init__(self, inputs: int, outputs: int, seed: int) -> None:
        self.gains = np.random.default_rng(seed).normal(size=(inputs, outputs)) / math.sqrt(inputs)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        return np.clip(np.clip(rows, -10, 10) @ self.gains, -1, 1)


class Feedback:
    """A linear policy as a control function of the states of many worlds."""

    batched = True

    def __init__(self, policy: Linear) -> None:
        self.policy = policy

    def __call__(self, now: float, worlds: Any) -> np.ndarray:
        return self.policy(np.concatenate([worlds.qpos, worlds.qvel], axis=-1))


def moved(xpos: np.ndarray) -> np.ndarray:
    """Return the distance of the first moving body from its first place [m], (n,)."""
    return np.linalg.norm(xpos[:, -1, 1] - xpos[:, 0, 1], axis=-1)


def of_task(name: str, seed: int, new: int) -> dict[str, Any]:
    """Try the return of a task."""
    probe = VectorEnv(task_of(name), 1)
    shape = probe.single_observation_space.shape[0], probe.single_action_space.shape[0]
    policy = Linear(*shape, seed)
    quantity = Return(f"stepcore/{name}-v0", policy, horizon=HORIZON)

    def numbers(settings: Any) -> np.ndarray:
        task = task_of(name)
        steps = round(quantity.period / settings.dt)
        object.__setattr__(task, "frame_skip", steps)
        envs = VectorEnv(task, new, settings=settings, autoreset_mode="SameStep")
        observations, _ = envs.reset(seed=10_000_000)
        total, over = np.zeros(new), np.zeros(new, dtype=bool)
        for _ in range(quantity.actions):
            actions = policy(observations)
            observations, rewards, ended, _, _ = envs.step(actions)
            total += np.where(over, 0.0, rewards)
            over |= ended
        return total

    return judged(quantity.model, {"quantity": quantity}, numbers)


def task_of(name: str) -> Any:
    from stepcore.gymnasium import tasks

    return getattr(tasks, name)()


def of_robot(name: str, seed: int, new: int) -> dict[str, Any]:
    """Try the distance that a robot moves."""
    model = sc.load(f"dm_control:{name}").compile()
    control = Feedback(Linear(model.nq + model.nv, model.nu, seed))
    motion = Motion(horizon=HORIZON, control=control, control_dt=PERIOD)

    def numbers(settings: Any) -> np.ndarray:
        unseen = Motion(horizon=HORIZON, control=control, control_dt=PERIOD, seed=77 + seed)
        starts = scheduled(unseen, model, PERIOD, new + 1).starts[1:]
        batch = sc.Batch(model.with_settings(settings=settings), new)
        batch.qpos[:] = [start.qpos for start in starts]
        batch.qvel[:] = [start.qvel for start in starts]
        first = None
        for _ in range(round(HORIZON / PERIOD)):
            batch.ctrl[:] = control(0.0, batch)
            batch.step(round(PERIOD / settings.dt))
            first = np.array(batch.xpos[:, 1]) if first is None else first
        return np.linalg.norm(batch.xpos[:, 1] - first, axis=-1)

    return judged(model, {"motion": motion, "quantity": moved}, numbers)


def judged(model: Any, question: dict[str, Any], numbers: Any) -> dict[str, Any]:
    """Ask for a recommendation, and compute its bias from new starts."""
    begun = time.monotonic()
    shipped = numbers(model.settings)[:256]
    error = REQUESTED * float(np.nanstd(shipped))
    result = sc.trade(
        model, **question, error=error, effort=5e11, seconds=120, progress=False, threads=1
    )
    record: dict[str, Any] = {"error": error, "seconds": round(time.monotonic() - begun, 1)}
    record |= {"resolved": result.resolved, "starts": result.starts}
    if result.chosen is None or not result.resolved:
        return record
    fine = model.settings.replace(integrator="rk4", solver="newton", dt=model.settings.dt / FINE)
    truth, chosen = numbers(fine), numbers(result.chosen.settings)
    both = np.isfinite(truth) & np.isfinite(chosen)
    apart = (chosen - truth)[both]
    bias, half = float(apart.mean()), 1.96 * float(apart.std() / math.sqrt(len(apart)))
    d = result.chosen.difference
    return record | {
        "chosen": result.chosen.change.words,
        "cost": result.chosen.cost / result.shipped.cost,
        "bias": bias,
        "half": half,
        "within": abs(bias) <= error,
        "covered": d.low - half <= bias <= d.high + half,
        "measured": [d.value, d.low, d.high],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--new", type=int, default=1024, help="new starts")
    parser.add_argument("--out", type=Path, default=Path("benches/results/means.jsonl"))
    args = parser.parse_args()
    done = set()
    if args.out.exists():
        done = {json.loads(line)["case"] for line in args.out.read_text().splitlines()}
    for seed in (1, 2):
        for trial, names in ((of_robot, ROBOTS), (of_task, TASKS)):
            for name in names:
                case = f"{name}, policy {seed}"
                if case in done:
                    continue
                line = json.dumps({"case": case} | trial(name, seed, args.new))
                with args.out.open("a") as file:
                    print(line, file=file)
                print(line, flush=True)


if __name__ == "__main__":
    main()
