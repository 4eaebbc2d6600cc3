"""`trade`: one scene under many settings against its own converged motion."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any

from numpy.typing import ArrayLike

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.executors import check_executor
from stepcore.experiment.coordinates import movable
from stepcore.experiment.errors import errors, extent
from stepcore.experiment.motion import Control, Motion, motion, time_steps
from stepcore.experiment.other_models import Models, clamping
from stepcore.experiment.reference import FINER, Reference, Search, smallest
from stepcore.experiment.runner import Course
from stepcore.experiment.statistics import LEAST, after
from stepcore.loading import find_model
from stepcore.measure.trade import frugal
from stepcore.measure.trade import mujoco as opponent
from stepcore.measure.trade.finish import Finisher
from stepcore.measure.trade.moves import Steps, longest, slides
from stepcore.measure.trade.recommend import confirmed, others
from stepcore.measure.trade.remarks import truths
from stepcore.measure.trade.result import Row, Trade
from stepcore.measure.trade.settings import grid
from stepcore.measure.trade.trials import Trials
from stepcore.report import units
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import seconds
from stepcore.scene.scene import Scene

__all__ = ["Row", "Trade", "trade"]

# What the reference may cost, in steps × (dofs + 2): some seconds on one core.
EFFORT = 6e6
# The further starts are drawn by a seed this far from the search's own.
APART = 1_000_003


def trade(
    model: Model | Scene | str | os.PathLike[str],
    *,
    error: float | str | None = None,
    budget: float | str | None = None,
    horizon: float | None = None,
    key: str | int | None = None,
    control: Control | None = None,
    control_dt: float | None = None,
    ctrl: ArrayLike | None = None,
    starts: int = 8,
    further: int = 16,
    seed: int = 0,
    search: str | None = None,
    by: str = "time",
    dts: Sequence[float] | None = None,
    integrators: Sequence[str] | None = None,
    solvers: Sequence[str] | None = None,
    sweeps: Sequence[int] | None = None,
    precisions: Sequence[str] | None = None,
    mujoco: bool = False,
    effort: float = EFFORT,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> Trade:
    """Measures what speed costs in accuracy, and recommends settings: a scene under many of them.

    Every setting runs the same motion and is compared with the scene's own converged motion,
    whose error is stated. See `Errors` for what is measured and `stepcore.measure.trade.search` for
    how the settings are found.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name", see
        `stepcore.loading`). Its settings are the shipped ones.
    error: recommend the cheapest settings that keep to it in every start: metres, "1mm", or
        "0.1%" of the scene's size. What counts is the root mean square of positions over
        bodies and time.
    budget: recommend the most accurate settings within it: "20us/step" (of computing per
        shipped time step simulated), "5ms/s" (per simulated second), "100x" (times real time),
        or µs per simulated second; "2kflop/step" and the like where `by` is "flops".
    horizon: simulated time [s]; by default 1 s, or a whole number of samples that is near it.
    key: the keyframe to start from, by name or index; by default the first, or the scene's pose.
    starts: how many; all but the first are moved a little, by `seed`. further: how many more
        a recommendation is tried on, which the search has not seen; 0: none.
    ctrl: controls, shape (n, nu), one row a control period (the last is held); or control: a
        function of (time, sim) that returns them, as in `Sim.run`, called once a period. It
        must depend on nothing else, for it is called from several threads. By default every
        motor follows a few smooth seeded sines in its range.
    control_dt: the control period [s], a multiple of every time step; default: the largest
        time step tried.
    search: "frugal", or "grid" for every combination of the axes; by default "frugal" unless
        an axis is given: dts [s], integrators, solvers, sweeps, precisions: what to try.
        The shipped settings are always among it.
    by: what cheap means: "time", measured; or "flops", counted: nothing is timed, and the same
        seed gives the same result on any machine.
    mujoco: also run MuJoCo on the scene (needs the package mujoco); see `Trade.mujoco`.
    effort: what the reference may cost, in steps × (dofs + 2).
    threads: how many runs at once (default: one a core); executor: any concurrent.futures
        executor in their place. Costs are timed on one thread, afterwards.
    progress: False for no bar, or a function of (label, done, total).

    Raises ValueError for an argument outside its limits, or if the reference itself fails.

    >>> from stepcore import lesson
    >>> result = trade(lesson.spring(), horizon=0.2, starts=1, dts=[0.005, 0.01])
    >>> result.shipped.settings.integrator
    'semi-implicit'
    >>> print(f"{1e3 * result.error(result.shipped):.1f} mm")
    39.7 mm
    >>> result.best(error=1e-5).integrator
    'rk4'
    """
    source, model = model, find_model(model)
    checks.told("trade", progress)
    check_executor("trade", executor)
    starts, seed = checks.count("starts", starts), checks.count("seed", seed, least=0)
    further = checks.count("further", further, least=0)
    workers = checks.threads(threads)
    effort = checks.real(low=0)("trade", "effort", effort)
    axes: dict[str, Any] = {"integrators": integrators, "solvers": solvers, "sweeps": sweeps}
    axes["precisions"] = precisions
    full = _full(search, {"dts": dts} | axes)
    shipped = model.settings
    checks.one_of("time", "flops")("trade", "by", by)
    limit = None if budget is None else units.budget("trade", "budget", budget, shipped.dt, by)
    if error is not None:
        units.length("trade", "error", error, 1.0)
    if mujoco:
        opponent.load(source, model)
    dofs = movable(model.scene, "no motion to trade")
    steps, period = time_steps(shipped.dt, dts, control_dt, 1.0 if horizon is None else horizon)
    if not (full or dofs.motors or control or control_dt):
        period = longest(period, 1.0 if horizon is None else horizon)
    drawn = partial(
        motion,
        model,
        dofs,
        horizon=horizon,
        period=period,
        key=key,
        ctrl=ctrl,
        control=control,
    )
    course = Course(model, dofs, drawn(count=starts, seed=seed))
    finder = Search(course, shipped, min(steps), effort, workers, executor)
    with Progress("reference", finder.runs, progress) as bar:
        reference = finder.first(bar)
    size = extent(reference.paths, model.scene)
    target = None if error is None else units.length("trade", "error", error, size)
    trials = Trials(course, reference, size, workers, executor, progress)
    counts, rows = Steps(period, shipped.dt), max(path.rows for path in reference.paths)
    if full:
        tried = grid(shipped, steps, rows=rows, **axes)
        trials.run(tried)
    else:
        wanted = frugal.Wanted(target, limit is not None, mujoco)
        tried = frugal.found(finder, trials, counts, rows, slides(model.scene), wanted)
    _refine(finder, trials, tried, progress)
    softens = rows > 0 and shipped.law == "solref" and shipped.refsafe
    tau = clamping(model.scene) if softens else None
    models = Models(finder, reference, size)
    reference.gaps = models.gaps()
    finisher = Finisher(trials, models, shipped, tau, by)
    rivals = []
    if mujoco:
        rivals = opponent.Opponent(source, course, reference, size).players(counts, progress)
    result = Trade(
        name=model.scene.name or "scene",
        horizon=course.motion.horizon,
        rows=finisher.rows(tried, rivals),
        reference=reference,
        starts=starts,
        notes=[*model.scene.notes, *_notes(course.motion, reference, rows, tau, horizon)],
        target=target,
        budget=limit,
        by=by,
        size=size,
        mujoco=[rival.point for rival in rivals],
        screened=len({*trials.paths, *trials.glances}),
        runs=trials.runs,
    )
    many = partial(drawn, count=max(LEAST, starts), seed=seed)
    after(result.rows, finder, reference, many, progress)
    if further and (target or limit):
        more = others(drawn(count=further + 1, seed=seed + APART))
        confirmed(result, trials, finder, more, finisher.row, counts)
    return result


def _full(search: str | None, axes: Mapping[str, Sequence[Any] | None]) -> bool:
    """Whether a full grid is wanted; checks the axes given."""
    checks.one_of("frugal", "grid", None)("trade", "search", search)
    given = {name: values for name, values in axes.items() if values is not None}
    for name, values in given.items():
        checks.several(name, values)
    for dt in given.get("dts", ()):
        checks.real(above=0)("trade", "dts", dt)
    if given and search == "frugal":
        raise ValueError(f"search = 'frugal': {min(given)} is given, which asks for a grid")
    return bool(given) or search == "grid"


def _refine(search: Search, trials: Trials, tried: Sequence[Settings], progress: Choice) -> None:
    """Halves the reference's step until its error is a tenth of the smallest in the table."""
    reference = trials.reference
    whole = [trials.paths[one] for one in tried if not trials.paths[one][-1].failure]
    while whole and search.can_refine(reference):
        found = [errors(p, reference.paths, reference.scored).high for p in whole]
        least = smallest(found, search.size)
        if not least or reference.high * FINER <= least:
            return
        with Progress("finer reference", len(search.course.motion.starts), progress) as bar:
            if not search.refine(reference, bar):
                return


def _notes(
    motive: Motion, reference: Reference, rows: int, tau: float | None, asked: float | None
) -> list[str]:
    notes = []
    if asked is not None and motive.horizon < asked * (1 - 1e-9):
        notes.append(
            f"the horizon is {seconds(motive.horizon)}, a whole number of samples, not "
            f"{seconds(asked)}"
        )
    if rows == 0:
        notes.append("no contact, limit or other row was ever active: the solver does not matter")
    if motive.undriven:
        names = ", ".join(motive.undriven)
        notes.append(f"motors without a control range are not driven: {names}")
    notes += truths(reference)
    if tau is not None:
        notes.append(
            f"refsafe keeps the time constant of contacts and limits at 2 dt or above: beyond "
            f"dt {seconds(tau / 2)} (rows marked c) it makes the scene itself softer"
        )
    return notes
