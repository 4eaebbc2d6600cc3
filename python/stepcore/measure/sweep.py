"""`sweep`: a measurement at every point of a grid of settings or model values."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from stepcore import checks, files
from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.batch import unwatched as unwatched_batch
from stepcore.engine.follow import of_one_run
from stepcore.engine.model import Model
from stepcore.engine.parameters import Variants
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.arguments import Source, Workers
from stepcore.loading import find_model
from stepcore.report.progress import Choice
from stepcore.report.table import Table, jsonable
from stepcore.scene.scene import Scene
from stepcore.scene.value_paths import WHOLE, find, is_path

Point = dict[str, Any]
Measure = Callable[[Any], Any]

# The largest number of points in one batch on an executor.
MAX_POINTS = 256


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
        and returns the argument of `measure`; a returned Scene or Model is converted to a Sim.
    grid: the values of each key. Every combination is a point; the last key varies fastest.
    measure: a function of the Sim that returns a number (column "value") or a mapping of columns.
    batch: True measures all points with equal settings in one `Batch`, one point per world.
        `measure` is then a function of the Batch, whose `param` has the values of the points. It
        returns an array with one entry per world, or a mapping of such arrays. The numbers are
        bit-identical to those of single Sims, and a world that fails does not stop the others. A
        batch has all points, or up to 256 with an executor. batch=True needs a model, not a
        function that makes one.
    folder: a folder to which each result is written when it is done. A sweep with the same folder,
        model and function measures only the missing points, also of a larger grid. Results must be
        numbers, texts, arrays or lists of these. A function is identified by its name: use another
        folder once you have changed it.
    threads: the number of measurements at the same time (default: one per core). A Sim releases
        Python's global interpreter lock while it steps.
    executor: any `concurrent.futures` executor, used instead of threads. If the executor uses
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
    checks.mapping("grid", grid, "names and their values")
    axes = {str(name): checks.nonempty(f"grid['{name}']", grid[name]) for name in grid}
    checks.function("batch" if batch is True else "sim")("sweep", "measure", measure)
    workers = Workers.checked("sweep", threads, executor, progress)
    source: Any = make_or_model
    if isinstance(source, (Model, Scene, str, os.PathLike)):
        source = find_model(source)
        _check_names(source, axes)
    elif not callable(source):
        limit = "a Model, a Scene, a path or a function"
        raise ValueError(f"make_or_model = {checks.shown(source)}: must be {limit}")
    points = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    if checks.flag("sweep", "batch", batch) and not isinstance(source, Model):
        raise checks.refuse("sweep", "batch", batch, "False with a function that makes the model")
    kept = None if folder is None else _Folder(folder, source, measure)
    results = [None if kept is None else kept.result(point) for point in points]
    shares = [[index] for index, result in enumerate(results) if result is None]
    job: Any = partial(_one_by_one, source, measure)
    if batch:
        here = workers.executor is None
        shares = _alike(points, [index for (index,) in shares], len(points) if here else MAX_POINTS)
        job = partial(_together, source, measure, workers.threads if here else 1)
        # In this process, batches run one after the other, and each uses all threads.
        workers = Workers(1, workers.executor, workers.progress)

    def took(places: range, batches: Sequence[list[Point]]) -> None:
        """Keep the results of some shares of the points."""
        for share, measured in zip(shares[places.start : places.stop], batches, strict=True):
            for index, result in zip(share, measured, strict=True):
                results[index] = result
            if kept is not None:
                kept.store([points[index] for index in share], measured)

    try:
        workers.each(job, [[points[k] for k in share] for share in shares], "sweep", took=took)
    except BaseException as error:
        error.table = _table(axes, points, results)  # type: ignore[attr-defined]
        raise
    return _table(axes, points, results)


def _table(
    axes: Mapping[str, Any], points: Sequence[Point], results: Sequence[Point | None]
) -> Table:
    done = [(p, r) for p, r in zip(points, results, strict=True) if r is not None]
    names = [name for _, result in done for name in result if name != "failure"]
    columns = list(dict.fromkeys([*axes, *names]))
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
            reason = f"settings have no {checks.quoted(name)}{checks.nearest(name, fields)}"
            raise ValueError(f"grid[{checks.shown(name)}]: {reason}")


def _settings_and_values(point: Point) -> tuple[Point, Point]:
    values = {name: value for name, value in point.items() if is_path(name)}
    return {name: value for name, value in point.items() if name not in values}, values


def _record(measured: Any) -> Point:
    return dict(measured) if isinstance(measured, Mapping) else {"value": measured}


def _failure(error: Exception) -> Point:
    return {"failure": checks.one_line(error)}


def at_point(source: Any, measure: Measure, point: Point) -> Point:
    """Measure at one point; return the columns, or the reason of a failure."""
    try:
        if isinstance(source, Model):
            settings, values = _settings_and_values(point)
            world = unwatched(Sim(source.with_values(values) if values else source, **settings))
        else:
            world = source(**point)
            world = unwatched(Sim(world)) if isinstance(world, (Model, Scene)) else world
        return _record(measure(world))
    except (ValueError, SimulationError) as error:
        return _failure(error)


def _one_by_one(source: Any, measure: Measure, points: Sequence[Point]) -> list[Point]:
    return [at_point(source, measure, point) for point in points]


# --- in batches -----------------------------------------------------------------------------------


def _alike(points: Sequence[Point], indices: Sequence[int], most: int) -> list[list[int]]:
    """Return groups of points with equal settings, by index. most: the largest size of a group."""
    alike: dict[str, list[int]] = {}
    for index in indices:
        alike.setdefault(repr(_settings_and_values(points[index])[0]), []).append(index)
    groups = alike.values()
    return [group[at : at + most] for group in groups for at in range(0, len(group), most)]


def _together(model: Model, measure: Measure, threads: int, points: Sequence[Point]) -> list[Point]:
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
            limit = f"an array with one entry for each of the batch's {n} worlds"
            raise TypeError(f'measure: "{name}" has shape {np.shape(values)}: must be {limit}')
    failures = batch.failures
    return [
        _failure(of_one_run(failures[world]))
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


# --- in a folder ----------------------------------------------------------------------------------


class _Folder:
    """Results that are written to a folder when they are done.

    ``sweep.json`` identifies the measurement, and ``points.jsonl`` has a line for each measured
    point. Numbers are read back with the same bits.

    Raises ValueError for a folder of another sweep (another model, measurement or version).
    """

    def __init__(self, path: Any, source: Model | Callable[..., Any], measure: Any) -> None:
        folder = Path(files.as_path("folder", path))
        folder.mkdir(parents=True, exist_ok=True)
        identity = {"stepcore": version("stepcore"), "model": _named(source)}
        identity["measure"] = _named(measure)
        kept, self.points = folder / "sweep.json", folder / "points.jsonl"
        if not kept.exists():
            kept.write_text(json.dumps(identity, indent=1) + "\n", encoding="utf-8")
        data = files.contents(kept, "a sweep")
        try:
            stored = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{kept}: is damaged: {checks.one_line(error)}") from None
        for name, value in identity.items():
            theirs = stored.get(name) if isinstance(stored, dict) else None
            if theirs != value:
                text = f"folder = {checks.shown(str(folder))}: holds a sweep of another {name}"
                raise ValueError(f"{text} ({theirs}, not {value}): choose another folder")
        self.done: dict[str, Point] = {}
        data = files.contents(self.points, "a sweep") if self.points.exists() else b""
        lines = data.split(b"\n")
        for line in lines[:-1]:
            try:
                point, result = json.loads(line)
                self.done[point] = {name: _read(value) for name, value in result.items()}
            except (ValueError, TypeError, AttributeError, KeyError, RecursionError):
                shown = checks.shown(line[:80])
                raise ValueError(f"{self.points}: is damaged: {shown}") from None
        if lines[-1]:
            # The last line is incomplete: remove it.
            with self.points.open("rb+") as cut:
                cut.truncate(sum(len(line) + 1 for line in lines[:-1]))

    def result(self, point: Point) -> Point | None:
        """Return the kept result of a point; None for a point that is not done."""
        kept = self.done.get(_key(point))
        return None if kept is None else dict(kept)

    def store(self, points: Sequence[Point], results: Sequence[Point]) -> None:
        """Write results to the folder; see `_written` for those that it cannot keep."""
        lines = list[str]()
        for point, result in zip(points, results, strict=True):
            row = {name: _written(name, value) for name, value in result.items()}
            lines.append(json.dumps([_key(point), row]) + "\n")
        with self.points.open("ab") as file:
            file.write("".join(lines).encode())


def _key(point: Point) -> str:
    return json.dumps({name: _written(name, value) for name, value in sorted(point.items())})


def _written(name: str, value: Any) -> Any:
    """Return a value as JSON data; numpy's types are marked."""
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "fiub":
        array = np.asarray(value)
        return {"dtype": array.dtype.name, "shape": array.shape, "values": array.ravel().tolist()}
    if isinstance(value, list | tuple):
        return [_written(name, entry) for entry in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    limit = "numbers, texts, arrays or lists of these, to be kept in a folder"
    raise ValueError(f"{checks.quoted(name)} = {checks.shown(value)}: must be {limit}")


def _read(value: Any) -> Any:
    if isinstance(value, dict):
        array = np.array(value["values"], dtype=value["dtype"]).reshape(value["shape"])
        return array[()] if not array.shape else array
    return [_read(entry) for entry in value] if isinstance(value, list) else value


def _named(thing: Any) -> str:
    """Return a text that identifies a model or a function."""
    if isinstance(thing, Model):
        data = [thing.scene.to_dict(), thing.settings.as_dict()]
        return hashlib.sha256(json.dumps(jsonable(data), sort_keys=True).encode()).hexdigest()[:16]
    if isinstance(thing, partial):
        arguments = [*thing.args, *sorted(thing.keywords.items())]
        return f"{_named(thing.func)}({', '.join(map(repr, arguments))})"
    name = getattr(thing, "__qualname__", type(thing).__qualname__)
    return f"{getattr(thing, '__module__', None)}.{name}"
