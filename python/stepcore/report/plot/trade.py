"""Plot of a trade: error against cost, on log axes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from stepcore.report.plot.style import (
    COLOURS,
    GREY,
    SMALL,
    TEXT,
    frame,
    legend,
    line,
    log_ticks,
    new_figure,
)
from stepcore.report.settings import label
from stepcore.report.units import counted, metres, operations, seconds

if TYPE_CHECKING:
    from stepcore.measure.trade.result import Trade
    from stepcore.measure.trade.rows import TradeRow

MARKERS = {"newton": "o", "pgs": "s"}
# MuJoCo's points, in the same colours.
THEIRS = "*"
# Errors above this multiple of the shipped error are drawn as failures, to limit the axis.
FAR = 1e4
# The least height of the band below the reference's error, as a ratio.
NARROW = 1.5
# Points in this fraction of the axes at the left have their text at the right.
EDGE = 0.2
# Points above this multiple of the front have their text above.
ABOVE = 1.5


def trade(trade: Trade) -> Any:
    """Draw a point for each setting, and a line through the best settings of each engine.

    Colours are integrators, markers are solvers, hollow markers are single precision, and stars are
    MuJoCo. Rings mark the shipped and the recommended settings. Crosses at the upper edge are
    failures.
    """
    figure = new_figure(9.0, 5.2)
    axes = figure.add_subplot()
    good, far = _split(trade)
    for row in good:
        _point(axes, trade, row)
    front = sorted((_cost(trade, row), trade.frontier.searched(row)) for row in good if row.best)
    axes.plot(*zip(*front, strict=True), color="black", lw=1.3, alpha=0.8, zorder=2)
    limit = max(trade.frontier.searched(row) for row in good)
    theirs = _mujoco(axes, trade, limit)
    axes.set_xscale("log")
    axes.set_yscale("log")
    target = [error for error in (trade.target, trade.verified) if error is not None]
    low, high = _limits([*(trade.frontier.searched(row) for row in good), *theirs, *target])
    axes.set_ylim(low, high)
    axes.margins(x=0.08)
    _failures(axes, trade, far, high)
    _asked(axes, trade)
    _rings(axes, trade, good)
    error = trade.reference.high
    # Room for the text of a band that the axis would cut.
    if low < error < NARROW * low:
        low = error / NARROW
        axes.set_ylim(low, high)
    if error > low:
        axes.axhspan(low, error, color="#DDDDDD", zorder=0)
        text = f"below the reference's own error, {metres(error)}"
        place = {"transform": axes.get_yaxis_transform(), "va": "top", "fontsize": SMALL}
        axes.text(0.01, error, text, **place)
    _label_axes(axes, trade)
    _legend(figure, trade, good, bool(far))
    return figure


def _cost(trade: Trade, row: TradeRow) -> float:
    """Return the horizontal value: ms per simulated second, or operations."""
    return trade.price(row) if trade.by == "flops" else row.cost / 1e3


def _split(trade: Trade) -> tuple[list[TradeRow], list[TradeRow]]:
    """Return the rows drawn at their values, and the rows that failed or are far off."""
    errors = sorted(trade.frontier.searched(row) for row in trade.rows if row.errors)
    middle = (
        trade.frontier.searched(trade.shipped) if trade.shipped.errors else errors[len(errors) // 2]
    )
    limit = FAR * max(middle, trade.reference.high, 1e-300)
    good = [row for row in trade.rows if row.errors and trade.frontier.searched(row) <= limit]
    return good, [
        row for row in trade.rows if not row.errors or trade.frontier.searched(row) > limit
    ]


def _point(axes: Any, trade: Trade, row: TradeRow) -> None:
    s = row.settings
    colour = COLOURS.get(s.integrator, GREY)
    axes.plot(
        _cost(trade, row),
        trade.frontier.searched(row),
        MARKERS.get(s.solver, "^"),
        ms=7 if row.best else 5.5,
        mfc=colour if s.precision == "f64" else "white",
        mec=colour,
        mew=1.2,
        alpha=1.0 if row.best else 0.55,
        # Two integrators can coincide; the shipped setting is drawn on top.
        zorder=4.5 if row.shipped else 4 if row.best else 3,
    )


def _mujoco(axes: Any, trade: Trade, limit: float) -> list[float]:
    """Draw MuJoCo's points and a line through the best of them; return their errors."""
    points = [p for p in trade.mujoco if p.error <= limit and not math.isnan(p.cost)]
    for p in points:
        axes.plot(
            p.cost / 1e3,
            p.error,
            THEIRS,
            ms=11 if p.best else 8,
            mfc=COLOURS.get(p.integrator, GREY),
            mec="black",
            mew=0.7,
            alpha=1.0 if p.best else 0.5,
            zorder=4 if p.best else 3,
        )
    front = sorted((p.cost / 1e3, p.error) for p in points if p.best)
    if front:
        axes.plot(*zip(*front, strict=True), color="black", lw=1.1, ls=":", zorder=2)
    return [p.error for p in points]


def _limits(errors: list[float]) -> tuple[float, float]:
    """Return the range of errors [m], with room above for the failures."""
    some = [max(error, 1e-18) for error in errors]
    low, high = math.log10(min(some)), math.log10(max(some))
    room = max(0.06 * (high - low), 0.15)
    return 10 ** (low - room), 10 ** (high + 2.5 * room)


