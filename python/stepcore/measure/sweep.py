"""`sweep`: one measurement at every point of a grid of settings or values."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.executors import check_executor, each
from stepcore.report.progress import Choice, Progress
from stepcore.report.table import Table
from stepcore.scene.scene import Scene
from stepcore.scene.value_paths import find

if TYPE_CHECKING:
    from concurrent.futures import Executor


def sweep(
    make_or_model: Model | Scene | Callable[..., Any],
    grid: Mapping[str, Sequence[Any]],
    measure: Callable[[Any], Any],
    *,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> Table:
    """Measures at every point of the cartesian product of `grid`, in the order of the grid.

    make_or_model: a Model (or Scene), whose grid keys are `Settings` fields or, with a "/" in
        them, paths as in `Model.with_values`; or a function that is called with the point's
        values by keyword. What it returns is measured; a Scene or Model is made a Sim first.
    measure: called with the Sim; returns a number (column "value") or a mapping of columns.
    threads: how many measurements run at once (default: one a core). The lock of the
        interpreter is released while a Sim steps.
    executor: any `concurrent.futures` executor in place of threads; with one that uses
        processes, everything must pickle.
    progress: False for no bar, or a function of (label, done, total).

    A measurement that fails (SimulationError, or a ValueError of a setting) keeps its row: its
    column "failure" says why. Any other exception is raised. The last key varies fastest.

    Raises ValueError for an unknown setting in the grid, an axis that is not a list of at least
    one value, and threads < 1.

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
    """
    if not isinstance(grid, Mapping):
        raise ValueError(f"grid = {checks.shown(grid)}: must be a dict of names and their values")
    axes = {str(name): checks.several(f"grid['{name}']", grid[name]) for name in grid}
    workers = checks.threads(threads)
    checks.function("sim")("sweep", "measure", measure)
    check_executor("sweep", executor)
    checks.told("sweep", progress)
    if isinstance(make_or_model, Scene):
        make_or_model = make_or_model.compile()
    if isinstance(make_or_model, Model):
        _check_names(make_or_model, axes)
    elif not callable(make_or_model):
        limit = "a Model, a Scene or a function"
        raise ValueError(f"make_or_model = {checks.shown(make_or_model)}: must be {limit}")
    points = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    with Progress("sweep", len(points), progress) as bar:
        job = partial(at_point, make_or_model, measure)
        results = each(job, points, bar=bar, threads=workers, executor=executor)
    own = [name for result in results for name in result if name != "failure"]
    columns = list(dict.fromkeys([*axes, *own]))
    if any("failure" in result for result in results):
        columns.append("failure")
    return Table((p | r for p, r in zip(points, results, strict=True)), columns)


def _is_value(name: str) -> bool:
    """Whether a grid key is a path into the scene and not a setting."""
    return "/" in name or name == "gravity"


def _check_names(model: Model, axes: Mapping[str, Any]) -> None:
    """A misspelt name is an error of the whole sweep, not a failure of every point."""
    fields = model.settings.as_dict()
    for name in axes:
        if _is_value(name):
            if name != "gravity":
                find(model.scene, name)
        elif name not in fields:
            raise ValueError(
                f"grid['{name}']: settings have no '{name}'{checks.nearest(name, fields)}"
            )


def at_point(source: Any, measure: Callable[[Any], Any], point: dict[str, Any]) -> dict[str, Any]:
    """One measurement as a record, or the reason why there is none."""
    try:
        got = measure(_made(source, point))
    except (ValueError, SimulationError) as error:
        return {"failure": checks.one_line(error)}
    return dict(got) if isinstance(got, Mapping) else {"value": got}


def _made(source: Any, point: dict[str, Any]) -> Any:
    """What is measured at a point."""
    if isinstance(source, Model):
        values = {name: value for name, value in point.items() if _is_value(name)}
        settings = {name: value for name, value in point.items() if not _is_value(name)}
        return Sim(source.with_values(values) if values else source, **settings)
    made = source(**point)
    return Sim(made) if isinstance(made, (Model, Scene)) else made
