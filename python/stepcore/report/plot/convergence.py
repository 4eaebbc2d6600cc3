"""The plot of a convergence: residual against sweeps, and what equal work buys."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import (
    BLUE,
    GREEN,
    GREY,
    RED,
    SMALL,
    TEXT,
    frame,
    log_ticks,
    new_figure,
    say,
)
from stepcore.report.units import metres, seconds

if TYPE_CHECKING:
    from stepcore.measure.convergence.result import Convergence

# Residuals below this share of the largest are rounding.
LEAST = 1e-13


def draw(result: Convergence) -> Any:
    """Left, the residual by sweeps; right, the error at equal row updates, as steps and sweeps.

    Lines are the median of the states, from zero impulses and from those of the step before, shaded
    up to the worst state; dashed is theory.
    """
    figure = new_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _sweeps(left, result)
    _work(right, result)
    return figure


def _sweeps(axes: Any, result: Convergence) -> None:
    table = result.sweeps
    frame(axes, f"{result.name}: {result.verdict}")
    axes.set_xlabel("sweeps")
    axes.set_ylabel("residual [m/s]")
    if not len(table):
        say(axes, "no contact, limit or other row")
        return
    sweeps = np.array(table["sweeps"], float)
    top = max(max(table["cold worst"]), max(table["warm worst"]), 1e-300)
    for kind, colour, width in (("cold", BLUE, 3.0), ("warm", RED, 1.4)):
        middle, worst = (np.maximum(table[name], LEAST * top) for name in (kind, f"{kind} worst"))
        axes.plot(sweeps, middle, color=colour, lw=width, marker="o", ms=3.5, label=f"{kind} start")
        axes.fill_between(sweeps, middle, worst, color=colour, alpha=0.18, lw=0)
    _theory(axes, result, sweeps, top)
    own = result.settings
    if own.solver == "pgs" and own.sweeps != "auto" and own.sweeps > 0:
        axes.axvline(own.sweeps, color=GREY, lw=1, ls=":", label=f"as shipped, {own.sweeps}")
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_ylim(0.5 * LEAST * top if _reaches(table, top) else None, 3 * top)
    done = [n for n in table if max(n["cold worst"], n["warm worst"]) <= LEAST * top]
    axes.set_xlim(0.8, 1.25 * (max(4 * done[0]["sweeps"], 8) if done else sweeps[-1]))
    # Below, where nothing is drawn.
    axes.legend(
        fontsize=SMALL, frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.14), ncols=2
    )


def _reaches(table: Any, top: float) -> bool:
    """Whether some residual is at rounding."""
    return min(min(table["cold"]), min(table["warm"])) <= LEAST * top


def _theory(axes: Any, result: Convergence, sweeps: Any, top: float) -> None:
    """The slope that theory gives, through the slowest state's middle."""
    theory, slowest = result.theory, result.slowest
    rate = theory.radius
    if slowest is None or rate is None or not 0 < rate < 1:
        return
    # Anchored where the measured curve is on its slope and not yet rounding.
    cold = np.array(slowest.cold)
    at = [k for k, value in enumerate(cold) if value > 1e-7 * cold.max()]
    if not at:
        return
    k = at[-1]
    grid = np.geomspace(sweeps[0], sweeps[-1], 400)
    line = 1.8 * cold[k] * rate ** (grid - sweeps[k])
    seen = (line > LEAST * top) & (line < 3 * top)
    text = f"theory, {_share(rate)} per sweep"
    axes.plot(grid[seen], line[seen], color="black", lw=1.2, ls="--", label=text)


def _share(rate: float) -> str:
    digits = 3 if rate < 0.99 else 2 + math.ceil(-math.log10(1 - rate))
    return f"{rate:.{digits}f}"


def _work(axes: Any, result: Convergence) -> None:
    frame(axes, "equal row updates, steps × sweeps")
    axes.set_xlabel("RMS position error [m]")
    splits = result.candidates.splits
    runs = [result.runs[split.settings] for split in splits]
    errors = [run.error for run in runs]
    known = [error for error in errors if math.isfinite(error) and error > 0]
    if not known:
        say(axes, "all of these runs fail")
        return
    solved = result.solved.error
    low = 0.3 * min([*known, *([solved] if solved > 0 else [])])
    high = 12 * max(known)
    for k, (run, error) in enumerate(zip(runs, errors, strict=True)):
        if run.failure:
            axes.text(low * 1.3, k, "fails", va="center", color=GREY)
            continue
        axes.barh(k, max(error, low) - low, left=low, height=0.62, color=GREEN)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
        axes.text(max(error, low) * 1.15, k, metres(error), va="center", fontsize=TEXT, bbox=box)
    labels = [f"{s.steps} × {s.sweeps}\ndt {seconds(s.settings.dt)}" for s in splits]
    axes.set_yticks(range(len(splits)), labels, fontsize=TEXT)
    axes.set_ylim(len(splits) - 0.4, -0.6)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    log_ticks(axes.xaxis)
    if math.isfinite(solved) and solved > 0:
        text = f"dt {seconds(result.settings.dt)}, converged"
        axes.axvline(solved, color="black", lw=1.2, ls="--", label=text)
        axes.legend(fontsize=SMALL, frameon=False, loc="upper right", bbox_to_anchor=(1.0, -0.14))
