"""Two sides timed in turn, A B A B …, so that whatever slows the machine slows both.

A sample is processor time of this thread per step, not wall time: on a busy machine it leaves
out the time in which somebody else ran. Where a side uses threads of its own it is wall time, or
processor time of all threads where both sides have one at work.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

PAIRS = 15  # the fewest that count


@dataclass(frozen=True)
class Side:
    """One side of a duel: `play()` restarts it and takes `steps` steps (summed over worlds)."""

    name: str
    play: Callable[[], object]
    steps: int


@dataclass(frozen=True)
class Duel:
    """Samples of both sides [µs a step], pair by pair."""

    ours: np.ndarray
    theirs: np.ndarray
    clock: str

    @property
    def ratio(self) -> float:
        """How many times faster we are: the median over pairs."""
        return float(np.median(self.theirs / self.ours))

    @property
    def ratio_spread(self) -> tuple[float, float]:
        """The ratio's quartiles."""
        low, high = np.quantile(self.theirs / self.ours, (0.25, 0.75))
        return float(low), float(high)

    def record(self) -> dict[str, object]:
        return {
            "ours_us": summary(self.ours),
            "theirs_us": summary(self.theirs),
            "ratio": self.ratio,
            "ratio_quartiles": self.ratio_spread,
            "pairs": len(self.ours),
            "clock": self.clock,
        }


def summary(samples: np.ndarray) -> dict[str, float]:
    low, median, high = np.quantile(samples, (0.25, 0.5, 0.75))
    return {"median": median, "low": low, "high": high, "best": float(samples.min())}


def duel(
    ours: Side,
    theirs: Side,
    pairs: int = PAIRS,
    sample: float = 0.03,
    wall: bool = False,
    process: bool = False,
) -> Duel:
    """Times both sides in turn, each sample lasting about `sample` [s]."""
    clock = time.perf_counter_ns if wall else time.thread_time_ns
    clock = time.process_time_ns if process else clock
    plays = [_plays(side, sample, clock) for side in (ours, theirs)]
    samples: list[list[float]] = [[], []]
    collecting = gc.isenabled()
    gc.disable()
    try:
        for pair in range(-1, pairs):  # the first pair warms up
            for side, count, kept in zip((ours, theirs), plays, samples, strict=True):
                start = clock()
                for _ in range(count):
                    side.play()
                spent = (clock() - start) * 1e-3
                if pair >= 0:
                    kept.append(spent / (count * side.steps))
    finally:
        if collecting:
            gc.enable()
    name = "wall time" if wall else "processor time of all threads" if process else "processor time"
    return Duel(np.array(samples[0]), np.array(samples[1]), name)


def _plays(side: Side, sample: float, clock: Callable[[], int]) -> int:
    """How many plays fill a sample; warms the side up."""
    side.play()
    start = clock()
    side.play()
    return max(1, round(sample / max(1e-9 * (clock() - start), 1e-9)))
