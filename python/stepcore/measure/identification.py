"""`identify`: finds values of a model from logs of its motion."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.axes import axes_of
from stepcore.engine.batch import Batch
from stepcore.engine.gradients import Steps, Tangents, sensitivities
from stepcore.engine.model import Model
from stepcore.engine.parameter_columns import columns, split_entry
from stepcore.engine.trajectory import Trajectory
from stepcore.engine.variations import own_value
from stepcore.experiment.arguments import Source
from stepcore.loading import find_model
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, seconds

# What a log can tell, in the order of a state.
MEASURED = ("qpos", "qvel")
# Estimates whose correlation is above this cannot be told apart.
ALIKE = 0.99
# An estimate whose interval is wider than this share of its range is not known from the log.
WIDE = 0.5
# Of a normal distribution, 95 %.
SIGMAS = 1.96
# The step whose integration error is looked at is this many times shorter.
FINER = 4

Log = Trajectory | Mapping[str, ArrayLike] | str | os.PathLike[str]


@dataclass(repr=False, kw_only=True)
class Identification(Result):
    """The values that `identify` found.

    settings: of the runs. logs: how many there were. samples: measured numbers in all.
    values: the estimates by path. start: the values before. bounds: the ranges given.
    intervals: 95 % intervals by path, (low, high), from the residuals, taken as independent noise.
    alike: sets of parameters that the logs cannot tell apart.
    residuals, before: RMS residual by quantity, after and before: [m or rad], [m/s or rad/s].
    integration: RMS change of the prediction when steps are four times shorter, by quantity.
    model: the model with the estimates.
    steps: time steps made in all, runs for derivatives included.

    >>> import stepcore as sc
    >>> true = sc.lesson.spring().compile().with_values({"joint/spring/stiffness": 90.0})
    >>> sim = sc.Sim(true, dt=0.005, integrator="semi-implicit")
    >>> sim.reset("start")
    >>> log = sim.run(0.5)
    >>> model = sc.lesson.spring().compile().with_settings(dt=0.005, integrator="semi-implicit")
    >>> found = sc.identify(model, log, {"joint/spring/stiffness": (50, 200)})
    >>> round(found.values["joint/spring/stiffness"], 6)
    90.0
    """

    settings: Settings
    logs: int
    samples: int
    values: dict[str, float]
    start: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    intervals: dict[str, tuple[float, float]]
    alike: list[tuple[str, ...]]
    residuals: dict[str, float]
    before: dict[str, float]
    integration: dict[str, float]
    model: Model
    steps: int

    kind: ClassVar[str] = "identification"

    @property
    def title(self) -> str:
        return f"{self.name}: {counted(len(self.values), 'value')} from {counted(self.logs, 'log')}"

    @property
    def setup(self) -> str:
        return f"{counted(self.samples, 'measured number')}, {self.steps} steps. {self.settings!r}"

    @property
    def sentences(self) -> list[str]:
        said = []
        for path, value in self.values.items():
            low, high = self.intervals[path]
            interval = f"95 %: {low:.6g} to {high:.6g}"
            said.append(f"{path} = {value:.6g} ({interval}; it was {self.start[path]:.6g}).")
        said += [f"The logs cannot tell apart: {', '.join(paths)}." for paths in self.alike]
        said += [
            f"The logs say little of {path}: its interval is half of its range or more."
            for path in self.unknown
        ]
        for path, value in self.values.items():
            if value in self.bounds[path]:
                said.append(f"{path} is at the bound of its range.")
        for name, after in self.residuals.items():
            step = self.integration[name]
            said.append(
                f"The residual of {name} is {after:.3g} RMS ({self.before[name]:.3g} before); "
                f"steps {FINER} times shorter change the prediction by {step:.3g}"
                + (": take shorter steps." if step > after / 2 else ".")
            )
        return said

    @property
    def unknown(self) -> list[str]:
        """The parameters of which the logs say little."""
        known = []
        for path, (low, high) in self.intervals.items():
            first, last = self.bounds[path]
            if not high - low < WIDE * (last - first):
                known.append(path)
        return known

    @property
    def table(self) -> Table:
        """A row for each parameter."""
        rows = [
            {
                "parameter": path,
                "value": value,
                "low": self.intervals[path][0],
                "high": self.intervals[path][1],
                "before": self.start[path],
            }
            for path, value in self.values.items()
        ]
        return Table(rows, heading="Estimates with 95 % intervals")

    def details(self) -> dict[str, Any]:
        return {
            "values": self.values,
            "intervals": self.intervals,
            "alike": self.alike,
            "residuals": self.residuals,
            "residuals_before": self.before,
            "integration": self.integration,
            "steps": self.steps,
        }

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """There is no plot: `model` predicts, and a trajectory has one."""
        raise ValueError("an identification has no plot; run its `model` and plot the trajectory")


def identify(
    model: Source,
    logs: Log | Sequence[Log],
    parameters: Mapping[str, tuple[float, float]],
    *,
    most: int = 50,
) -> Identification:
    """Find values of a model from logs of its motion, with exact derivatives.

    model: a Model, a Scene, or any argument of `stepcore.load`; its values are the first guess.
    logs: a log, or several: a `Trajectory`; a dict of arrays with "time" (T,) [s], "qpos" and
        "qvel" (T, n) as far as they were measured, and "ctrl" (T, nu), each row from its time on;
        or a .npz or .csv file as `Trajectory.save` writes, with columns such as "qpos[knee]". NaN
        is not measured. The first row needs a whole qpos.
    parameters: the range of each value, by path as in `Sim.linearize`: (low, high).
    most: the largest number of iterations.

    Each log is predicted from its first row, which is estimated too, under its controls, each held
    until the next. Predictions are taken between steps where the log's times are no steps. The
    method is scipy's `least_squares` within bounds, whose Jacobian is exact: it goes forward with
    each step's derivative. Needs scipy (the extra "identify").

    Raises ValueError for unknown parameters and ranges without the present value, and for logs
    that do not fit the model.

    >>> import stepcore as sc
    >>> model = sc.lesson.spring().compile().with_settings(dt=0.005, integrator="semi-implicit")
    >>> sim = sc.Sim(model.with_values({"joint/spring/stiffness": 90.0}))
    >>> sim.reset("start")
    >>> found = identify(model, sim.run(0.5), {"joint/spring/stiffness": (50, 200)})
    >>> round(found.values["joint/spring/stiffness"], 6)
    90.0
    """
    try:
        from scipy.optimize import least_squares
    except ImportError:
        raise ImportError('identify needs scipy: pip install "stepcore[identify]"') from None

    compiled = find_model(model)
    compiled = compiled.with_settings(precision="f64")
    several = [logs] if isinstance(logs, (Trajectory, Mapping, str, os.PathLike)) else list(logs)
    if not several:
        raise ValueError("logs: must be at least one")
    read = [_Read(compiled, log, f"logs[{k}]") for k, log in enumerate(several)]
    bounds = _bounds(compiled, parameters)
    paths = list(bounds)
    labels = [columns(compiled, [path])[0].label for path in paths]
    guess = np.array([_value(compiled, label) for label in labels])
    low, high = np.array(list(bounds.values())).T
    fit = _Fit(compiled, read, labels)
    # Estimates in units of their range; then what the first states are off.
    width, off = high - low, np.zeros(fit.free)

    def full(x: np.ndarray) -> np.ndarray:
        return np.concatenate([low + x[: len(low)] * width, x[len(low) :]])

    begin = np.concatenate([np.clip((guess - low) / width, 1e-9, 1 - 1e-9), off])
    units = np.concatenate([width, np.ones(fit.free)])
    result = least_squares(
        lambda x: fit.residual(full(x)),
        begin,
        jac=lambda x: fit.jacobian(full(x)) * units,
        bounds=(
            np.concatenate([np.zeros(len(low)), off - np.inf]),
            np.concatenate([np.ones(len(low)), off + np.inf]),
        ),
        x_scale="jac",
        max_nfev=checks.count("most", most),
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-14,
    )
    found = full(result.x)
    jacobian = fit.jacobian(found)
    error, alike = _certainty(jacobian, fit.residual(found), labels)
    own = fit.model(found)
    residuals = fit.by_quantity(found)
    finer = own.with_settings(dt=own.settings.dt / FINER)
    return Identification(
        name=compiled.scene.name or "scene",
        settings=compiled.settings,
        logs=len(read),
        samples=len(result.fun),
        values=dict(zip(labels, found.tolist(), strict=False)),
        start=dict(zip(labels, guess.tolist(), strict=True)),
        bounds=dict(zip(labels, bounds.values(), strict=True)),
        intervals={
            label: (float(x - SIGMAS * e), float(x + SIGMAS * e))
            for label, x, e in zip(labels, found, error, strict=False)
        },
        alike=alike,
        residuals=residuals,
        before=fit.by_quantity(np.concatenate([guess, off])),
        integration=fit.apart(found, own, finer),
        model=own,
        steps=fit.steps,
        ran=f"{counted(len(read), 'log')} of {seconds(sum(log.time[-1] for log in read))} in all",
    )


def _bounds(
    model: Model, parameters: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    if not isinstance(parameters, Mapping) or not parameters:
        limit = 'a dict of paths and ranges, such as {"joint/knee/damping": (0.01, 10)}'
        raise ValueError(f"parameters = {checks.shown(parameters)}: must be {limit}")
    known = {}
    for path, given in parameters.items():
        pair = checks.listed(given) or ()
        low, high = (checks.number(x) for x in pair) if len(pair) == 2 else (None, None)
        if low is None or high is None or not low < high:
            raise ValueError(f"parameters[{checks.shown(path)}]: must be a range (low, high)")
        several = columns(model, [path])
        if len(several) > 1:
            raise ValueError(f"parameters: {path} has several entries: name one, as {path}[0]")
        value = several[0].value
        if not low <= value <= high or low * high <= 0:
            limit = f"a range around {value:g}, the model's value, without 0"
            raise ValueError(
                f"parameters[{checks.shown(path)}] = ({low:g}, {high:g}): must be {limit}"
            )
        known[path] = (float(low), float(high))
    return known


def _value(model: Model, label: str) -> float:
    path, entry = split_entry(label)
    value = own_value(model, path)
    return float(value if entry is None else value[entry])


class _Read:
    """A log: times from its beginning, measured arrays (T, n) with NaN, controls by step."""

    def __init__(self, model: Model, log: Log, name: str) -> None:
        time, data = _arrays(model, log, name)
        self.name = name
        if time.ndim != 1 or len(time) < 2 or not (np.diff(time) > 0).all():
            raise ValueError(f"{name}: time must be two or more increasing numbers")
        self.time = time - time[0]
        self.measured: dict[str, np.ndarray] = {}
        for key, size in (("qpos", model.nq), ("qvel", model.nv), ("ctrl", model.nu)):
            table = data.get(key)
            if table is None:
                table = np.full((len(time), size), 0.0 if key == "ctrl" else np.nan)
                if key == "ctrl" and size:
                    raise ValueError(f"{name}: ctrl is missing, and the model has {size} controls")
            if table.shape != (len(time), size):
                raise ValueError(
                    f"{name}: {key} has shape {table.shape}: must be {(len(time), size)}"
                )
            self.measured[key] = table
        if not np.isfinite(self.measured["qpos"][0]).all():
            raise ValueError(f"{name}: the first row of qpos must be whole: the run begins there")
        if not np.isfinite(self.measured["ctrl"]).all():
            raise ValueError(f"{name}: ctrl has gaps: a control that is not known cannot be played")
        self.start = self.measured["qpos"][0], self._velocity(model)
        dt = model.settings.dt
        self.steps = int(np.ceil(self.time[-1] / dt - 1e-9))
        at = np.searchsorted(self.time, np.arange(self.steps) * dt + 1e-9 * dt, "right") - 1
        self.ctrl = self.measured["ctrl"][np.clip(at, 0, len(time) - 1)]

    def _velocity(self, model: Model) -> np.ndarray:
        first = self.measured["qvel"][0]
        if np.isfinite(first).all():
            return first
        qpos, rate = self.measured["qpos"], np.zeros(model.nv)
        for joint, kind in enumerate(model.jnt_type):
            q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            if kind not in ("slide", "hinge"):
                raise ValueError(
                    f"{self.name}: the first row of qvel must be whole: of "
                    f"{model.element_name('joint', joint)} it does not follow from qpos"
                )
            rate[v] = (qpos[1, q] - qpos[0, q]) / (self.time[1] - self.time[0])
        return np.where(np.isfinite(first), first, rate)


def _arrays(model: Model, log: Log, name: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return time and arrays; a recorded run has at each instant the controls of the last step."""
    recorded = not isinstance(log, Mapping)
    if isinstance(log, (str, os.PathLike)):
        log = _table(log) if str(log).lower().endswith(".csv") else Trajectory.load(log)
    if isinstance(log, Trajectory):
        log = {"time": log.time, **log.data}
    if not isinstance(log, Mapping) or "time" not in log:
        raise ValueError(f'{name}: must be a Trajectory, a file or a dict with "time"')
    sizes = (("qpos", model.nq), ("qvel", model.nv), ("ctrl", model.nu))
    wanted = {key for key in log if key.partition("[")[0] in ("time", "qpos", "qvel", "ctrl")}
    given = {key: np.asarray(log[key], float) for key in wanted}
    time, data = given.pop("time"), {}
    for key, size in sizes:
        if key in given:
            data[key] = given[key]
            continue
        entries = axes_of(model, key, (size,))[0].entries if size else ()
        own = [given.get(f"{key}[{entry}]") for entry in entries]
        if any(column is not None for column in own):
            gap = np.full(len(time), np.nan)
            data[key] = np.stack([gap if column is None else column for column in own], axis=1)
    if recorded and "ctrl" in data:
        data["ctrl"] = np.concatenate([data["ctrl"][1:], data["ctrl"][-1:]])
    return time, data


