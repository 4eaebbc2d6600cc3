"""Delays among the parameters of an identification: of the controls, and of what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stepcore.engine.model import Model
from stepcore.measure.identification.log import MEASURED, MeasuredLog, Series

# The time by which controls act later than their rows say [s]. Behind a slash follows what was
# measured so much earlier than its rows say: an array or a sensor.
DELAY = "delay"


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
