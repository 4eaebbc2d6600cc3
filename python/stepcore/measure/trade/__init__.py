"""`trade`: runs a scene under many settings and compares every run with the converged motion."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Unpack

from stepcore import checks
from stepcore._core import Settings
from stepcore.deadline import OutOfTime
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.cost import TimedRun
from stepcore.experiment.errors import moved
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.horizon import affordable, horizon_of
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.other_models import ErrorSplit
from stepcore.experiment.reference import FINER, Gap, Reference, ReferenceRuns, smallest
from stepcore.experiment.schedule import STARTS, scheduled, time_steps
from stepcore.measure.monitors import Finding, monitored
from stepcore.measure.trade import mujoco as mujoco_points
from stepcore.measure.trade import words
from stepcore.measure.trade.adaptive import adaptive, within
from stepcore.measure.trade.batch_cost import BatchPoint, batch_points
from stepcore.measure.trade.methods import Kind, Steps, grid, longest
from stepcore.measure.trade.recommend import Confirmation, HardestStarts, Recommendation
from stepcore.measure.trade.result import Trade
from stepcore.measure.trade.rows import Frontier, TradeRow, observed_orders
from stepcore.measure.trade.run_cache import RowMaker, RunCache
from stepcore.measure.trade.search import SettingsSearch
from stepcore.measure.trade.statistics import LEAST, MOST, AfterPrediction
from stepcore.report import units
from stepcore.scene.softness import clamping

__all__ = ["Trade", "TradeRow", "trade"]

# Default limit on the cost of the reference, in steps × (dofs + 2): some seconds on one core.
EFFORT = 6e6
# The largest error that replaces one which cannot be verified, as a share of the displacement.
USEFUL = 0.5
# Offset between the seed of the search's starts and the seed of the further starts.
APART = 1_000_003
# The shares of the time (`seconds`) at which the search, the finer reference, the comparison with
# other models, the statistics and the tests on further starts end.
SEARCHED, REFINED, COMPARED, COUNTED, TESTED = 0.55, 0.6, 0.65, 0.75, 0.95


@measurement()
def trade(
    model: Source,
    motion: Motion | str | None = None,
    *,
    error: float | str | None = None,
    budget: float | str | None = None,
    further: int = 32,
    search: str | None = None,
    by: str = "time",
    dts: Sequence[float | str] | None = None,
    integrators: Sequence[str] | None = None,
    solvers: Sequence[str] | None = None,
    sweeps: Sequence[int] | None = None,
    precisions: Sequence[str] | None = None,
    accuracies: Sequence[float | str] | None = None,
    mujoco: bool = False,
    effort: float = EFFORT,
    **fields: Unpack[MeasurementFields],
) -> Trade:
    """Measure accuracy against cost over many settings of a scene, and recommend settings.

    Every setting runs the same motion and is compared with the scene's own converged motion, whose
    error is reported. `Errors` lists the measured errors; `stepcore.measure.trade.search` describes
    the search.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name", see
        `stepcore.loading`). The model's own settings are the shipped settings.
    motion: the `Motion` that every setting runs; or write its fields as arguments. By default
        there are 8 starts, and the horizon is near 1 s; a motion that is not at rest then goes on
        as far as `effort` allows; see `stepcore.experiment.horizon`. The default
        control period is the largest time step tried; with `control` or `ctrl` the default is the
        shipped time step.
    error: the largest allowed error in every start (RMS position error over bodies and time):
        metres, "1mm", or "0.1%" of the scene's size. The cheapest settings within this error are
        recommended.
    budget: the largest allowed cost: "20us/step" (computing time per shipped time step simulated),
        "5ms/s" (per simulated second), "100x" (times real time), or µs per simulated second;
        "2kflop/step" and similar units if `by` is "flops". The most accurate settings within the
        budget are recommended.
    further: the number of further starts, not used by the search, that must confirm a
        recommendation; 0 for no confirmation.
    search: "frugal", or "grid" for every combination of the axes. The default is "frugal", unless
        an axis is given.
    dts [s], integrators, solvers, sweeps, precisions: the axes, with the values to try. The shipped
        settings are always tried too.
    accuracies: the accuracies that steps are to keep: metres, "1mm", or "0.1%" of the scene's size;
        each is tried beside the combinations of the axes. A search chooses its own.
    by: the cost metric: "time" for measured wall time, or "flops" for counted floating-point
        operations. With "flops" nothing is timed, and the same seed gives the same result on any
        machine.
    mujoco: whether to run MuJoCo on the scene too (needs the package mujoco); see `Trade.mujoco`.
    effort: the largest cost of the reference, in steps × (dofs + 2). A step that takes more
        operations than 1500 × (dofs + 2), as with many contacts, counts in proportion. Time steps
        that the reference cannot judge are not searched; a note lists them.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

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
    axes: dict[str, Any] = {"integrators": integrators, "solvers": solvers, "sweeps": sweeps}
    axes["precisions"] = precisions
    full = _full(search, {"dts": dts, "accuracies": accuracies} | axes)
    checks.one_of("time", "flops")("trade", "by", by)
    further = checks.count("further", further, least=0)
    effort = checks.real(low=0)("trade", "effort", effort)
    if error is not None:
        units.length("trade", "error", error, 1.0)
    source = model
    model, motion, workers = setup = set_up(
        trade, model, motion, fields, missing="no motion to trade"
    )
    shipped = model.settings
    fixed = shipped.replace(accuracy=None)
    limit = None if budget is None else units.budget("trade", "budget", budget, shipped.dt, by)
    if mujoco:
        mujoco_points.load(source, model)
    starts = motion.starts or STARTS
    far = horizon_of(model, motion, cost=affordable(effort, starts))
    length = far.length
    if far.words:
        motion = dataclasses.replace(motion, horizon=length)
    held = motion.period(shipped.dt)
    steps, period = time_steps(shipped.dt, dts, held, length)
    if not (full or model.nu or held):
        period = longest(period, length)
    experiment = Experiment(model, scheduled(motion, model, period), workers)
    runner, schedule = experiment.runner, experiment.schedule
    runner.check_repeatable()
    # No body sleeps in the reference, so that the effect of sleep counts as an error.
    awake = fixed.replace(sleep=False)
    cache = RunCache(experiment, experiment.reference(min(steps), effort, awake))
    made = experiment.reference_runs
    assert made is not None
    size, rows = experiment.size, max(run.rows for run in cache.reference.runs)
    target = None if error is None else units.length("trade", "error", error, size)
    counts, kind = Steps(period, shipped.dt), Kind.of(model, rows)
    unjudged: list[str] = []
    time = workers.deadline
    if full:
        tried = grid(kind, steps, **axes)
        kept = (units.length("trade", "accuracies", value, size) for value in accuracies or ())
        tried += within(experiment, counts, kind, kept)
        left_out = partial(words.not_run, cache, tried)
        with time.stage(left_out, SEARCHED):
            cache.run([shipped])
            if not cache.failure(shipped):
                wrong = experiment.errors(cache.full[shipped], cache.reference).high
                time.so_far(f"error as shipped {words.error(wrong, cache.reference.high)}")
            cache.run([shipped, *tried])
    else:
        searching = SettingsSearch(cache, counts, kind)
        with time.stage(partial(words.not_searched, cache), SEARCHED):
            searching.search(target, budget=limit is not None)
            aims = [error for error, _ in searching.aims]
            searching.chosen += adaptive(cache, counts, kind, aims)
        tried = searching.best(whole=mujoco)
        with time.closing(), time.stage(partial(words.not_run, cache, tried)):
            cache.run(tried, "search: the best")
        unjudged = list(words.about_search(cache.reference, counts, min(steps)))
    if shipped not in cache.full:
        raise OutOfTime("the shipped settings have not been run")
    others = (setting for setting in tried if setting in cache.full and setting != shipped)
    # Timed in this order, the shipped settings first.
    tried = [shipped, *sorted(others, key=lambda setting: -setting.dt)]
    with time.stage("a finer reference", REFINED):
        _refine(cache, tried)
    softens = rows > 0 and shipped.law == "solref" and shipped.refsafe
    tau = clamping(model.scene) if softens else None
    split, gaps = ErrorSplit(made, cache.reference, size), dict[str, Gap]()
    with time.stage("comparisons with other models of the scene", COMPARED):
        gaps = split.gaps()
    reference = dataclasses.replace(cache.reference, gaps=gaps)
    maker = RowMaker(cache, split, tau, by)
    points: list[mujoco_points.Point] = []
    timed: list[TimedRun] = []
    if mujoco:
        with time.stage("runs of MuJoCo", COMPARED):
            theirs = mujoco_points.MujocoTrials(source, experiment, reference)
            points, timed = theirs.points(counts, workers)
    with time.closing():
        rows_made = maker.rows(tried, timed)
    frontier = Frontier.of(rows_made, reference.high, reference.largest, by)
    with time.stage("statistics of the motion", COUNTED):
        frontier = _with_statistics(frontier, made, reference, motion)
    chosen = None
    # The error that settings are tested for: one that the reference can verify.
    asked = target
    if target is not None and reference.high > target:
        asked = frontier.least() if frontier.least() <= USEFUL * moved(reference.runs) else target
    best = _best(frontier, asked, limit)
    if further and best is not None:
        time.so_far(words.so_far(frontier, best, further))
        unseen = dataclasses.replace(motion, seed=motion.seed + APART)
        with time.stage(f"all tests on {further} further starts", TESTED):
            new = scheduled(unseen, model, period, starts=further + 1).part(1)
            confirm, again = Confirmation(cache, new), None
            if asked is not None and not full:
                again = HardestStarts(cache, confirm, counts, kind, asked)
            recommendation = Recommendation(frontier, confirm, maker.row, counts, again)
            try:
                if asked is not None:
                    chosen = recommendation.within_error(asked)
                    if chosen is None and asked != target:
                        # Further starts were harder than those of the search.
                        chosen, asked = recommendation.within_least(asked)
                elif limit is not None:
                    recommendation.within_budget(limit)
            finally:
                frontier = recommendation.frontier
    forces = shipped.law == "penalty" and model.npair > 0
    softened = tau if any(row.clamped for row in frontier.rows) else None
    orders = observed_orders(frontier.rows, reference)
    findings: list[Finding] = []
    with time.stage("the findings on the shipped settings"):
        findings = monitored(runner, shipped)[0]
    result = Trade(
        name=setup.name,
        motion=motion,
        frontier=frontier,
        reference=reference,
        ran=far.after(motion_in_words(model, motion, schedule)),
        horizon=schedule.horizon,
        notes=[
            *words.about_run(schedule, rows, forces, softened, motion.horizon),
            *words.about_reference(reference, frontier.rows, size),
            *unjudged,
            *words.observed(reference, schedule.horizon, orders),
            *words.failed(frontier.rows),
            *model.scene.notes,
        ],
        target=target,
        verified=asked if asked != target else None,
        budget=limit,
        size=size,
        mujoco=mujoco_points.timed(points, timed),
        batches=workers.speedup.sentences,
        screened=len({*cache.full, *cache.screened}),
        chosen=chosen,
        findings=findings,
        runner=runner,
    )
    answer = (result.recommended or result.nearest, result.shipped, *result.offered)
    in_batch: list[BatchPoint] = []
    with time.stage("costs in a batch"):
        in_batch = batch_points(answer, frontier, maker)
    return dataclasses.replace(result, in_batch=in_batch, runs=cache.count)


