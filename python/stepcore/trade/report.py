"""A trade as text: the rows that tell something, and what they mean in sentences."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

from stepcore.table import Table
from stepcore.trade.reference import FINER, smallest
from stepcore.trade.settings import label, metres, quantity, seconds

if TYPE_CHECKING:
    from stepcore.trade.result import Row, Trade

# A printed trade shows all rows up to this many, then the ones that matter.
FULL = 40
MICRO = (("s", 1e6), ("ms", 1e3), ("µs", 1.0))
# A residual of the reference that is worth saying [m/s].
UNSOLVED = 1e-9
# From here on the largest error says something else than the median of the starts.
DIFFER = 30.0
# A saving below this is within what timing can tell.
NOTABLE = 0.9
LEGEND = """\
* best for its cost, s as shipped, c refsafe softens rows at this dt, ref the reference
dt ms; cost µs, and rows: row updates, per simulated second; error: of positions, rms, median of
starts, and max: the largest, m (<: below the reference's own, which is shown); angle: rms, rad;
gained, lost: energy beyond the work done, J; overlap: deepest, m; resid: worst residual, m/s"""


def text(trade: Trade, width: int | None, full: bool) -> str:
    """The printed trade."""
    shown = trade.rows if full or len(trade.rows) <= FULL else telling(trade)
    starts = f"{trade.starts} start" + "s" * (trade.starts != 1)
    ref = trade.reference
    records = [*(cells(trade, row) for row in shown), truth(trade)]
    names = [n for n in records[0] if n in HEADS or any(r.get(n) not in BLANK for r in records)]
    right = dict.fromkeys((*NUMBERS, "dt"), "")
    left = len(trade.rows) - len(shown)
    lines = [
        f"{trade.name}: {len(trade.rows)} settings over {seconds(trade.horizon)}, {starts}; "
        f"reference {label(ref.settings, sweeps=False)}, known to {metres(ref.error)} "
        f"({ref.basis})",
        "",
        Table(records, names, right).text(width),
        "",
        LEGEND,
    ]
    if left:
        lines.append(f"{left} more settings are in Trade.table, and printed with --all")
    lines += failed(trade)
    lines += ["", *sentences(trade)]
    notes = trade.notes + cautions(trade)
    if notes:
        lines += ["", *(f"note: {note}" for note in notes)]
    return "\n".join(lines)


def telling(trade: Trade) -> list[Row]:
    """The Pareto-best rows, the shipped one, and those that differ from it in dt alone."""
    own = trade.shipped.settings
    return [
        row
        for row in trade.rows
        if row.best or row.shipped or row.settings == own.replace(dt=row.settings.dt)
    ]


HEADS = ("", "dt", "integrator", "solver", "cost", "error")
NUMBERS = ("cost", "rows", "error", "max", "angle", "gained", "lost", "overlap", "resid")
# A column with nothing else says nothing of the scene.
BLANK = ("", None, "0")


def cells(trade: Trade, row: Row) -> dict[str, Any]:
    """One printed row."""
    s, e = row.settings, row.errors
    record: dict[str, Any] = {
        "": "*" * row.best + "s" * row.shipped + "c" * row.clamped,
        "dt": f"{s.dt * 1e3:.4g}",
        "integrator": s.integrator,
        "solver": f"pgs {s.sweeps}" if s.solver == "pgs" else s.solver,
        "cost": "" if math.isnan(row.cost) else f"{row.cost:.{0 if row.cost > 99 else 1}f}",
        "rows": "" if math.isnan(row.row_updates) else short(row.row_updates),
    }
    if s.precision != "f64":
        record["solver"] += f" {s.precision}"
    if e is None:
        return record | dict.fromkeys(NUMBERS[2:], "") | {"error": "failed"}
    numbers = (e.angle, e.gained, e.lost, e.overlap, e.residual)
    record["error"] = "<" * row.below + short(trade.error(row))
    largest = max(e.position_max, trade.reference.largest)
    record["max"] = "<" * row.below_max + short(largest)
    return record | dict(zip(NUMBERS[4:], map(short, numbers), strict=True))


def truth(trade: Trade) -> dict[str, Any]:
    """The reference's own line, so that what the scene itself loses or overlaps can be told."""
    ref = trade.reference
    lost = max(-float(path.balance.min()) for path in ref.paths)
    gained = max(float(path.balance.max()) for path in ref.paths)
    overlap = max(path.overlap for path in ref.paths)
    residual = max(path.residual for path in ref.paths)
    numbers = (ref.error, ref.largest, ref.angle, gained, lost, overlap, residual)
    return {
        "": "ref",
        "dt": f"{ref.settings.dt * 1e3:.4g}",
        "integrator": ref.settings.integrator,
        "solver": ref.settings.solver,
    } | dict(zip(NUMBERS[2:], map(short, numbers), strict=True))


def short(value: float) -> str:
    """Two digits and a short exponent: 1.3e-3; 0 for rounding below zero or none at all."""
    if value <= 0:
        return "0"
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits}e{int(exponent)}"


