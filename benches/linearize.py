"""What `Sim.linearize` costs, beside plain steps and beside differences of them.

    python benches/linearize.py

Processor time, the best of 9 turns. "steps" is how many plain steps the linearisation costs;
central differences of second order take two steps a direction, and the time to set each up.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import stepcore as sc
from stepcore.report.table import Table

TURNS, STEPS = 9, 400


def best(run: Callable[[], object]) -> float:
    """Least processor time of a call [µs]."""
    samples = []
    for _ in range(TURNS):
        start = time.process_time()
        run()
        samples.append(time.process_time() - start)
    return 1e6 * min(samples)


def line(name: str, sim: sc.Sim) -> dict[str, object]:
    """One scene, on the ground."""
    sim.step(200)
    state = sim.state()

    def steps() -> None:
        sim.restore(state)
        sim.step(STEPS)

    step = best(steps) / STEPS
    sim.restore(state)
    whole = best(sim.linearize)
    ways = 2 * sim.model.nv + sim.model.nu
    return {
        "scene": name,
        "directions": ways,
        "µs a step": step,
        "µs to linearize": whole,
        "steps": whole / step,
        "differences": 2.0 * ways,
    }


def main() -> None:
    names = ("inverted_pendulum", "hopper", "half_cheetah", "ant")
    print(Table([line(name, sc.Sim(sc.load(f"gymnasium:{name}"))) for name in names]))


if __name__ == "__main__":
    main()