def _full(search: str | None, axes: Mapping[str, Sequence[Any] | None]) -> bool:
    """Return whether to search the full grid; raise ValueError for an invalid axis."""
    checks.one_of("frugal", "grid", None)("trade", "search", search)
    given = {name: values for name, values in axes.items() if values is not None}
    for name, values in given.items():
        checks.several(name, values)
        for value in values:
            # Check every value now, including values that would never be tried.
            if name == "dts":
                units.time(name, value)
            elif name == "accuracies":
                units.length("trade", name, value, 1.0)
            else:
                Settings(**{name if name == "sweeps" else name.removesuffix("s"): value})
    if given and search == "frugal":
        raise ValueError(f"search = 'frugal': must be 'grid' or None where {min(given)} is given")
    return bool(given) or search == "grid"


def _refine(cache: RunCache, tried: Sequence[Settings]) -> None:
    """Halve the reference's step until its error is a tenth of the smallest error in the table."""
    whole = [cache.full[setting] for setting in tried if not cache.failure(setting)]
    while whole and cache.can_refine:
        each = [cache.experiment.errors(runs, cache.reference).high for runs in whole]
        least = smallest(each, cache.experiment.size)
        if not least or cache.reference.high * FINER <= least or not cache.refine():
            return


def _with_statistics(
    frontier: Frontier, made: ReferenceRuns, reference: Reference, motion: Motion
) -> Frontier:
    """Add statistics to the shipped and best rows if the motion becomes unpredictable."""
    schedule = made.runner.schedule
    if not (schedule.times > reference.growth.overall).any():
        return frontier
    many = max(LEAST, len(schedule.starts))
    longer = scheduled(motion, made.runner.model, schedule.period, starts=many)
    after = AfterPrediction(made, reference, longer)
    best = [row for row in frontier.rows if row.errors and row.best]
    some = best[:: 1 + (len(best) - 1) // MOST] if best else []
    some = [
        row for row in frontier.rows if row.shipped or (row in some and after.affords(row.settings))
    ]
    wanted = [row for row in some if row.errors]
    with made.workers.bar("statistics", (1 + len(wanted)) * many) as bar:
        for row in wanted:
            measured = dataclasses.replace(row, after=after.measure(row.settings, bar))
            frontier = frontier.updated(measured)
    return frontier


def _best(frontier: Frontier, target: float | None, budget: float | None) -> TradeRow | None:
    """Return the row that meets the request; None without a request, or if none does."""
    with contextlib.suppress(ValueError):
        if target is not None:
            return frontier.cheapest(target)
        if budget is not None:
            return frontier.most_accurate(budget)
    return None
