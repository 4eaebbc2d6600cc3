"""`Trade`: the rows and the recommendation of `trade`, in sentences, tables and data."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.snapshots import RATE, Snapshots
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.motion import Motion, picklable
from stepcore.experiment.reference import Reference
from stepcore.experiment.run import Probe
from stepcore.experiment.runner import Runner
from stepcore.measure.monitors import Finding
from stepcore.measure.trade.batch_cost import BatchPoint
from stepcore.measure.trade.mujoco import Point, compared_with_mujoco
from stepcore.measure.trade.rows import MARGIN, NOTABLE, UNITS, Frontier, TradeRow, observed_orders
from stepcore.measure.trade.tables import batch_tables, settings_table, statistics_tables
from stepcore.measure.trade.words import Words
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, length, metres, seconds

if TYPE_CHECKING:
    from stepcore.viewing.live import View

# Default error of `Trade.best` [m].
ERROR = 1e-3
# Largest share of starts on which a cheaper row may exceed the error and still be named.
FEW = 0.1


@dataclass(eq=False, repr=False)
class Trade(Result):
    """The trade-off between cost and accuracy for one scene; `stepcore.trade` returns it.

    motion: the motion that every setting ran.
    frontier: every setting that ran from all starts, and every setting that failed.
    reference: the converged motion, with its error.
    horizon: the simulated time [s].
    target, budget: the requested error [m] or the requested budget.
    verified: if the reference cannot verify `target`, the least round error that it can [m].
    size: the size of the scene [m].
    mujoco: MuJoCo's points, if MuJoCo was requested.
    in_batch: the cost of the named settings as worlds of a batch, in both precisions; empty if
        costs are counted or a Python function gives the controls.
    screened: the number of settings that were tried.
    runs: the number of runs that the trade made.
    chosen: the row for `target`, or for `verified`, that further starts confirmed.
    findings: problems of the shipped settings in the first start, such as creep; see `Finding`.
    runner: repeats runs of the trade for viewing.
    """

    kind = "trade"
    units: ClassVar = UNITS

    motion: Motion
    frontier: Frontier
    reference: Reference
    horizon: float
    target: float | None = None
    budget: float | None = None
    verified: float | None = None
    size: float = math.nan
    mujoco: Sequence[Point] = ()
    in_batch: Sequence[BatchPoint] = ()
    screened: int = 0
    runs: int = 0
    chosen: TradeRow | None = None
    findings: Sequence[Finding] = ()
    runner: Runner | None = None

    def __getstate__(self) -> dict[str, Any]:
        state = dict(self.__dict__)
        if (runner := self.runner) is not None and (control := runner.schedule.control) is not None:
            schedule = replace(runner.schedule, control=picklable(control))
            state["runner"] = Runner(runner.model, schedule)
        return state

    # Rows and recommendations.

    @property
    def rows(self) -> list[TradeRow]:
        """Every setting that ran from all starts, and those that failed; coarsest step first."""
        return list(self.frontier.rows)

    @property
    def starts(self) -> int:
        """The number of starts that every setting ran from."""
        return len(self.reference.runs)

    @property
    def by(self) -> str:
        """The cost metric: "time" [µs] or "flops", per simulated second."""
        return self.frontier.by

    def error(self, row: TradeRow) -> float:
        """Return the error that a row can claim [m]; inf if the row failed.

        This is the RMS position error of the worst start, further starts included, and never below
        the reference's own error.
        """
        return self.frontier.error(row)

    def price(self, row: TradeRow) -> float:
        """Return the cost of a row per simulated second: µs, or operations with `by="flops"`."""
        return self.frontier.price(row)

    @property
    def shipped(self) -> TradeRow:
        """The row of the scene's own settings."""
        return self.frontier.shipped

    @property
    def settings(self) -> Settings:
        """The scene's own settings."""
        return self.shipped.settings

    @property
    def orders(self) -> dict[str, float]:
        """The observed order of accuracy of each integrator in the worst start."""
        return observed_orders(self.rows, self.reference)

    @property
    def predictable(self) -> float:
        """The time when the first start becomes unpredictable [s]; inf if none does.

        Trajectory errors are measured before this time; see `stepcore.predict`.
        """
        return self.reference.growth.overall

    @property
    def failures(self) -> list[TradeRow]:
        """The rows that failed; `TradeRow.failure` gives the reason."""
        return [row for row in self.rows if row.failure]

    @property
    def recommended(self) -> TradeRow | None:
        """The row for the requested error or budget; None without a request or a matching row."""
        return self._wanted(self.target) if self.verified is None else None

    @property
    def nearest(self) -> TradeRow | None:
        """The row for `verified`, where the reference cannot verify the requested error."""
        return None if self.verified is None else self._wanted(self.verified)

    def _wanted(self, error: float | None) -> TradeRow | None:
        if self.chosen is not None:
            return self.chosen
        try:
            if error is not None:
                return self.cheapest(error)
            return None if self.budget is None else self.most_accurate(self.budget)
        except ValueError:
            return None

    @property
    def passed_over(self) -> TradeRow | None:
        """A notably cheaper row than the recommended row that almost meets the error.

        The row meets the requested error without the safety margin of a recommendation, or exceeds
        the error on at most a tenth of the starts. Of several such rows, this is the row with the
        fewest misses.
        """
        chosen = self.recommended or self.nearest
        if chosen is None or self.target is None:
            return None
        near = []
        for row in self.rows:
            if row.errors is None or row.further is None or row.further.starts == 0:
                continue
            missed, count = self.misses(row)
            cheap = self.price(row) < NOTABLE * self.price(chosen)
            if cheap and missed <= FEW * count and self.error(row) < math.inf:
                near.append((missed, self.price(row), row.settings.dt, row))
        return min(near, key=lambda entry: entry[:3])[-1] if near else None

    @property
    def offered(self) -> list[TradeRow]:
        """The rows compared in the answer: half the error, and the same error at a lower cost."""
        if (chosen := self.recommended or self.nearest) is not None:
            rows = [self.passed_over, self.frontier.halving(chosen)]
        elif self.shipped.errors is not None and not math.isnan(self.price(self.shipped)):
            error = self.error(self.shipped)
            rows = [self.next_better(error), self.frontier.cheapest(error)]
        else:
            rows = []
        return [row for row in rows if row is not None]

    @property
    def kept(self) -> float:
        """The error limit of a recommendation [m]: `target` less a margin; NaN without a target.

        Where the reference cannot verify the target, `verified` takes its place.
        """
        return math.nan if self.target is None else MARGIN * (self.verified or self.target)

    def misses(self, row: TradeRow) -> tuple[int, int]:
        """Return on how many starts a row exceeds the requested error, and from how many it ran."""
        return row.misses(self.verified or self.target or math.inf)

    def best(self, error: float | str | None = None) -> Settings:
        """Return the cheapest Settings whose error in every start is at most `error`.

        error: metres, "1mm", or "0.1%" of the scene's size. The default is the error that `trade`
            was called with. After a call with a budget, the most accurate settings within the
            budget are returned. After a call with neither, the default is 1 mm.

        Raises ValueError, naming the smallest error reached, if no row is accurate enough.
        """
        if error is None and self.target is None and self.budget is not None:
            return self.most_accurate(self.budget).settings
        if self.chosen is not None and error in (None, self.target) and self.verified is None:
            return self.chosen.settings
        return self.cheapest(error).settings

    def next_better(self, error: float | str | None = None) -> TradeRow | None:
        """Return the cheapest row with at most half of an error; None if there is no such row.

        error: as in `best`. The default is the error of the recommended row. That error is compared
            on the starts of the search, because other rows need not have run from the further
            starts.
        """
        if error is None and (row := self.recommended or self.nearest) is not None:
            return self.frontier.halving(row)
        try:
            return self.frontier.cheapest(self._length(error) / 2)
        except ValueError:
            return None

    def cheapest(self, error: float | str | None = None) -> TradeRow:
        """Return the row with the lowest price whose error is at most `error`; see `best`."""
        return self.frontier.cheapest(self._length(error))

    def _length(self, error: float | str | None) -> float:
        if error is None:
            return ERROR if self.target is None else self.target
        return length("best", "error", error, self.size)

    def most_accurate(self, budget: float) -> TradeRow:
        """Return the row with the smallest error whose price is at most `budget`.

        Raises ValueError, naming the lowest price, if no row is cheap enough.
        """
        return self.frontier.most_accurate(budget)

    # Sentences.

    @property
    def title(self) -> str:
        """The quantity measured, in a few words."""
        return f"{self.name}: position error against cost"

    @property
    def setup(self) -> str:
        """The settings tried and the reference, in one line."""
        ref, tried = self.reference, ""
        if self.screened > len(self.rows):
            tried = f", of {self.screened} tried in {self.runs} runs"
        truth = f"a converged motion ({ref.level.integrator}, dt {seconds(ref.settings.dt)})"
        if ref.exact is not None:
            truth = "the exact motion"
        return (
            f"{counted(len(self.rows), 'setting')}{tried}. Errors are measured from {truth}; its "
            f"uncertainty is {metres(ref.high)}."
        )

    @property
    def sentences(self) -> list[str]:
        """The recommendation, the error of the shipped settings, and the cost of less error."""
        words = Words(
            frontier=self.frontier,
            reference=self.reference,
            target=self.target,
            verified=self.verified,
            budget=self.budget,
            recommended=self.recommended or self.nearest,
            passed_over=self.passed_over,
            horizon=self.horizon,
        )
        said = list(words.answer())
        if self.mujoco:
            said += compared_with_mujoco(self.mujoco, self.shipped)
        said += words.in_a_batch(self.in_batch)
        return said + [finding.text for finding in self.findings]

    # Tables, data and motions.

    @property
    def table(self) -> Table:
        """All rows, coarsest step first; units as in `Errors` and `TradeRow`."""
        return Table(row.record() for row in self.rows)

    def tables(self, full: bool) -> list[Table]:
        """Return the table of the main settings, and the means after the motion is unpredictable.

        full: whether to include all settings, and the batch cost of the recommended ones.
        """
        chosen, frontier = self.recommended or self.nearest, self.frontier
        named = [row for row in (self.shipped, chosen, *self.offered) if row is not None]
        return [
            settings_table(frontier, self.reference, chosen, named, self.mujoco, full),
            *(batch_tables(frontier, self.in_batch) if full else []),
            *statistics_tables(frontier),
        ]

    def details(self) -> dict[str, Any]:
        """Return the reference, the request, the recommendation and MuJoCo's points as data."""
        chosen = self.recommended
        return {
            "horizon": self.horizon,
            "starts": self.starts,
            "size": self.size,
            "reference": self._reference(),
            "orders": self.orders,
            "predictable": self.predictable,
            "asked": {"error": self.target, "budget": self.budget, "by": self.by},
            "recommended": None if chosen is None else chosen.settings,
            "verified": self.verified,
            "nearest": None if self.nearest is None else self.nearest.settings,
            "mujoco": [point.record() for point in self.mujoco],
            "in_batch": [point.record() for point in self.in_batch],
            "screened": self.screened,
            "runs": self.runs,
            "findings": [finding.record() for finding in self.findings],
        }

    def _reference(self) -> dict[str, Any]:
        ref = self.reference
        return {
            "settings": ref.settings,
            "error": ref.error,
            "error_high": ref.high,
            "error_max": ref.largest,
            "angle_error": ref.angle,
            "agreement": ref.agreement,
            "other_integrator": ref.other,
            "halvings": [{"dt": level.dt, "distance": level.distance} for level in ref.levels],
            "basis": ref.basis,
            "order": ref.order,
            "known": None if ref.exact else {"orders": ref.known.orders, "bases": ref.known.bases},
            "orders": ref.orders,
            "closed_form": None if ref.exact is None else ref.exact.check,
            "stiffens": ref.stiffens,
            "modelling": ref.gaps,
            "predictable": self.predictable,
            "predictable_starts": ref.growth.ends,
            "overlap": max(run.overlap for run in ref.runs),
            "gained": max(float(run.balance.max()) for run in ref.runs),
            "lost": max(-float(run.balance.min()) for run in ref.runs),
        }

    def seen(self, row: TradeRow | None = None) -> list[Trajectory]:
        """Return the converged motion and the motion of a row, from the row's worst start.

        row: by default the recommended row, or the shipped settings without a recommendation.

        The runs are repeated. A run that fails ends at its failure.
        """
        if self.runner is None:
            raise ValueError("this trade does not hold its runs, so that they cannot be made again")
        chosen = row or self.recommended or self.nearest or self.shipped
        start = 0 if chosen.errors is None else chosen.errors.worst
        return [
            run_again(self.runner, settings, start)
            for settings in (self.reference.settings, chosen.settings)
        ]

    def view(
        self,
        row: TradeRow | None = None,
        *,
        host: str = "localhost",
        port: int = 8080,
        wait: bool | None = None,
    ) -> View:
        """Open a page with the motion of a row, the converged motion, and their distance.

        row: by default the recommended row, or the shipped settings without a recommendation. The
            motion is that of the row's worst start.
        host, port, wait: see `stepcore.view`. Needs the extra "view".
        """
        from stepcore.viewing.live import view

        chosen = row or self.recommended or self.nearest or self.shipped
        named = f"dt {seconds(chosen.settings.dt)}, {chosen.settings.integrator}"
        return view(self.seen(row), labels=["converged", named], host=host, port=port, wait=wait)

    def to_pandas(self) -> Any:
        """Return the table as a pandas DataFrame."""
        return self.table.to_pandas()

    def __repr__(self) -> str:
        failed = len(self.failures)
        return f"<Trade of {self.name}: {len(self.rows)} settings, {failed} failed>"


