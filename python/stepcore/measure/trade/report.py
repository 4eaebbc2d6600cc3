"""A trade as text: the rows that tell something, and what they mean in sentences."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

from stepcore.experiment.reference import FINER, smallest
from stepcore.measure.trade.answer import answer
from stepcore.measure.trade.remarks import after, observed
from stepcore.report.settings import label, rarer
from stepcore.report.table import Table
from stepcore.report.units import compact, metres, seconds

if TYPE_CHECKING:
    from stepcore.measure.trade.result import Trade
    from stepcore.measure.trade.row import Row

# A printed trade shows all rows up to this many, then the ones that matter.
FULL = 40
# A residual of the reference that is worth saying [m/s].
UNSOLVED = 1e-9
LEGEND = """\
* best for its cost, s as shipped, r recommended, c refsafe softens rows at this dt, ref reference
dt ms; cost µs, flops and rows (updates) per simulated second; error: how far matter is off (centres
of mass, and turning × radius of gyration), rms, of the worst start, m (<: below what the reference
knows, which is shown); median: of the starts; numeric, model: what error is made of where a setting
changes the model; max: of centres, any sample; angle: rms, rad; gained, lost: energy beyond the
work done, J; overlap: deepest, m; resid: worst residual, m/s; iterations, tolerance, cold, …: where
it is not as shipped"""


def text(trade: Trade, width: int | None, full: bool) -> str:
    """The printed trade."""
    shown = trade.rows if full or len(trade.rows) <= FULL else telling(trade)
    starts = f"{trade.starts} start" + "s" * (trade.starts != 1)
    ref = trade.reference
    records = [*(cells(trade, row) for row in shown), truth(trade)]
    records += [point.cells() for point in trade.mujoco if point.best]
    names = [
        n for n in NAMES if n in HEADS or any(record.get(n) not in BLANK for record in records)
    ]
    right = dict.fromkeys((*NUMBERS, "dt"), "")
    left = len(trade.rows) - len(shown)
    legend = LEGEND + ("\nm: MuJoCo's best for their cost" if trade.mujoco else "")
    lines = [
        f"{trade.name}: {len(trade.rows)} settings over {seconds(trade.horizon)}, {starts}; "
        f"reference {label(ref.settings, sweeps=False)}, known to {metres(ref.high)} "
        f"({ref.basis})",
        "",
        Table(records, names, right).text(width),
        "",
        legend,
    ]
    if left:
        lines.append(f"{left} more settings are in Trade.table, and printed with --all")
    if trade.screened > len(trade.rows):
        tried = f"{trade.screened} settings were tried in {trade.runs} runs"
        lines.append(f"{tried}; those above ran from all starts")
    lines += [*observed(trade), *after(trade, width), *failed(trade)]
    lines += ["", *sentences(trade)]
    notes = trade.notes + cautions(trade)
    if notes:
        lines += ["", *(f"note: {note}" for note in notes)]
    return "\n".join(lines)


def telling(trade: Trade) -> list[Row]:
    """The Pareto-best rows, the shipped one, and those that differ from it in dt alone."""
    own, chosen = trade.shipped.settings, trade.recommended
    return [
        row
        for row in trade.rows
        if row.best
        or row.shipped
        or (chosen is not None and row.settings == chosen.settings)
        or row.settings == own.replace(dt=row.settings.dt)
    ]


HEADS = ("", "dt", "integrator", "solver", "error")
COSTS = ("cost", "flops", "rows")
ERRORS = (
    "error",
    "median",
    "numeric",
    "model",
    "max",
    "angle",
    "gained",
    "lost",
    "overlap",
    "resid",
)
NUMBERS = (*COSTS, *ERRORS)
NAMES = ("", "dt", "integrator", "solver", "also", *NUMBERS)
# A column with nothing else says nothing of the scene.
BLANK = ("", None, "0")


def cells(trade: Trade, row: Row) -> dict[str, Any]:
    """One printed row."""
    s, e = row.settings, row.errors
    marks = "*" * row.best + "s" * row.shipped + "c" * row.clamped
    record: dict[str, Any] = {
        "": marks + "r" * (row is trade.recommended),
        "dt": f"{s.dt * 1e3:.4g}",
        "integrator": s.integrator,
        "solver": f"pgs {s.sweeps}" if s.solver == "pgs" else s.solver,
        "also": ", ".join(rarer(s, trade.shipped.settings)),
        "cost": "" if math.isnan(row.cost) else f"{row.cost:.{0 if row.cost > 99 else 1}f}",
        "flops": "" if math.isnan(row.flops) else compact(row.flops),
        "rows": "" if math.isnan(row.row_updates) else compact(row.row_updates),
    }
    if s.precision != "f64":
        record["solver"] += f" {s.precision}"
    if e is None:
        return record | dict.fromkeys(ERRORS, "") | {"error": "failed"}
    largest = max(e.position_max, trade.reference.largest)
    split = (e.numerical, e.modelling) if e.modelling else (0.0, 0.0)
    numbers = (e.median, *split, largest, e.angle, e.gained, e.lost, e.overlap, e.residual)
    record |= dict(zip(ERRORS, map(compact, (trade.error(row), *numbers)), strict=True))
    if not e.modelling:
        record["numeric"] = record["model"] = ""
    record["error"] = "<" * row.below + record["error"]
    record["max"] = "<" * row.below_max + record["max"]
    return record


def truth(trade: Trade) -> dict[str, Any]:
    """The reference's own line, so that what the scene itself loses or overlaps can be told."""
    ref = trade.reference
    lost = max(-float(path.balance.min()) for path in ref.paths)
    gained = max(float(path.balance.max()) for path in ref.paths)
    overlap = max(path.overlap for path in ref.paths)
    residual = max(path.residual for path in ref.paths)
    numbers = (
        ref.high,
        ref.error,
        0.0,
        0.0,
        ref.largest,
        ref.angle,
        gained,
        lost,
        overlap,
        residual,
    )
    return {
        "": "ref",
        "dt": f"{ref.settings.dt * 1e3:.4g}",
        "integrator": ref.settings.integrator,
        "solver": ref.settings.solver,
    } | dict(zip(ERRORS, map(compact, numbers), strict=True))


