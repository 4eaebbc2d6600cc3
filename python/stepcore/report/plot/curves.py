"""Line plots over time, sweeps or steps: runs, failures, predictability, convergence."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import checks
from stepcore.report.plot.style import (
    BLUE,
    COLOURS,
    FONT,
    GREY,
    ORANGE,
    RED,
    frame,
    legend,
    log_ticks,
    new_figure,
    stacked,
    write_centred,
)
from stepcore.report.units import joules, seconds

if TYPE_CHECKING:
    from stepcore.engine.replay import PostMortem
    from stepcore.engine.trajectory import Trajectory
    from stepcore.experiment.answer import Answer
    from stepcore.measure.convergence import Convergence
    from stepcore.measure.predictability import Predictability


# Colours of the lines of one quantity, in drawing order.
LINES = tuple(COLOURS.values())
NAMED, DASHES = len(LINES), ("-", "--", ":")
# The recorded quantities that are drawn.
WANTED = ("qpos", "energy", "overlap", "error")
UNITS = {"energy": "energy [J]", "overlap": "deepest overlap [m]"}
UNITS |= {"residual": "residual [m/s]", "error": "estimated error [m]"}
# Kinds of joint coordinates, by unit.
JOINTS = {"rad": "position [rad]", "m": "position [m]", "": "orientation (quaternion)"}
JOINTS |= {"rad/s": "velocity [rad/s]", "m/s": "velocity [m/s]"}


def trajectory(run: Trajectory) -> Any:
    """Draw positions, energy, overlap and error over time, or else all recorded arrays.

    Positions of joints have a panel for each unit. An overlap that is never there has none.
    Positions of bodies whose error was recorded too are drawn with it as a band. Time counts from
    the beginning of the run: the first state of a Sim can have another time, such as that of a
    keyframe.

    Raises ValueError for a run without recorded arrays.
    """
    names = [name for name in WANTED if name in run.data]
    if names in ([], ["qpos"]):
        names = [*run.data]
    if len(names) > 1 and "overlap" in names and not np.any(run.data["overlap"] > 0):
        names.remove("overlap")
    if not names:
        raise ValueError("the run recorded nothing that can be drawn")
    drawn = [panel for name in names for panel in _panels(run, name)]
    figure, panels = stacked(len(drawn))
    time = run.time - run.time[0]
    for axes, (name, words, lines) in zip(panels, drawn, strict=True):
        if name == "energy":
            _energy(axes, time, run)
        elif name == "error":
            _error(axes, time, run)
        else:
            _lines(axes, time, lines)
        if name == "overlap":
            axes.set_ylim(bottom=0)
        if name == "xpos" and "body_error" in run.data:
            _bands(axes, time, run)
        if 1 < len(axes.get_legend_handles_labels()[1]) <= NAMED * len(DASHES):
            _legend(axes)
        frame(axes, y=words)
    frame(panels[-1], x="time [s]")
    panels[-1].set_xlim(0.0, float(time[-1]) or None)
    return figure


def answer(answer: Answer) -> Any:
    """Draw one column of a user's answer over another; axes of positive numbers are logarithmic."""
    figure = new_figure()
    axes, (across, up) = figure.add_subplot(), answer.axes
    numbers = [[checks.number(row.get(name)) for name in (across, up)] for row in answer.rows]
    pairs = [(x, y) for x, y in numbers if x is not None and y is not None]
    axes.plot(*np.reshape(pairs, (-1, 2)).T, "o-", color=BLUE)
    for scale, axis, column in (
        (axes.set_xscale, axes.xaxis, [x for x, _ in pairs]),
        (axes.set_yscale, axes.yaxis, [y for _, y in pairs]),
    ):
        if pairs and min(column) > 0:
            scale("log")
            log_ticks(axis)
    names = [
        f"{name} [{answer.of_columns[name]}]" if name in answer.of_columns else name
        for name in answer.axes
    ]
    frame(axes, answer.title, *names)
    return figure


# A panel: the array, the words of its axis, and lines by name.
Panel = tuple[str, str, dict[str, np.ndarray]]


