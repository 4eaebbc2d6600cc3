"""`MeasuredLog`: what was measured of a robot, with the controls that moved it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from stepcore import checks
from stepcore.engine.axes import axes_of
from stepcore.engine.element import listed
from stepcore.engine.model import Model
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.control_table import ControlLog, control_table
from stepcore.experiment.user_table import LATE, MCAP, OWN, TIME, mcap_rows, read_table
from stepcore.experiment.user_table import numbers as numbers_of
from stepcore.report.units import counted, seconds

# What a log can tell of a state and of the sensors, and its controls.
MEASURED = ("qpos", "qvel", "sensordata")
ARRAYS = (*MEASURED, "ctrl")
# Other words for an array in the name of a column: "knee.position", "position[knee]".
WORDS = {"position": "qpos", "velocity": "qvel", "sensor": "sensordata", "control": "ctrl"}
COLUMN = re.compile(r"(?P<array>\w+)\[(?P<entry>.+)\]|(?P<name>.+)[./](?P<word>\w+)")
# Times are in milliseconds if rows are so far apart [s], and last so many steps in all.
SLOW, LONG = 0.5, 20_000
# The time by which controls act later than their rows say [s]. Behind a slash follows what was
# measured so much earlier than its rows say: an array or a sensor.
DELAY = "delay"
KINDS = 'a Trajectory, a DataFrame, a file or a dict with "time"'

Log = Trajectory | Mapping[str, Any] | str | os.PathLike[str] | Any


class Series(NamedTuple):
    """Numbers over time: times [s], shape (T,); values, shape (T, n), NaN where there are none."""

    times: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class MeasuredLog:
    """A log of a model's motion, in time from its first position on.

    name: such as "logs[0]". measured: series by array of `MEASURED`. controls: of all actuators.
    start: the first qpos, and the qvel there. unread: columns that are nothing of the model.
    """

    name: str
    measured: Mapping[str, Series]
    controls: ControlLog
    start: tuple[np.ndarray, np.ndarray]
    unread: tuple[str, ...] = ()

    @cached_property
    def duration(self) -> float:
        """The time of the last measured number [s]."""
        known = (
            series.times[np.isfinite(series.values).any(axis=1)]
            for series in self.measured.values()
        )
        return float(max(times[-1] for times in known if len(times)))

    def steps(self, dt: float) -> int:
        """Return how many steps of dt [s] the log lasts."""
        return int(np.ceil(self.duration / dt - 1e-9))

    def until(self, end: float) -> MeasuredLog:
        """Return the beginning of this log, to a time [s]."""
        cut = {}
        for name, series in self.measured.items():
            early = series.times <= end
            if np.isfinite(series.values[early]).any():
                cut[name] = Series(series.times[early], series.values[early])
        return MeasuredLog(self.name, cut, self.controls, self.start)


def read_log(model: Model, log: Log, name: str) -> MeasuredLog:
    """Return a log of a user as numbers of a model; see `identify`.

    Raises ValueError for what is no log of this model, and OSError for a file.
    """
    tables, unread = _tables(model, log, name)
    for key, (times, _) in tables.items():
        if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0).all():
            raise ValueError(f"{name}: time of {key} must be two or more increasing numbers")
    if "ctrl" not in tables and model.nu:
        limit = f"{counted(model.nu, 'control')}, {listed(model.called('actuator'))}"
        other = f"; columns that were not read: {listed(unread)}" if unread else ""
        raise ValueError(f"{name}: ctrl is missing, and the model has {limit}{other}")
    first = tables["qpos"].values[0] if "qpos" in tables else np.full(max(1, model.nq), np.nan)
    if not np.isfinite(first).all():
        raise ValueError(f"{name}: the first row of qpos must be whole: the run begins there")
    origin = tables["qpos"].times[0]
    moved = {key: Series(times - origin, values) for key, (times, values) in tables.items()}
    controls = moved.pop("ctrl", Series(np.zeros(1), np.zeros((1, model.nu))))
    measured = {key: series for key, series in moved.items() if np.isfinite(series.values).any()}
    _check_times(name, model, measured)
    return MeasuredLog(
        name,
        measured,
        ControlLog(*_complete(model, name, controls)),
        (first, _velocity(model, name, moved)),
        tuple(unread),
    )


def _check_times(name: str, model: Model, measured: Mapping[str, Series]) -> None:
    """Refuse times that look like milliseconds, a thousand times as long as they are."""
    times, dt = measured["qpos"].times, model.settings.dt
    apart = float(np.median(np.diff(times)))
    if apart >= SLOW and times[-1] >= LONG * dt:
        raise ValueError(
            f"{name}: time: rows are {apart:g} s apart, {apart / dt:g} steps of {seconds(dt)}: "
            "must be in seconds; these look like milliseconds"
        )


def _complete(model: Model, name: str, controls: Series) -> Series:
    """Return the controls, of which every actuator must have all."""
    bad = np.argwhere(~np.isfinite(controls.values))
    if len(bad):
        row, actuator = bad[0]
        where = f"of {model.called('actuator')[actuator]} at {seconds(controls.times[row])}"
        limit = "a control that is not known cannot be played"
        raise ValueError(f"{name}: ctrl has gaps, {where}: {limit}")
    return controls


def _velocity(model: Model, name: str, measured: Mapping[str, Series]) -> np.ndarray:
    """Return the first velocity: as measured, or from the first two positions."""
    first = np.full(model.nv, np.nan)
    if "qvel" in measured and measured["qvel"].times[0] == 0.0:
        first = measured["qvel"].values[0]
    if np.isfinite(first).all():
        return first
    (times, qpos), rate = measured["qpos"], np.zeros(model.nv)
    for joint, kind in enumerate(model.jnt_type):
        q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        if kind not in ("slide", "hinge"):
            raise ValueError(
                f"{name}: the first row of qvel must be whole: of "
                f"{model.element_name('joint', joint)} it does not follow from qpos"
            )
        rate[v] = np.nan_to_num((qpos[1, q] - qpos[0, q]) / times[1])
    return np.where(np.isfinite(first), first, rate)


def _tables(model: Model, log: Log, name: str) -> tuple[dict[str, Series], list[str]]:
    """Return the series of a log by array, and its columns that are nothing of the model."""
    if not (isinstance(log, Mapping) and log and set(map(str, log)) <= set(ARRAYS)):
        return _source(model, log, name, ARRAYS)
    # Each from a source of its own, with times of its own.
    tables: dict[str, Series] = {}
    for key, source in log.items():
        if key == "ctrl":
            # Columns by joint drive its actuator.
            table = control_table(source)
            if table.times is None:
                raise ValueError(f"{name}: ctrl: {table.source} has no times")
            rows = table.log(model, np.full(model.nu, np.nan), 1.0).rows
            found = {key: Series(table.times, rows)}
        else:
            found, _ = _source(model, source, name, (key,))
        if key not in found:
            raise ValueError(f"{name}: {key}: {checks.shown(source)} has no {key}")
        tables[key] = found[key]
    return tables, []


def _source(
    model: Model, log: Log, name: str, arrays: Sequence[str]
) -> tuple[dict[str, Series], list[str]]:
    """Return some arrays of a log of one source, and its columns that are none of these."""
    if isinstance(log, (str, os.PathLike)) and MCAP.fullmatch(os.fsdecode(log)):
        return dict(_messages(model, os.fsdecode(log), arrays, name)), []
    source, content = read_table(log, name)
    if isinstance(content, Trajectory):
        content = {"time": content.time, **content.data}
        late = tuple(key for key in LATE if key in content)
    elif isinstance(content, dict):
        # A recorded run as a table has at each instant the controls of the last step.
        late = () if isinstance(log, Mapping) else LATE
        late = tuple(key for key in late if any(str(c).startswith(f"{key}[") for c in content))
    clocks = [key for key in content if TIME.fullmatch(str(key))] if content is not None else []
    if not isinstance(content, dict) or not clocks:
        raise ValueError(f"{name}: must be {KINDS}")
    times = np.ravel(numbers_of(f"{source}, time", content.pop(clocks[0])))
    tables, unread = _arranged(model, name, content, len(times), arrays)
    found = {}
    for key, values in tables.items():
        if key in late:
            last = values[-1:] if key == "ctrl" else np.full_like(values[-1:], np.nan)
            values = np.concatenate([values[1:], last])
        found[key] = Series(times, values)
    return found, unread


def _arranged(
    model: Model, name: str, content: Mapping[str, Any], rows: int, arrays: Sequence[str]
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the arrays, whole or put together from columns, and the columns that are none."""
    entries, tables, unread = _entries(model, arrays), dict[str, np.ndarray](), []
    for column, given in content.items():
        whole = column in arrays
        array, entry = (column, -1) if whole else _place(entries, name, str(column))
        if not array or (not whole and array in content):
            unread.append(str(column))
            continue
        values, width = numbers_of(f"{name}: {column}", given), len(entries[array])
        if whole and width == 1 and values.ndim == 1:
            values = values[:, None]
        shape = (rows, width) if whole else (rows,)
        if values.shape != shape:
            raise ValueError(f"{name}: {column} has shape {values.shape}: must be {shape}")
        if whole:
            tables[array] = np.array(values)
        else:
            tables.setdefault(array, np.full((rows, width), np.nan))[:, entry] = values
    return tables, unread


