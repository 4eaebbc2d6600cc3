"""`identify`: finds values of a model from logs of its motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.deadline import Deadline, OutOfTime, in_time
from stepcore.engine.model import Model
from stepcore.engine.parameters import columns, named_columns, own_value
from stepcore.experiment.arguments import Source, Workers
from stepcore.experiment.change import Change
from stepcore.experiment.motion import INTERPOLATIONS
from stepcore.loading import find_model
from stepcore.measure.identification.doubts import (
    WEAK,
    certainty,
    fit_findings,
    gap_findings,
    horizon_findings,
    log_findings,
    predictable_times,
    spare,
)
from stepcore.measure.identification.log import (
    DELAY,
    Log,
    MeasuredLog,
    driven,
    is_delay,
    late_entries,
    open_logs,
    read_log,
    usable,
)
from stepcore.measure.identification.misfit import FINER, Quality, beyond, lacking, misfits, refines
from stepcore.measure.identification.predictions import Predictions
from stepcore.measure.identification.readings import check_smooth
from stepcore.measure.identification.result import LIMITS, Curve, Identification
from stepcore.measure.monitors.finding import Finding
from stepcore.needs import need
from stepcore.report import units
from stepcore.report.progress import Choice
from stepcore.report.units import counted, rounded

__all__ = ["Identification", "identify"]

# The beginning of a long log is fitted first, which is cheap, and possible from a poor guess: this
# share of the log, if it has at least this many steps.
BEGINNING, ENOUGH = 1 / 8, 40
# Tolerances that end the iterations, for the beginning and for the whole log. Each iteration
# squares the error: after a step of 1e-7 it is below 1e-13, or with noise, a millionth of the
# uncertainty from noise.
ROUGH = {"xtol": 1e-3, "ftol": 1e-4, "gtol": 1e-8}
FINE = {"xtol": 1e-7, "ftol": 1e-14, "gtol": 1e-14}
# From a poor guess a fit may end far from the best one. Then this many pieces, spread over the
# logs, are fitted, each with a separate first state. They begin with half this number of rows, and
# are doubled, each time from the values found before. All of five logs (servos that saturate one
# after another) led to the hidden values; with twice as many rows at first none did to all digits,
# and one did not at all. This is also the largest number of iterations of each such fit.
PIECES = 20
FROM = "the fit began with the values of fits of short pieces, because it was bad from those given"
LINEAR = (
    "controls between rows were interpolated, which fits the logs better than holding each row "
    "(--interpolation linear)"
)
CUT = "the logs were cut into pieces of {}, because they can be predicted for about {} (--pieces)"


@in_time
def identify(
    model: Source,
    logs: Log | Sequence[Log],
    parameters: Mapping[str, tuple[float, float]],
    *,
    pieces: float | str | None = None,
    interpolation: str | None = None,
    most: int = 50,
    threads: int | None = None,
    progress: Choice = None,
    seconds: float | None = None,
) -> Identification:
    """Find values of a model from logs of its motion, with exact derivatives.

    model: a Model, a Scene, or any argument of `stepcore.load`; its values are the first guess.
    logs: a log, or a list of several. A log is a `stepcore.Log` or a source of one, such as a file,
        a DataFrame or a `Trajectory`; or a dict of such sources by array, each with separate times:
        {"qpos": "log.mcap:/joint_states", "ctrl": "log.mcap:/commands"}. NaN marks a number that
        was not measured. If a model has no actuators, motors are added that apply the torques.
    parameters: the range (low, high) of each value, without 0, by path as in `Sim.linearize`.
        "joint/*/damping" sets this range for the damping of every joint that is not free. A value
        that is 0 in the model starts at √(low·high). "delay" is the delay of controls after the
        times of their rows [s], negative if positions lead the commands. "delay/qpos",
        "delay/qvel", "delay/sensordata" and "delay/NAME" (a sensor) are the delays of measured
        numbers in the log [s]. Delays start at 0, or at the end of their range nearest to 0. Rows
        that may belong to times outside of the log are left out.
    pieces: cut each log into pieces of this length, a time [s] or a text such as "0.5s". Each piece
        has a separate first state, which keeps errors from growing over a long or unstable motion.
        By default logs are cut only if the fit is bad without pieces and good with them.
    interpolation: "held" (each row of controls until the next) or "linear" between rows. By default
        rows are held. Interpolation is tried if positions lead the commands by up to a row, and
        used if it fits better.
    most: the largest number of iterations.
    threads: the number of steps that are linearised at the same time (default: one per core).
    progress: False for no progress bar, or a function of (label, done, total).
    seconds: the longest time [s]. The result then has the best values so far, and `unfinished`
        lists the remaining work.

    Each log is predicted from its first row, which is estimated too, under its controls; each step
    uses their mean. Predictions are interpolated to the times of the log. The method is scipy's
    `least_squares` within bounds, with exact derivatives of each step (for sensors, differences of
    the fourth order). Needs scipy (the extra "identify").

    Raises ValueError for unknown parameters and ranges without the present value, for logs that do
    not fit the model or have times in milliseconds, for sensors that do not change smoothly, and if
    the run with the present values fails; OSError for files that cannot be read; OutOfTime if the
    time is over before the first iteration.

    >>> import stepcore as sc
    >>> model = sc.lesson.spring().compile().with_settings(dt=0.005, integrator="semi-implicit")
    >>> sim = sc.Sim(model.with_values({"joint/spring/stiffness": 90.0}))
    >>> sim.reset("start")
    >>> found = identify(model, sim.run(0.5), {"joint/spring/stiffness": (50, 200)})
    >>> round(found.values["joint/spring/stiffness"], 6)
    90.0
    """
    workers = Workers.checked("identify", threads, None, progress)
    logs = open_logs(logs)
    initial = driven(Change(precision="f64").of(find_model(model)), logs)
    if any(actuator.delay > 0 for actuator in initial.scene.actuators):
        limit = 'without delays of actuators: make these 0, and "delay" a parameter'
        raise ValueError(f"model: must be {limit}")
    compiled, bounds, guess = _bounds(initial, parameters)
    if interpolation is not None:
        checks.one_of(*INTERPOLATIONS)("identify", "interpolation", interpolation)
    data = _read(compiled, logs, interpolation == "linear")
    length = None if pieces is None else units.time("pieces", pieces)
    findings = [*log_findings(compiled, data, list(bounds)), *gap_findings(data)]
    for finding in findings:
        workers.deadline.so_far(finding.text)
    start, most = list(guess.values()), checks.count("most", most)

    def fitted(length: float | None, values: Sequence[float] = start) -> Identification:
        """Fit the logs in pieces of a length [s], beginning with these values."""
        parts = data if length is None else [p for log in data for p in log.split(compiled, length)]
        read = [usable(compiled, part, bounds) for part in parts]
        fit = Predictions(compiled, read, list(bounds), threads=workers.threads)
        check_smooth(compiled, {p.entry for p in fit.parts if p.array == "sensordata"})
        first = fit.predicted(np.append(start, np.zeros(fit.free)))
        search = Search(fit, bounds, values, workers, most)
        with workers.deadline.closing():
            result = _result(search, guess, first, findings, workers.deadline)
        if not search.settled and not workers.deadline.left_out:
            text = f"The search was cut off by most = {most}: the values may still change."
            result.unfinished = text
        return result

    try:
        result = fitted(length)
    except SimulationError as error:
        limit = "must be values with which the logs can be run"
        text = " ".join(["", *(finding.text for finding in findings)])
        raise ValueError(f"model: {checks.one_line(error)}: {limit}.{text}") from None
    notes = list[str]()
    if interpolation is None and _leads(result, data):
        stepped = data
        data = [replace(log, controls=replace(log.controls, linear=True)) for log in stepped]
        between = None
        with suppress(SimulationError), workers.deadline.stage("a fit with interpolated controls"):
            between = fitted(length)
        lacks = None if between is None else between.quality.missing
        # If a delay of half a row is left with interpolated rows, the rows were held.
        late = lacks is not None and lacks.delay > _row(stepped) / 4
        if between is None or late or not _explains(between.quality, result.quality):
            data = stepped
        else:
            result, notes = between, [LINEAR]
            result.notes.append(LINEAR)
    if length is not None or not all(len(log.begins) for log in data):
        return result
    # Errors grow six times in a quarter of the time in which they grow a thousand times.
    end, verdict = rounded(min(result.predictable) / 4, 1), result.quality.verdict
    refit, note = None, FROM
    try:
        if end == np.inf and verdict == "bad":
            with workers.deadline.stage("a fit that begins with short pieces"):
                near = _from_pieces(compiled, data, bounds, result, workers, most)
                refit = None if near is None else fitted(None, near)
        elif ENOUGH * compiled.settings.dt < end < np.inf and not findings and verdict != "noise":
            note = CUT.format(units.seconds(end), units.seconds(4 * end))
            with workers.deadline.stage(f"the fit of pieces of {units.seconds(end)}"):
                refit = fitted(end)
    except SimulationError:
        # If the pieces cannot be run, return the fit of the whole logs.
        return result
    if refit is None:
        return result
    if refit.quality.verdict == "bad" and not _explains(refit.quality, result.quality):
        return result
    refit.notes += [*notes, note]
    return refit


def _leads(result: Identification, logs: Sequence[MeasuredLog]) -> bool:
    """Return whether a fit may be bad because rows of controls were held, not interpolated.

    On average a held row acts half a row later than an interpolated one.
    """
    lacks, row = result.quality.missing, _row(logs)
    if result.quality.verdict not in ("bad", "unexplained") or row <= result.settings.dt:
        return False
    if DELAY in result.values:
        # Half a row of the estimated delay may come from held rows.
        return True
    return lacks is not None and -1.5 * row < lacks.delay < -row / 8


def _row(logs: Sequence[MeasuredLog]) -> float:
    """Return the median time between two rows of controls [s]; 0 for a single row."""
    rows = np.concatenate([np.diff(log.controls.times) for log in logs])
    return float(np.median(rows)) if len(rows) else 0.0


def _explains(quality: Quality, other: Quality) -> bool:
    """Return whether one fit leaves less residual beyond the noise than another, worse fit: less
    than half, and less than with the other's missing value; or any less if only the other is bad.
    """
    lacks = other.missing
    rest = 0.5 if lacks is None or is_delay(lacks.label) else min(0.5, 1 - lacks.share)
    rest = 1.0 if quality.verdict in LIMITS and other.verdict == "bad" else rest
    return beyond(quality.misfits, other.misfits) < rest * beyond(other.misfits, other.misfits)


def _from_pieces(
    model: Model,
    logs: Sequence[MeasuredLog],
    bounds: Mapping[str, tuple[float, float]],
    bad: Identification,
    workers: Workers,
    most: int,
) -> list[float] | None:
    """Return values that fit pieces of the logs, with the number of rows doubled each time.

    bad: the fit of the whole logs. None if the pieces fit no better: then the model is wrong.
    """
    values, rows = list(bad.start.values()), PIECES // 2
    while any(rows <= BEGINNING * len(log.measured["qpos"].times) for log in logs):
        parts = list[MeasuredLog]()
        for log in logs:
            spacing = log.duration / max(1, len(log.measured["qpos"].times) - 1)
            parts += log.split(model, rows * spacing)
        some = [usable(model, part, bounds) for part in parts[:: math.ceil(len(parts) / PIECES)]]
        fit = Predictions(model, some, list(bounds), threads=workers.threads)
        x = Search(fit, bounds, values, workers, min(most, PIECES)).x
        # A quantity that is seldom measured may be in no piece.
        off = fit.rms(fit.measured, fit.predicted(x))
        both = np.array([(off[q], bad.residuals[q]) for q in off]).T
        mine, its = np.linalg.norm(both / [fit.scales[q] for q in off], axis=1)
        if mine >= its:
            return None
        values, rows = x[: len(values)].tolist(), 2 * rows
    return values


def _read(model: Model, logs: Sequence[Log], linear: bool) -> list[MeasuredLog]:
    return [read_log(model, log, f"logs[{k}]", linear) for k, log in enumerate(logs)]


def _bounds(
    model: Model, parameters: Mapping[str, tuple[float, float]]
) -> tuple[Model, dict[str, tuple[float, float]], dict[str, float]]:
    """Return the initial model, and the checked ranges and the first guess by label."""
    if not isinstance(parameters, Mapping) or not parameters:
        limit = 'a dict of paths and ranges, such as {"joint/knee/damping": (0.01, 10)}'
        raise ValueError(f"parameters = {checks.shown(parameters)}: must be {limit}")
    bounds, guess = dict[str, tuple[float, float]](), dict[str, float]()
    for path, value_range in parameters.items():
        pair = checks.as_list(value_range) or ()
        low, high = (checks.number(x) for x in pair) if len(pair) == 2 else (None, None)
        if low is None or high is None or not low < high:
            raise ValueError(f"parameters[{checks.shown(path)}]: must be a range (low, high)")
        small = math.copysign(min(1e-6, 1e-3 * max(high, -low)), high or -1)
        limit = "a range without 0" + f": use {small:g} in its place" * (low * high == 0)
        allowed, initial = low > 0 or high < 0, {path: min(max(0.0, low), high)}
        if path == DELAY:
            limit, allowed = "of a model with controls", model.nu > 0
        elif isinstance(path, str) and is_delay(path):
            late_entries(model, path)
            allowed = True
        elif allowed:
            model, initial = _begun(model, path, low, high)
            off = {label: value for label, value in initial.items() if not low <= value <= high}
            if off:
                path, allowed = ", ".join(off), False
                values = ", ".join(f"{value:g}" for value in off.values())
                limit = f"a range around {values}, the model's value{'s' * (len(off) > 1)}"
        if not allowed:
            shown = f"parameters[{checks.shown(path)}] = ({low:g}, {high:g})"
            raise ValueError(f"{shown}: must be {limit}")
        guess |= {label: float(value) for label, value in initial.items()}
        bounds |= dict.fromkeys(initial, (float(low), float(high)))
    return model, bounds, guess


def _begun(model: Model, path: str, low: float, high: float) -> tuple[Model, dict[str, float]]:
    """Return the initial model and the numbers of a path, with √(low·high) instead of zero.

    A step leaves out terms that are zero, so it has no derivative by them.
    """
    middle = math.copysign(math.sqrt(abs(low)) * math.sqrt(abs(high)), low)
    changed = dict[str, np.ndarray]()
    for column in named_columns(model, [path]):
        if column.value == 0:
            value = changed.setdefault(column.path, own_value(model, column.path))
            value[() if column.entry is None else column.entry] = middle
    try:
        model = Change({name: value.tolist() for name, value in changed.items()}).of(model)
    except ValueError as error:
        shown = f"parameters[{checks.shown(path)}] = ({low:g}, {high:g})"
        raise ValueError(f"{shown}: must be a range of values: {error}") from None
    return model, {column.label: column.value for column in columns(model, [path])}


class Search:
    """The search for the values x that fit best, which ends early when its time is over.

    x, jacobian: the best values so far, and the derivatives of the residuals there. begun: the
        initial values.
    settled: whether the values have converged.
    """

    def __init__(
        self,
        fit: Predictions,
        bounds: Mapping[str, tuple[float, float]],
        start: Sequence[float],
        workers: Workers,
        most: int,
    ) -> None:
        self.fit, self.bounds = fit, bounds
        self.workers, self.most = workers, most
        low, high = np.array(list(bounds.values())).T
        # Estimates in units of their range, then the corrections of the first states.
        self._units = np.concatenate([high - low, np.ones(fit.free)])
        self._origin = np.concatenate([low, np.zeros(fit.free)])
        free = np.full(fit.free, np.inf)
        self._ends = np.concatenate([0 * low, -free]), np.concatenate([0 * low + 1, free])
        self.begun = np.array(start, float)
        self.settled, self._known = False, dict[Predictions, tuple[np.ndarray, np.ndarray]]()
        with workers.bar("iterations at most", most) as self._bar:
            self._run(np.append(start, np.zeros(fit.free)))
            if fit not in self._known:
                raise OutOfTime("no iteration is complete")
        self.x, self.jacobian = self._known[fit]

    def _run(self, x: np.ndarray) -> None:
        fit, stage = self.fit, partial(self.workers.deadline.stage, "the rest of the search")
        with stage():
            if all(BEGINNING * log.steps(fit.base.settings.dt) >= ENOUGH for log in fit.logs):
                part = fit.until(BEGINNING)
                # The whole gets at least half of the time.
                with stage(0.5):
                    self._solve(part, x, ROUGH)
                near, _ = self._known.get(part, (x, None))
                fit.steps, fit.linearised = fit.steps + part.steps, fit.linearised + part.linearised
                before, after = (np.sum(_residual(fit, each) ** 2) for each in (x, near))
                x = near if after < before else x
            self.settled = self._solve(fit, x, FINE)

    def _solve(self, part: Predictions, begin: np.ndarray, when: Mapping[str, float]) -> bool:
        """Find the values that fit a part of the logs best; return whether they have converged."""
        least_squares = need("scipy.optimize", "identify", "identify").least_squares
        # Raise the error of the first run itself if it fails.
        part.runs(begin)
        low, high = self._ends
        first = np.clip((begin - self._origin) / self._units, low + 1e-9, high - 1e-9)

        def at(y: np.ndarray) -> np.ndarray:
            # Exactly the first values, whose run is cached.
            return begin if np.array_equal(y, first) else self._origin + y * self._units

        def slopes(y: np.ndarray) -> np.ndarray:
            x = at(y)
            self._known[part] = x, part.jacobian(x)
            self._bar.advance()
            self.workers.deadline.so_far(
                ", ".join(f"{k} = {v:.4g}" for k, v in zip(part.labels, x, strict=False))
            )
            return self._known[part][1] * self._units

        solution = least_squares(
            lambda y: _residual(part, at(y)),
            first,
            jac=slopes,
            bounds=self._ends,
            x_scale="jac",
            max_nfev=self.most,
            **when,
        )
        return bool(solution.status > 0)


def _residual(fit: Predictions, x: np.ndarray) -> np.ndarray:
    """Return the residuals, or NaN if a run fails; from NaN the method steps back."""
    try:
        return fit.residual(x)
    except SimulationError:
        return np.full(int(fit.known.sum()), np.nan)


def _result(
    search: Search,
    guess: Mapping[str, float],
    first: np.ndarray,
    findings: Sequence[Finding],
    limit: Deadline,
) -> Identification:
    """Return the result of a search. first: the predictions with the first guess."""
    fit, x, after = search.fit, search.x, search.fit.predicted(search.x)
    ends, finer = predictable_times(fit, x), np.full(len(after), np.nan)
    low, high = np.array(list(search.bounds.values())).T
    with limit.stage("the error of the time step"):
        finer = fit.predicted(x, FINER)
    misfit = misfits(fit, after, fit.rms(after, finer))
    spreads, kinds = [each.spread for each in misfit.values()], fit.kinds[fit.known]
    sure = certainty(search.jacobian, fit.residual(x), kinds, fit.labels, spreads)
    rest, lacks = spare(search.jacobian), None
    half = need("scipy.special", "identify", "identify").stdtrit(max(1, rest), 0.975) * sure.errors
    shorter = fit.residual_of(finer) - fit.residual_of(after)
    # A Gauss-Newton step from the estimates for the change of residuals with shorter steps.
    moved, refined = x - sure.inverse @ shorter, False
    moved[: len(low)] = np.clip(moved[: len(low)], low, high)
    # An exact log leaves no residual to explain.
    if rest > 0 and any(each.residual > WEAK * fit.scales[label] for label, each in misfit.items()):
        if np.isfinite(moved).all():
            with limit.stage("a run with shorter steps"):
                refined = refines(fit, misfit, finer, moved)
        with limit.stage("the value that would explain the residual"):
            lacks = lacking(fit, x, search.jacobian, shorter if refined else None, misfit)
    quality = Quality(misfit, lacks, rest, refined)
    if quality.verdict in ("bad", "few"):
        half = np.full(len(half), np.inf)
    elif quality.verdict == "unexplained" and lacks is not None:
        half = half + np.abs(lacks.shift)
    elif quality.verdict == "step":
        half = half + np.abs(moved - x)[: len(half)]
    if not search.settled:
        # A value is unknown if another iteration would change it by more than half of the interval.
        next_step = np.abs(sure.inverse @ fit.residual(x))[: len(half)]
        half = np.where((next_step > half) | (x[: len(half)] == search.begun), np.inf, half)
    duration = sum(log.duration for log in fit.logs)
    ranges = zip((x[: len(half)] - half).tolist(), (x[: len(half)] + half).tolist(), strict=True)

    def named(values: np.ndarray) -> dict[str, float]:
        return dict(zip(fit.labels, values.tolist(), strict=False))

    return Identification(
        name=fit.base.scene.name or "scene",
        settings=fit.base.settings,
        logs=len(fit.logs),
        samples=int(fit.known.sum()),
        values=named(x),
        start=dict(guess),
        bounds=dict(search.bounds),
        intervals=dict(zip(fit.labels, ranges, strict=True)),
        # Derivatives of an unstable motion are dominated by its growth, and show nothing else.
        alike=sure.alike if min(ends) == np.inf else [],
        correlations=sure.correlations,
        quality=quality,
        before=fit.rms(fit.measured, first),
        finer=named(moved[: len(low)]),
        predictable=ends,
        findings=[*findings, *fit_findings(fit, first), *horizon_findings(fit.logs, ends)],
        curves=_curves(fit, first, after),
        kept=[] if search.settled else np.array(fit.labels)[x[: len(low)] == search.begun].tolist(),
        model=fit.model(x),
        steps=fit.steps,
        linearised=fit.linearised,
        ran=f"{counted(len(fit.logs), 'log')} of {units.seconds(duration)} in all",
        notes=[note for log in fit.logs for note in log.notes],
    )


def _curves(fit: Predictions, before: np.ndarray, after: np.ndarray) -> list[Curve]:
    ends = np.cumsum([len(part.times) for part in fit.parts])[:-1]
    both = zip(fit.parts, np.split(before, ends), np.split(after, ends), strict=True)
    return [Curve(p.log, p.label, p.times, p.values, *predictions) for p, *predictions in both]
