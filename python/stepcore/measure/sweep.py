"""`sweep`: a measurement at every point of a grid of settings or model values."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.batch import unwatched as unwatched_batch
from stepcore.engine.model import Model
from stepcore.engine.parameters import Variants
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.arguments import Source, Workers
from stepcore.loading import find_model
from stepcore.measure.sweep_folder import SweepFolder
from stepcore.report.progress import Choice
from stepcore.report.table import Table
from stepcore.scene.scene import Scene
from stepcore.scene.value_paths import WHOLE, find, is_path

Point = dict[str, Any]
Measure = Callable[[Any], Any]

# The largest number of points in one batch on an executor.
SHARE = 256


def sweep(
    make_or_model: Source | Callable[..., Any],
    grid: Mapping[str, Sequence[Any]],
    measure: Callable[[Any], Any],
    *,
    batch: bool = False,
    folder: str | os.PathLike[str] | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> Table:
    """Measure at every point of a grid; return a table with one row for each point.

    make_or_model: a Model, a Scene, or the path of an MJCF file (or "package:name"). The keys of
        the grid are then `Settings` fields or, if they contain a "/", paths as in
        `Model.with_values`. Or a function that takes the values of a point as keyword arguments
        and returns the argument of `measure`; a returned Scene or Model is made into a Sim.
    grid: the values of each key. Every combination is a point; the last key varies fastest.
    measure: a function of the Sim that returns a number (column "value") or a mapping of columns.
    batch: True measures all points with equal settings in one `Batch`, one point in each world.
        `measure` is then a function of the Batch, whose `param` has the values of the points. It
        returns an array with an entry for each world, or a mapping of such arrays. The numbers are
        bit-identical to those of single Sims, and a world that fails does not stop the others. A
        batch has all points, or up to 256 with an executor. batch=True needs a model, not a
        function that makes one.
    folder: a folder that keeps each result as it comes. A sweep with the same folder, model and
        function measures only the points that are missing, also of a larger grid. Results must be
        numbers, texts, arrays or lists of these. A function is known by its name: take another
        folder once you have changed it.
    threads: the number of measurements at the same time (default: one per core). A Sim releases
        Python's global interpreter lock while it steps.
    executor: any `concurrent.futures` executor, used in place of threads. If the executor uses
        processes, all arguments and results must be picklable.
    progress: False for no progress bar, or a function of (label, done, total).

    A measurement that fails (SimulationError, or ValueError for a setting) keeps its row, and the
    column "failure" gives the reason. Any other exception is raised, as is KeyboardInterrupt and
    the RuntimeError of an executor whose processes died; its attribute `table` has the rows that
    were done.

    Raises ValueError for an unknown setting in the grid, an axis that is not a list of at least
    one value, a folder of another sweep, and threads < 1. Raises TypeError if `measure` returns
    arrays of a wrong shape for a batch.

    >>> from stepcore import lesson
    >>> def height(sim):
    ...     sim.reset(key="start")
    ...     sim.step(5)
    ...     return {"height": sim.qpos[0]}
    >>> print(sweep(lesson.drop(), {"dt": [0.01, 0.02], "sweeps": [1, 2]}, height))
      dt  sweeps  height
    0.01       1  0.2853
    0.01       2  0.2853
    0.02       1  0.2411
    0.02       2  0.2411
    >>> import numpy as np
    >>> def pull(batch):
    ...     batch.qpos[:] = 0.1
    ...     batch.step(10)
    ...     return np.abs(batch.qvel[:, 0])
    >>> print(sweep(lesson.spring(), {"joint/spring/stiffness": [1.0, 4.0]}, pull, batch=True))
    joint/spring/stiffness     value
                         1  0.009984
                         4   0.03974
    """
    if not isinstance(grid, Mapping):
        raise ValueError(f"grid = {checks.shown(grid)}: must be a dict of names and their values")
    axes = {str(name): checks.several(f"grid['{name}']", grid[name]) for name in grid}
    checks.function("batch" if batch is True else "sim")("sweep", "measure", measure)
    workers = Workers.checked("sweep", threads, executor, progress)
    if isinstance(make_or_model, (Model, Scene, str, os.PathLike)):
        make_or_model = find_model(make_or_model)
        _check_names(make_or_model, axes)
    elif not callable(make_or_model):
        limit = "a Model, a Scene, a path or a function"
        raise ValueError(f"make_or_model = {checks.shown(make_or_model)}: must be {limit}")
    points = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    if checks.flag("sweep", "batch", batch) and not isinstance(make_or_model, Model):
        raise checks.refuse("sweep", "batch", batch, "False with a function that makes the model")
    kept = None if folder is None else SweepFolder(folder, make_or_model, measure)
    results = [None if kept is None else kept.result(point) for point in points]
    missing = [index for index, result in enumerate(results) if result is None]

    def took(indices: Sequence[int], found: list[Point]) -> None:
        """Keep the results of some of the missing points."""
        own = [missing[index] for index in indices]
        for index, result in zip(own, found, strict=True):
            results[index] = result
        if kept is not None:
            kept.keep([points[index] for index in own], found)

    left = [points[index] for index in missing]
    try:
        if batch and isinstance(make_or_model, Model):
            _in_batches(make_or_model, measure, left, workers, took)
        else:
            job = partial(at_point, make_or_model, measure)
            workers.each(job, left, "sweep", took=took)
    except BaseException as error:
        error.table = _table(axes, points, results)  # type: ignore[attr-defined]
        raise
    return _table(axes, points, results)


def _table(
    axes: Mapping[str, Any], points: Sequence[Point], results: Sequence[Point | None]
) -> Table:
    """Return the table of the points that have a result."""
    done = [(p, r) for p, r in zip(points, results, strict=True) if r is not None]
    own = [name for _, result in done for name in result if name != "failure"]
    columns = list(dict.fromkeys([*axes, *own]))
    if any("failure" in result for _, result in done):
        columns.append("failure")
    return Table((point | result for point, result in done), columns)


def _check_names(model: Model, axes: Mapping[str, Any]) -> None:
    """Raise ValueError for an unknown name in the grid, before any point is measured."""
    fields = model.settings.as_dict()
    for name in axes:
        if is_path(name):
            if name not in WHOLE:
                find(model.scene, name)
        elif name not in fields:
            raise ValueError(
                f"grid[{checks.shown(name)}]: settings have no {checks.quoted(name)}"
                f"{checks.nearest(name, fields)}"
            )


def _settings_and_values(point: Point) -> tuple[Point, Point]:
    """Return the settings of a point, and its model values by path."""
    values = {name: value for name, value in point.items() if is_path(name)}
    return {name: value for name, value in point.items() if name not in values}, values


def _record(measured: Any) -> Point:
    """Return the result of a measurement as a dict of columns."""
    return dict(measured) if isinstance(measured, Mapping) else {"value": measured}


def _failure(error: Exception) -> Point:
    return {"failure": checks.one_line(error)}


def at_point(source: Any, measure: Measure, point: Point) -> Point:
    """Measure at one point; return the columns, or the reason of a failure."""
    try:
        if isinstance(source, Model):
            settings, values = _settings_and_values(point)
            made = unwatched(Sim(source.with_values(values) if values else source, **settings))
        else:
            made = source(**point)
            made = unwatched(Sim(made)) if isinstance(made, (Model, Scene)) else made
        return _record(measure(made))
    except (ValueError, SimulationError) as error:
        return _failure(error)


def _in_batches(
    model: Model,
    measure: Measure,
    points: Sequence[Point],
    workers: Workers,
    took: Callable[[Sequence[int], list[Point]], object],
) -> None:
    """Measure points with equal settings as worlds of one batch.

    took: called with the indices of points and their columns, as these come.
    """
    alike: dict[str, list[int]] = {}
    for index, point in enumerate(points):
        alike.setdefault(repr(_settings_and_values(point)[0]), []).append(index)
    here = workers.executor is None
    size = len(points) if here else SHARE
    shares = [
        group[at : at + size] for group in alike.values() for at in range(0, len(group), size)
    ]
    job = partial(_batch_of, model, measure, workers.threads if here else 1)
    # In this process, batches run one after the other, and each uses all threads.
    crew = Workers(1, workers.executor, workers.progress)

    def took_shares(those: range, results: list[list[Point]]) -> None:
        for own, columns in zip(shares[those.start : those.stop], results, strict=True):
            took(own, columns)

    jobs = [[points[index] for index in share] for share in shares]
    crew.each(job, jobs, "sweep", took=took_shares)


def _batch_of(model: Model, measure: Measure, threads: int, points: Sequence[Point]) -> list[Point]:
    """Measure points with equal settings as one batch; return the columns of each."""
    settings, values = _settings_and_values(points[0])
    try:
        base = model.with_settings(**settings)
        columns = {path: _column(path, [point[path] for point in points]) for path in values}
        refused = Variants(base, columns, len(points)).errors() if columns else {}
        worlds = [world for world in range(len(points)) if world not in refused]
        measured = _worlds(base, columns, worlds, measure, threads) if worlds else []
    except (ValueError, SimulationError) as error:
        return [_failure(error)] * len(points)
    records = {world: _failure(error) for world, error in refused.items()}
    records |= zip(worlds, measured, strict=True)
    return [records[world] for world in range(len(points))]


def _worlds(
    model: Model, columns: Mapping[str, Floats], worlds: list[int], measure: Measure, threads: int
) -> list[Point]:
    """Measure the points whose values the model accepts; return the columns of each."""
    n = len(worlds)
    batch = unwatched_batch(Batch(model, n, threads=min(threads, n), on_failure="go on"))
    if columns:
        batch.param.update({path: column[worlds] for path, column in columns.items()})
    table = _record(measure(batch))
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
    """Return the values of a path as an array over the points."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        text = "with batch=True values must be numbers, or vectors of one length"
        raise ValueError(f"grid[{checks.shown(path)}]: {text}") from None
