"""`stability_map`: where in the plane of dt and a value of the scene runs are of use."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.executors import check_executor
from stepcore.loading import find_model
from stepcore.measure.stability import defaults, theory, truth
from stepcore.measure.stability.course import Bodies, Course, run
from stepcore.measure.stability.defaults import STABLE, Case, Setting
from stepcore.measure.stability.result import (
    EXPLODED,
    FINITE,
    INACCURATE,
    Cell,
    Panel,
    StabilityMap,
)
from stepcore.measure.stability.truth import FINER, Truth
from stepcore.measure.sweep import sweep
from stepcore.report.progress import Choice
from stepcore.scene.scene import Scene
from stepcore.scene.value_paths import find

__all__ = ["StabilityMap", "stability_map"]

# A run that is further off than so many sizes of the true motion has exploded.
FAR = 10.0
# The horizon is at least so many of the largest steps, so that growth has time to show.
STEPS = 25
# All cells together: above half an hour of the smallest scene.
MOST_STEPS = 1e10
LESSON = {"lesson:spring": "spring", "lesson:stack": "stack"}


def stability_map(
    model: Model | Scene | str | os.PathLike[str] | None = None,
    path: str | None = None,
    values: Sequence[float] | None = None,
    dts: Sequence[float] | None = None,
    *,
    integrator: str | Sequence[str] | None = None,
    horizon: float | None = None,
    error: float = 0.1,
    size: float | None = None,
    key: str | int | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> StabilityMap:
    """Runs a scene at every pair of a value and a dt, and says which runs are of use.

    model: a Model, a Scene, or what `stepcore.load` takes. None or "lesson:spring": the lesson's
        spring, stiffness against dt, by integrator; "lesson:stack": a heavy ball on a light one,
        mass ratio against dt, by how contacts are held. With a path these two are scenes like
        others.
    path: the value that is varied, as in `Model.with_values`: "joint/knee/stiffness",
        "body/arm/mass", "actuator/grip/kp". values: its values, ascending in the map; by default
        13 from a hundredth to a hundred times what it is.
    dts: [s]; by default 13 from a tenth to ten times the scene's.
    integrator: one or several, a panel each; by default the scene's own.
    horizon: simulated time [s]; by default 1 s, or 25 of the largest dt if that is more.
    error: a run that is further than this from the truth, as a share of `size`, is inaccurate.
    size: [m]; by default how far the bodies go in the true motion.
    key: keyframe to start from (default: the first), whose controls are held.
    threads, executor, progress: as in `stepcore.sweep`.

    Truth is a closed form for the two maps of the lesson that have one, else the scene's own run
    at the same value, dt halved until two runs agree to a tenth of `error` (rk4 if nothing in the
    scene makes rows, the solver at rounding). Distances are those of the moving bodies' centres,
    of three points a radius of gyration away, and of hinge angles times that radius, at up to 32
    looks a run. *exploded*: further off than 10 sizes, or the run ended in an error;
    *inaccurate*: further off than `error`; *finite*: the rest. A value whose run does not
    converge is not judged for accuracy.

    The boundary that theory gives is that of the linear system of joint springs, dampers and
    servos at the start: the dt from which its step matrix has a spectral radius above 1.

    Raises ValueError for an unknown path or key, an empty or non-positive list, or numbers
    outside their limits.

    >>> from stepcore import Scene
    >>> scene = Scene(gravity=(0, 0, 0))
    >>> mass = scene.add_body("mass", mass=1, inertia=(1, 1, 1))
    >>> _ = scene.add_joint(mass, "slide", name="rail", stiffness=100)
    >>> _ = scene.add_key("out", qpos=[1.0])
    >>> found = stability_map(scene, "joint/rail/stiffness", [100], [0.001, 0.1, 0.19, 0.21],
    ...     integrator="semi-implicit", threads=1)
    >>> [cell.state for cell in found.panels[0].cells]
    ['finite', 'inaccurate', 'inaccurate', 'exploded']
    >>> round(found.panels[0].boundary[0], 6)  # 2 / ω
    0.2
    """
    tolerance = _positive("error", error)
    checks.told("stability_map", progress)
    check_executor("stability_map", executor)
    workers = {"threads": threads, "executor": executor, "progress": progress}
    size = None if size is None else _positive("size", size)
    case = _case(model, path, values, dts, integrator, key, tolerance, size)
    span = case.horizon or max(1.0, STEPS * max(case.dts))
    course = Course(span if horizon is None else checks.seconds("horizon", horizon), case.key)
    if course.horizon < max(case.dts):
        raise ValueError(f"horizon = {course.horizon:g}: must be >= the largest dt")
    finest, rows = min(case.dts), len(case.values) * len(case.settings)
    runs = rows * sum(finest / dt for dt in case.dts)
    cells = rows * len(case.dts)
    words = f"in {cells} cells of which the finest have steps"
    checks.steps(course.horizon, finest, runs, words, MOST_STEPS)
    truths: dict[str, list[Truth]] = {}
    panels = [_panel(case, one, course, tolerance, truths, workers) for one in case.settings]
    name = case.model.scene.name or "scene"
    grid = (case.values, case.dts, course.horizon, tolerance, FAR)
    return StabilityMap(name, case.path, case.words, *grid, panels)


def _case(
    model: Model | Scene | str | os.PathLike[str] | None,
    path: str | None,
    values: Sequence[float] | None,
    dts: Sequence[float] | None,
    integrator: str | Sequence[str] | None,
    key: str | int | None,
    tolerance: float,
    size: float | None,
) -> Case:
    name = "spring" if model is None else LESSON.get(model) if isinstance(model, str) else None
    if name is None or path is not None:
        source = "lesson:spring" if model is None else model
        return _users(source, path, values, dts, integrator, key, size)
    case = defaults.spring(size) if name == "spring" else defaults.stack(tolerance, size)
    if key is not None:
        raise ValueError(f"key = {checks.shown(key)}: the lesson's maps have their own start")
    if integrator is not None:
        if name == "stack":
            raise ValueError("integrator: the map of the stack is by law and sweeps; give a path")
        named = _integrators(integrator)
        case.settings = [one for one in case.settings if one.label in named]
    case.values = case.values if values is None else _ascending("values", values)
    case.dts = case.dts if dts is None else _ascending("dts", dts)
    if dts is not None:
        case.horizon = None
    return case


def _users(
    source: Model | Scene | str | os.PathLike[str],
    path: str | None,
    values: Sequence[float] | None,
    dts: Sequence[float] | None,
    integrator: str | Sequence[str] | None,
    key: str | int | None,
    size: float | None,
) -> Case:
    """A scene of the user's own."""
    model = find_model(source)
    if path is None:
        raise ValueError('path = None: must name the value to vary, as "joint/knee/stiffness"')
    if not len(Bodies(model).index):
        raise ValueError("nothing in the scene can move: there is no motion to map")
    element, field = find(model.scene, path)
    if key is None:
        key = 0 if model.keys else None
    model.index("key", key) if key is not None else None
    if values is None:
        told = getattr(element, field)
        now = checks.number(told)
        if now is None or now <= 0:
            raise ValueError(f"values = None: {path} is {checks.shown(told)}, so give them")
        values = np.geomspace(now / 100, now * 100, 13).tolist()
    if dts is None:
        dts = np.geomspace(model.settings.dt / 10, 10 * model.settings.dt, 13).tolist()
    asked = model.settings.integrator if integrator is None else integrator
    settings = [
        Setting(name, {"integrator": name}, None, partial(_linear, model, path, key, name), STABLE)
        for name in _integrators(asked)
    ]
    axes = (_ascending("values", values), _ascending("dts", dts))
    return Case(model, path, path, *axes, settings, key, size=size)