def _entries(model: Model, arrays: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the names of the entries of arrays."""
    sizes = {"qpos": model.nq, "qvel": model.nv, "ctrl": model.nu}
    sizes["sensordata"] = int(np.sum(model.sensor_dim))
    return {key: entries_of(model, key, sizes[key]) for key in arrays}


def _place(entries: Mapping[str, Sequence[str]], log: str, column: str) -> tuple[str, int]:
    """Return the array and the entry of a column; "" if it is none of these arrays.

    A name alone is an actuator's, a sensor's, or a joint's, whose position it is.
    """
    match = COLUMN.fullmatch(column)
    if match is not None:
        word, entry = match["array"] or match["word"], match["entry"] or match["name"]
        array = WORDS.get(word, word)
        if entry in entries.get(array, ()):
            return array, entries[array].index(entry)
    found = [key for key in ("qpos", "sensordata", "ctrl") if column in entries.get(key, ())]
    if len(found) > 1:
        words = " or ".join(f"{column}.{word}" for word, key in WORDS.items() if key in found)
        raise ValueError(f"{log}: column {checks.quoted(column)}: must be {words}")
    return (found[0], entries[found[0]].index(column)) if found else ("", -1)


def entries_of(model: Model, array: str, size: int) -> tuple[str, ...]:
    """Return the names of an array's entries, such as "knee" or "root.x"."""
    return axes_of(model, array, (size,))[0].entries if size else ()


def _messages(
    model: Model, path: str, arrays: Sequence[str], name: str
) -> Iterator[tuple[str, Series]]:
    """Yield the arrays of a log of messages: of a recorded run all, else of joints their states."""
    if len(arrays) > 1:
        try:
            mcap_rows(f"{path}:{OWN}", arrays[0])
            path = f"{path}:{OWN}"
        except ValueError:
            arrays = [key for key in arrays if key in ("qpos", "qvel")]
    for array in arrays:
        try:
            times, rows, columns = mcap_rows(path, array)
        except ValueError:
            if array == arrays[0]:
                raise
            continue
        content: dict[str, Any] = {array: rows}
        if columns is not None:
            names = [f"{array}[{column}]" for column in columns]
            content = dict(zip(names, rows.T, strict=True))
        tables, _ = _arranged(model, name, content, len(times), (array,))
        if array in tables:
            yield array, Series(times, tables[array])


def is_delay(label: str) -> bool:
    """Whether a parameter is a time, and no value of the model."""
    return label == DELAY or label.startswith(f"{DELAY}/")


def late_entries(model: Model, label: str) -> tuple[str, Sequence[int]]:
    """Return the array that is late by a delay such as "delay/qpos", and which of its entries.

    Raises ValueError for what is neither an array of a log nor a sensor.
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


def within(
    model: Model, log: MeasuredLog, bounds: Mapping[str, tuple[float, float]]
) -> MeasuredLog:
    """Return a log without the rows that, within these bounds of delays, may be from before its
    first state or from after its end.

    Raises ValueError if of an array or a sensor nothing is left.
    """
    measured = dict(log.measured)
    for label, (low, high) in bounds.items():
        if not is_delay(label) or label == DELAY:
            continue
        array, entries = late_entries(model, label)
        if array not in measured:
            continue
        times, values = measured[array]
        outside = (times < high) | (times > log.duration + low)
        values = np.array(values)
        values[np.ix_(outside, np.array(entries))] = np.nan
        if not np.isfinite(values[:, entries]).any():
            limit = f"a range that {log.name} outlasts, which ends at {log.duration:g} s"
            raise ValueError(f"parameters['{label}'] = ({low:g}, {high:g}): must be {limit}")
        measured[array] = Series(times, values)
    return replace(log, measured=measured)
