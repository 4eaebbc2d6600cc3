"""`identify`: finds values of a model from logs of its motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import NormalDist

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.parameters import Column, named_columns, own_value
from stepcore.experiment.arguments import Source
from stepcore.experiment.change import Change
from stepcore.loading import find_model
from stepcore.measure.identification.doubts import (
    Certainty,
    certainty,
    fit_findings,
    gap_findings,
    horizon_findings,
    predictable,
    unit_findings,
)
from stepcore.measure.identification.log import (
    DELAY,
    Log,
    MeasuredLog,
    driven,
    is_delay,
    late_entries,
    opened,
    read_log,
    within,
)
from stepcore.measure.identification.predictions import Predictions
from stepcore.measure.identification.readings import check_smooth
from stepcore.measure.identification.result import FINER, Curve, Identification
from stepcore.measure.monitors.finding import Finding
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import counted, seconds

__all__ = ["Identification", "identify"]

# Of a normal distribution, 95 % are within so many standard errors.
SIGMAS = NormalDist().inv_cdf(0.975)
# A long log is fitted to its beginning first, which costs little and can be predicted from a poor
# guess: this share of it, if that is as many steps.
BEGINNING, ENOUGH = 1 / 8, 40
# When iterations end: of the beginning, and of all. Errors are squared in each: after a step of
# 1e-7 they are below 1e-13, of logs with noise a millionth of what that makes uncertain.
ROUGH = {"xtol": 1e-3, "ftol": 1e-4, "gtol": 1e-8}
FINE = {"xtol": 1e-7, "ftol": 1e-14, "gtol": 1e-14}


def identify(
    model: Source,
    logs: Log | Sequence[Log],
    parameters: Mapping[str, tuple[float, float]],
    *,
    most: int = 50,
    progress: Choice = None,
) -> Identification:
    """Find values of a model from logs of its motion, with exact derivatives.

    model: a Model, a Scene, or any argument of `stepcore.load`; its values are the first guess.
    logs: a log, or a list of several. A log is a `stepcore.Log` or what one is read from, such as a
        file, a DataFrame or a `Trajectory`; or a dict of such sources by array, each with times of
        its own: {"qpos": "log.mcap:/joint_states", "ctrl": "log.mcap:/commands"}. NaN is not
        measured. Torques are played by motors, which are made where a model has no actuators.
    parameters: the range of each value, by path as in `Sim.linearize`: (low, high), without 0. A
        value that is 0 in the model begins at √(low·high). "delay" is the time by which controls
        act later than their rows say [s]; it begins at the low end. "delay/qpos", "delay/qvel",
        "delay/sensordata" and "delay/NAME" of a sensor are how much later the log has what was
        measured than it was [s]; they begin at 0. Rows as early as the high end are left out.
    most: the largest number of iterations.
    progress: False for no progress bar, or a function of (label, done, total).

    Each log is predicted from its first row, which is estimated too, under its controls, each held
    until the next; a step has their mean. Predictions are taken between steps where the log's times
    are no steps. The method is scipy's `least_squares` within bounds, whose Jacobian is exact: it
    goes forward with each step's derivative (sensors: differences of the fourth order). Needs scipy
    (the extra "identify").

    Raises ValueError for unknown parameters and ranges without the present value, for logs that do
    not fit the model or have times in milliseconds, for sensors that do not change smoothly, and if
    the run with the present values fails; OSError for files that cannot be read.

    >>> import stepcore as sc
    >>> model = sc.lesson.spring().compile().with_settings(dt=0.005, integrator="semi-implicit")
    >>> sim = sc.Sim(model.with_values({"joint/spring/stiffness": 90.0}))
    >>> sim.reset("start")
    >>> found = identify(model, sim.run(0.5), {"joint/spring/stiffness": (50, 200)})
    >>> round(found.values["joint/spring/stiffness"], 6)
    90.0
    """
    checks.progress("identify", progress)
    logs = opened(logs)
    given = driven(Change(precision="f64").of(find_model(model)), logs)
    if any(actuator.delay > 0 for actuator in given.scene.actuators):
        limit = 'without delays of actuators: make these 0, and "delay" a parameter'
        raise ValueError(f"model: must be {limit}")
    compiled, bounds, guess = _bounds(given, parameters)
    read = [within(compiled, log, bounds) for log in _read(compiled, logs)]
    labels = list(bounds)
    fit = Predictions(compiled, read, labels)
    check_smooth(compiled, {part.entry for part in fit.parts if part.array == "sensordata"})
    findings = [*unit_findings(compiled, read), *gap_findings(read)]
    start = np.concatenate([guess, np.zeros(fit.free)])
    most = checks.count("most", most)
    with Progress("iterations at most", most, progress) as bar:
        try:
            fit.residual(start)
        except SimulationError as error:
            limit = "must be values with which the logs can be run"
            raise ValueError(f"model: {checks.one_line(error)}: {limit}") from None
        x, settled = _fitted(fit, bounds, start, most, bar)
    sure = certainty(fit.jacobian(x), fit.residual(x), fit.kinds[fit.known], labels)
    result = _result(fit, bounds, start, x, sure, findings)
    if not settled:
        result.unfinished = f"The search was cut off by most = {most}: the values may still change."
    return result


def _read(model: Model, logs: Sequence[Log]) -> list[MeasuredLog]:
    return [read_log(model, log, f"logs[{k}]") for k, log in enumerate(logs)]


def _bounds(
    model: Model, parameters: Mapping[str, tuple[float, float]]
) -> tuple[Model, dict[str, tuple[float, float]], list[float]]:
    """Return the model to begin with, the checked ranges by label, and the guess: its values."""
    if not isinstance(parameters, Mapping) or not parameters:
        limit = 'a dict of paths and ranges, such as {"joint/knee/damping": (0.01, 10)}'
        raise ValueError(f"parameters = {checks.shown(parameters)}: must be {limit}")
    known, guess = dict[str, tuple[float, float]](), []
    for path, given in parameters.items():
        pair = checks.listed(given) or ()
        low, high = (checks.number(x) for x in pair) if len(pair) == 2 else (None, None)
        if low is None or high is None or not low < high:
            raise ValueError(f"parameters[{checks.shown(path)}]: must be a range (low, high)")
        label, value = path, low
        limit, allowed = "a range without 0", low > 0 or high < 0
        if path == DELAY:
            limit, allowed = "a range of times [s] from 0 on, of a model with controls", low >= 0
            allowed = allowed and model.nu > 0
        elif isinstance(path, str) and is_delay(path):
            late_entries(model, path)
            value, allowed = min(max(0.0, low), high), True
        elif allowed:
            model, column = _begun(model, path, low, high)
            label, value = column.label, column.value
            limit, allowed = f"a range around {value:g}, the model's value", low <= value <= high
        if not allowed:
            shown = f"parameters[{checks.shown(path)}] = ({low:g}, {high:g})"
            raise ValueError(f"{shown}: must be {limit}")
        known[label] = (float(low), float(high))
        guess.append(float(value))
    return model, known, guess


def _begun(model: Model, path: str, low: float, high: float) -> tuple[Model, Column]:
    """Return the model to begin with and the number of a path: √(low·high) where it is zero.

    A step leaves out what is zero, and so has no derivative by it.
    """
    several = named_columns(model, [path])
    if len(several) > 1:
        raise ValueError(f"parameters: {path} has several entries: name one, as {several[0].label}")
    (column,) = several
    if column.value == 0:
        value = own_value(model, column.path)
        middle = math.copysign(math.sqrt(abs(low)) * math.sqrt(abs(high)), low)
        value[() if column.entry is None else column.entry] = middle
        try:
            model = Change({column.path: value.tolist()}).of(model)
        except ValueError as error:
            shown = f"parameters[{checks.shown(path)}] = ({low:g}, {high:g})"
            raise ValueError(f"{shown}: must be a range of values: {error}") from None
        (column,) = named_columns(model, [column.label])
    column.check()
    return model, column


def _fitted(
    fit: Predictions,
    bounds: Mapping[str, tuple[float, float]],
    start: np.ndarray,
    most: int,
    bar: Progress,
) -> tuple[np.ndarray, bool]:
    """Return the values x that fit best, and whether the search had ended."""
    try:
        from scipy.optimize import least_squares
    except ImportError:
        raise ImportError('identify needs scipy: pip install "stepcore[identify]"') from None
    low, high = np.array(list(bounds.values())).T
    # Estimates in units of their range; then what the first states are off.
    units = np.concatenate([high - low, np.ones(fit.free)])
    origin = np.concatenate([low, np.zeros(fit.free)])
    free = np.full(fit.free, np.inf)
    ends = np.concatenate([0 * low, -free]), np.concatenate([0 * low + 1, free])

    def solve(
        part: Predictions, begin: np.ndarray, when: Mapping[str, float]
    ) -> tuple[np.ndarray, bool]:
        first = np.clip((begin - origin) / units, ends[0] + 1e-9, ends[1] - 1e-9)

        def at(y: np.ndarray) -> np.ndarray:
            # The run of the first is known.
            return begin if np.array_equal(y, first) else origin + y * units

        def slopes(y: np.ndarray) -> np.ndarray:
            bar.advance()
            return part.jacobian(at(y)) * units

        found = least_squares(
            lambda y: _residual(part, at(y)),
            first,
            jac=slopes,
            bounds=ends,
            x_scale="jac",
            max_nfev=most,
            **when,
        )
        return at(found.x), found.status > 0

    x = start
    if all(BEGINNING * log.steps(fit.base.settings.dt) >= ENOUGH for log in fit.logs):
        part = fit.until(BEGINNING)
        near, _ = solve(part, x, ROUGH)
        fit.steps, fit.linearised = fit.steps + part.steps, fit.linearised + part.linearised
        before, after = (np.sum(_residual(fit, each) ** 2) for each in (x, near))
        x = near if after < before else x
    return solve(fit, x, FINE)


def _residual(fit: Predictions, x: np.ndarray) -> np.ndarray:
    """Return the residuals; NaN, which the method steps back from, if a run fails."""
    try:
        return fit.residual(x)
    except SimulationError:
        return np.full(int(fit.known.sum()), np.nan)


def _result(
    fit: Predictions,
    bounds: Mapping[str, tuple[float, float]],
    start: np.ndarray,
    x: np.ndarray,
    sure: Certainty,
    findings: Sequence[Finding],
) -> Identification:
    ends, after, first = predictable(fit, x), fit.predicted(x), fit.predicted(start)
    finer = fit.predicted(x, FINER)
    # One step of Gauss and Newton from the estimates, by what shorter steps change.
    moved = x - sure.inverse @ (fit.residual_of(finer) - fit.residual_of(after))
    low, high = np.array(list(bounds.values())).T
    half = SIGMAS * sure.errors
    ranges = zip((x[: len(half)] - half).tolist(), (x[: len(half)] + half).tolist(), strict=True)

    def named(values: np.ndarray) -> dict[str, float]:
        return dict(zip(fit.labels, values.tolist(), strict=False))

    return Identification(
        name=fit.base.scene.name or "scene",
        settings=fit.base.settings,
        logs=len(fit.logs),
        samples=int(fit.known.sum()),
        values=named(x),
        start=named(start),
        bounds=dict(bounds),
        intervals=dict(zip(fit.labels, ranges, strict=True)),
        alike=sure.alike,
        correlations=sure.correlations,
        residuals=fit.rms(fit.measured, after),
        before=fit.rms(fit.measured, first),
        integration=fit.rms(after, finer),
        finer=named(np.clip(moved[: len(low)], low, high)),
        predictable=ends,
        findings=[*findings, *fit_findings(fit, first), *horizon_findings(fit.logs, ends)],
        curves=_curves(fit, first, after),
        model=fit.model(x),
        steps=fit.steps,
        linearised=fit.linearised,
        ran=f"{counted(len(fit.logs), 'log')} of {seconds(sum(log.duration for log in fit.logs))} "
        "in all",
        notes=[note for log in fit.logs for note in log.notes],
    )


def _curves(fit: Predictions, before: np.ndarray, after: np.ndarray) -> list[Curve]:
    ends = np.cumsum([len(part.times) for part in fit.parts])[:-1]
    both = zip(fit.parts, np.split(before, ends), np.split(after, ends), strict=True)
    return [Curve(p.log, p.label, p.times, p.values, *made) for p, *made in both]