def failed(trade: Trade) -> list[str]:
    """One line for the failures of each integrator and solver."""
    hidden = trade.failures
    kinds = [(row.settings.integrator, row.settings.solver) for row in hidden]
    lines = []
    for kind, count in Counter(kinds).items():
        # Rows stand coarsest first: the last of a kind is the finest step that fails.
        last = [row for row, own in zip(hidden, kinds, strict=True) if own == kind][-1]
        first = hidden[kinds.index(kind)]
        at = f"first at dt {seconds(first.settings.dt)}: {first.failure}"
        finest = "" if last is first else f"; last at dt {seconds(last.settings.dt)}"
        lines.append(f"failed: {count} with {', '.join(kind)}; {at}{finest}")
    return lines


def sentences(trade: Trade) -> list[str]:
    """How wrong the shipped settings are, what is recommended, and what less or more costs."""
    return answer(trade)


def cautions(trade: Trade) -> list[str]:
    """What the reference's error means for the table."""
    ref = trade.reference
    least = smallest([row.errors.high for row in trade.rows if row.errors], trade.size)
    found = []
    if ref.high * FINER > least > 0:
        found.append(
            f"the reference's error of {metres(ref.high)} is not {FINER:.0f} times smaller "
            f"than the smallest error, {metres(least)}; an error below the reference's own is "
            "shown as < the reference's"
        )
    marked = sum(row.best and row.below_max and not row.below for row in trade.rows)
    if marked:
        found.append(
            f"the largest error of {marked} of the best rows is below the reference's own, "
            f"{metres(ref.largest)}: no more than that is known of it"
        )
    rest = max(path.residual for path in ref.paths)
    if rest > UNSOLVED:
        found.append(f"the reference's rows are solved to {rest:.0e} m/s only")
    if ref.other and ref.agreement > 4 * (ref.other_error + ref.error):
        found.append(
            f"caution: two integrators do not agree: {ref.other} is still "
            f"{metres(ref.agreement)} from the reference, and moved by only "
            f"{metres(ref.other_error)} when its step was halved"
        )
    return found
