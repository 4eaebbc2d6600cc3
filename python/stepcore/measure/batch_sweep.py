"""The points of a sweep as the worlds of batches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch, unwatched
from stepcore.engine.model import Model
from stepcore.engine.parameters import Variants
from stepcore.experiment.arguments import Workers
from stepcore.scene.value_paths import is_path

Point = dict[str, Any]

# As many points a process of an executor measures at a time.
SHARE = 256


def measured_in_batches(
    model: Model, measure: Callable[[Any], Any], points: Sequence[Point], workers: Workers
) -> list[Point]:
    """The record of each point; see `sweep`."""
    alike: dict[str, list[int]] = {}
    for index, point in enumerate(points):
        key = repr({name: value for name, value in point.items() if not is_path(name)})
        alike.setdefault(key, []).append(index)
    here = workers.executor is None
    size = len(points) if here else SHARE
    shares = [own[at : at + size] for own in alike.values() for at in range(0, len(own), size)]
    job = partial(_measured, model, measure, workers.threads if here else 1)
    # In this process one batch after the other has all threads.
    crew = Workers(1, workers.executor, workers.progress)
    results = crew.each(job, [[points[index] for index in share] for share in shares], "sweep")
    records: dict[int, Point] = {}
    for share, found in zip(shares, results, strict=True):
        records |= zip(share, found, strict=True)
    return [records[index] for index in range(len(points))]


def _measured(
    model: Model, measure: Callable[[Any], Any], threads: int, points: Sequence[Point]
) -> list[Point]:
    """Records of points with the same settings, in one batch."""
    settings = {name: value for name, value in points[0].items() if not is_path(name)}
    paths = [name for name in points[0] if is_path(name)]
    try:
        base = model.with_settings(**settings)
        columns = {path: _column(path, [point[path] for point in points]) for path in paths}
        refused = Variants(base, columns, len(points)).errors() if paths else {}
        worlds = [world for world in range(len(points)) if world not in refused]
        found = _worlds(base, columns, worlds, measure, threads) if worlds else []
    except (ValueError, SimulationError) as error:
        return [_failure(error)] * len(points)
    records = {world: _failure(error) for world, error in refused.items()}
    records |= zip(worlds, found, strict=True)
    return [records[world] for world in range(len(points))]


def _worlds(
    model: Model,
    columns: Mapping[str, Floats],
    worlds: list[int],
    measure: Callable[[Any], Any],
    threads: int,
) -> list[Point]:
    """Records of those points whose values can be."""
    n = len(worlds)
    batch = unwatched(Batch(model, n, threads=min(threads, n), on_failure="go on"))
    if columns:
        batch.param.update({path: column[worlds] for path, column in columns.items()})
    got = measure(batch)
    table = dict(got) if isinstance(got, Mapping) else {"value": got}
    for name, values in table.items():
        if np.shape(values)[:1] != (n,):
            limit = f"with one entry for each of the batch's {n} worlds"
            raise TypeError(
                f'measure: "{name}" has shape {np.shape(values)}: must be an array {limit}'
            )
    failures = batch.failures
    return [
        _failure(failures[world])
        if world in failures
        else {name: values[world] for name, values in table.items()}
        for world in range(n)
    ]


def _column(path: str, values: list[Any]) -> Floats:
    """The values of a path as an array over the points."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        text = "with batch=True values must be numbers, or vectors of one length"
        raise ValueError(f"grid[{checks.shown(path)}]: {text}") from None


def _failure(error: Exception) -> Point:
    return {"failure": checks.one_line(error)}
