"""`MeasuredLog`: the measured motion of a robot, with the controls that moved it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from stepcore import checks
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.element import name_list
from stepcore.engine.model import Model
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.control_table import ControlLog
from stepcore.experiment.log import Log as Log
from stepcore.experiment.log import entries_of as entries_of
from stepcore.experiment.schedule import home

# The arrays that a log can contain: states, sensors and controls.
MEASURED = ("qpos", "qvel", "sensordata")
ARRAYS = (*MEASURED, "ctrl")
# The delay of controls after the times of their rows [s]. With a slash and an array or a sensor:
# the delay of the measurement's rows after the measurement.
DELAY = "delay"
KINDS = 'a Trajectory, a DataFrame, a file or a dict with a column "time"'


class Series(NamedTuple):
    """Numbers over time: times [s], shape (T,); values, shape (T, n), NaN where missing."""

    times: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class MeasuredLog:
    """A log of a model's motion; times count from its first position.

    name: such as "logs[0]". measured: series by array of `MEASURED`. controls: of all actuators.
    start: the first qpos and qvel; if they were not measured, the model's pose and the rate of
    change of the positions. notes: the columns that were read, and those that match nothing.
    """

    name: str
    measured: Mapping[str, Series]
    controls: ControlLog
    start: tuple[np.ndarray, np.ndarray]
    notes: tuple[str, ...] = ()

    @cached_property
    def duration(self) -> float:
        """The time of the last measured number [s]."""
        finite_times = (
            series.times[np.isfinite(series.values).any(axis=1)]
            for series in self.measured.values()
        )
        return float(max(times[-1] for times in finite_times if len(times)))

    def steps(self, dt: float) -> int:
        """Return the number of steps of dt [s] that the log lasts."""
        return int(np.ceil(self.duration / dt - 1e-9))

    def between(self, begin: float, end: float) -> MeasuredLog:
        """Return the rows of this log between two times [s]; new times count from the first."""
        cut = {}
        for name, (times, values) in self.measured.items():
            inside = (times >= begin) & (times <= end)
            if np.isfinite(values[inside]).any():
                cut[name] = Series(times[inside] - begin, values[inside])
        controls = replace(self.controls, times=self.controls.times - begin)
        return replace(self, measured=cut, controls=controls)

    @property
    def begins(self) -> np.ndarray:
        """The times of rows with all positions that the log measures [s]."""
        times, qpos = self.measured["qpos"]
        finite = np.isfinite(qpos)
        return times[finite[:, finite.any(axis=0)].all(axis=1)]

    def split(self, model: Model, length: float) -> list[MeasuredLog]:
        """Return pieces of a length [s], each starting at one of `begins`.

        Raises ValueError if there is none.
        """
        complete = self.begins
        if not len(complete):
            raise ValueError(f"pieces: {self.name} has no row with all positions that it measures")
        marks = np.arange(length, self.duration - length / 2, length)
        begins = np.unique(complete[np.searchsorted(complete, marks).clip(max=len(complete) - 1)])
        ends = np.nextafter([*begins, np.inf], 0.0)
        later = [self.between(*rows) for rows in zip(begins, ends[1:], strict=True)]
        pieces = [replace(piece, start=first_state(model, piece.measured)) for piece in later]
        return [self.between(0.0, ends[0]), *pieces]


def open_logs(logs: Any) -> list[Any]:
    """Return the sources of each log for `read_log`, each with its array or ""."""
    alone = isinstance(logs, (Trajectory, Mapping, str, os.PathLike, Log))
    several = [logs] if alone or hasattr(logs, "columns") else [*logs]
    if not several:
        raise ValueError("logs: must be at least one")
    return [_sources(log, f"logs[{k}]") for k, log in enumerate(several)]


def _sources(log: Any, name: str) -> list[tuple[str, Log]]:
    """Open a log of one source, or of several by array, each with separate times."""
    if isinstance(log, list):
        return log
    apart = isinstance(log, Mapping) and log and set(map(str, log)) <= set(ARRAYS)
    sources = [(str(key), Log(log[key], name)) for key in log] if apart else [("", Log(log, name))]
    for array, source in sources:
        source.expected = array if array in ("qpos", "ctrl") else ""
    return sources


def driven(model: Model, logs: Iterable[Any]) -> Model:
    """Return the model with motors for the torques of opened logs; see `Log.driven`."""
    for _, log in (each for sources in logs for each in sources):
        model = log.driven(model)
    return model


def read_log(model: Model, log: Any, name: str, linear: bool = False) -> MeasuredLog:
    """Convert a log, opened or as a user gives it, to arrays of a model; see `identify`.

    linear: whether controls between rows are interpolated.

    Raises ValueError if it is no log of this model, and OSError for a file.
    """
    series, notes = dict[str, Series](), list[str]()
    for array, part in _sources(log, name):
        if part.times is None:
            raise ValueError(f"{part.source}: must be {KINDS}")
        placed, arrays = part.placed(model), [array] if array else ARRAYS
        read = {key: placed.arrays[key] for key in arrays if key in placed.arrays}
        if "ctrl" in arrays and model.nu:
            read["ctrl"] = part.controls(model, np.full(model.nu, np.nan))
        if array and array not in read:
            raise ValueError(f"{part.source}: has no {array}, but {placed.words or 'no names'}")
        series |= {key: Series(part.begin + part.times, values) for key, values in read.items()}
        notes.append(f"{part.source}: {part.told(model)}")
        if placed.unread and not array:
            unread = checks.cut(", ".join(placed.unread), 120)
            notes.append(f"{part.source} has columns that are nothing of the model: {unread}")
    if "qpos" not in series or not np.isfinite(series["qpos"].values).any():
        raise ValueError(f"{name}: has no positions: name columns such as joint.position")
    if model.nu and "ctrl" not in series:
        raise ValueError(f"{name}: ctrl is missing of {name_list(model.called('actuator'))}")
    origin = series["qpos"].times[0]
    moved = {key: Series(times - origin, values) for key, (times, values) in series.items()}
    controls = moved.pop("ctrl", Series(np.zeros(1), np.zeros((1, model.nu))))
    without = np.flatnonzero(np.isnan(controls.values).any(axis=0))
    if len(without):
        actuator = model.called("actuator")[without[0]]
        raise ValueError(f"{name}: ctrl is missing of {actuator}: name a column {actuator}.control")
    measured = {key: each for key, each in moved.items() if np.isfinite(each.values).any()}
    return MeasuredLog(
        name, measured, ControlLog(*controls, linear), first_state(model, moved), tuple(notes)
    )


def first_state(model: Model, measured: Mapping[str, Series]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first state: the first measured numbers, else the model's pose.

    Velocities that were not measured are computed from the first two positions.
    """
    times, poses = measured["qpos"]
    first = home(model, None)[0].qpos.copy()
    for k, column in enumerate(poses.T):
        finite = column[np.isfinite(column)]
        first[k] = finite[0] if len(finite) else first[k]
    second = poses[1:2] if len(poses) > 1 else first[None]
    after = np.where(np.isfinite(second[0]), second[0], first)
    rate = Coordinates(model).change(first, after) / (times[1] if len(times) > 1 else 1.0)
    if "qvel" in measured and measured["qvel"].times[0] == 0.0:
        speed = measured["qvel"].values[0]
        rate = np.where(np.isfinite(speed), speed, rate)
    return first, rate