def _panels(run: Trajectory, name: str) -> Iterator[Panel]:
    """Yield the panels of a recorded array: of joints one for each unit."""
    values, axes = np.asarray(run.data[name], float), run.axes(name)
    columns = values.reshape(len(values), -1).T
    entries = [
        " ".join(entry).replace("`", "")
        for entry in itertools.product(*(axis.entries for axis in axes))
    ]
    units = axes[0].units if len(axes) == 1 else ()
    if not units:
        yield name, UNITS.get(name, name), dict(zip(entries, columns, strict=True))
    for unit in dict.fromkeys(units):
        lines = {e: c for e, c, u in zip(entries, columns, units, strict=True) if u == unit}
        alone = f"{next(iter(lines))}\n" if len(lines) == 1 < len(columns) else ""
        yield name, f"{alone}{JOINTS[unit]}", lines


def _energy(axes: Any, time: np.ndarray, run: Trajectory) -> None:
    kinetic, potential = np.asarray(run.data["energy"], float).T
    axes.plot(time, kinetic, color=BLUE, lw=1.2, label="kinetic")
    axes.plot(time, potential, color=ORANGE, lw=1.2, label="potential")
    axes.plot(time, kinetic + potential, color="black", lw=3.0, label="total", zorder=1.9)


def _error(axes: Any, time: np.ndarray, run: Trajectory) -> None:
    rms, largest = np.asarray(run.data["error"], float).T
    there = np.isfinite(largest)
    axes.fill_between(time, 0, np.where(there, largest, np.nan), color=BLUE, alpha=0.25, lw=0)
    axes.plot(time, np.where(there, largest, np.nan), color=BLUE, lw=1.2, label="largest of a body")
    axes.plot(time, np.where(there, rms, np.nan), color=ORANGE, lw=1.2, label="RMS over bodies")
    if not there.all():
        axes.axvspan(time[np.argmin(there)], time[-1], color=GREY, alpha=0.3, label="not known")
    axes.set_ylim(bottom=0)


def _bands(axes: Any, time: np.ndarray, run: Trajectory) -> None:
    places = np.asarray(run.data["xpos"], float)
    error = np.asarray(run.data["body_error"], float)[:, :, None]
    low, high = (np.reshape(places + sign * error, (len(time), -1)) for sign in (-1, 1))
    for k in range(low.shape[1]):
        ends = (np.where(np.isfinite(end[:, k]), end[:, k], np.nan) for end in (low, high))
        axes.fill_between(time, *ends, color=LINES[k % NAMED], alpha=0.25, lw=0)


def _lines(axes: Any, time: np.ndarray, lines: Mapping[str, np.ndarray]) -> None:
    for k, (name, values) in enumerate(lines.items()):
        style: dict[str, Any] = {"color": LINES[k % NAMED], "ls": DASHES[k // NAMED % len(DASHES)]}
        axes.plot(time, values, lw=1.2, label=name, **style)


def _legend(axes: Any) -> None:
    """Draw the legend at the right of the panel, where it covers no data."""
    many = len(axes.get_legend_handles_labels()[1]) > NAMED
    style: dict[str, Any] = {"ncols": 1 + many, "fontsize": FONT["small" if many else "text"]}
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, **style)


# The number of elements drawn.
DRAWN = 5


def postmortem(result: PostMortem) -> Any:
    """Draw the energy after each step (above) and the fraction injected by each element (below).

    Without recorded steps, only each element's share of the growth is drawn.
    """
    if not len(result.time):
        return _shares_alone(result)
    figure = new_figure(8.0, 6.2)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.3))
    count = min(len(result.time), 128)
    last = int(result.replay.happened["step"])
    steps = np.arange(last - count, last + 1)
    energy = result.energy[-count - 1 :]
    # The exponents are plotted, because a log axis overflows for huge energies.
    with np.errstate(divide="ignore", invalid="ignore"):
        powers = np.log10(np.where(np.isfinite(energy) & (energy > 0), energy, np.nan))
    above.plot(steps, powers, color="black", lw=1.4)
    if np.nanmax(powers, initial=-np.inf) - np.nanmin(powers, initial=np.inf) < 2:
        # Energies (5 J) instead of powers of ten (10^0.7).
        above.yaxis.set_major_formatter(lambda power, _: joules(10.0**power))
    else:
        above.yaxis.set_major_formatter(lambda power, _: f"$10^{{{power:g}}}$")
        above.yaxis.get_major_locator().set_params(integer=True, nbins=7)
    frame(above, _heading(result), y="kinetic and spring\nenergy [J]")
    size = np.maximum(energy[1:], energy[:-1])
    for name, colour in zip(result.leading(DRAWN), COLOURS.values(), strict=False):
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(size > 0, result.work[name][-count:] / size, np.nan)
        label = _label(result, name)
        below.step(steps[1:], part, where="mid", color=colour, lw=1.6, label=label)
    low, high = below.get_ylim()
    # In the last steps, inertial forces and rows inject and remove many times the total energy.
    below.set_ylim(max(low, -1.5), min(high, 1.5))
    below.axhline(0.0, color=GREY, lw=0.8)
    below.xaxis.get_major_locator().set_params(integer=True)
    frame(below, "", "step", "energy injected per step,\npart of that energy")
    legend(figure, columns=2)
    return figure


