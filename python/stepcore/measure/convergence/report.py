"""A convergence in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import metres, seconds

if TYPE_CHECKING:
    from stepcore.measure.convergence.result import Convergence

# Errors that differ by less than this factor are as good as each other.
ALIKE = 1.2
# Rows that are named, and those that are printed.
NAMED, PRINTED = 3, 10
ROWS = """\
After the shipped sweeps, where most is missing: missing impulse as a speed, and residual [m/s];
force as it is and as it is once solved [N or N·m]"""
# What misses less than this share of the largest holds nothing back.
SHARE = 0.1
# Of the largest residual: no more than rounding.
ROUNDING = 1e-13


def text(found: Convergence, width: int | None) -> str:
    """The printed convergence."""
    starts = f"{found.starts} start" + "s" * (found.starts != 1)
    reference = f"known to {metres(found.reference_error)}"
    lines = [
        f"{found.name}: {found.verdict}; {seconds(found.horizon)}, {starts}, as shipped "
        f"({label(found.settings)}); reference dt {seconds(found.reference.dt)}, {reference}",
        "",
        *sentences(found),
    ]
    if found.curves:
        rows = found.rows
        shown = Table(rows.records[:PRINTED], rows.columns, rows.formats)
        lines += ["", "Residual by sweeps, median and worst of the states [m/s]"]
        lines += [_falling(found.sweeps).text(width), "", ROWS]
        lines += [shown.text(width)]
        left = len(rows) - len(shown)
        lines += [f"and {left} more"] if left > 0 else []
    lines += ["", "By time step, all else as shipped: residual [m/s], error [m]"]
    lines += [found.steps.text(width)]
    if found.curves:
        lines += ["", "Equal row updates, steps x sweeps, under pgs; and the shipped settings"]
        lines += [found.work.text(width)]
    notes = [*found.notes, *_cautions(found)]
    if notes:
        lines += ["", *(f"note: {note}" for note in notes)]
    return "\n".join(lines)


def _falling(sweeps: Table) -> Table:
    """Up to where nothing falls any more but rounding."""
    worst = [max(r["cold worst"], r["warm worst"]) for r in sweeps]
    done = [k for k, value in enumerate(worst) if value <= ROUNDING * max(worst)]
    records = sweeps.records[: done[0] + 1] if done else sweeps.records
    return Table(records, sweeps.columns, sweeps.formats)


def sentences(found: Convergence) -> list[str]:
    """The verdict, what holds it back, how fast sweeps close in, and what buys more."""
    said = [_verdict(found)]
    if found.curves:
        said += [_rows(found), _closing(found), _work(found), _four(found)]
    return [sentence for sentence in said if sentence]


def _verdict(found: Convergence) -> str:
    if found.verdict == "diverging":
        return _diverging(found)
    if found.verdict == "no rows":
        return "There never is a contact, limit or other row: sweeps do not matter."
    rest = found.rest
    assert rest is not None
    both = f"{_length(found, rest.solver)} (rms) from the motion with converged forces"
    than = f"the time step makes {_length(found, found.solved.error)}"
    if found.verdict == "solved" and rest.solver < 1e-9 * found.size:
        return f"Solved: forces are converged; {than}."
    if found.verdict == "solved":
        return f"Solved: forces that are not converged put it {both}; {than}."
    return f"Under-solved: {_ending(found)} Over the motion it is {both}; {than}."


def _length(found: Convergence, value: float) -> str:
    """A length that means something beside the scene's size."""
    least = 1e-12 * found.size
    return metres(value) if value >= least else f"less than {metres(least)}"


def _ending(found: Convergence) -> str:
    """Where an under-solved motion goes."""
    from stepcore.measure.convergence.result import NOTABLE, STILL

    rest = found.rest
    assert rest is not None
    apart = f"{metres(rest.apart)} from where converged forces take it"
    slow = STILL * rest.apart / found.horizon
    where = f"body {rest.body}" if not rest.body.startswith("body ") else rest.body
    if rest.apart <= NOTABLE * found.size:
        return "the motion is another on the way, and ends at the same place."
    if rest.speed <= slow:
        return f"it settles at a wrong fixed point, {where} {apart}."
    if rest.solved_speed <= max(slow, STILL * rest.speed):
        return (
            f"{where} still moves, at {metres(rest.speed)}/s where converged forces hold it, and "
            f"ends {apart}."
        )
    return f"{where} ends {apart}."


