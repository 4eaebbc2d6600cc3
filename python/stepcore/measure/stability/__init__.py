"""`stability_map`: stability and accuracy over dt × a value of the scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any, Unpack

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.engine.model import Model
from stepcore.experiment.arguments import Source, Workers, set_up
from stepcore.experiment.motion import Motion, MotionFields, takes_motion
from stepcore.experiment.motion_words import held_in_words, start_in_words, without_in_words
from stepcore.measure.stability import cases, theory
from stepcore.measure.stability.cases import GROWS, MapCase, MapSetting
from stepcore.measure.stability.points import CellMotion, run
from stepcore.measure.stability.reference import (
    FINER,
    Tolerance,
    TrueMotion,
    closed_form,
    converged_runs,
)
from stepcore.measure.stability.result import (
    EXPLODED,
    FINITE,
    INACCURATE,
    MapCell,
    MapPanel,
    StabilityMap,
)
from stepcore.measure.sweep import sweep
from stepcore.report.progress import Choice
from stepcore.report.units import seconds
from stepcore.scene.value_paths import find

__all__ = ["MapCell", "MapPanel", "StabilityMap", "stability_map"]

# A run that is further off than this many sizes of the true motion has exploded.
FAR = 10.0
# The horizon is at least so many of the largest steps, so that growth has time to show.
STEPS = 25
# Of all cells together: above half an hour of the smallest scene.
MOST_STEPS = 1e10
LESSON = {"lesson:spring": "spring", "lesson:stack": "stack"}
# Every cell starts at the keyframe and holds its controls.
WITHOUT = ("starts", "seed", "control", "ctrl", "control_dt")


@takes_motion(without=WITHOUT)
def stability_map(
    model: Source | None = None,
    motion: Motion | None = None,
    *,
    path: str | None = None,
    values: Sequence[float] | None = None,
    dts: Sequence[float] | None = None,
    integrators: str | Sequence[str] | None = None,
    error: float | str = "10%",
    size: float | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
    **fields: Unpack[MotionFields],
) -> StabilityMap:
    """Maps stability and accuracy over dt × a value of the scene: one run for each pair.

    model: a Model, a Scene, or what `stepcore.load` takes. None or "lesson:spring": the lesson's
        spring, stiffness against dt, by integrator; "lesson:stack": a heavy ball on a light one,
        mass ratio against dt, by the way contacts act. With a path these two are scenes like
        others.
    motion: a `Motion`, or its fields as arguments: the horizon (by default 1 s, or 25 of the
        largest dt if that is more) and the keyframe to start from (by default the first), whose
        controls are held. It has one start and no other controls.
    path: the value that is varied, as in `Model.with_values`: "joint/knee/stiffness",
        "body/arm/mass", "actuator/grip/kp". values: its values, ascending in the map; by default
        13 from a hundredth to a hundred times the present one.
    dts: [s]; by default 13 from a tenth to ten times the scene's.
    integrators: one or several, one panel each; by default the scene's own.
    error: a run with a larger error is inaccurate: metres, "1mm", or "10%" of `size`.
    size: [m]; by default how far the bodies move in the true motion.
    threads, executor, progress: as in `stepcore.sweep`.

    The true motion is a closed form for the two maps of the lesson that have one. Otherwise it is
    the scene's own run at the same value, with dt halved until two runs agree to a tenth of `error`
    (rk4 if nothing in the scene makes rows; converged rows). Errors are distances of the moving
    bodies' centres, of three points a radius of gyration away, and of hinge angles times that
    radius, read up to 32 times in a run. *exploded*: the error is larger than 10 sizes, or the run
    failed; *inaccurate*: it is larger than `error`; *finite*: all else. Where the run of a value
    does not converge, accuracy is not judged.

    The theoretical boundary is that of the linear system of joint springs, dampers and servos at
    the start: the dt beyond which its step matrix has a spectral radius above 1.

    Raises ValueError for an unknown path or key, an empty or non-positive list, or numbers
    outside their limits.

    >>> from stepcore import Scene
    >>> scene = Scene(gravity=(0, 0, 0))
    >>> mass = scene.add_body("mass", mass=1, inertia=(1, 1, 1))
    >>> _ = scene.add_joint(mass, "slide", name="rail", stiffness=100)
    >>> _ = scene.add_key("out", qpos=[1.0])
    >>> result = stability_map(scene, path="joint/rail/stiffness", values=[100],
    ...     dts=[0.001, 0.1, 0.19, 0.21], integrators="semi-implicit", threads=1)
    >>> [cell.state for cell in result.panels[0].cells]
    ['finite', 'inaccurate', 'inaccurate', 'exploded']
    >>> round(result.panels[0].boundary[0], 6)  # 2 / ω
    0.2
    """
    tolerance = Tolerance(error)
    size = None if size is None else _positive("size", size)
    lesson = "spring" if model is None else LESSON.get(model) if isinstance(model, str) else None
    case: MapCase | None = None
    if lesson is not None and path is None:
        case = cases.spring(size) if lesson == "spring" else cases.stack(tolerance, size)
        _narrow(case, lesson, values, dts, integrators)
    setup = set_up(
        stability_map,
        case.model if case else "lesson:spring" if model is None else model,
        motion,
        fields,
        missing="no motion to map",
        threads=threads,
        executor=executor,
        progress=progress,
    )
    key = setup.motion.key
    if case is None:
        case = _case(setup.model, path, values, dts, integrators, key, size)
    elif key is not None:
        raise ValueError(
            f"key = {checks.shown(key)}: must be None, because the lesson's maps have their own "
            "start"
        )
    horizon = setup.motion.horizon or case.horizon or max(1.0, STEPS * max(case.dts))
    _check_steps(case, horizon)
    cell, converged = CellMotion(horizon, case.key), dict[str, list[TrueMotion]]()
    return StabilityMap(
        name=setup.name,
        settings=case.model.settings,
        motion=dataclasses.replace(setup.motion, horizon=horizon, key=case.key),
        path=case.path,
        axis=case.axis,
        values=case.values,
        dts=case.dts,
        horizon=horizon,
        tolerance=tolerance,
        far=FAR,
        ran=_ran(case, horizon),
        panels=[_panel(case, s, cell, tolerance, converged, setup.workers) for s in case.settings],
    )


def _ran(case: MapCase, horizon: float) -> str:
    """What motion was run, in words; the law where all panels have the same."""
    model = case.model
    key = None if case.key is None else model.keys[model.index("key", case.key)]
    ctrl = np.zeros(model.nu) if key is None else key.ctrl
    begin = "the pose of the scene" if key is None else start_in_words(model, case.key)
    laws = {str(s.settings.get("law", model.settings.law)) for s in case.settings}
    law = f"; law {laws.pop()}" if len(laws) == 1 else ""
    said = f"{seconds(horizon)} from {begin}; {held_in_words(model, ctrl)}{law}"
    return said + without_in_words(model)


def _narrow(
    case: MapCase,
    lesson: str,
    values: Sequence[float] | None,
    dts: Sequence[float] | None,
    integrators: str | Sequence[str] | None,
) -> None:
    """Takes the axes and integrators that were asked for into a map of the lesson."""
    if integrators is not None:
        if lesson == "stack":
            raise ValueError(
                f"integrators = {checks.shown(integrators)}: must be None, because the map of the "
                "stack is by law and sweeps; name a value to map it by integrator"
            )
        named = _integrators(integrators)
        case.settings = [setting for setting in case.settings if setting.label in named]
    if values is not None:
        case.values = _ascending("values", values)
    if dts is not None:
        case.dts, case.horizon = _ascending("dts", dts), None


def _case(
    model: Model,
    path: str | None,
    values: Sequence[float] | None,
    dts: Sequence[float] | None,
    integrators: str | Sequence[str] | None,
    key: str | int | None,
    size: float | None,
) -> MapCase:
    """A scene of the user's own."""
    if path is None:
        raise ValueError('path = None: must name the value to vary, as "joint/knee/stiffness"')
    element, field = find(model.scene, path)
    if key is None:
        key = 0 if model.keys else None
    else:
        model.index("key", key)
    if values is None:
        present = getattr(element, field)
        number = checks.number(present)
        if number is None or number <= 0:
            raise ValueError(
                f"values = None: must be given, because {path} is {checks.shown(present)}"
            )
        values = np.geomspace(number / 100, number * 100, 13).tolist()
    if dts is None:
        dts = np.geomspace(model.settings.dt / 10, 10 * model.settings.dt, 13).tolist()
    asked = model.settings.integrator if integrators is None else integrators
    settings = [
        MapSetting(
            name, {"integrator": name}, None, partial(_linear, model, path, key, name), GROWS
        )
        for name in _integrators(asked)
    ]
    axes = (_ascending("values", values), _ascending("dts", dts))
    return MapCase(model, path, path, *axes, settings, key, size=size)


