"""What machine code gains: batches with and without it, in turn, and how long it takes to make.

Processor time of `step`, one thread, worlds at different speeds after they have settled. Checked
first: the bits at the end are the same.
"""

from __future__ import annotations

import os
import time

import numpy as np
import record
import scenes

import stepcore as sc
from stepcore import lesson

# Newton's method, which the stages do between two parts of the code.
NEWTON = {"solver": "newton", "integrator": "euler"}
SWEPT = {"solver": "pgs", "sweeps": 5, "tolerance": 0.0, "integrator": "euler"}
CASES = {
    "spring": (lesson.spring(damping=0.1), {}),
    "drop": (lesson.drop(), {}),
    "stack": (lesson.stack(5), {}),
    "chain20": (sc.loads(scenes.chain(20)), {}),
    **{
        f"{name}, {sweeps} sweeps": (
            sc.load(scenes.gym_path(name)),
            SWEPT | {"sweeps": sweeps},
        )
        for name in ("hopper", "walker2d", "half_cheetah", "ant")
        for sweeps in (5, 20)
    },
    **{
        f"{name}, Newton": (sc.load(scenes.gym_path(name)), NEWTON)
        for name in ("hopper", "walker2d", "half_cheetah", "ant")
    },
    **{
        f"{name}, momentum": (sc.load(scenes.gym_path(name)), {"integrator": "euler"})
        for name in ("humanoid",)
    },
}
WORLDS, SETTLE, STEPS = 512, 60, 100


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    report = record.Report("machine_code", options, f"{WORLDS} worlds, one thread")
    report.say()
    report.say(f"{'model':26}{'':5}{'code':>9}{'stages':>9}{'ratio':>7}{'made in':>11}")
    for name, (scene, settings) in CASES.items():
        if options.only in name:
            for precision in ("f64", "f32"):
                compare(name, scene.compile(), settings | {"precision": precision}, options, report)
    report.close()


def compare(name: str, model: sc.Model, settings: dict, options, report: record.Report) -> None:
    """A line for one model and precision."""
    worlds, steps = (64, 10) if options.quick else (WORLDS, STEPS)
    qvel = np.random.default_rng(0).normal(size=(worlds, model.nv))
    started, batches = time.perf_counter(), {}
    for when in ("now", "0"):
        os.environ["STEPCORE_COMPILE"] = when
        batches[when] = sc.Batch(model, worlds, threads=1, lanes=True, **settings)
        batches[when].step(1)
        if when == "now":
            made = time.perf_counter() - started
    times: dict[str, list[float]] = {when: [] for when in batches}
    for _ in range(max(3, options.pairs)):
        for when, batch in batches.items():
            batch.reset()
            batch.qvel[:] = qvel
            batch.step(SETTLE)
            start = time.thread_time()
            batch.step(steps)
            times[when].append(time.thread_time() - start)
    if batches["now"].qpos.tobytes() != batches["0"].qpos.tobytes():
        raise AssertionError(f"{name}: code shows in the bits")
    code, stages = (1e9 * float(np.median(times[w])) / worlds / steps for w in ("now", "0"))
    report.say(
        f"{name:26}{settings['precision']:5}{code:6.0f} ns{stages:6.0f} ns{stages / code:7.2f}"
        f"{1e3 * made:8.0f} ms"
    )
    report.add(case=name, settings=settings, code=code, stages=stages, made=made, worlds=worlds)


if __name__ == "__main__":
    main()