def is_delay(label: str) -> bool:
    """Return whether a parameter is a delay, not a value of the model."""
    return label == DELAY or label.startswith(f"{DELAY}/")


def late_entries(model: Model, label: str) -> tuple[str, Sequence[int]]:
    """Return the array and its entries that a delay such as "delay/qpos" shifts.

    Raises ValueError for a name that is neither an array of a log nor a sensor.
    """
    name = label.partition("/")[2]
    if name not in MEASURED:
        try:
            sensor = model.index("sensor", name)
        except ValueError as error:
            limit = f"{', '.join(MEASURED)} or a sensor: {error}"
            raise ValueError(f"parameters: {label}: must be of {limit}") from None
        owners = np.repeat(np.arange(len(model.sensor_dim)), model.sensor_dim)
        return "sensordata", [int(entry) for entry in np.flatnonzero(owners == sensor)]
    widths = {"qpos": model.nq, "qvel": model.nv, "sensordata": sum(model.sensor_dim)}
    return name, range(widths[name])


def usable(
    model: Model, log: MeasuredLog, bounds: Mapping[str, tuple[float, float]]
) -> MeasuredLog:
    """Return a log without the rows that may be from before its first state or after its end, for
    delays within their bounds.

    Raises ValueError if nothing of an array or a sensor is left.
    """
    measured = dict(log.measured)
    for label, (low, high) in bounds.items():
        for array, entries, first, last in _known(model, log, label, low, high):
            times, values = measured[array]
            outside = (times < first) | (times > last)
            values = np.array(values)
            values[np.ix_(outside, np.array(entries))] = np.nan
            if not np.isfinite(values[:, entries]).any():
                limit = f"a range that {log.name} outlasts, which ends at {log.duration:g} s"
                raise ValueError(f"parameters['{label}'] = ({low:g}, {high:g}): must be {limit}")
            measured[array] = Series(times, values)
    return replace(log, measured=measured)


def _known(
    model: Model, log: MeasuredLog, label: str, low: float, high: float
) -> Iterator[tuple[str, Sequence[int], float, float]]:
    """Yield arrays and entries of a log that a delay shifts, and the times [s] between which they
    remain known over its range.
    """
    if label == DELAY and low < 0:
        # Controls after the end of the log would act on its last rows.
        end = max(log.duration, float(log.controls.times[-1])) + low
        for array, series in log.measured.items():
            yield array, range(series.values.shape[1]), -np.inf, end
    elif label != DELAY and is_delay(label):
        array, entries = late_entries(model, label)
        if array in log.measured:
            yield array, entries, high, log.duration + low
