"""What threads gain in a batch: `step()` of few and of many worlds by one thread and by several.

Wall time of a call: the median of all samples, and the quickest, which a busy machine disturbs
least; the numbers of threads take turns. The bits at the end are compared, which are the same with
any number of threads.
"""

from __future__ import annotations

import os
import time

import numpy as np
import record
import scenes

import stepcore as sc

CASES = (
    ("ball", scenes.ball()),
    ("stack", scenes.stack()),
    ("half_cheetah", scenes.gym_path("half_cheetah")),
    ("ant", scenes.gym_path("ant")),
)
WORLDS = (64, 4096)
# No slower with two threads for few worlds, nearly twice as quick for many.
AIMS = {64: 1.0, 4096: 1.9}
THREADS = (1, 2, 4)
SAMPLES, SETTLE = 25, 20


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    options.pairs = 0  # Numbers of threads take turns, not sides.
    report = record.Report("batch_threads", options, f"{os.cpu_count()} processors")
    report.say()
    report.say(
        f"{'model':14}{'worlds':>7}{'threads':>9}{'median [µs]':>13}{'gain':>6}"
        f"{'quickest [µs]':>15}{'gain':>6}{'aim':>6}"
    )
    for name, text in CASES:
        if options.only in name:
            model = (sc.loads if text.startswith("<") else sc.load)(text).compile()
            for worlds in WORLDS:
                compare(name, model, worlds, options, report)
    report.close()


def compare(name: str, model: sc.Model, worlds: int, options, report: record.Report) -> None:
    """Lines for a number of worlds."""
    batches = [sc.Batch(model, worlds, threads=threads, lanes=True) for threads in THREADS]
    rng = np.random.default_rng(3)
    qvel = rng.normal(0, 0.1, batches[0].qvel.shape)
    for batch in batches:
        batch.qvel[:] = qvel
        batch.step(SETTLE)
    # As long for few worlds as for many, within reason.
    calls = max(1, 1024 // worlds)
    samples = 5 if options.quick else SAMPLES
    times = np.array([[sample(batch, calls) for batch in batches] for _ in range(samples)])
    if any(batch.qpos.tobytes() != batches[0].qpos.tobytes() for batch in batches):
        raise AssertionError("the number of threads shows in the bits")
    median, least = np.median(times, axis=0), times.min(axis=0)
    for k, threads in enumerate(THREADS):
        aim = f"{AIMS[worlds]:6.1f}" if threads == 2 else ""
        report.say(
            f"{name:14}{worlds:7}{threads:9}{median[k]:13.1f}{median[0] / median[k]:6.2f}"
            f"{least[k]:15.1f}{least[0] / least[k]:6.2f}{aim}"
        )
        both = {"median_us": median[k], "least_us": least[k]}
        report.add(case=name, worlds=worlds, threads=threads, **both)


def sample(batch: sc.Batch, calls: int) -> float:
    """A call [µs]: of so many the quickest."""
    spent = []
    for _ in range(calls):
        start = time.perf_counter()
        batch.step()
        spent.append(time.perf_counter() - start)
    return 1e6 * min(spent)


if __name__ == "__main__":
    main()
