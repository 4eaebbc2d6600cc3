"""The plot of a post-mortem: energy over the last steps, and which elements injected it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.report.plot.style import BLUE, COLOURS, GREY, frame, legend, new_figure
from stepcore.report.units import joules

if TYPE_CHECKING:
    from stepcore.engine.postmortem import PostMortem

# Elements that are drawn, and the steps before the failure.
DRAWN, STEPS = 5, 128
# Energy injected beyond this part of the whole is cut off: in the last steps inertial forces and
# rows inject and take out many times what there is.
CUT = 1.5
# Energies over fewer decades are written out: 5 J, and not 10 to the power of 0.7.
FEW_DECADES = 2.0


def draw(result: PostMortem) -> Any:
    """Above, the energy after each step; below, the part of it that each element injected.

    Without recorded steps there is only each element's part of the growth.
    """
    if not len(result.time):
        return _shares_alone(result)
    figure = new_figure(8.0, 6.2)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.3))
    count = min(len(result.time), STEPS)
    last = int(result.replay.happened["step"])
    steps = np.arange(last - count, last + 1)
    energy = result.energy[-count - 1 :]
    # Exponents, because a log axis overflows where energies do.
    with np.errstate(divide="ignore", invalid="ignore"):
        powers = np.log10(np.where(np.isfinite(energy) & (energy > 0), energy, np.nan))
    above.plot(steps, powers, color="black", lw=1.4)
    if np.nanmax(powers, initial=-np.inf) - np.nanmin(powers, initial=np.inf) < FEW_DECADES:
        above.yaxis.set_major_formatter(lambda power, _: joules(10.0**power))
    else:
        above.yaxis.set_major_formatter(lambda power, _: f"$10^{{{power:g}}}$")
        above.yaxis.get_major_locator().set_params(integer=True, nbins=7)
    above.set_ylabel("kinetic and spring\nenergy [J]")
    frame(above, _heading(result))
    size = np.maximum(energy[1:], energy[:-1])
    for name, colour in zip(result.leading(DRAWN), COLOURS.values(), strict=False):
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(size > 0, result.work[name][-count:] / size, np.nan)
        label = _label(result, name)
        below.step(steps[1:], part, where="mid", color=colour, lw=1.6, label=label)
    low, high = below.get_ylim()
    below.set_ylim(max(low, -CUT), min(high, CUT))
    below.axhline(0.0, color=GREY, lw=0.8)
    below.set_ylabel("energy injected per step,\npart of that energy")
    below.set_xlabel("step")
    below.xaxis.get_major_locator().set_params(integer=True)
    frame(below)
    legend(figure, columns=2)
    return figure


def _heading(result: PostMortem) -> str:
    happened = result.replay.happened
    what = "more energy than is possible" if happened["gained"] else "not finite after this step"
    of = f"{result.replay.name}: " if result.replay.name else ""
    return f"{of}step {happened['step']}, {happened['time']:.6g} s: {what}"


def _label(result: PostMortem, name: str) -> str:
    share = result.shares.get(name)
    plain = name.replace("`", "")
    return plain if share is None else f"{plain} ({100 * share:.0f} % of the growth)"


def _shares_alone(result: PostMortem) -> Any:
    figure = new_figure(8.0, 3.0)
    axes = figure.add_subplot()
    names = list(result.shares)[:DRAWN][::-1]
    shares = [100 * result.shares[name] for name in names]
    axes.barh([name.replace("`", "") for name in names], shares, color=BLUE, height=0.6)
    axes.set_xlabel("share of the energy injected over the last steps [%]")
    frame(axes, _heading(result))
    return figure
