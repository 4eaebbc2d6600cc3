"""The report of a convergence in sentences."""

from __future__ import annotations

import math

from stepcore.measure.convergence.findings import NOTABLE, ConvergenceFindings, Ending
from stepcore.report.units import counted, metres, seconds, speed

# A body that moves less than this share of the distance in the whole motion rests.
STILL = 0.1
# A share of the error that is none.
NOTHING = 1e-12
# The number of rows that are named; a row that lacks less than this share of the largest is not.
NAMED, SHARE = 3, 0.1


def of(result: ConvergenceFindings) -> list[str]:
    """The verdict, what limits it, how fast sweeps converge, what gains more; what is shown."""
    said = [_verdict(result)]
    if result.histories:
        said += [_rows(result), _contraction(result), _work(result), _four_times(result)]
    said += [finding.text for finding in result.findings]
    return [sentence for sentence in said if sentence]


def _verdict(result: ConvergenceFindings) -> str:
    if result.ending is None:
        return _diverging(result)
    if result.verdict == "no rows":
        return "The motion has no contact, limit or other row, so sweeps do not matter."
    solver, size = result.ending.solver, result.reference.size
    apart = f"{_length(solver, size)} (RMS) from the motion with converged forces"
    step = f"The time step itself causes an error of {_length(result.solved.error, size)}."
    if result.verdict == "solved" and solver < 1e-9 * size:
        return f"Solved: the forces are converged. {step}"
    if result.verdict == "solved":
        return f"Solved: the motion is {apart}. {step}"
    return f"Under-solved: {_ending(result, result.ending)} Over the motion it is {apart}. {step}"


def _length(value: float, size: float) -> str:
    """A length that is no rounding beside the scene's size."""
    least = 1e-12 * size
    return metres(value) if value >= least else f"less than {metres(least)}"


def _ending(result: ConvergenceFindings, ending: Ending) -> str:
    """Where an under-solved motion ends."""
    apart = f"{metres(ending.apart)} from where converged forces take it"
    slow = STILL * ending.apart / result.horizon
    if ending.apart <= NOTABLE * result.reference.size:
        return "the motion differs on the way, but ends in the same place."
    if ending.speed <= slow:
        return f"{ending.body} settles at a wrong fixed point, {apart}."
    if ending.solved_speed <= max(slow, STILL * ending.speed):
        return (
            f"{ending.body} still moves at {speed(ending.speed)} where converged forces hold it, "
            f"and ends {apart}."
        )
    return f"{ending.body} ends {apart}."


def _diverging(result: ConvergenceFindings) -> str:
    if not result.own.failure:
        return (
            f"Diverging: with converged forces the motion fails ({result.solved.failure}); it runs "
            "only because sweeps are too few."
        )
    why = f"Diverging: {result.own.failure}."
    if not result.solved.failure:
        return f"{why} With converged forces at the same time step it does not: sweeps are too few."
    smaller = [
        settings.dt
        for settings in result.candidates.dts
        if settings.dt < result.settings.dt and not result.runs[settings].failure
    ]
    if smaller:
        return (
            f"{why} Converged forces do not help; a time step of {seconds(max(smaller))} does. "
            "`stepcore diagnose` names the element that limits it."
        )
    return f"{why} Neither converged forces nor the smaller time steps tried help."


def _rows(result: ConvergenceFindings) -> str:
    rows = [row for row in result.rows if row.missing > 0]
    if not rows or result.verdict == "solved":
        return ""
    most = max(abs(row.solved - row.force) for row in rows)
    limiting = [
        f"{row.name} ({row.force:.3g} of {row.solved:.3g}, residual {row.residual:.2g} m/s)"
        for row in rows
        if row.missing >= SHARE * rows[0].missing or abs(row.solved - row.force) >= SHARE * most
    ]
    return f"Force reached, of the converged force: {', '.join(limiting[:NAMED])}."


def _contraction(result: ConvergenceFindings) -> str:
    rate = result.contraction
    if rate is None:
        return "No two rows act at once, so one sweep solves them."
    if rate >= 1 - 1e-9:
        return f"Sweeps do not converge: each leaves {rate:.6g} of the error."
    said = f"A sweep leaves {_share(rate)} of the solver's error"
    if rate > NOTHING:
        said += f" ({math.log(10) / -math.log(rate):.3g} sweeps reduce it tenfold)"
    theory = result.theory
    parts = []
    if theory.radius is not None:
        parts.append(f"the matrix of the rows predicts {_share(theory.radius)}")
    elif theory.why:
        parts.append(f"the matrix of the rows predicts nothing, because {theory.why}")
    if theory.closed is not None:
        parts.append(f"theory for rigid rows is {_share(theory.closed)}, {theory.formula}")
    return f"{'; '.join([said, *parts])}."


def _share(value: float) -> str:
    """Enough digits to tell a number near 1 from 1."""
    if value <= NOTHING:
        return "nothing"
    if 0 < value < 1e-3:
        return f"{value:.1e}"
    digits = 4 if value < 0.99 else 2 + math.ceil(-math.log10(max(1 - value, 1e-12)))
    return f"{value:.{digits}f}"


def _work(result: ConvergenceFindings) -> str:
    errors = []
    for split in result.candidates.splits:
        run = result.runs[split.settings]
        error = "fails" if run.failure else metres(run.error)
        step, sweep = counted(split.steps, "step"), counted(split.sweeps, "sweep")
        errors.append(f"{step} of {sweep} {error}")
    steps, sweeps = result.at_equal_work
    if not (steps or sweeps):
        answer = "neither smaller steps nor more sweeps give a motion"
    elif not (steps and sweeps):
        answer = f"only {'smaller steps' if steps else 'more sweeps'} give a motion"
    else:
        answer = {
            "smaller steps": "smaller steps are more accurate than more sweeps",
            "more sweeps": "more sweeps are more accurate than smaller steps",
            "neither": "smaller steps and more sweeps are equally accurate",
        }[result.better]
    return f"At equal work (row updates) {answer}: {', '.join(errors)}."


def _four_times(result: ConvergenceFindings) -> str:
    """What four times the work gains from here."""
    more, quarter = result.candidates.more, result.candidates.quarter
    if more is None or quarter is None or result.own.failure:
        return ""
    sweeps, steps = result.runs[more], result.runs[quarter]
    if sweeps.failure or steps.failure:
        return ""
    return (
        f"The shipped settings have an error of {metres(result.own.error)}; four times the sweeps "
        f"give {metres(sweeps.error)}, a quarter of the time step {metres(steps.error)}."
    )


def cautions(result: ConvergenceFindings) -> list[str]:
    """Where the reference is too poor."""
    said = []
    references = result.candidates.references
    residual = result.runs[references[0]].residual
    if result.verdict != "no rows" and residual > 1e-3 * max(result.own.residual, 1e-9):
        said.append(
            f"the reference's own residual is {residual:.2g} m/s: its sweeps do not converge "
            "within their limit"
        )
    errors = [run.error for run in result.runs.values() if run.settings not in references]
    least = min((error for error in errors if math.isfinite(error)), default=math.inf)
    if result.reference.error * 10 > least:
        said.append(
            f"the reference has an error of {metres(result.reference.error)}, more than a tenth of "
            f"the smallest error shown ({metres(least)}): errors near it are uncertain"
        )
    return said