def _failures(axes: Any, trade: Trade, rows: list[TradeRow], high: float) -> None:
    """Draw failures at the upper edge; a failed run has the estimated cost of a similar run."""
    done = [row for row in trade.rows if not math.isnan(trade.price(row))]
    for row in rows:
        cost = _cost(trade, row)
        if math.isnan(cost):
            like = [r for r in done if r.settings.integrator == row.settings.integrator] or done
            near = min(like, key=lambda r: abs(math.log(r.settings.dt / row.settings.dt)))
            cost = _cost(trade, near) * near.settings.dt / row.settings.dt
        colour = COLOURS.get(row.settings.integrator, GREY)
        axes.plot(cost, high, "x", ms=8, mew=2, color=colour, clip_on=False, zorder=6)


def _asked(axes: Any, trade: Trade) -> None:
    """Draw the target error or the budget as a dashed line."""
    dashed = {"color": GREY, "ls": "--", "lw": 1.0, "zorder": 1}
    if trade.target is not None:
        kept, error = trade.kept, trade.verified or trade.target
        axes.axhline(error, **dashed)
        axes.axhspan(kept, error, color="#F0F0F0", zorder=0)
    elif trade.budget is not None:
        axes.axvline(trade.budget if trade.by == "flops" else trade.budget / 1e3, **dashed)


def _rings(axes: Any, trade: Trade, good: list[TradeRow]) -> None:
    """Draw rings around the shipped and the recommended settings, with their names.

    A grey ring, explained by the legend, marks a cheaper setting that almost meets the target.
    """
    from matplotlib.patheffects import withStroke

    shipped = label(trade.shipped.settings, sweeps=False).replace(", dt", ",\ndt")
    marked = [(trade.shipped, f"as shipped\n{shipped}")]
    chosen, other = trade.recommended or trade.nearest, trade.passed_over
    if chosen is not None and chosen is not trade.shipped:
        words = label(chosen.settings).replace(", dt", ",\ndt")
        marked.append((chosen, f"recommended\n{words}"))
    if other is not None and other is not trade.shipped:
        at = (_cost(trade, other), trade.frontier.searched(other))
        axes.plot(*at, "o", ms=15, mfc="none", mec=GREY, mew=1.6, zorder=5)
    for row, text in marked:
        if row not in good:
            continue
        at = (_cost(trade, row), trade.frontier.searched(row))
        axes.plot(*at, "o", ms=15, mfc="none", mec="black", mew=1.6, zorder=5)
        # Below and left of the front there are no points, so a text covers nothing except the
        # axis. A point far above the front has its text on the other side.
        left = axes.transAxes.inverted().transform(axes.transData.transform(at))[0] > EDGE
        front = [
            trade.frontier.searched(r)
            for r in good
            if r.best and trade.price(r) <= trade.price(row)
        ]
        below = trade.frontier.searched(row) <= ABOVE * min(front, default=math.inf)
        # What a text covers, such as the line of the target, is pale around its letters.
        halo = [withStroke(linewidth=1.5, foreground="white")]
        style: dict[str, Any] = {"textcoords": "offset points", "path_effects": halo}
        style |= {"ha": "right" if left and below else "left", "va": "top" if below else "bottom"}
        place = (-9 if left and below else 9, -9 if below else 9)
        axes.annotate(text, at, place, fontsize=TEXT, zorder=6, **style)


def _why_not(trade: Trade, row: TradeRow) -> str:
    """Return the reason why a cheaper setting is not recommended."""
    missed, count = trade.misses(row)
    if missed:
        return f"cheaper, but beyond the\ntarget on {missed} of {count} starts"
    if trade.error(row) <= trade.kept:
        return "cheaper, but its time\nstep is not round"
    return f"cheaper, but beyond\nthe {metres(trade.kept)} kept to"


def _label_axes(axes: Any, trade: Trade) -> None:
    log_ticks(axes.xaxis, operations if trade.by == "flops" else "{:g}".format)
    log_ticks(axes.yaxis)
    axes.set_xlabel("computing time per simulated second [ms]")
    if trade.by == "flops":
        axes.set_xlabel("floating-point operations per simulated second")
    axes.set_ylabel("RMS position error of the worst start [m]")
    starts = counted(trade.starts, "start")
    frame(axes, f"{trade.name}: error over {seconds(trade.horizon)} against cost, {starts}")


def _legend(figure: Any, trade: Trade, good: list[TradeRow], failed: bool) -> None:
    used = {row.settings.integrator for row in trade.rows} | {p.integrator for p in trade.mujoco}
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
        error = trade.verified or trade.target
        text = f"target {metres(error)},\nkept to {metres(trade.kept)}"
        entries.append(line(text, color=GREY, ls="--", lw=1.0))
    if trade.passed_over is not None:
        ring: dict[str, Any] = {"ls": "none", "ms": 12, "mfc": "none", "mec": GREY, "mew": 1.6}
        entries.append(line(_why_not(trade, trade.passed_over), marker="o", **ring))
    if trade.mujoco:
        name = f"MuJoCo {trade.mujoco[0].check.version}"
        entries.append(line(name, marker=THEIRS, mec="black", ms=11, **hollow))
        entries.append(line("MuJoCo's best for its cost", color="black", lw=1.1, ls=":"))
    if failed:
        entries.append(line("failed or far off", marker="x", color=GREY, mew=2, **point))
    legend(figure, entries)
