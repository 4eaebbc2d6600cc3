"""Bar plots: limits of the time step, costs of a step, savings of removed features."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    bar,
    frame,
    halo,
    legend,
    line,
    log_ticks,
    name_places,
    named_bars,
    new_figure,
    patches,
    write_centred,
)
from stepcore.report.units import seconds

if TYPE_CHECKING:
    from stepcore.engine.plan import Plan
    from stepcore.measure.ablation import Ablation
    from stepcore.measure.check import Check
    from stepcore.measure.comparison import Comparison
    from stepcore.measure.diagnosis.result import Diagnosis
    from stepcore.measure.tune import Tuning


# The number of letters of a name.
ELEMENT_LETTERS = 28
# Height of a group of bars relative to the distance between groups.
GROUP = 0.8


def diagnosis(result: Diagnosis) -> Any:
    """Draw the largest stable dt of each integrator, the scene's first: runs, and the held pose.

    A bar ends with an arrow at the longest step that was tried if no step fails. A limit that is
    not known has a bar with a question mark, up to the longest step that holds. A red line spans
    the steps of which some hold and some fail. The vertical line is the wanted dt.
    """
    limits = sorted(result.limits.values(), key=lambda limit: limit is not result.own)
    figure = new_figure(8.0, 1.9 + 0.5 * len(limits))
    axes = figure.add_subplot()
    low, high = _range([result.wanted, *(dt for limit in limits for dt in limit.ends)])
    for place, limit in enumerate(limits):
        ends, colours = limit.ends, (BLUE, GREY)
        for k, dt in enumerate((limit.dt, limit.held)):
            at = place + GROUP * (k / 2 - 0.25)
            _bar(axes, at, ends[k], (low, high), 0.42 * GROUP, colours[k], math.isinf(dt))
        at, name = place - 0.25 * GROUP, "?"
        if limit.known:
            name = result.stiffest(limit.integrator) if math.isfinite(limit.dt) else ""
        _named(axes, name.replace("`", ""), at, ends[0], (low, high))
        if limit.erratic is not None:
            axes.plot(limit.erratic, (at, at), color=RED, lw=1.3, zorder=4)
    axes.axvline(result.wanted, color="black", lw=1.3, zorder=4)
    names = [limit.integrator for limit in limits]
    name_places(axes, names, range(len(limits)), ELEMENT_LETTERS)
    axes.set_ylim(len(limits) - 0.4, -0.6)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    log_ticks(axes.xaxis, seconds)
    frame(axes, f"{result.name}: what limits the time step", "largest stable dt")
    axes.grid(False, axis="y")
    entries = patches({"runs of the motion": BLUE, "held pose, linearised": GREY})
    entries.append(line(f"dt {seconds(result.wanted)}", color="black", lw=1.3))
    if any(limit.erratic for limit in limits):
        entries.append(line("erratic", color=RED, lw=1.3))
    if any(math.isinf(dt) for limit in limits for dt in (limit.dt, limit.held)):
        entries.append(line("no limit up to here", marker=">", ls="none", ms=5, color=GREY))
    legend(figure, entries, columns=4)
    return figure


def _range(values: Sequence[float]) -> tuple[float, float]:
    """Return the range of full decades that contains all finite positive numbers."""
    values = [x for x in values if math.isfinite(x) and x > 0]
    low = 10.0 ** math.floor(math.log10(0.7 * min(values)))
    high = 10.0 ** math.ceil(math.log10(1.5 * max(values)))
    return max(low, high / 1e9), high


def _bar(
    axes: Any,
    place: float,
    dt: float,
    limits: tuple[float, float],
    height: float,
    colour: str,
    endless: bool,
) -> None:
    low, high = limits
    if math.isnan(dt):
        return
    if dt <= low:
        axes.plot(low, place, "x", ms=5, mew=1.6, color=colour, clip_on=False, zorder=5)
        return
    axes.barh(place, min(dt, high) - low, left=low, height=height, color=colour, zorder=3)
    if endless:
        axes.plot(dt, place, ">", ms=4.5, color=colour, clip_on=False, zorder=5)


def _named(axes: Any, name: str, place: float, dt: float, limits: tuple[float, float]) -> None:
    """Write the name of what limits a step after its bar, or in it where the bar is long."""
    low, high = limits
    inside = dt > math.sqrt(low * high)
    style: dict[str, Any] = (
        {"color": "white", "ha": "right"} if inside else {"path_effects": halo()}
    )
    style |= {"textcoords": "offset points", "va": "center", "fontsize": 7, "zorder": 5}
    axes.annotate(name, (max(dt, low), place), (-4 if inside else 4, 0), **style)


def check(check: Check) -> Any:
    """Draw the plot of the diagnosis."""
    if check.diagnosis is not None:
        return diagnosis(check.diagnosis)
    figure = new_figure(8.0, 2.0)
    axes = figure.add_subplot()
    frame(axes, check.title)
    write_centred(axes, "the time step was not diagnosed")
    return figure


def tuning(result: Tuning) -> Any:
    """Draw the measured value of each proposal as a multiple of the wanted one."""
    names = [f"{tuned.kind} {tuned.name}" for tuned in result.found]
    figure, (axes,), places = named_bars(names, ELEMENT_LETTERS)
    for place, tuned in zip(places, result.found, strict=True):
        ratio, colour = tuned.measured / tuned.goal.value, GREEN if tuned.reached else RED
        # An unknown value, or one far from the wanted value, has a number and no bar.
        near = ratio < 1.4
        bar(axes, place, near * ratio, colour, tuned.result, after=1.0 if near else 0.0)
    axes.axvline(1.0, color="black", lw=1.3, zorder=4)
    axes.set_xlim(0.0, 1.5)
    frame(axes, result.title, "measured, relative to the wanted value")
    return figure


# The number of letters of an entry's or a feature's name.
LETTERS = 46
STAGES = {"place": BLUE, "detect": ORANGE, "solve": RED, "commit": GREEN}


def plan(plan: Plan) -> Any:
    """Draw bars of the operations, or of the measured time, of each entry by stage."""
    timed = plan.micros is not None
    costs = [(entry, entry.micros if timed else entry.flops) for entry in plan.used]
    bars = [(e, float(cost)) for e, cost in costs if e.stage in STAGES and cost is not None]
    figure, (axes,), places = named_bars([entry.name for entry, _ in bars], LETTERS)
    for place, (entry, value) in zip(places, bars, strict=True):
        bar(axes, place, value, STAGES[entry.stage], f"{value:.2f}" if timed else f"{value:.0f}")
    axes.set_xlim(right=1.12 * max([1e-3, *(value for _, value in bars)]))
    words = "time per step [µs]" if timed else "floating-point operations per step"
    frame(axes, f"{plan.name}: what a step does", words)
    used = {entry.stage for entry, _ in bars}
    legend(figure, patches({name: STAGES[name] for name in STAGES if name in used}), columns=4)
    return figure


def ablation(result: Ablation) -> Any:
    """Draw the work saved (left) and the error added (right) by removing each feature."""
    rows = [row for row in result.sorted() if not row.trial.failure][:24]
    names = [f"all {len(result.removed)} that are not needed"]
    names += [row.removal.label for row in rows]
    rows = [result.best, *rows]
    figure, (work, error), places = named_bars(names, LETTERS, 2, 9.0, 2.2)
    tolerance = result.tolerance
    # The axis begins a decade below the smallest error that counts.
    measured = [row.trial.error for row in rows if result.measurable(row)]
    least = min([added for added in (*measured, tolerance) if added > 0], default=tolerance)
    # Errors below a thousandth of the tolerance have no bar, only a number.
    low = float(10.0 ** math.floor(math.log10(max(least, 1e-3 * tolerance)) - 1))
    for place, row in zip(places, rows, strict=True):
        share, added = 100 * result.saved(row), row.trial.error
        colour = GREEN if row.removal in result.removed else RED
        colour = "black" if row is result.best else colour
        bar(work, place, share, colour, f"{share:.1f}" if abs(share) < 10 else f"{share:.0f}")
        text = result.least(row, result.words(added)) if result.measurable(row) else "none"
        bar(error, place, added, colour, text, left=low)
    error.set_xscale("log")
    error.set_xlim(low, 40 * max(*(row.trial.error for row in rows), tolerance))
    log_ticks(error.xaxis)
    error.axvline(tolerance, color=GREY, ls="--", lw=1)
    error.tick_params(axis="y", length=0)
    work.set_xlim(right=1.25 * max(1.0, *(100 * result.saved(row) for row in rows)))
    frame(work, f"{result.name}: without …", "work saved [% of operations]")
    frame(error, "", f"{result.measure.error_words} added{result.measure.in_unit}")
    figure.get_layout_engine().set(wspace=0.06)
    needed = {f"not needed within {result.words(tolerance)}": GREEN, "kept": RED}
    entries = patches(needed | {"the smallest model": "black"})
    entries.append(line(f"tolerance {result.words(tolerance)}", color=GREY, ls="--", lw=1))
    legend(figure, entries, columns=2)
    return figure


def comparison(result: Comparison) -> Any:
    """Draw the effect of each difference alone and removed, for each kind of runs."""
    parts = [(part, row) for part in result.parts for row in part.rows if row.largest > 0][:24]
    names = [row.difference.path for _, row in parts]
    figure, (axes,), places = named_bars(names, LETTERS, width=9.0)
    finite = [x for _, row in parts for x in (row.alone, row.removed) if 0 < x < math.inf]
    low, high = _range(finite or [1.0])
    for place, (part, row) in zip(places, parts, strict=True):
        colours = (BLUE, ORANGE) if row.needed else (GREY, GREY)
        for k, far in enumerate((row.alone, row.removed)):
            at = place + GROUP * (0.25 - k / 2)
            if far > low:
                width = min(far, high) - low
                axes.barh(at, width, 0.42 * GROUP, left=low, color=colours[k], zorder=3)
        axes.plot([part.within] * 2, (place - 0.5, place + 0.5), color="black", lw=1.3, zorder=4)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    log_ticks(axes.xaxis)
    frame(axes, result.title, "distance by which a difference moves the motion [m]")
    axes.grid(False, axis="y")
    entries = patches({"alone": BLUE, "removed": ORANGE, "does not matter": GREY})
    entries.append(line("counts as equal", color="black", lw=1.3))
    legend(figure, entries, columns=4)
    return figure