def failed(trade: Trade) -> list[str]:
    """One line for the failures of each integrator and solver."""
    hidden = [row for row in trade.rows if row.failure]
    kinds = [(row.settings.integrator, row.settings.solver) for row in hidden]
    lines = []
    for kind, count in Counter(kinds).items():
        first = hidden[kinds.index(kind)]
        at = f"first at dt {seconds(first.settings.dt)}: {first.failure}"
        lines.append(f"failed: {count} with {', '.join(kind)}; {at}")
    return lines


def sentences(trade: Trade) -> list[str]:
    """How wrong the shipped settings are, and what less or more of that costs."""
    row = trade.shipped
    if row.errors is None:
        found = [f"As shipped ({label(row.settings)}) it fails: {row.failure}."]
        ran = [other for other in trade.rows if not math.isnan(other.cost)]
        if ran:
            least = min(ran, key=lambda other: other.cost)
            wrong = metres(trade.error(least))
            found.append(f"The cheapest that runs: {label(least.settings)}, {wrong} wrong.")
        return found
    error = trade.error(row)
    what = "median error" if _differ(trade, row) else "error"
    found = [
        f"As shipped ({label(row.settings)}) {_wrong(trade, row, error)}, for "
        f"{quantity(row.cost, MICRO)} of computing per simulated second.",
        _offer(trade, f"Half that {what}", error / 2, row),
    ]
    same = trade.cheapest(error)
    if same.cost < NOTABLE * row.cost:
        found.append(_offer(trade, f"No more {what} than that", error, row))
    return found


def _wrong(trade: Trade, row: Row, error: float) -> str:
    """How wrong positions are; where one start is far worse than the median, that one first."""
    assert row.errors is not None
    worst, over = metres(row.errors.position_max), f"over {seconds(trade.horizon)}"
    if trade.starts == 1:
        return f"positions are {metres(error)} wrong {over} (rms; at worst {worst})"
    start, median = f"start {row.errors.worst}", f"median of {trade.starts} starts"
    if _differ(trade, row):
        return (
            f"positions are up to {worst} wrong {over}, in {start}; starts differ: the {median} "
            f"is {metres(error)} (rms)"
        )
    return (
        f"positions are {metres(error)} wrong {over} (rms, {median}; at worst {worst}, in {start})"
    )


def _differ(trade: Trade, row: Row) -> bool:
    """Whether the median over starts says little about the worst of them."""
    largest = 0.0 if row.errors is None else row.errors.position_max
    return trade.starts > 1 and largest > DIFFER * trade.error(row)


def _offer(trade: Trade, what: str, error: float, row: Row) -> str:
    try:
        found = trade.cheapest(error)
    except ValueError:
        return f"{what} is not reached by any setting tried."
    return (
        f"{what} costs {found.cost / row.cost:.2f} times as much computing: "
        f"{label(found.settings)} ({metres(trade.error(found))})."
    )


def cautions(trade: Trade) -> list[str]:
    """What the reference's error means for the table."""
    ref = trade.reference
    least = smallest([row.errors.position for row in trade.rows if row.errors])
    found = []
    if ref.error * FINER > least > 0:
        found.append(
            f"the reference's error of {metres(ref.error)} is not {FINER:.0f} times smaller "
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