def _diverging(found: Convergence) -> str:
    if not found.own.failure:
        return (
            f"Diverging: with converged forces it fails ({found.solved.failure}), and only few "
            "sweeps hide it."
        )
    why = f"Diverging: {found.own.failure}."
    if not found.solved.failure:
        return f"{why} With converged forces at the same time step it does not: it lacks sweeps."
    finite = [s for s in found.plan.dts if s.dt < found.settings.dt and not found.runs[s].failure]
    if finite:
        step = seconds(max(s.dt for s in finite))
        return (
            f"{why} Converged forces do not help; a smaller time step does, from {step} on. See "
            "stepcore diagnose for the element that sets it."
        )
    return f"{why} Neither converged forces nor the time steps tried help."


def _rows(found: Convergence) -> str:
    rows = [r for r in found.rows if r["missing"] > 0]
    if not rows or found.verdict == "solved":
        return ""
    most = max(abs(r["solved"] - r["force"]) for r in rows)
    held = [
        r
        for r in rows
        if r["missing"] >= SHARE * rows[0]["missing"]
        or abs(r["solved"] - r["force"]) >= SHARE * most
    ][:NAMED]
    names = ", ".join(
        f"{r['name']} ({r['force']:.3g} of {r['solved']:.3g}, residual {r['residual']:.2g} m/s)"
        for r in held
    )
    return f"Held back by {names}: what the shipped sweeps give it of the force that it needs."


def _closing(found: Convergence) -> str:
    rate = found.contraction
    if rate is None:
        return "No two rows push at once: one sweep solves them."
    if rate >= 1 - 1e-9:
        return f"Sweeps do not converge: each leaves {rate:.6g} of the error."
    said = f"A sweep leaves {_share(rate)} of the error"
    if rate > 0:
        said += f" ({math.log(10) / -math.log(rate):.3g} sweeps a decimal)"
    theory = found.theory
    parts = []
    if theory.radius is not None:
        parts.append(f"{_share(theory.radius)} by the rows' own matrix")
    elif theory.why:
        parts.append(f"none of the rows: {theory.why}")
    if theory.closed is not None:
        parts.append(f"{_share(theory.closed)} for rigid rows, {theory.formula}")
    return f"{said}; theory: {'; '.join(parts)}." if parts else f"{said}."


def _share(value: float) -> str:
    """Enough digits to tell a number near 1 from 1."""
    if 0 < value < 1e-3:
        return f"{value:.1e}"
    digits = 4 if value < 0.99 else 2 + math.ceil(-math.log10(max(1 - value, 1e-12)))
    return f"{value:.{digits}f}"


def better(found: Convergence) -> str:
    """What buys more at equal row updates."""
    splits = [(s, found.runs[s.settings]) for s in found.plan.splits]
    done = [(s, run.error) for s, run in splits if not run.failure]
    if not found.curves:
        return "neither"
    many_steps = min((e for s, e in done if s.steps > s.sweeps), default=math.inf)
    many_sweeps = min((e for s, e in done if s.steps < s.sweeps), default=math.inf)
    if many_steps * ALIKE < many_sweeps:
        return "smaller steps"
    return "more sweeps" if many_sweeps * ALIKE < many_steps else "neither"


def _work(found: Convergence) -> str:
    told = []
    for split in found.plan.splits:
        run = found.runs[split.settings]
        told.append(f"{split.steps}x{split.sweeps} {'fails' if run.failure else metres(run.error)}")
    words = {
        "smaller steps": "smaller steps buy more than sweeps",
        "more sweeps": "sweeps buy more than smaller steps",
        "neither": "sweeps and smaller steps buy the same",
    }
    return f"At equal row updates {words[found.better]} (steps x sweeps): {', '.join(told)}."


def _four(found: Convergence) -> str:
    """What four times the work buys from here."""
    quarter = [s for s in found.plan.dts if math.isclose(s.dt, found.settings.dt / 4)]
    if found.plan.more is None or not quarter or found.own.failure:
        return ""
    more, finer = found.runs[found.plan.more], found.runs[quarter[0]]
    if more.failure or finer.failure:
        return ""
    return (
        f"From the shipped {metres(found.own.error)}, four times the sweeps give "
        f"{metres(more.error)}, a quarter of the time step {metres(finer.error)}."
    )


def _cautions(found: Convergence) -> list[str]:
    said = []
    reached = found.runs[found.reference].residual
    if found.verdict != "no rows" and reached > 1e-3 * max(found.own.residual, 1e-9):
        said.append(
            f"the reference's own residual is {reached:.2g} m/s: its sweeps do not converge in the "
            "time that they are given"
        )
    errors = [run.error for run in found.runs.values() if run.settings not in found.plan.references]
    least = min((e for e in errors if e == e), default=math.inf)
    if found.reference_error * 10 <= least:
        return said
    return [
        *said,
        f"the reference is known to {metres(found.reference_error)}, more than a tenth of the "
        f"smallest error shown, {metres(least)}: errors near it say little",
    ]
