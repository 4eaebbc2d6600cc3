"""What `follow` costs beside `Sim.step` over the same controls, and what a call costs by itself.

    python benches/follow.py    # worst row first; processor time, medians of interleaved runs

One start may take 1.1 times `sim.step(n)` over the same controls, eight starts half of that each,
and a call without motion 50 µs.
"""

from __future__ import annotations

import statistics
import time
from functools import partial

import numpy as np

import stepcore as sc
from stepcore.engine.follow import follow
from stepcore.engine.start import Start

MODELS = ("inverted_pendulum", "half_cheetah", "hopper", "walker2d", "ant", "humanoid")
# Steps of a run, from one sample to the next, and under one row of controls; runs a figure.
STEPS, EVERY, HOLD, TIMES = 1000, 20, 10, 9
# Calls of one step, one after the other, that are timed together.
CALLS = 100
ONE, EIGHT, FIXED = 1.1, 0.5, 50e-6


def starts_of(model: sc.Model, n: int) -> tuple[list[Start], np.ndarray]:
    rng = np.random.default_rng(0)
    qpos = model.qpos0 + rng.normal(0, 0.01, (n, model.nq))
    starts = [Start(qpos[k], rng.normal(0, 0.1, model.nv)) for k in range(n)]
    return starts, rng.uniform(-0.4, 0.4, (n, STEPS // HOLD, model.nu))


def stepped(model: sc.Model, start: Start, ctrl: np.ndarray) -> None:
    sim = sc.Sim(model)
    start.put(sim)
    for row in ctrl:
        sim.ctrl[:] = row
        sim.step(HOLD)


def took(work: partial) -> float:
    begun = time.thread_time()
    work()
    return time.thread_time() - begun


def main() -> None:
    rows = []
    for name in MODELS:
        model = sc.load(f"gymnasium:{name}").compile()
        starts, ctrl = starts_of(model, 8)
        still = [Start(model.qpos0, np.zeros(model.nv))]
        call, still_sim = partial(follow, model, still, 1, record=("qpos",)), sc.Sim(model)
        run = partial(follow, model, steps=STEPS, every=EVERY, hold=HOLD)
        works = {
            "sim": partial(stepped, model, starts[0], ctrl[0]),
            "one": partial(run, starts[:1], ctrl=ctrl[:1]),
            "sims": lambda model=model, starts=starts, ctrl=ctrl: [
                stepped(model, *pair) for pair in zip(starts, ctrl, strict=True)
            ],
            "eight": partial(run, starts, ctrl=ctrl),
            "step": lambda sim=still_sim: [sim.step() for _ in range(CALLS)],
            "calls": lambda call=call: [call() for _ in range(CALLS)],
        }
        times: dict[str, list[float]] = {key: [] for key in works}
        for _ in range(TIMES):
            for key, work in works.items():
                times[key].append(took(work))
        typical = {key: statistics.median(each) for key, each in times.items()}
        one, eight = typical["one"] / typical["sim"], typical["eight"] / typical["sims"]
        fixed = (typical["calls"] - typical["step"]) / CALLS
        worst = max(one / ONE, eight / EIGHT, fixed / FIXED)
        step = typical["sim"] / STEPS * 1e6
        row = f"{name:20} {one:6.2f} {eight:8.2f} {fixed * 1e6:8.0f} µs {step:8.2f} µs"
        rows.append((worst, row))
    print(f"{'':20} {'one':>6} {'of eight':>8} {'a call':>11} {'sim.step':>11}")
    for _, row in sorted(rows, reverse=True):
        print(row)
    print(f"{'at most':20} {ONE:6.2f} {EIGHT:8.2f} {FIXED * 1e6:8.0f} µs")


if __name__ == "__main__":
    main()