def _table(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Return the columns of a .csv file; the first is time."""
    with Path(path).open(encoding="utf-8", newline="") as file:
        head, *rows = list(csv.reader(file))
    numbers = np.array([[float(x) if x.strip() else np.nan for x in row] for row in rows])
    if not len(rows) or not head[0].startswith("time"):
        raise ValueError(f"{checks.cut(str(path), 300)}: its first column must be time [s]")
    return {name: numbers[:, k] for k, name in enumerate(["time", *head[1:]])}


class _Fit:
    """Predictions of the logs under values of the parameters, and their derivatives."""

    def __init__(self, model: Model, logs: Sequence[_Read], labels: Sequence[str]) -> None:
        self.base, self.logs, self.labels = model, logs, labels
        # Each log's first state, by how much it is off: a position and a velocity a dof.
        self.free = 2 * model.nv * len(logs)
        self.steps = 0
        self.kept: tuple[bytes, list[Any]] | None = None
        # Each quantity in units of how much it moves.
        self.scale = {
            key: max(
                float(np.nanmax([np.nanstd(log.measured[key]) for log in logs], initial=0.0)), 1e-12
            )
            if any(np.isfinite(log.measured[key]).any() for log in logs)
            else 1.0
            for key in MEASURED
        }

    def model(self, values: np.ndarray) -> Model:
        """Return the model with these values."""
        changed: dict[str, Any] = {}
        for label, value in zip(self.labels, values, strict=False):
            path, entry = split_entry(label)
            own = changed.get(path, own_value(self.base, path))
            own[() if entry is None else entry] = value
            changed[path] = own
        plain = {path: value.tolist() for path, value in changed.items()}
        return self.base.with_values(plain)

    def _steps(self, values: np.ndarray) -> list[Steps]:
        """Return the rollouts of all logs; the last ones are kept."""
        key = values.tobytes()
        if self.kept is None or self.kept[0] != key:
            model = self.model(values)
            runs = (self._run(model, values, nth) for nth in range(len(self.logs)))
            self.kept = key, list(runs)
        return self.kept[1]

    def _run(self, model: Model, values: np.ndarray, nth: int, finer: int = 1) -> Steps:
        log, nv = self.logs[nth], model.nv
        batch = Batch(model, 1, threads=1)
        off = values[len(self.labels) :].reshape(-1, 2, nv)[nth]
        qpos = log.start[0]
        batch.qpos = qpos + Tangents(model).of_dofs(qpos, off[0])
        batch.qvel = log.start[1] + off[1]
        ctrl = np.repeat(log.ctrl, finer, axis=0)[None]
        self.steps += ctrl.shape[1]
        return Steps(batch, ctrl, self.labels).roll()

    def _at(self, model: Model, log: _Read, steps: Steps) -> dict[str, np.ndarray]:
        """Return the predicted arrays at the log's times."""
        dt = model.settings.dt
        times = np.arange(steps.count + 1) * dt
        out = {}
        for key in MEASURED:
            rows = np.concatenate([steps.start[key], getattr(steps.rollout, key)[0]])
            out[key] = _between(times, rows, log.time)
        return out

    def differences(self, values: np.ndarray) -> list[dict[str, np.ndarray]]:
        """Return prediction less measurement of each log."""
        made = self._steps(values)
        return [
            {
                key: predicted - log.measured[key]
                for key, predicted in self._at(self.base, log, steps).items()
            }
            for log, steps in zip(self.logs, made, strict=True)
        ]

    def residual(self, values: np.ndarray) -> np.ndarray:
        """Return all residuals in units of their quantity."""
        parts = []
        for off in self.differences(values):
            each = ((off[key], self.scale[key]) for key in MEASURED)
            parts += [own[np.isfinite(own)] / scale for own, scale in each]
        return np.concatenate(parts)

    def jacobian(self, values: np.ndarray) -> np.ndarray:
        """Return the derivative of the residuals by the values."""
        parts = []
        off, nv, count = self.differences(values), self.base.nv, len(self.labels)
        runs = self._steps(values)
        for nth, (log, steps, own) in enumerate(zip(self.logs, runs, off, strict=True)):
            self.steps += steps.count
            slopes = sensitivities(steps)
            whole = np.zeros((*slopes.shape[:2], count + self.free))
            whole[..., :count] = slopes[..., :count]
            place = count + 2 * nv * nth
            whole[..., place : place + 2 * nv] = slopes[..., count : count + 2 * nv]
            times = np.arange(steps.count + 1) * self.base.settings.dt
            qpos = np.concatenate([steps.start["qpos"], steps.rollout.qpos[0]])
            columns = np.moveaxis(whole[:, :nv], -1, 0)
            moved = [steps.tangents.of_dofs(qpos, column) for column in columns]
            for key, rows in (
                ("qpos", np.stack(moved, axis=-1)),
                ("qvel", whole[:, nv : 2 * nv]),
            ):
                there = _between(times, rows, log.time)
                parts.append(there[np.isfinite(own[key])] / self.scale[key])
        return np.concatenate(parts)

    def by_quantity(self, values: np.ndarray) -> dict[str, float]:
        """Return the RMS residual of each quantity that was measured."""
        return _roots(self.differences(values))

    def apart(self, values: np.ndarray, model: Model, finer: Model) -> dict[str, float]:
        """Return the RMS distance of the predictions of two models, by quantity."""
        factor = round(model.settings.dt / finer.settings.dt)
        distances = []
        for nth, log in enumerate(self.logs):
            one = self._at(model, log, self._run(model, values, nth))
            two = self._at(finer, log, self._run(finer, values, nth, factor))
            distances.append({key: one[key] - two[key] for key in MEASURED})
        known = self.by_quantity(values)
        return {key: value for key, value in _roots(distances).items() if key in known}


def _roots(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, float]:
    out = {}
    for key in MEASURED:
        every = np.concatenate([part[key].ravel() for part in parts])
        finite = every[np.isfinite(every)]
        if len(finite):
            out[key] = float(np.sqrt(np.mean(finite**2)))
    return out


def _between(times: np.ndarray, rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate rows linearly."""
    k = np.clip(np.searchsorted(times, at, "right") - 1, 0, len(times) - 2)
    share = ((at - times[k]) / (times[k + 1] - times[k])).reshape(-1, *[1] * (rows.ndim - 1))
    found: np.ndarray = rows[k] + share * (rows[k + 1] - rows[k])
    return found


def _certainty(
    jacobian: np.ndarray, residual: np.ndarray, labels: Sequence[str]
) -> tuple[np.ndarray, list[tuple[str, ...]]]:
    """Return the standard error of each estimate, and sets that cannot be told apart."""
    free = max(1, len(residual) - jacobian.shape[1])
    variance = float(residual @ residual) / free
    sizes = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(sizes > 0, sizes, 1.0)
    _, singular, turns = np.linalg.svd(unit, full_matrices=False)
    weak = singular < 1e-6 * max(singular.max(initial=0.0), 1e-300)
    alike = [
        tuple(labels[int(k)] for k in np.flatnonzero(np.abs(way[: len(labels)]) > 0.1))
        for way in turns[weak]
    ]
    alike = [names for names in alike if names]
    inverse = np.where(weak, np.inf, 1 / np.where(weak, 1.0, singular) ** 2)
    moved = np.maximum(turns.T**2, 1e-300)
    parts = np.where(moved > 1e-12, moved * inverse, 0.0)
    covariance = turns.T * np.where(weak, 0.0, inverse) @ turns
    size = np.where(sizes > 0, sizes, 1e-300)
    known = np.isfinite(parts.sum(1))
    error = np.where(known, np.sqrt(variance * np.where(known, parts.sum(1), 0.0)) / size, np.inf)
    spread = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        related = np.abs(covariance) / np.outer(spread, spread)
    for i in range(len(labels)):
        for k in range(i):
            pair = (labels[k], labels[i])
            if related[i, k] > ALIKE and not any(set(pair) <= set(known) for known in alike):
                alike.append(pair)
    return error, alike