def run_again(runner: Runner, settings: Settings, start: int) -> Trajectory:
    """Repeat the run from one start for viewing; a run that fails ends at its failure."""
    sim, states = runner.sim(settings), _States(settings.dt)
    with contextlib.suppress(SimulationError):
        runner.follow(sim, start, [states])
    kept = Snapshots(type(sim), sim.model, tuple(states.states))
    return Trajectory(np.array(states.times), snapshots=kept)


class _States(Probe):
    """A probe that records whole states of a run, each with the inputs of the following step."""

    def __init__(self, dt: float) -> None:
        self.apart = max(1, round(1 / (RATE * dt)))
        self.least = 1 / RATE - 0.5 * dt
        self.times: list[float] = []
        self.states: list[bytes] = []

    def stride(self, steps: int) -> int:
        return min(steps, self.apart)

    def begin(self, sim: Any) -> None:
        self._keep(sim)

    def period(self, sim: Any, period: int) -> None:
        self._keep(sim)

    def step(self, sim: Any) -> None:
        self._keep(sim)

    def _keep(self, sim: Any) -> None:
        if self.times and sim.time == self.times[-1]:
            # Replace the state of the same instant by the state that has the new controls.
            self.states[-1] = sim.state()
        elif not self.times or sim.time - self.times[-1] >= self.least:
            self.times.append(sim.time)
            self.states.append(sim.state())