def _linear(
    model: Model, path: str, key: str | int | None, integrator: str, values: Sequence[float]
) -> list[float]:
    """The boundary of springs, dampers and servos; nan where a value leaves none."""
    found = [theory.of_scene(model.with_values({path: v}), key, integrator) for v in values]
    return [np.nan if limit is None else limit for limit in found]


def _panel(
    case: Case,
    setting: Setting,
    course: Course,
    tolerance: float,
    truths: dict[str, list[Truth]],
    workers: dict[str, Any],
) -> Panel:
    """All cells of one setting, judged."""
    model = case.model.with_settings(**setting.settings)
    times = truth.union(course, case.dts)
    if setting.truth is not None:
        true = [truth.closed(setting.truth, value, times, case.size) for value in case.values]
        against = "its closed form"
    else:
        law = str({k: v for k, v in setting.settings.items() if k != "integrator"})
        if law not in truths:
            truths[law] = truth.converged(
                model, case.path, case.values, course, case.dts, tolerance, case.size, workers
            )
        true = truths[law]
        against = "its own converged run"
    grid = {case.path: case.values, "dt": case.dts}
    found = sweep(model, grid, partial(run, course), **workers)
    cells = []
    for k, record in enumerate(found):
        if record.get("failure"):
            raise ValueError(f"{setting.label}: {record['failure']}")
        cells.append(_judged(record, case.path, course, true[k // len(case.dts)], tolerance))
    boundary = setting.boundary(case.values) if setting.boundary else None
    if boundary is not None and all(np.isnan(limit) for limit in boundary):
        boundary = None
    return Panel(setting.label, cells, against, boundary, setting.says if boundary else "")


def _judged(
    record: dict[str, Any], path: str, course: Course, true: Truth, tolerance: float
) -> Cell:
    """The state of one cell; see `stability_map`."""
    value, dt, points = record[path], record["dt"], record["points"]
    known = true.points is not None and true.error <= tolerance / FINER
    times = np.concatenate([[0.0], course.times(dt)])[: len(points)]
    with np.errstate(over="ignore", invalid="ignore"):
        goal = true.at(times) if true.points is not None else points[:1]
        apart = np.linalg.norm(points - goal, axis=-1) / max(true.size, 1e-300)
        off = float(apart.max()) if np.all(np.isfinite(apart)) else np.inf
    if record["stopped"] or not off <= FAR:
        return Cell(value, dt, EXPLODED, off, known, record["stopped"])
    state = INACCURATE if known and off > tolerance else FINITE
    return Cell(value, dt, state, off if known else np.nan, known)


def _integrators(asked: str | Sequence[str]) -> list[str]:
    """Names that `Settings` knows."""
    names = [asked] if isinstance(asked, str) else list(asked)
    if not names:
        raise ValueError("integrator = []: must name at least one")
    for name in names:
        Settings().replace(integrator=name)
    return names


def _positive(name: str, value: object) -> float:
    number = checks.number(value)
    if number is None or number <= 0:
        raise ValueError(f"{name} = {checks.shown(value)}: must be a finite number > 0")
    return number


def _ascending(name: str, values: Sequence[float]) -> list[float]:
    """Positive numbers without doubles, in order."""
    some = [_positive(f"{name}[{k}]", v) for k, v in enumerate(checks.several(name, values))]
    if len(set(some)) < len(some):
        raise ValueError(f"{name}: the same number twice")
    return sorted(some)
