"""The cost of settings as worlds of a batch, in double and in single precision.

Batches are timed in turn with single worlds, and printed in a separate table. The errors are equal:
a world of a batch is bit-identical to a single run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from stepcore._core import Settings
from stepcore.experiment.batched_runs import BatchRun, can
from stepcore.experiment.cost import Stopwatch, TimedRun
from stepcore.experiment.errors import pareto
from stepcore.experiment.runner import Runner
from stepcore.measure.trade.rows import Frontier, TradeRow
from stepcore.measure.trade.run_cache import RowMaker

# Number of worlds: fills two vector registers.
WORLDS = 16
PRECISIONS = ("f64", "f32")
# Largest number of the recommended settings that are timed.
MOST = 3


@dataclass(frozen=True)
class BatchPoint:
    """One setting as worlds of a `Batch` on one thread.

    row: the row of the setting, with the errors of a world and the cost of a single world.
    cost: the cost of each world of the batch [µs per simulated second].
    lanes: whether the batch stepped its worlds in vector registers rather than one by one.
    error: RMS position error of the search's worst start [m]; inf if the setting failed.
    best: whether no other point is cheaper and at least as accurate.
    """

    row: TradeRow
    cost: float
    worlds: int
    lanes: bool
    error: float
    best: bool = False

    def record(self) -> dict[str, Any]:
        """Return the point as plain data."""
        s = self.row.settings
        return {
            "dt": s.dt,
            "integrator": s.integrator,
            "solver": s.solver,
            "precision": s.precision,
            "position_high": self.error if math.isfinite(self.error) else None,
            "worlds": self.worlds,
            "lanes": self.lanes,
            "cost": None if math.isnan(self.cost) else self.cost,
            "alone": None if math.isnan(self.row.cost) else self.row.cost,
            "pareto": self.best,
            "failure": self.row.failure,
        }


class TimedBatch(TimedRun):
    """A timer that runs the motion from a runner's starts in the worlds of a batch."""

    def __init__(self, runner: Runner, settings: Settings, failed: bool, worlds: int) -> None:
        super().__init__(runner, settings, failed)
        self.worlds = worlds
        self.run: BatchRun | None = None

    @property
    def cost(self) -> float:
        """Computing time of one world [µs per simulated second]; NaN if a world failed."""
        return super().cost / self.worlds

    @property
    def lanes(self) -> bool:
        """Whether the batch found vector registers faster."""
        return self.run is not None and self.run.batch.in_lanes

    def once(self) -> float:
        if self.run is None:
            starts = len(self.runner.schedule.starts)
            some = [world % starts for world in range(self.worlds)]
            self.run = BatchRun(self.runner, self.settings, some, on_failure="stop")
        watch = Stopwatch()
        self.run.timed(watch)
        return watch.total()


def batch_points(
    named: Sequence[TradeRow | None], frontier: Frontier, maker: RowMaker
) -> list[BatchPoint]:
    """Return the settings of some rows, in both precisions, as worlds of a batch.

    The list is empty if nothing is timed, or if a Python function controls each world.
    """
    cache, runner = maker.cache, maker.cache.experiment.runner
    if maker.by != "time" or not can(runner):
        return []
    bases = dict.fromkeys(row.settings for row in named if row is not None and row.errors)
    both = (
        base.replace(precision=p)
        for base in list(bases)[:MOST]
        for p in (PRECISIONS if base.accuracy is None else [base.precision])
    )
    settings = list(dict.fromkeys(both))
    cache.run(settings, "single precision")
    runs = [TimedBatch(runner, s, cache.failure(s) is not None, WORLDS) for s in settings]
    rows = maker.rows(settings, runs)
    costs, errors = [run.cost for run in runs], [frontier.searched(row) for row in rows]
    return [
        BatchPoint(row, run.cost, run.worlds, run.lanes, error, best)
        for row, run, error, best in zip(rows, runs, errors, pareto(costs, errors), strict=True)
    ]
