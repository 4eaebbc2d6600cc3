"""What threads gain in one world: a step of a heap by one thread and by several, which take turns.

Wall time of a step: the median of all samples, and the quickest, which a busy machine disturbs
least. The bits at the end are compared, which are the same with any number of threads.
"""

from __future__ import annotations

import os

import record
import scenes
import turns

import stepcore as sc

CASES = (
    ("boxes1000", scenes.boxes(1000), {"solver": "newton"}),
    ("boxes1000", scenes.boxes(1000), {"solver": "pgs", "sweeps": 10, "tolerance": 0.0}),
    ("spheres3000", scenes.spheres(3000), {"solver": "pgs", "sweeps": 10, "tolerance": 0.0}),
    ("capsules216", scenes.capsules(6), {"solver": "newton"}),
)
THREADS = (1, 2, 3, 4)
SETTLE, STEPS = 300, 4


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    options.pairs = 0  # Numbers of threads take turns, not sides.
    report = record.Report("heap_threads", options, f"{os.cpu_count()} processors")
    report.say()
    report.say(f"{'heap':13}{'solver':8}{'contacts':>9}{turns.COLUMNS}")
    for name, text, settings in CASES:
        if options.only not in name:
            continue
        model = sc.loads(text).compile()
        sims = {n: sc.Sim(model, threads=n, **settings) for n in THREADS}
        for sim in sims.values():
            sim.step(SETTLE)
        solver, contacts = settings["solver"], len(sims[1].contacts)
        label = f"{name:13}{solver:8}{contacts:9}"
        turns.compare(report, label, sims, STEPS, case=name, solver=solver)
    report.close()


if __name__ == "__main__":
    main()
