"""The picture of a post-mortem: energy over the last steps, and who fed it in."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import COLOURS, GREY, bare, figure, saved

if TYPE_CHECKING:
    from stepcore.engine.postmortem import PostMortem

# Elements that are drawn by name.
DRAWN = 5
# Parts beyond this are cut off.
CUT = 1.5
# Steps that are drawn: the last ones.
STEPS = 128


def plot_work(result: PostMortem, path: str | os.PathLike[str] | None = None) -> Any:
    """Draws a `PostMortem`; returns the matplotlib Figure. Raises ImportError without matplotlib.

    Above, the energy of motion and springs after each step, in powers of ten. Below, what each of
    the leading elements fed in in that step, as a part of that energy.
    """
    if not len(result.time):
        return _shares_alone(result, path)
    drawn = figure(8.0, 6.2)
    above, below = drawn.subplots(2, 1, sharex=True, height_ratios=(1, 1.3))
    count = min(len(result.time), STEPS)
    last = int(result.replay.happened["step"])
    steps = np.arange(last - count, last + 1)
    energy = result.energy[-count - 1 :]
    # The powers themselves: a log axis overflows where energies do.
    with np.errstate(divide="ignore", invalid="ignore"):
        powers = np.log10(np.where(np.isfinite(energy) & (energy > 0), energy, np.nan))
    above.plot(steps, powers, color="black", lw=1.4)
    above.yaxis.set_major_formatter(lambda power, _: f"$10^{{{power:g}}}$")
    above.yaxis.get_major_locator().set_params(integer=True, nbins=7)
    above.set_ylabel("energy of motion\nand springs [J]")
    bare(above, _heading(result))
    size = np.maximum(energy[1:], energy[:-1])
    colours = list(COLOURS.values())
    for name, colour in zip(result.leading(DRAWN), colours, strict=False):
        fed = result.work[name][-count:]
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(size > 0, fed / size, np.nan)
        below.step(steps[1:], part, where="mid", color=colour, lw=1.6, label=_label(result, name))
    # In the end inertial forces and rows feed in and take out many times what there is.
    low, high = below.get_ylim()
    below.set_ylim(max(low, -CUT), min(high, CUT))
    below.axhline(0.0, color=GREY, lw=0.8)
    below.set_ylabel("fed in per step, as a\npart of that energy")
    below.set_xlabel("step")
    below.xaxis.get_major_locator().set_params(integer=True)
    bare(below)
    drawn.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return saved(drawn, path)


def _heading(result: PostMortem) -> str:
    happened = result.replay.happened
    what = "energy that it cannot have gained" if happened["gained"] else "not finite after this"
    of = f"{result.replay.name}: " if result.replay.name else ""
    return f"{of}step {happened['step']}, {happened['time']:.6g} s: {what}"


def _label(result: PostMortem, name: str) -> str:
    share = result.shares.get(name)
    plain = name.replace("`", "")
    return plain if share is None else f"{plain} ({100 * share:.0f} % of the growth)"


def _shares_alone(result: PostMortem, path: str | os.PathLike[str] | None) -> Any:
    """Without kept steps there is only each element's part of the growth."""
    drawn = figure(8.0, 3.0)
    axes = drawn.add_subplot()
    names = list(result.shares)[:DRAWN][::-1]
    axes.barh(
        [name.replace("`", "") for name in names],
        [100 * result.shares[n] for n in names],
        color=COLOURS["rk4"],
        height=0.6,
    )
    axes.set_xlabel("part of the energy fed in over the last steps [%]")
    bare(axes, _heading(result))
    return saved(drawn, path)
