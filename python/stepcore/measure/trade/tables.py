"""The printed tables of a trade."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from stepcore.experiment.reference import Reference
from stepcore.measure.trade.batch_cost import BatchPoint
from stepcore.measure.trade.mujoco import Point
from stepcore.measure.trade.rows import Frontier, TradeRow
from stepcore.measure.trade.statistics import QUANTITIES
from stepcore.report.settings import differences, few_iterations, label
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, seconds

# Largest number of rows in a printed trade; other rows along the front are left out.
SHOWN = 10
MARKS = {
    "*": "no other setting is cheaper and at least as accurate",
    "s": "shipped",
    "r": "recommended",
    "c": "contacts are softened at this dt (MuJoCo's refsafe)",
}
LEGEND = """ref: the converged motion, with its uncertainty. dt [ms]; cost [µs] and flops per \
simulated second; error: RMS position error of the worst of the {starts} [m]{below}, rotations \
included as arcs; median: of the median start; max: the largest of any body at any time."""
BELOW = " (<: below what the converged motion can tell)"
FULL_LEGEND = """ rows: row updates per simulated second. numeric, model: numerical and modelling \
part of the error, for settings that change the model. angle: RMS rotation error [rad]. gained, \
lost: energy beyond the work done [J]. overlap: the deepest [m]. resid: largest residual [m/s]."""
ALSO = " also: other settings that differ from the shipped ones."
MUJOCO = " m: MuJoCo, where none of its settings is better."

HEADS = ("", "dt", "integrator", "solver", "error")
COSTS = ("cost", "flops", "rows")
ERRORS = (
    *("error", "median", "numeric", "model", "max"),
    *("angle", "gained", "lost", "overlap", "resid"),
)
NUMBERS = (*COSTS, *ERRORS)
NAMES = ("", "dt", "integrator", "solver", "also", *NUMBERS)
# Columns of the full table only.
DETAILS = ("rows", "numeric", "model", "angle", "gained", "lost", "overlap", "resid")
# A column with only these values is left out.
BLANK = ("", None, "0")


def settings_table(
    frontier: Frontier,
    reference: Reference,
    chosen: TradeRow | None,
    named: Sequence[TradeRow],
    points: Sequence[Point],
    full: bool,
) -> Table:
    """Return the table of rows, the reference and MuJoCo's best points.

    chosen: the recommended row.
    named: the rows that the answer names.
    full: whether to include all rows.
    """
    shown = frontier.rows
    if not full and len(shown) > SHOWN:
        shown = _main_rows(frontier, named)
    records = [*(_cells(frontier, row, chosen) for row in shown), _reference_cells(reference)]
    records += [_mujoco_cells(point) for point in points if point.best]
    some = [n for n in NAMES if full or n not in DETAILS]
    columns = [n for n in some if n in HEADS or any(r.get(n) not in BLANK for r in records)]
    used = "".join(str(record[""]) for record in records)
    marks = [f"{mark}: {words}" for mark, words in MARKS.items() if mark in used.replace("ref", "")]
    starts = counted(len(reference.runs), "start")
    below = any(str(record.get(name)).startswith("<") for record in records for name in ERRORS)
    legend = "; ".join([*marks, LEGEND.format(below=BELOW * below, starts=starts)])
    legend += ALSO * ("also" in columns) + FULL_LEGEND * full + MUJOCO * bool(points)
    left = len(frontier.rows) - len(shown)
    more = f"{counted(left, 'more setting')} and " if left else ""
    if not full:
        legend += f" --all (in Python text(full=True)) prints {more}energy, overlap and residual."
    return Table(records, columns, dict.fromkeys((*NUMBERS, "dt"), ""), legend=legend)


def statistics_tables(frontier: Frontier) -> list[Table]:
    """Return the table of means after the motion becomes unpredictable, if any were measured."""
    rows = [(row, row.after) for row in frontier.rows if row.after is not None]
    if not rows:
        return []
    first = rows[0][1]
    means = {name: getattr(first, name).reference for name in QUANTITIES}
    heads = {"height": "height m", "kinetic": "kinetic J", "touching": "contacts"}
    heads = {name: head for name, head in heads.items() if name != "touching" or means[name]}
    records = []
    for row, after in rows:
        record = {"": "*" * row.best + "s" * row.shipped, "setting": label(row.settings)}
        for name, head in heads.items():
            apart = getattr(after, name)
            record[head] = f"{apart.mean:+.1e} ± {apart.interval:.0e}" + " !" * apart.seen
        records.append(record)
    known = ", ".join(f"{head} {means[name]:.3g}" for name, head in heads.items())
    heading = (
        f"After {seconds(first.since)} the motion cannot be predicted: difference from the "
        f"reference's means ({known}) with 95 % intervals over {first.starts} starts; !: the "
        "interval does not include 0"
    )
    return [Table(records, heading=heading)]


def batch_tables(frontier: Frontier, points: Sequence[BatchPoint]) -> list[Table]:
    """Return the table of costs as worlds of a batch, if they were timed."""
    if not points:
        return []
    records = []
    for point in points:
        cells = _cells(frontier, point.row, None)
        record = {name: cells[name] for name in (*HEADS, "also")}
        record[""] = "*" * point.best + cells[""].replace("*", "")
        record["error"] = compact(point.error) if point.row.errors else cells["error"]
        record |= {"alone": cells["cost"], "in a batch": _cost(point.cost)}
        records.append(record | {"lanes": "yes" if point.lanes else "no"})
    columns = [name for name in records[0] if any(r[name] not in BLANK for r in records)]
    heading = (
        f"Cost per world when {points[0].worlds} worlds are stepped as a batch on one thread, "
        "beside that of a single world [µs per simulated second]"
    )
    legend = (
        "error: in the starts of the search; lanes: whether the batch stepped its worlds side by "
        "side in vector registers, which it does where that is quicker"
    )
    formats = dict.fromkeys(("dt", "error", "alone", "in a batch"), "")
    return [Table(records, columns, formats, heading=heading, legend=legend)]


def _main_rows(frontier: Frontier, named: Sequence[TradeRow]) -> tuple[TradeRow, ...]:
    """Return the rows that the answer names, and best rows spread evenly along the front."""
    kept = {row.settings for row in named}
    best = [row for row in frontier.rows if row.best and row.settings not in kept]
    best = sorted(best, key=frontier.price)
    room = SHOWN - len(kept)
    if len(best) > room:
        best = [best[round(k * (len(best) - 1) / (room - 1))] for k in range(room)]
    kept |= {row.settings for row in best}
    return tuple(row for row in frontier.rows if row.settings in kept)


def _cells(frontier: Frontier, row: TradeRow, chosen: TradeRow | None) -> dict[str, Any]:
    """Return one printed row."""
    s, e = row.settings, row.errors
    marks = "*" * row.best + "s" * row.shipped + "c" * row.clamped
    record: dict[str, Any] = {
        "": marks + "r" * (chosen is not None and chosen.settings == s),
        "dt": f"{s.dt * 1e3:.4g}",
        "integrator": s.integrator,
        "solver": f"{s.solver} {s.sweeps}" if s.solver == "pgs" or few_iterations(s) else s.solver,
        "also": ", ".join(differences(s, frontier.shipped.settings)),
        "cost": _cost(row.cost),
        "flops": "" if math.isnan(row.flops) else compact(row.flops),
        "rows": "" if math.isnan(row.row_updates) else compact(row.row_updates),
    }
    if s.precision != "f64":
        record["solver"] += f" {s.precision}"
    if e is None:
        return record | dict.fromkeys(ERRORS, "") | {"error": "failed"}
    split = (e.numerical, e.modelling) if e.modelling else (0.0, 0.0)
    numbers = (
        e.median,
        *split,
        frontier.largest(row),
        e.angle,
        e.gained,
        e.lost,
        e.overlap,
        e.residual,
    )
    record |= dict(zip(ERRORS, map(compact, (frontier.searched(row), *numbers)), strict=True))
    if not e.modelling:
        record["numeric"] = record["model"] = ""
    record["error"] = "<" * row.below + record["error"]
    record["max"] = "<" * row.below_max + record["max"]
    return record


def _reference_cells(ref: Reference) -> dict[str, Any]:
    """Return the reference's own row, which shows the scene's own losses and overlaps."""
    gained = max(float(run.balance.max()) for run in ref.runs)
    lost = max(-float(run.balance.min()) for run in ref.runs)
    overlap = max(run.overlap for run in ref.runs)
    residual = max(run.residual for run in ref.runs)
    numbers = (ref.high, ref.error, 0.0, 0.0, ref.largest, ref.angle)
    return {
        "": "ref",
        "dt": f"{ref.settings.dt * 1e3:.4g}",
        "integrator": ref.settings.integrator,
        "solver": ref.settings.solver,
    } | dict(zip(ERRORS, map(compact, (*numbers, gained, lost, overlap, residual)), strict=True))


def _mujoco_cells(point: Point) -> dict[str, Any]:
    """Return the printed row of one of MuJoCo's points."""
    record = {
        "": "m",
        "dt": f"{point.dt * 1e3:.4g}",
        "integrator": point.integrator,
        "solver": point.solver,
        "cost": _cost(point.cost),
    }
    e = point.errors
    if e is None:
        return record | {"error": "failed"}
    numbers = (point.error, e.median, e.position_max)
    return record | dict(zip(("error", "median", "max"), map(compact, numbers), strict=True))


def _cost(micro: float) -> str:
    return "" if math.isnan(micro) else f"{micro:.{0 if micro > 99 else 1}f}"
