"""What threads gain in one world: a step of a heap by one thread and by several, which take turns.

Wall time of a step: the median of all samples, and the quickest, which a busy machine disturbs
least. The bits at the end are compared, which are the same with any number of threads.
"""

from __future__ import annotations

import os
import time

import numpy as np
import record
import scenes

import stepcore as sc

CASES = (
    ("boxes1000", scenes.boxes(1000), {"solver": "newton"}),
    ("boxes1000", scenes.boxes(1000), {"solver": "pgs", "sweeps": 10, "tolerance": 0.0}),
    ("spheres3000", scenes.spheres(3000), {"solver": "pgs", "sweeps": 10, "tolerance": 0.0}),
    ("capsules216", scenes.capsules(6), {"solver": "newton"}),
)
THREADS = (1, 2, 3, 4)
SAMPLES, SETTLE, STEPS = 25, 300, 4


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    options.pairs = 0  # Numbers of threads take turns, not sides.
    report = record.Report("heap_threads", options, f"{os.cpu_count()} processors")
    report.say()
    report.say(
        f"{'heap':13}{'solver':8}{'contacts':>9}{'threads':>8}{'median [µs]':>13}{'gain':>6}"
        f"{'quickest [µs]':>15}{'gain':>6}"
    )
    samples = 5 if options.quick else SAMPLES
    for name, text, settings in CASES:
        if options.only not in name:
            continue
        model = sc.loads(text).compile()
        sims = [sc.Sim(model, threads=threads, **settings) for threads in THREADS]
        for sim in sims:
            sim.step(SETTLE)
        times = np.array([[sample(sim) for sim in sims] for _ in range(samples)])
        if any(sim.qpos.tobytes() != sims[0].qpos.tobytes() for sim in sims):
            raise AssertionError("the number of threads shows in the bits")
        contacts = len(sims[0].contacts)
        median, least = np.median(times, axis=0), times.min(axis=0)
        for k, threads in enumerate(THREADS):
            report.say(
                f"{name:13}{settings['solver']:8}{contacts:9}{threads:8}{median[k]:13.1f}"
                f"{median[0] / median[k]:6.2f}{least[k]:15.1f}{least[0] / least[k]:6.2f}"
            )
            both = {"median_us": median[k], "least_us": least[k]}
            report.add(case=name, solver=settings["solver"], threads=threads, **both)
    report.close()


def sample(sim: sc.Sim) -> float:
    """The quickest of some steps [µs]."""
    spent = []
    for _ in range(STEPS):
        start = time.perf_counter()
        sim.step()
        spent.append(time.perf_counter() - start)
    return 1e6 * min(spent)


if __name__ == "__main__":
    main()