def _heading(result: PostMortem) -> str:
    happened = result.replay.happened
    problem = "faster than anything moves" if happened["finite"] else "not finite after this step"
    problem = "more energy than is possible" if happened["gained"] else problem
    prefix = f"{result.replay.name}: " if result.replay.name else ""
    return f"{prefix}step {happened['step']}, {happened['time']:.6g} s: {problem}"


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
    frame(axes, _heading(result), "share of the energy injected over the last steps [%]")
    return figure


def predictability(result: Predictability) -> Any:
    """Draw the growth of each start on a log axis; a dot marks the end of predictability."""
    figure = new_figure()
    axes = figure.add_subplot()
    times = np.concatenate([[0.0], result.growth.times])
    for start, factor in enumerate(result.growth.factor):
        values = np.concatenate([[1.0], np.maximum(factor, 1e-3)])
        colour, label = (BLUE, "start 0, the keyframe") if start == 0 else (GREY, None)
        style: dict[str, Any] = {"lw": 0.9, "alpha": 0.7} if start else {"lw": 1.8, "zorder": 4}
        axes.plot(
            times, values, color=colour, label="other starts" if start == 1 else label, **style
        )
        end = float(result.growth.ends[start])
        if math.isfinite(end):
            axes.plot(end, result.limit, "o", ms=5, color=colour, zorder=5)
    text = f"not predictable\nabove {result.limit:g}"
    axes.axhline(result.limit, color=RED, lw=1.2, ls="--", zorder=2, label=text)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, 3 * result.limit))
    log_ticks(axes.yaxis)
    axes.set_xlim(0, result.horizon)
    until = "all of it" if math.isinf(result.time) else f"{seconds(result.time)} of it"
    title = f"{result.name}: {seconds(result.horizon)}, {until} predictable"
    frame(axes, title, "time [s]", "growth of a perturbation")
    legend(figure)
    return figure


def convergence(result: Convergence) -> Any:
    """Draw the error against the work of other time steps and of more sweeps."""
    figure = new_figure()
    axes = figure.add_subplot()
    work = "floating-point operations per simulated second"
    words = f"{result.measure.error_words}{result.measure.in_unit}"
    frame(axes, f"{result.name}: {result.verdict}", work, words)
    kinds = {"time steps": (BLUE, result.dts), "sweeps": (RED, [result.shipped, *result.sweeps])}
    for name, (colour, trials) in kinds.items():
        good = sorted((t.work, t.error) for t in trials if not t.failure and t.error > 0)
        if len(good) > 1:
            axes.plot(*zip(*good, strict=True), color=colour, lw=1.6, marker="o", ms=4, label=name)
    shipped, solved = result.shipped, result.solved
    if shipped.error > 0 and not shipped.failure:
        axes.plot(shipped.work, shipped.error, "D", ms=7, color="black", label="as shipped")
    if solved.error > 0 and not solved.failure:
        axes.axhline(solved.error, color="black", lw=1.2, ls="--", label="converged forces")
    if not axes.lines:
        write_centred(axes, "all of these runs fail")
        return figure
    axes.set_xscale("log")
    axes.set_yscale("log")
    log_ticks(axes.xaxis)
    log_ticks(axes.yaxis)
    legend(figure)
    return figure
