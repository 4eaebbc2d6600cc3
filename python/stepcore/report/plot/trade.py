"""Plot of a trade: error against cost, on log axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import (
    COLOURS,
    FONT,
    GREY,
    frame,
    legend,
    line,
    log_ticks,
    new_figure,
    write_beside,
)
from stepcore.report.settings import label
from stepcore.report.units import counted, operations, seconds

if TYPE_CHECKING:
    from stepcore.experiment.trial import Trial
    from stepcore.measure.trade.result import Trade

MARKERS = {"newton": "o", "pgs": "s"}
# MuJoCo's points, in the same colours.
THEIRS = "*"
AT_LEAST = r"$\uparrow$"


def trade(trade: Trade) -> Any:
    """Draw a point for each setting, and a line through the best settings of each engine.

    Where a setting did not run from all starts an arrow at its error points up.
    Colours are integrators, markers are solvers, hollow markers are single precision, and stars are
    MuJoCo. Rings mark the shipped and the chosen settings. Crosses at the upper edge are failures.
    """
    figure = new_figure(9.0, 5.2)
    axes = figure.add_subplot()
    good, far = _split(trade)
    beside = trade.beside
    theirs = [] if beside is None else [r for r in _split(beside)[0] if not beside.partial(r)]
    fronts = [] if beside is None else beside.front
    for rows, front, style in ((good, trade.front, "-"), (theirs, fronts, ":")):
        for row in rows:
            _point(axes, trade, row, best=row in front, theirs=rows is theirs)
        best = [(_cost(trade, row), row.error) for row in front if row in rows]
        if best:
            axes.plot(*zip(*best, strict=True), color="black", lw=1.3, ls=style, zorder=2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    target = [error for error in (trade.target, trade.verified) if error is not None]
    low, high = _limits([row.error for row in (*good, *theirs)] + target)
    error = trade.reference.error
    if low < error < 1.5 * low:
        # Room for the text of a band that the axis would cut.
        low = error / 1.5
    axes.set_ylim(low, high)
    axes.margins(x=0.08)
    # Failures are drawn a little below the upper edge.
    top = high * (low / high) ** 0.03
    for row in far:
        colour = COLOURS.get(row.settings.integrator, GREY)
        axes.plot(_cost(trade, row), top, "x", ms=8, mew=2, color=colour, zorder=6)
    dashed: dict[str, Any] = {"color": GREY, "ls": "--", "lw": 1.0, "zorder": 1}
    if trade.target is not None:
        axes.axhline(trade.asked, **dashed)
    elif trade.budget is not None:
        axes.axvline(trade.budget if trade.by == "flops" else trade.budget / 1e3, **dashed)
    if error > low:
        axes.axhspan(low, error, color="#DDDDDD", zorder=0)
        text = f"below what the converged motion is sure of, {trade.words(error)}"
        place = {"transform": axes.get_yaxis_transform(), "va": "top", "fontsize": FONT["small"]}
        axes.text(0.01, error, text, **place)
    flops = trade.by == "flops"
    log_ticks(axes.xaxis, operations if flops else "{:g}".format)
    log_ticks(axes.yaxis)
    timed = "computing time per simulated second, by counted work [ms]"
    counts = "floating-point operations per simulated second"
    starts = counted(trade.starts, "start")
    starts += " or more" if any(len(row.starts) > trade.starts for row in good) else ""
    title = f"{trade.name}: error over {seconds(trade.horizon)} against cost, {starts}"
    error_words = f"{trade.measure.error_words} of the worst start{trade.measure.in_unit}"
    frame(axes, title, counts if flops else timed, error_words)
    _legend(figure, trade, good, bool(far))
    _rings(axes, trade, good, top)
    return figure


def _cost(trade: Trade, row: Trial) -> float:
    """Return the horizontal value: ms per simulated second, or operations."""
    return row.cost if trade.by == "flops" else row.cost / 1e3


def _split(trade: Trade) -> tuple[list[Trial], list[Trial]]:
    """Return the rows drawn at their values, and the rows that failed or are far off."""
    done = sorted(row.error for row in trade.rows if not row.failure)
    middle = done[len(done) // 2] if trade.shipped.failure and done else trade.shipped.error
    # Larger errors are drawn as failures, to limit the axis.
    limit = 1e4 * max(middle, trade.reference.error, 1e-300)
    good = [row for row in trade.rows if not row.failure and row.error <= limit]
    return good, [row for row in trade.rows if row not in good and math.isfinite(row.cost)]


def _point(axes: Any, trade: Trade, row: Trial, *, best: bool, theirs: bool) -> None:
    s = row.settings
    colour = COLOURS.get(s.integrator, GREY)
    if trade.partial(row) and not theirs:
        style: dict[str, Any] = {"marker": AT_LEAST, "ls": "none", "alpha": 0.55}
        axes.plot(_cost(trade, row), row.error, ms=7, color=colour, zorder=2.5, **style)
        return
    axes.plot(
        _cost(trade, row),
        row.error,
        THEIRS if theirs else MARKERS.get(s.solver, "^"),
        ms=(11 if theirs else 7) if best else (8 if theirs else 5.5),
        mfc=colour if getattr(s, "precision", "f64") == "f64" else "white",
        mec="black" if theirs else colour,
        mew=0.7 if theirs else 1.2,
        alpha=1.0 if best else 0.55,
        # Two integrators can coincide; the shipped setting is drawn on top.
        zorder=4.5 if row is trade.shipped else 4 if best else 3,
    )


def _limits(errors: Sequence[float]) -> tuple[float, float]:
    """Return the range of errors [m], with room above for the failures."""
    some = [max(error, 1e-18) for error in errors] or [1e-3, 1.0]
    low, high = math.log10(min(some)), math.log10(max(some))
    room = max(0.06 * (high - low), 0.15)
    return 10 ** (low - room), 10 ** (high + 2.5 * room)


def _rings(axes: Any, trade: Trade, good: Sequence[Trial], top: float) -> None:
    """Draw rings around the shipped and the chosen settings, with their names.

    top: where failures are drawn.
    """
    marked = [("as shipped", trade.shipped)]
    chosen = trade.chosen
    if chosen is not None and chosen.change != trade.shipped.change:
        marked.append(("recommended", chosen))
    texts = list[tuple[tuple[float, float], str]]()
    for words, row in marked:
        settings = label(row.settings, sweeps=row is chosen).replace(", dt", ",\ndt")
        at = (_cost(trade, row), min(row.error, top))
        if row.change in [trial.change for trial in good]:
            axes.plot(*at, "o", ms=15, mfc="none", mec="black", mew=1.6, zorder=5)
        if math.isfinite(at[0]):
            texts.append((at, f"{words}\n{settings}"))
    write_beside(axes, texts)


def _legend(figure: Any, trade: Trade, good: Sequence[Trial], failed: bool) -> None:
    theirs = [] if trade.beside is None else trade.beside.rows
    used = {row.settings.integrator for row in (*trade.rows, *theirs)}
    solvers = {row.settings.solver for row in good}
    point: dict[str, Any] = {"ls": "none", "ms": 6}
    hollow: dict[str, Any] = {"mfc": "white", "ls": "none"}
    entries = [
        line(name, marker="o", color=colour, **point)
        for name, colour in COLOURS.items()
        if name in used
    ]
    entries += [line(n, marker=m, color=GREY, **point) for n, m in MARKERS.items() if n in solvers]
    if any(row.settings.precision == "f32" for row in good):
        entries.append(line("single precision", marker="o", mec=GREY, ms=6, **hollow))
    entries.append(line("best for its cost", color="black", lw=1.3))
    if trade.target is not None:
        entries.append(line(f"target {trade.words(trade.asked)}", color=GREY, ls="--", lw=1.0))
    if theirs:
        entries.append(line("MuJoCo", marker=THEIRS, mec="black", ms=11, **hollow))
        entries.append(line("MuJoCo's best for its cost", color="black", lw=1.1, ls=":"))
    if any(trade.partial(row) for row in good):
        entries.append(line("at least, not all starts", marker=AT_LEAST, color=GREY, **point))
    if failed:
        entries.append(line("failed or far off", marker="x", color=GREY, mew=2, **point))
    legend(figure, entries)
