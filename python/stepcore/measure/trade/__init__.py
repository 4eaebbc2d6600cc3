"""`trade`: runs a scene under many settings and compares every run with the converged motion."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Unpack, cast

from stepcore import checks
from stepcore._core import Settings
from stepcore.deadline import PROVEN, SEARCHED
from stepcore.experiment.arguments import SHARED, MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.horizon import settled_motion
from stepcore.experiment.motion import Motion
from stepcore.experiment.outcomes import PILOT
from stepcore.experiment.quantity import Quantity, Wanted
from stepcore.experiment.schedule import STARTS, time_steps
from stepcore.experiment.study import EFFORT, SHIPPED, Allowed, Study
from stepcore.measure.monitors import monitored
from stepcore.measure.monitors.joints import chatter_findings
from stepcore.measure.monitors.recording import recorded
from stepcore.measure.trade.outcomes import MOST, Outcomes, trade_means
from stepcore.measure.trade.result import Trade
from stepcore.measure.trade.search import SEARCHING, UNSURE, Search, proven, settled
from stepcore.report import units
from stepcore.report.units import counted, rounded

__all__ = ["Outcomes", "Trade", "trade"]

# The largest error that may replace a target which cannot be verified, as a share of the
# displacement, or of the error of the shipped settings.
USEFUL = 0.5
# Tolerances of a search without a request, relative to the error of the shipped settings.
LESS = (1.0, 0.5, 0.1)


@measurement()
def trade(
    model: Source,
    motion: Motion | str | None = None,
    *,
    quantity: Wanted = None,
    error: Allowed = None,
    statistic: str | None = None,
    budget: float | str | None = None,
    further: int = 32,
    most: int = MOST,
    search: str | None = None,
    by: str = "time",
    dts: Sequence[float | str] | None = None,
    integrators: Sequence[str] | None = None,
    solvers: Sequence[str] | None = None,
    sweeps: Sequence[int] | None = None,
    precisions: Sequence[str] | None = None,
    accuracies: Sequence[float | str] | None = None,
    effort: float = EFFORT,
    engine: str = "stepcore",
    mujoco: bool = False,
    **fields: Unpack[MeasurementFields],
) -> Trade | Any:
    """Measure accuracy against cost over many settings of a scene, and recommend settings.

    Every setting runs the same motion and is compared with the scene's converged motion, whose
    uncertainty is reported. `stepcore.engine.norm` defines the distance between two motions, and
    `stepcore.measure.trade.search` describes the search. Settings are ranked by counted work, so
    the answer is the same on every machine; the reported times are measured.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name", see
        `stepcore.loading`). The settings in the model are the shipped settings.
    motion: the `Motion` that every setting runs; or write its fields as arguments. By default
        there are 8 starts, and the horizon is near 1 s, longer if the motion is not at rest then;
        see `stepcore.experiment.horizon`. Recommended steps divide your control period; without one
        they are the shipped step times or divided by a whole number.
    quantity: the quantity whose error is measured: "site/tip", "joint/knee", "max(contact/foot)"
        and others, or a function of the runs; see `stepcore.experiment.Quantity`. By default the
        motion of all bodies. A list of several is judged together.
    error: the largest allowed error in every start (of the motion: RMS position error over bodies
        and time): metres, "1mm", or "0.1%" of the scene's size; of another quantity "2N", "0.5deg",
        or "1%" of its range over the motion; of several quantities one for each. The cheapest
        settings that meet this tolerance are recommended. Of a mean it is the largest difference
        from the converged mean, and by default the smallest that the starts resolve.
    statistic: "worst" to judge every start, or "mean" to judge the mean over many starts, which
        converges where single motions are unpredictable. The default is "mean" for numbers of a run
        ("max(…)", functions), with 256 starts and at least 64, and "worst" for all else. With
        "mean" the result is a `stepcore.Outcomes`, and its choice is tested on as many held-out
        starts, unless `further` is 0.
    budget: the largest allowed cost: "20us/step" (computing time per shipped time step simulated),
        "5ms/s" (per simulated second), "100x" (times real time), or µs per simulated second;
        "2kflop/step" and similar units if `by` is "flops". The most accurate settings within the
        budget are recommended.
    further: the number of held-out starts in the second set, on which a choice must hold before it
        is recommended, and in the third set, on which it is then validated once; 0 for neither.
    most: the most starts of a mean: their number doubles until the error can be resolved.
    search: "frugal", or "grid" for every combination of the axes. The default is "frugal", unless
        an axis is given.
    dts [s], integrators, solvers, sweeps, precisions: the axes, with the values to try. The shipped
        settings are always tried too.
    accuracies: tolerances of adaptive steps: metres, "1mm", or "0.1%" of the scene's size; each is
        tried in addition to the combinations of the axes. A search chooses its tolerances itself.
    by: "time" to print measured computing times next to the counted work; with "flops" nothing is
        timed.
    effort: the most floating-point operations of the runs; a small effort leaves more uncertainty.
    engine: "stepcore", or "mujoco" to run MuJoCo, whose settings are then the axes. It also runs
        files that stepcore cannot load.
    mujoco: whether to trade with MuJoCo on the same motion too, and compare; see `Trade.beside`.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, or if no converged motion can be run.

    >>> from stepcore import lesson
    >>> result = trade(lesson.spring(), horizon=0.2, starts=1, dts=[0.005, 0.01])
    >>> result.shipped.settings.integrator
    'semi-implicit'
    >>> print(f"{1e3 * result.error(result.shipped):.1f} mm")
    39.7 mm
    >>> result.best(error=1e-5).integrator
    'rk4'

    The mean of a number of each run:

    >>> def height(qpos):
    ...     return qpos[:, -1, 0]
    >>> result = trade(lesson.drop(), quantity=height, horizon=0.3, starts=64, most=64)
    >>> abs(result.shipped.difference.value) < 0.01
    True
    """
    axes: dict[str, Any] = {"integrators": integrators, "solvers": solvers, "sweeps": sweeps}
    axes["precisions"] = precisions
    full = _full(search, {"dts": dts, "accuracies": accuracies} | axes, engine)
    checks.one_of("time", "flops")("trade", "by", by)
    further = checks.count("further", further, least=0)
    effort = checks.real(low=0)("trade", "effort", effort)
    most = checks.count("most", most, least=2 * PILOT)
    quantity = Quantity.of(quantity)
    of_means = _of_means(statistic, quantity)
    if error is not None and quantity.is_motion:
        units.length("trade", "error", error, 1.0)
    if error is None and quantity.parts:
        raise ValueError(f"error = None: several quantities ({quantity.name}) need one each")
    if of_means:
        refused = {"budget": budget is not None, "mujoco": mujoco, "accuracies": bool(accuracies)}
        if name := next((name for name, given in refused.items() if given), None):
            raise ValueError(f'{name}: must not be given for a mean; statistic="worst" takes it')
    if mujoco and engine == "mujoco":
        raise ValueError("mujoco = True: must be False where the engine is MuJoCo already")
    if quantity.plays:
        motion, fields = _episodes(quantity, motion, engine, fields)
    setup = set_up(trade, model, motion, fields, missing="no motion to trade", engine=engine)
    if of_means:
        changes = partial(grid, **axes) if full else None
        rest = (most, effort, by, bool(further), dts, changes)
        return trade_means(setup, quantity, error, *rest)
    shipped, workers = setup.engine.settings(SHIPPED), setup.workers
    limit = None if budget is None else units.budget("trade", "budget", budget, shipped.dt, by)
    starts = setup.motion.starts or STARTS
    ran, far = settled_motion(setup.engine, setup.motion, starts, effort)
    held = ran.period(shipped.dt)
    steps, period = time_steps(shipped.dt, dts, held, far.length)
    how: dict[str, Any] = {"period": period, "effort": effort, "by": by, "workers": workers}
    study = Study(motion=ran, engine=setup.engine, quantity=quantity, **how)
    target = None if error is None else study.error_of("trade", error)
    known = setup.engine.known
    search_ = Search.of(study, None if full else target, held=held is not None)
    result = Trade(
        name=setup.name,
        motion=ran,
        ran=far.after(study.motion_ran),
        model=setup.model if known else None,
        engine=engine,
        schedule=study.schedule,
        target=target,
        budget=limit,
        by=by,
        effort=effort,
        size=study.size,
        scale=study.scale,
        measure=study.measure,
        notes=[*study.schedule.notes, *(setup.model.scene.notes if known else ())],
    )
    result.reference, result.shipped = search_.truth, search_.shipped
    workers.deadline.so_far(search_.so_far())
    if full:
        with workers.deadline.stage("some of the settings", SEARCHED):
            search_.grid([*grid(study, steps, **axes), *within(study, accuracies)])
    else:
        with workers.deadline.stage("the rest of the search", SEARCHED):
            _searched(result, search_, further)
        with workers.deadline.stage("some settings of the frontier from all starts", SEARCHED):
            search_.complete(result.asked)
    search_.score_again()
    if target is not None and not full:
        search_.remember(result.asked)
    result.take(search_)
    _proven_and_timed(result, search_, 0 if full or target is None else further)
    if mujoco:
        with workers.deadline.stage("the same trade in MuJoCo"):
            again: Any = {name: fields.get(name) for name in ("threads", "executor")}
            limits = study.measure.allowed_errors if study.measure.parts else target
            again |= {"error": limits, "budget": budget, "by": by, "effort": effort}
            again |= {"quantity": quantity, "statistic": statistic, "progress": False}
            result.compare(trade(model, ran, engine="mujoco", further=0, **again))
    return result


def _of_means(statistic: str | None, quantity: Quantity) -> bool:
    """Return whether the mean over starts is judged; ValueError if the quantity has none."""
    checks.one_of("mean", "worst", None)("trade", "statistic", statistic)
    if statistic == "mean" and not quantity.is_scalar:
        raise ValueError(
            f'statistic = "mean": {quantity.name} is not one number of a run: use max(…), min(…), '
            "mean(…), final(…), integral(…) or range(…) of it, or a function of runs"
        )
    if statistic == "worst" and quantity.plays:
        raise ValueError('statistic = "worst": must be "mean" for the return of a task')
    return statistic != "worst" and quantity.is_scalar


def _episodes(
    quantity: Any, motion: Motion | str | None, engine: str, fields: MeasurementFields
) -> tuple[Motion, MeasurementFields]:
    """Return the motion of the episodes of a task, and the arguments that are not its fields."""
    rest = {name: value for name, value in fields.items() if name in SHARED}
    others = fields.keys() - rest.keys() - {"starts"}
    if motion is not None or others:
        name = min(others, default="motion")
        raise ValueError(f"{name}: must be given to the Return of the task, not to trade")
    if engine != "stepcore":
        raise ValueError(f"engine = {engine!r}: must be 'stepcore' for the return of a task")
    return replace(quantity.motion, starts=fields.get("starts")), cast("MeasurementFields", rest)


def _proven_and_timed(result: Trade, search: Search, further: int) -> None:
    """Test the choice on held-out starts, measure times, and look for findings."""
    study, deadline = search.study, search.study.workers.deadline
    if further and result.chosen is not None:
        test = f"{counted(further, 'held-out start')}"
        deadline.so_far(f"{search.so_far(result.chosen)}; {test} are to prove it")
        with deadline.stage(f"the test on {further} held-out starts", PROVEN):
            result.proof = proven(study, result.chosen.change, result.asked, further)
    result.runs = study.runs
    result.score(search)
    if result.by == "time":
        with deadline.closing(), deadline.stage("all timing"):
            named = [result.shipped, *result.named]
            result.times = study.times([trial.change for trial in named if not trial.failure])
    if result.engine == "stepcore":
        with deadline.stage("the findings on the shipped settings"):
            result.findings = monitored(study.model, study.schedule)[0]
            if result.chosen is not None and result.chosen.change != SHIPPED:
                run = recorded(result.chosen.change.of(study.model), study.schedule)
                result.chatter = list(chatter_findings(run))


def _searched(result: Trade, search: Search, further: int) -> None:
    """Search for the requested error or budget, or for the cost of less error."""
    unsure, target = search.truth.error, result.target
    result.unsure = unsure
    if result.budget is not None:
        result.chosen = search.most_accurate(result.budget)
        return
    if target is None:
        for share in LESS:
            search.cheapest(share * search.shipped.error)
        return
    if unsure > UNSURE * target:
        # The uncertainty of the converged motion sets the least error that can be verified.
        least = rounded(unsure / UNSURE, 2, up=True)
        most = search.moved if search.shipped.failure else max(search.moved, search.shipped.error)
        result.verified = least if least < math.inf and least <= USEFUL * most else None
    if unsure <= target or result.verified is not None:
        result.chosen = settled(search, result.asked, further)
    rest = search.study.spent <= SEARCHING * search.study.effort
    if result.verified is not None and search.truth.error <= UNSURE * target and rest:
        # The search has refined the converged motion enough for the requested error.
        result.unsure = search.truth.error
        chosen = settled(search, target, further)
        if chosen is not None:
            result.chosen, result.verified = chosen, None


def _full(search: str | None, axes: Mapping[str, Sequence[Any] | None], engine: str) -> bool:
    """Return whether to search the full grid; raise ValueError for an invalid axis."""
    checks.one_of("frugal", "grid", None)("trade", "search", search)
    values_by_axis = {name: values for name, values in axes.items() if values is not None}
    for name, values in values_by_axis.items():
        checks.nonempty(name, values)
        for value in values:
            # Check every value now, including values that would never be tried.
            if name == "dts":
                units.time(name, value)
            elif name == "accuracies":
                units.length("trade", name, value, 1.0)
            elif engine == "stepcore":
                Settings(**{name if name == "sweeps" else name.removesuffix("s"): value})
    if values_by_axis and search == "frugal":
        name = min(values_by_axis)
        raise ValueError(f"search = 'frugal': must be 'grid' or None where {name} is given")
    return bool(values_by_axis) or search == "grid"


def grid(
    study: Study,
    dts: Sequence[float],
    integrators: Sequence[str] | None,
    solvers: Sequence[str] | None,
    sweeps: Sequence[int] | None,
    precisions: Sequence[str] | None,
) -> list[Change]:
    """Return the changes of a full grid: every combination of the values of its axes.

    Unless precisions are given, single precision is tried with only one number of sweeps.
    """
    shipped, families = study.engine.settings(SHIPPED), study.engine.families(study.schedule)
    usual = {name: getattr(shipped, name) for name in ("integrator", "solver", "sweeps")}
    used = [usual, *(usual | {k: v for k, v in f.settings if k in usual} for f in families)]
    methods = list[dict[str, Any]]()
    for solver in solvers or dict.fromkeys(method["solver"] for method in used):
        counts = list(dict.fromkeys(m["sweeps"] for m in used if m["solver"] == solver))
        counts = list(sweeps or counts) if solver == "pgs" else counts[:1]
        methods += [{"solver": solver, "sweeps": n} for n in counts or [shipped.sweeps]]
    if precisions is None:
        single = {m["solver"]: m | {"precision": "f32"} for m in methods}
        methods = [m | {"precision": "f64"} for m in methods]
        methods += list(single.values()) if study.engine.name == "stepcore" else []
    else:
        methods = [m | {"precision": p} for p in precisions for m in methods]
    names = integrators or dict.fromkeys(method["integrator"] for method in used)
    return [
        Change.between(shipped.replace(accuracy=None, dt=dt, integrator=name, **method), shipped)
        for dt, name, method in itertools.product(dts, names, methods)
    ]


def within(study: Study, accuracies: Sequence[float | str] | None) -> list[Change]:
    """Return adaptive steps with these tolerances over the horizon."""
    kept = (units.length("trade", "accuracies", a, study.size) for a in accuracies or ())
    period, horizon = study.schedule.period, study.schedule.horizon
    return [Change(accuracy=a / horizon, dt=period) for a in kept]
