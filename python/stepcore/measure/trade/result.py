"""`Trade`: what `trade` returns, its findings in sentences, tables and data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from stepcore.measure.trade.findings import TradeFindings
from stepcore.measure.trade.row import UNITS, TradeRow
from stepcore.measure.trade.seen import seen_runs
from stepcore.measure.trade.sentences import sentences
from stepcore.measure.trade.tables import batch_tables, settings_table, statistics_tables
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, metres, seconds

if TYPE_CHECKING:
    from stepcore.engine.trajectory import Trajectory
    from stepcore.viewing.live import View


@dataclass(frozen=True, eq=False, repr=False)
class Trade(TradeFindings, Result):
    """What speed costs in accuracy for one scene; `stepcore.trade` returns it.

    motion: the motion that every setting ran.
    ran: that motion in words.
    horizon: the simulated time [s].
    size: the size of the scene [m].
    frontier: every setting that ran from all starts, and every one that failed.
    reference: the converged motion, with its error.
    target, budget: the error [m] or the budget that was asked for.
    chosen: the row for `target` that further starts confirmed.
    findings: what the shipped settings show from the first start, such as creep; see `Finding`.
    mujoco: MuJoCo's points, if they were asked for.
    in_batch: what the settings that the answer names cost as worlds of a batch, in both precisions;
        nothing where costs are counted or a Python function gives the controls.
    screened: the number of settings that were tried at all.
    runs: the number of runs they took.
    notes: remarks on the reference, the motion and the failures.
    """

    kind = "trade"
    units: ClassVar = UNITS

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
            f"{counted(len(self.rows), 'setting')}{tried}. Errors are measured from {truth}, which "
            f"is itself known to {metres(ref.high)} ({ref.basis})."
        )

    @property
    def sentences(self) -> list[str]:
        """What is recommended, how wrong the shipped settings are, what less error would cost."""
        return list(sentences(self))

    @property
    def table(self) -> Table:
        """All rows, coarsest step first; units as in `Errors` and `TradeRow`."""
        return Table(row.record() for row in self.rows)

    def tables(self, full: bool) -> list[Table]:
        """The settings that matter, and means after the motion is unpredictable.

        `full`: all settings, and what those of the answer cost in a batch.
        """
        shared = batch_tables(self) if full else []
        return [settings_table(self, full), *shared, *statistics_tables(self)]

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
        truth = ref.runs
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
            "overlap": max(path.overlap for path in truth),
            "gained": max(float(path.balance.max()) for path in truth),
            "lost": max(-float(path.balance.min()) for path in truth),
        }

    def seen(self, row: TradeRow | None = None) -> list[Trajectory]:
        """The converged motion and that of a row, from the start where the row is worst.

        row: by default the recommended one, else the shipped settings.

        The runs are made again; what fails ends where it failed.
        """
        chosen = row or self.recommended or self.shipped
        start = 0 if chosen.errors is None else chosen.errors.worst
        return seen_runs(self.runner, [self.reference.settings, chosen.settings], start)

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
