"""Computing time by counted work: the same on every machine, so that choices are too.

A step costs a fixed time and a time for each operation. Both were measured by
`python benches/cost_of_work.py` on eleven models and the lesson's scenes under every method that a
trade tries; a method's time differs from this by 40 % (standard deviation), at most 3.3 times. Only
the ratio of the two numbers decides a choice.
Commands also print computing times that they measure.
"""

from __future__ import annotations

import math
from typing import Any

# The time of a step and of an operation [µs]; benches/cost_of_work.py.
STEP_TIME, OPERATION = 0.46, 2.2e-4
# The operations that take as long as the fixed time of a step.
OVERHEAD = STEP_TIME / OPERATION


def computing_time(work: float, settings: Any) -> float:
    """Return the computing time of counted work [µs per simulated second].

    work: operations per simulated second. settings: of the run, with its time step.
    """
    return OPERATION * work + STEP_TIME / float(settings.dt) if math.isfinite(work) else math.inf
