"""`Trade`: what `trade` returns: rows, a recommendation, and both in sentences, tables and data."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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

# The error that `Trade.best` keeps to by default [m].
ERROR = 1e-3
# A cheaper row that misses the error on at most this share of the starts is worth naming.
FEW = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class Trade(Result):
    """What speed costs in accuracy for one scene; `stepcore.trade` returns it.

    name: the name of the scene.
    motion: the motion that every setting ran.
    frontier: every setting that ran from all starts, and every one that failed.
    reference: the converged motion, with its error.
    horizon: the simulated time [s].
    notes: remarks on the reference, the motion and the failures.
    target, budget: the error [m] or the budget that was asked for.
    size: the size of the scene [m].
    mujoco: MuJoCo's points, if they were asked for.
    in_batch: what the settings that the answer names cost as worlds of a batch, in both precisions;
        nothing where costs are counted or a Python function gives the controls.
    screened: the number of settings that were tried at all.
    runs: the number of runs they took.
    chosen: the row for `target` that further starts confirmed.
    ran: the motion in words.
    batches: what making runs as batches saved.
    findings: what the shipped settings show from the first start, such as creep; see `Finding`.
    runner: makes the runs of the trade again, to be seen.
    """

    kind = "trade"
    units: ClassVar = UNITS

    name: str
    motion: Motion
    frontier: Frontier
    reference: Reference
    horizon: float
    notes: list[str] = field(default_factory=list)
    target: float | None = None
    budget: float | None = None
    size: float = math.nan
    mujoco: Sequence[Point] = ()
    in_batch: Sequence[BatchPoint] = ()
    screened: int = 0
    runs: int = 0
    chosen: TradeRow | None = None
    ran: str = ""
    batches: Sequence[str] = ()
    findings: Sequence[Finding] = ()
    runner: Runner | None = None

    def __getstate__(self) -> dict[str, Any]:
        state = dict(self.__dict__)
        if (runner := self.runner) is not None and (control := runner.schedule.control) is not None:
            schedule = replace(runner.schedule, control=picklable(control))
            state["runner"] = Runner(runner.model, schedule)
        return state

    # The rows, and what they answer.

    @property
    def rows(self) -> list[TradeRow]:
        """Every setting that ran from all starts, and those that failed; coarsest step first."""
        return list(self.frontier.rows)

    @property
    def starts(self) -> int:
        """From how many starts every setting ran."""
        return len(self.reference.runs)

    @property
    def by(self) -> str:
        """The cost metric: "time" [µs] or "flops", per simulated second."""
        return self.frontier.by

    def error(self, row: TradeRow) -> float:
        """The error that a row can claim [m]: inf if it failed.

        The RMS position error of the worst start, further ones among them; not below the
        reference's own.
        """
        return self.frontier.error(row)

    def price(self, row: TradeRow) -> float:
        """What a row costs per simulated second: µs, or operations if that is the metric."""
        return self.frontier.price(row)

    @property
    def shipped(self) -> TradeRow:
        """The settings that came with the scene."""
        return self.frontier.shipped

    @property
    def settings(self) -> Settings:
        """The settings that came with the scene."""
        return self.shipped.settings

    @property
    def orders(self) -> dict[str, float]:
        """The order of accuracy that each integrator shows in the worst start."""
        return observed_orders(self.rows, self.reference)

    @property
    def predictable(self) -> float:
        """When the first of the starts can no longer be predicted [s]; inf beyond the horizon.

        Trajectory errors are those before it; see `stepcore.predict`.
        """
        return self.reference.growth.overall

    @property
    def failures(self) -> list[TradeRow]:
        """The rows that failed; `TradeRow.failure` says why."""
        return [row for row in self.rows if row.failure]

    @property
    def recommended(self) -> TradeRow | None:
        """The row for the error or budget that was asked for; None where no row is, or no ask."""
        if self.chosen is not None:
            return self.chosen
        try:
            if self.target is not None:
                return self.cheapest(self.target)
            return None if self.budget is None else self.most_accurate(self.budget)
        except ValueError:
            return None

    @property
    def passed_over(self) -> TradeRow | None:
        """A row that costs notably less than the recommended one and all but meets the error.

        It meets the error asked for, but not the share of it that a recommendation keeps to; or it
        misses it on few of the starts (one of ten at most). Of several the one that misses least.
        """
        chosen = self.recommended
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
        """The rows that the answer compares with: half the error, and the same one for less."""
        if (chosen := self.recommended) is not None:
            rows = [self.passed_over, self.frontier.halving(chosen)]
        elif self.shipped.errors is not None and not math.isnan(self.price(self.shipped)):
            error = self.error(self.shipped)
            rows = [self.next_better(error), self.frontier.cheapest(error)]
        else:
            rows = []
        return [row for row in rows if row is not None]

    @property
    def kept(self) -> float:
        """The error that a recommendation keeps to on every start that ran [m]; NaN without one."""
        return math.nan if self.target is None else MARGIN * self.target

    def misses(self, row: TradeRow) -> tuple[int, int]:
        """On how many starts a row exceeds the error asked for, and of how many that it ran."""
        return row.misses(self.target or math.inf)

    def best(self, error: float | str | None = None) -> Settings:
        """The cheapest Settings that keep to an error in every start.

        error: metres, "1mm", or "0.1%" of the scene's size; by default what the trade was made
            for (an error or a budget), else 1 mm.

        Raises ValueError, naming the smallest error there is, if none is that good.
        """
        if error is None and self.target is None and self.budget is not None:
            return self.most_accurate(self.budget).settings
        if self.chosen is not None and error in (None, self.target):
            return self.chosen.settings
        return self.cheapest(error).settings

    def next_better(self, error: float | str | None = None) -> TradeRow | None:
        """The cheapest row with at most half of that error; None if there is none.

        error: as in `best`; by default that of the recommended row, which is compared in the starts
        of the search, because no other row need have run from the further ones.
        """
        if error is None and self.recommended is not None:
            return self.frontier.halving(self.recommended)
        try:
            return self.frontier.cheapest(self._length(error) / 2)
        except ValueError:
            return None

    def cheapest(self, error: float | str | None = None) -> TradeRow:
        """The row of the lowest price whose error is at most `error`, as in `best`."""
        return self.frontier.cheapest(self._length(error))

    def _length(self, error: float | str | None) -> float:
        if error is None:
            return ERROR if self.target is None else self.target
        return length("best", "error", error, self.size)

    def most_accurate(self, budget: float) -> TradeRow:
        """The row with the smallest error whose price is at most `budget`.

        Raises ValueError, naming the lowest price there is, if none is that cheap.
        """
        return self.frontier.most_accurate(budget)

    # The answer in words.

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: position error against cost"

    @property
    def setup(self) -> str:
        """How it was measured, in a line."""
        ref, tried = self.reference, ""
        if self.screened > len(self.rows):
            tried = f", of {self.screened} tried in {self.runs} runs"
        truth = f"a converged motion ({ref.level.integrator}, dt {seconds(ref.settings.dt)})"
        if ref.exact is not None:
            truth = "the exact motion"
        return (
            f"{counted(len(self.rows), 'setting')}{tried}. Errors are measured from {truth}; its "
            f"uncertainty is {metres(ref.high)} ({ref.basis})."
        )

    @property
    def sentences(self) -> list[str]:
        """What is recommended, how wrong the shipped settings are, what less error would cost."""
        frontier, asked = self.frontier, (self.target, self.budget)
        words = Words(
            frontier, self.reference, *asked, self.recommended, self.passed_over, self.horizon
        )
        said = list(words.answer())
        if self.mujoco:
            said += compared_with_mujoco(self.mujoco, self.shipped)
        said += words.in_a_batch(self.in_batch)
        return said + [finding.text for finding in self.findings]

    # As tables, data and motions.

    @property
    def table(self) -> Table:
        """All rows, coarsest step first; units as in `Errors` and `TradeRow`."""
        return Table(row.record() for row in self.rows)

    def tables(self, full: bool) -> list[Table]:
        """The settings that matter, and means after the motion is unpredictable.

        `full`: all settings, and what those of the answer cost in a batch.
        """
        chosen, frontier = self.recommended, self.frontier
        named = [row for row in (self.shipped, chosen, *self.offered) if row is not None]
        return [
            settings_table(frontier, self.reference, chosen, named, self.mujoco, full),
            *(batch_tables(frontier, self.in_batch) if full else []),
            *statistics_tables(frontier),
        ]

    def details(self) -> dict[str, Any]:
        """The reference, what was asked for and is recommended, and MuJoCo's points."""
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
        """The converged motion and that of a row, from the start where the row is worst.

        row: by default the recommended one, else the shipped settings.

        The runs are made again; what fails ends where it failed.
        """
        if self.runner is None:
            raise ValueError("this trade does not hold its runs, so that they cannot be made again")
        chosen = row or self.recommended or self.shipped
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
        """Opens a page with the motion of a row over the converged one, and their distance.

        row: by default the recommended one, else the shipped settings; from its worst start.
        host, port, wait: see `stepcore.view`. Needs the extra "view".
        """
        from stepcore.viewing.live import view

        chosen = row or self.recommended or self.shipped
        named = f"dt {seconds(chosen.settings.dt)}, {chosen.settings.integrator}"
        return view(self.seen(row), labels=["converged", named], host=host, port=port, wait=wait)

    def to_pandas(self) -> Any:
        """The table as a pandas DataFrame."""
        return self.table.to_pandas()

    def __repr__(self) -> str:
        failed = len(self.failures)
        return f"<Trade of {self.name}: {len(self.rows)} settings, {failed} failed>"


def run_again(runner: Runner, settings: Settings, start: int) -> Trajectory:
    """The motion from one start, to be looked at; what fails ends where it failed."""
    sim, states = runner.sim(settings), _States(settings.dt)
    with contextlib.suppress(SimulationError):
        runner.follow(sim, start, [states])
    kept = Snapshots(type(sim), sim.model, tuple(states.states))
    return Trajectory(np.array(states.times), snapshots=kept)


class _States(Probe):
    """Keeps whole states of a run, with the inputs of the step that follows each."""

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
            # The same instant, now with its controls.
            self.states[-1] = sim.state()
        elif not self.times or sim.time - self.times[-1] >= self.least:
            self.times.append(sim.time)
            self.states.append(sim.state())
