"""What the ledger costs: the same steps with it off and on, in turns, in processor time.

    python benches/ledger.py [--pairs 25]

Both sides play the same steps from the same state; the figure is the median, over the pairs, of
time with the ledger over time without, and its quartiles. The aim is below 1.05.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
import scenes
from timing import PAIRS, Side, duel

import stepcore as sc

MODELS: dict[str, Callable[[], sc.Scene]] = {
    "spring": lambda: sc.loads(scenes.spring()),
    "stack": lambda: sc.loads(scenes.stack()),
    "half_cheetah": lambda: sc.load(scenes.gym_path("half_cheetah")),
    "ant": lambda: sc.load(scenes.gym_path("ant")),
}
STEPS = 1024


def side(model: sc.Model, ledger: bool) -> Side:
    """Steps from the start with a held control, as many as 16 milestones take."""
    sim = sc.Sim(model, ledger=ledger)
    ctrl = np.random.default_rng(0).uniform(-0.3, 0.3, model.nu)

    def play() -> None:
        sim.reset(0 if model.keys else None)
        sim.ctrl[:] = ctrl
        sim.step(STEPS)

    return Side("on" if ledger else "off", play, STEPS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--pairs", type=int, default=PAIRS)
    pairs = parser.parse_args().pairs
    print(f"{'':14} {'off us':>8} {'on us':>8} {'on/off':>7}  quartiles")
    for name, scene in MODELS.items():
        model = scene().compile()
        result = duel(side(model, True), side(model, False), pairs)
        on, off = (float(np.median(times)) for times in (result.ours, result.theirs))
        ratios = result.ours / result.theirs
        low, middle, high = np.quantile(ratios, (0.25, 0.5, 0.75))
        print(f"{name:14} {off:8.3f} {on:8.3f} {middle:7.3f}  {low:.3f} {high:.3f}")


if __name__ == "__main__":
    main()
