"""What threads gain in a batch: `step()` of few and of many worlds by one thread and by several.

Wall time of a call: the median of all samples, and the quickest, which a busy machine disturbs
least; the numbers of threads take turns. The bits at the end are compared, which are the same with
any number of threads.
"""

from __future__ import annotations

import os

import numpy as np
import record
import scenes
import turns

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
SETTLE = 20


def main() -> None:
    options = record.arguments(__doc__.splitlines()[0])
    options.pairs = 0  # Numbers of threads take turns, not sides.
    report = record.Report("batch_threads", options, f"{os.cpu_count()} processors")
    report.say()
    report.say(f"{'model':14}{'worlds':>7}{turns.COLUMNS}{'aim':>6}")
    for name, text in CASES:
        if options.only in name:
            model = (sc.loads if text.startswith("<") else sc.load)(text).compile()
            for worlds in WORLDS:
                compare(name, model, worlds, options, report)
    report.close()


def compare(name: str, model: sc.Model, worlds: int, options, report: record.Report) -> None:
    """Lines for a number of worlds."""
    batches = {n: sc.Batch(model, worlds, threads=n, lanes=True) for n in THREADS}
    rng = np.random.default_rng(3)
    qvel = rng.normal(0, 0.1, batches[1].qvel.shape)
    for batch in batches.values():
        batch.qvel[:] = qvel
        batch.step(SETTLE)
    # As long for few worlds as for many, within reason.
    calls = max(1, 1024 // worlds)
    label = f"{name:14}{worlds:7}"
    turns.compare(report, label, batches, calls, {2: AIMS[worlds]}, case=name, worlds=worlds)


if __name__ == "__main__":
    main()