def _linear(
    model: Model, path: str, key: str | int | None, integrator: str, values: Sequence[float]
) -> list[float]:
    """The boundary of springs, dampers and servos; nan where a value leaves none."""
    limits = [theory.limit_of(model.with_values({path: v}), key, integrator) for v in values]
    return [np.nan if limit is None else limit for limit in limits]


def _check_steps(case: MapCase, horizon: float) -> None:
    """Refuses a map that would take days."""
    if horizon < max(case.dts):
        raise ValueError(f"horizon = {horizon:g}: must be >= the largest dt")
    finest, rows = min(case.dts), len(case.values) * len(case.settings)
    runs = rows * sum(finest / dt for dt in case.dts)
    words = f"in {rows * len(case.dts)} cells of which the finest have steps"
    checks.steps(horizon, finest, runs, words, MOST_STEPS)


def _panel(
    case: MapCase,
    setting: MapSetting,
    motion: CellMotion,
    tolerance: Tolerance,
    converged: dict[str, list[TrueMotion]],
    workers: Workers,
) -> MapPanel:
    """All cells of one setting, judged."""
    model = case.model.with_settings(**setting.settings)
    if setting.form is not None:
        times = motion.all_times(case.dts)
        truth = [closed_form(setting.form, value, times, case.size) for value in case.values]
        reference = "closed form"
    else:
        # Integrators share a converged run, laws do not.
        law = str({k: v for k, v in setting.settings.items() if k != "integrator"})
        if law not in converged:
            converged[law] = converged_runs(
                model, case.path, case.values, motion, case.dts, tolerance, case.size, workers
            )
        truth, reference = converged[law], "converged run"
    grid = {case.path: case.values, "dt": case.dts}
    cells = []
    for k, record in enumerate(sweep(model, grid, partial(run, motion), **workers.arguments)):
        if record.get("failure"):
            raise ValueError(f"{setting.label}: {record['failure']}")
        true = truth[k // len(case.dts)]
        cells.append(_judged(record, case.path, motion, true, tolerance))
    boundary = setting.boundary(case.values) if setting.boundary else None
    if boundary is not None and all(np.isnan(limit) for limit in boundary):
        boundary = None
    return MapPanel(setting.label, cells, reference, boundary, setting.beyond if boundary else "")


def _judged(
    record: dict[str, Any], path: str, motion: CellMotion, true: TrueMotion, tolerance: Tolerance
) -> MapCell:
    """The state of one cell; see `stability_map`."""
    value, dt, points = record[path], record["dt"], record["points"]
    share = tolerance.share(true.size)
    known = true.points is not None and true.error <= share / FINER
    times = np.concatenate([[0.0], motion.times(dt)])[: len(points)]
    with np.errstate(over="ignore", invalid="ignore"):
        goal = true.at(times) if true.points is not None else points[:1]
        apart = np.linalg.norm(points - goal, axis=-1) / max(true.size, 1e-300)
        error = float(apart.max()) if np.all(np.isfinite(apart)) else np.inf
    if record["stopped"] or not error <= FAR:
        return MapCell(value, dt, EXPLODED, error, known, record["stopped"])
    state = INACCURATE if known and error > share else FINITE
    return MapCell(value, dt, state, error if known else np.nan, known)


def _integrators(asked: str | Sequence[str]) -> list[str]:
    """Names that `Settings` knows."""
    names = [asked] if isinstance(asked, str) else list(asked)
    if not names:
        raise ValueError("integrators = []: must name at least one")
    for name in names:
        Settings().replace(integrator=name)
    return names


def _positive(name: str, value: object) -> float:
    number = checks.number(value)
    if number is None or number <= 0:
        raise ValueError(f"{name} = {checks.shown(value)}: must be a finite number > 0")
    return number


def _ascending(name: str, values: Sequence[float]) -> list[float]:
    """Positive numbers without repetition, in order."""
    some = [_positive(f"{name}[{k}]", v) for k, v in enumerate(checks.several(name, values))]
    if len(set(some)) < len(some):
        raise ValueError(f"{name}: contains the same number twice")
    return sorted(some)
