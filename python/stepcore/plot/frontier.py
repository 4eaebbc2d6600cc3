"""The picture of a trade: log cost against log error. matplotlib is needed only here."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from stepcore.plot.style import COLOURS, GREY, bare, figure, saved
from stepcore.trade.settings import metres, seconds

if TYPE_CHECKING:
    from stepcore.trade.result import Row, Trade

MARKERS = ("^", "s", "D", "v", "P", "X")
# Errors this many times the shipped one are drawn as failures: they would flatten the rest.
FAR = 1e4


def plot_trade(trade: Trade, path: str | os.PathLike[str] | None = None) -> Any:
    """Draws a trade; writes it where `path` says, in the format of its ending.

    Colours are integrators, markers solvers, hollow ones single precision; the line joins the
    Pareto-best settings, a ring marks the shipped ones, crosses on the upper edge the failures.
    Returns the matplotlib Figure. Raises ImportError without matplotlib.
    """
    drawn = figure()
    axes = drawn.add_subplot()
    good, far = _split(trade)
    markers = _markers(row.settings for row in trade.rows)
    for row in good:
        _point(axes, trade, row, markers[_method(row.settings)])
    front = sorted((row.cost / 1e3, trade.error(row)) for row in good if row.best)
    axes.plot(*zip(*front, strict=True), color="black", lw=1.1, alpha=0.75, zorder=2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = _limits(trade, good)
    axes.set_ylim(low, high)
    _failures(axes, trade, far, high)
    shipped = trade.shipped
    if shipped in good:
        at = (shipped.cost / 1e3, trade.error(shipped))
        axes.plot(*at, "o", ms=15, mfc="none", mec="black", mew=1.6, zorder=5)
        text = f"as shipped\ndt {seconds(shipped.settings.dt)}"
        # Below and left of the front there is nothing to cover.
        style: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "va": "top"}
        axes.annotate(text, at, (-8, -10), zorder=6, fontsize=9, **style)
    error = trade.reference.high
    if error > low:
        axes.axhspan(low, error, color="#DDDDDD", zorder=0)
        text = f"below the reference's own error, {metres(error)}"
        axes.text(0.01, error, text, transform=axes.get_yaxis_transform(), va="top", fontsize=8)
    _words(axes, trade)
    _legend(drawn, trade, markers, bool(far))
    return saved(drawn, path)


def _method(settings: Any) -> str:
    """The solver as the legend names it."""
    return f"pgs, {settings.sweeps}" if settings.solver == "pgs" else str(settings.solver)


def _markers(settings: Iterable[Any]) -> dict[str, str]:
    """A marker for every solver and number of sweeps."""
    some = sorted({(s.solver, s.sweeps if s.solver == "pgs" else 0) for s in settings})
    names = [f"pgs, {sweeps}" if solver == "pgs" else solver for solver, sweeps in some]
    rest = iter(MARKERS * len(names))
    return {name: "o" if name == "newton" else next(rest) for name in names}


def _split(trade: Trade) -> tuple[list[Row], list[Row]]:
    """Rows that are drawn where they are, and those that failed or are far off."""
    errors = sorted(trade.error(row) for row in trade.rows if row.errors)
    middle = trade.error(trade.shipped) if trade.shipped.errors else errors[len(errors) // 2]
    limit = FAR * max(middle, trade.reference.high, 1e-300)
    good = [row for row in trade.rows if row.errors and trade.error(row) <= limit]
    return good, [row for row in trade.rows if not row.errors or trade.error(row) > limit]


def _point(axes: Any, trade: Trade, row: Row, marker: str) -> None:
    s = row.settings
    colour = COLOURS.get(s.integrator, GREY)
    face = colour if s.precision == "f64" else "white"
    axes.plot(
        row.cost / 1e3,
        trade.error(row),
        marker,
        ms=7 if row.best else 5.5,
        mfc=face,
        mec=colour,
        mew=1.2,
        alpha=1.0 if row.best else 0.55,
        zorder=4 if row.best else 3,
    )


def _limits(trade: Trade, rows: list[Row]) -> tuple[float, float]:
    """The range of errors [m], with room above for the failures."""
    errors = [max(trade.error(row), 1e-18) for row in rows]
    low, high = math.log10(min(errors)), math.log10(max(errors))
    room = max(0.06 * (high - low), 0.15)
    return 10 ** (low - room), 10 ** (high + 2.5 * room)


def _failures(axes: Any, trade: Trade, rows: list[Row], high: float) -> None:
    """Crosses on the upper edge, at what they cost, or where their like with success would be."""
    done = [row for row in trade.rows if not math.isnan(row.cost)]
    for row in rows:
        cost = row.cost
        if math.isnan(cost):
            like = [r for r in done if r.settings.integrator == row.settings.integrator] or done
            near = min(like, key=lambda r: abs(math.log(r.settings.dt / row.settings.dt)))
            cost = near.cost * near.settings.dt / row.settings.dt
        colour = COLOURS.get(row.settings.integrator, GREY)
        axes.plot(cost / 1e3, high, "x", ms=8, mew=2, color=colour, clip_on=False, zorder=6)


def _words(axes: Any, trade: Trade) -> None:
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlabel("computing time per simulated second [ms]")
    axes.set_ylabel("position error, rms [m]")
    starts = f"{trade.starts} start" + "s" * (trade.starts != 1)
    title = f"{trade.name}: error over {seconds(trade.horizon)} against cost, {starts}"
    bare(axes, title)


def _legend(drawn: Any, trade: Trade, markers: dict[str, str], failed: bool) -> None:
    from matplotlib.lines import Line2D

    def entry(name: str, marker: str, **style: Any) -> Any:
        return Line2D([], [], marker=marker, ls="none", ms=6, label=name, **style)

    used = {row.settings.integrator for row in trade.rows}
    entries = [entry(name, "o", color=colour) for name, colour in COLOURS.items() if name in used]
    words = {name: f"{name} sweeps" if name.startswith("pgs") else name for name in markers}
    words = {name: w[:-1] if w.endswith(" 1 sweeps") else w for name, w in words.items()}
    entries += [entry(words[name], mark, color=GREY) for name, mark in markers.items()]
    if any(row.settings.precision == "f32" for row in trade.rows):
        entries.append(entry("single precision", "o", mfc="white", mec=GREY))
    entries.append(Line2D([], [], color="black", lw=1.1, label="best for its cost"))
    if failed:
        entries.append(entry("failed or far off", "x", color=GREY, mew=2))
    drawn.legend(handles=entries, loc="outside right center", fontsize=9, frameon=False)
