"""`stability_map`: maps stability and accuracy over dt × a parameter of the scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Unpack

import numpy as np

from stepcore import checks
from stepcore._core import Settings
from stepcore.deadline import OutOfTime
from stepcore.engine.model import Model
from stepcore.experiment.arguments import MeasurementFields, Source, Workers, measurement, set_up
from stepcore.experiment.failure import FAR
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import held_in_words, start_in_words, without_in_words
from stepcore.experiment.schedule import home
from stepcore.experiment.sizes import scene_size
from stepcore.measure.stability import lesson_maps
from stepcore.measure.stability.lesson_maps import GROWS, MapCase, MapSetting, limit_of_springs
from stepcore.measure.stability.result import (
    ACCURATE,
    EXPLODED,
    FINITE,
    INACCURATE,
    UNTRIED,
    MapCell,
    MapPanel,
    StabilityMap,
    Tolerance,
)
from stepcore.measure.stability.runs import (
    FINER,
    MapMotion,
    Step,
    TrueMotion,
    closed_form,
    converged,
    within,
)
from stepcore.report import units
from stepcore.report.units import seconds
from stepcore.scene.value_paths import find

__all__ = ["MapCell", "MapPanel", "StabilityMap", "stability_map"]

# Least horizon in steps of the largest dt, so that instabilities have time to grow.
STEPS = 25
# The share of the time (`seconds`) at which the runs of the true motions end.
TRUE = 0.6
# The points of a cell's run, and the reason if it stopped.
Cell = tuple[np.ndarray, str | None]
# Largest number of steps of all cells: more than half an hour of the smallest scene.
MOST_STEPS = 1e10
# Motion fields that a map does not accept: every cell starts at the keyframe with its controls.
WITHOUT = ("starts", "seed", "control", "ctrl", "control_dt", "interpolation", "kind", "follow")


@measurement(without=WITHOUT)
def stability_map(
    model: Source | None = None,
    motion: Motion | str | None = None,
    *,
    path: str | None = None,
    values: Sequence[float] | None = None,
    dts: Sequence[float | str] | None = None,
    accuracies: Sequence[float | str] | None = None,
    integrators: str | Sequence[str] | None = None,
    deviation: float | str = "10%",
    size: float | None = None,
    **fields: Unpack[MeasurementFields],
) -> StabilityMap:
    """Map stability and accuracy over dt × a parameter of the scene, with one run for each pair.

    model: a Model, a Scene, or anything that `stepcore.load` accepts. None or "lesson:spring" is
        the lesson's spring: stiffness against dt, by integrator. "lesson:stack" is a heavy ball on
        a light ball: mass ratio against dt, by contact law. With a path, these two are treated as
        ordinary scenes.
    motion: a `Motion`, or its fields as arguments: the horizon (by default 1 s, or 25 of the
        largest dt if longer) and the keyframe to start from (by default the first), whose controls
        are held constant. The motion has one start and no other controls.
    path: the parameter that is varied, as in `Model.with_values`: "joint/knee/stiffness",
        "body/arm/mass", "actuator/grip/kp".
    values: the parameter's values, sorted ascending in the map; by default 13 from a hundredth to a
        hundred times the present value.
    dts: the time steps [s]; by default 13 from a tenth to ten times the scene's dt.
    accuracies: the errors asked for over the horizon: metres, "1mm", or "0.1%" of the scene's size.
        Steps of the scene's dt then keep them, and the map shows the error delivered over the one
        asked for. By default, if the model's steps keep an accuracy, seven around it.
    integrators: one or several, one panel each; by default the scene's own.
    deviation: the deviation (the largest distance from the true motion) above which a run is
        inaccurate: metres, "1mm", or "10%" of `size`.
    size: the length that deviations are relative to [m]; by default the size of the scene and its
        true motion, as in other measurements.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    The true motion is a closed form for the two maps of the lesson that have one. Otherwise the
    true motion is the scene's own run at the same value, with converged rows (and rk4 if nothing in
    the scene makes rows). There dt is halved until two runs agree to a tenth of `deviation`.

    Distances are those of the moving bodies' centres, of three points a radius of gyration away,
    and of hinge angles times that radius. They are read up to 32 times in a run.

    In a map over accuracies the true motion is the scene's own run within a hundredth of the finest
    one, and its error the distance from the run within a tenth.

    A cell is *exploded* if the deviation is larger than 100 sizes or the run failed, *inaccurate*
    if the deviation is larger than `deviation`, and *accurate* otherwise. A cell is *finite* if the
    accuracy is unknown, because the true motion at that value does not converge.

    The theoretical boundary is that of the linear system of joint springs, dampers and servos at
    the start: the dt beyond which the system's step matrix has a spectral radius above 1.

    Raises ValueError for an unknown path or key, an empty or non-positive list, or numbers outside
    their limits.

    >>> from stepcore import Scene
    >>> scene = Scene(gravity=(0, 0, 0))
    >>> mass = scene.add_body("mass", mass=1, inertia=(1, 1, 1))
    >>> _ = scene.add_joint(mass, "slide", name="rail", stiffness=100)
    >>> _ = scene.add_key("out", qpos=[1.0])
    >>> result = stability_map(scene, path="joint/rail/stiffness", values=[100],
    ...     dts=[0.001, 0.1, 0.19, 0.21], integrators="semi-implicit", threads=1)
    >>> [cell.state for cell in result.panels[0].cells]
    ['accurate', 'inaccurate', 'inaccurate', 'exploded']
    >>> round(result.panels[0].boundary[0], 6)  # 2 / ω
    0.2
    """
    tolerance = Tolerance(deviation)
    size = None if size is None else _positive("size", size)
    model = "lesson:spring" if model is None else model
    lesson: MapCase | None = None
    if path is None and model == "lesson:spring":
        lesson = lesson_maps.spring(size)
    elif path is None and model == "lesson:stack":
        lesson = lesson_maps.stack(tolerance, size)
    setup = set_up(
        stability_map, lesson.model if lesson else model, motion, fields, missing="no motion to map"
    )
    names = None if integrators is None else _integrators(integrators)
    kept = _accuracies(setup.model, accuracies, dts)
    if kept and lesson is not None:
        raise ValueError("accuracies: the lesson's maps are over dt; name a value to map it")
    if lesson is None:
        plain = setup.model.with_settings(accuracy=None)
        case = _case(plain, path, values, names, setup.motion.key, size)
    else:
        case = _narrowed(lesson, names, setup.motion.key)
    if values is not None:
        case.values = _ascending("values", values)
    if dts is not None:
        given = enumerate(checks.several("dts", dts))
        steps = [units.time(f"dts[{k}]", dt) for k, dt in given]
        case.dts, case.horizon = _ascending("dts", steps), None
    if kept:
        case.dts, case.accuracies = [setup.model.settings.dt], kept
        for setting in case.settings:
            setting.boundary = None
    horizon = setup.motion.horizon or case.horizon or max(1.0, STEPS * max(case.dts))
    _check_steps(case, horizon)
    panels = _Panels(case, MapMotion(horizon, case.key), tolerance, setup.workers)
    made = [panels.panel(setting) for setting in case.settings]
    if all(cell.state == UNTRIED for panel in made for cell in panel.cells):
        raise OutOfTime("no cell has been run")
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
        panels=made,
        accuracies=case.accuracies,
    )


def _accuracies(
    model: Model, given: Sequence[float | str] | None, dts: Sequence[float | str] | None
) -> list[float]:
    """Return the accuracies of a map over them [m], ascending; empty of a map over dt."""
    own = model.settings.accuracy
    if given is None:
        return [] if own is None or dts is not None else (own * np.geomspace(0.1, 100, 7)).tolist()
    if dts is not None:
        raise ValueError("accuracies and dts: give one of them, because steps choose their length")
    size = scene_size(model.scene)
    lengths = [
        units.length("stability_map", f"accuracies[{k}]", value, size)
        for k, value in enumerate(checks.several("accuracies", given))
    ]
    return _ascending("accuracies", lengths)


def _ran(case: MapCase, horizon: float) -> str:
    """Return the motion in words, and the contact law if all panels have the same."""
    model = case.model
    laws = {str(s.settings.get("law", model.settings.law)) for s in case.settings}
    law = f"; law {laws.pop()}" if len(laws) == 1 else ""
    drive = held_in_words(model, home(model, case.key)[1])
    begin = start_in_words(model, case.key)
    return f"{seconds(horizon)} from {begin}; {drive}{law}{without_in_words(model)}"


def _narrowed(case: MapCase, names: list[str] | None, key: str | int | None) -> MapCase:
    """Return a map of the lesson, reduced to the named integrators."""
    if key is not None:
        raise ValueError(
            f"key = {checks.shown(key)}: must be None, because the lesson's maps have their own "
            "start"
        )
    if names is None:
        return case
    if case.model.scene.name == "stack":
        raise ValueError(
            f"integrators = {checks.shown(names)}: must be None, because the map of the stack is "
            "by law and sweeps; name a value to map it by integrator"
        )
    chosen = [setting for setting in case.settings if setting.label in names]
    return dataclasses.replace(case, settings=chosen)


def _case(
    model: Model,
    path: str | None,
    values: Sequence[float] | None,
    names: list[str] | None,
    key: str | int | None,
    size: float | None,
) -> MapCase:
    """Return the map of a scene over a parameter, with one panel for each integrator."""
    if path is None:
        raise ValueError('path = None: must name the value to vary, as "joint/knee/stiffness"')
    element, field = find(model.scene, path)
    if key is None:
        key = 0 if model.keys else None
    else:
        model.index("key", key)
    present = checks.number(getattr(element, field))
    if values is None and (present is None or present <= 0):
        shown = checks.shown(getattr(element, field))
        raise ValueError(f"values = None: must be given, because {path} is {shown}")
    around = np.geomspace(0.01, 100.0, 13) * (present or 1.0)
    settings = [
        MapSetting(
            name, {"integrator": name}, None, partial(_linear, model, path, key, name), GROWS
        )
        for name in names or [model.settings.integrator]
    ]
    dts = np.geomspace(model.settings.dt / 10, 10 * model.settings.dt, 13).tolist()
    return MapCase(model, path, path, around.tolist(), dts, settings, key, size=size)


def _linear(
    model: Model, path: str, key: str | int | None, integrator: str, values: Sequence[float]
) -> list[float]:
    """Return the stability limit of dt for each value; nan at values without a linear system."""
    limits = (limit_of_springs(model.with_values({path: v}), key, integrator) for v in values)
    return [np.nan if limit is None else limit for limit in limits]


def _check_steps(case: MapCase, horizon: float) -> None:
    """Raise ValueError for a map that would take days."""
    if horizon < max(case.dts):
        raise ValueError(f"horizon = {horizon:g}: must be >= the largest dt")
    finest, rows = min(case.dts), len(case.values) * len(case.settings)
    runs = rows * sum(finest / dt for dt in case.dts)
    words = f"in {rows * len(case.dts)} cells of which the finest have steps"
    checks.steps(horizon, finest, runs, words, MOST_STEPS)


class _Panels:
    """Runs and judges the cells of a map.

    truths: the true motions by law; integrators share a true motion.
    """

    def __init__(
        self, case: MapCase, motion: MapMotion, tolerance: Tolerance, workers: Workers
    ) -> None:
        self.case, self.motion, self.tolerance, self.workers = case, motion, tolerance, workers
        self.truths: dict[str, list[TrueMotion | None]] = {}

    def panel(self, setting: MapSetting) -> MapPanel:
        """Run and judge all cells of one setting."""
        case = self.case
        model = case.model.with_settings(**setting.settings)
        if setting.form is not None:
            times = self.motion.all_times(case.dts)
            truth: list[TrueMotion | None]
            truth = [closed_form(setting.form, model, v, times, case.size) for v in case.values]
        else:
            law = str({k: v for k, v in setting.settings.items() if k != "integrator"})
            if law not in self.truths:
                job: Callable[[float], TrueMotion]
                if case.accuracies:
                    job = partial(within, model, case.path, case.steps, case.size, self.motion)
                else:
                    job = partial(
                        converged,
                        model,
                        case.path,
                        case.dts,
                        case.size,
                        self.motion,
                        self.tolerance,
                    )
                self.truths[law] = []
                with self.workers.deadline.stage("all true motions", TRUE):
                    self.workers.each(job, case.values, "true motion", self.truths[law])
            truth = self.truths[law]
        grid = list(product(case.values, case.steps))
        runs: list[Cell | None] = []
        with self.workers.deadline.stage(lambda: _not_run(setting.label, runs)):
            self.workers.each(
                partial(self.motion.cell, model, case.path), grid, setting.label, runs
            )
        cells = [
            self._judged(value, step, run, truth[k // len(case.steps)])
            for k, ((value, step), run) in enumerate(zip(grid, runs, strict=True))
        ]
        boundary = setting.boundary(case.values) if setting.boundary else None
        if boundary is not None and all(np.isnan(limit) for limit in boundary):
            boundary = None
        reference = "closed form" if setting.form is not None else "converged run"
        if case.accuracies:
            reference = "run within a hundredth of the finest accuracy"
        beyond = setting.beyond if boundary else ""
        return MapPanel(setting.label, cells, reference, boundary, beyond)

    def _judged(
        self, value: float, step: Step, run: Cell | None, true: TrueMotion | None
    ) -> MapCell:
        """Return one cell with its state; see `stability_map`."""
        dt, asked = step
        if run is None or true is None:
            return MapCell(value, dt, UNTRIED, np.nan, False, asked=asked)
        points, stopped = run
        share = self.tolerance.share(true.size) if asked is None else asked / true.size
        known = true.points is not None and true.error <= share / FINER
        with np.errstate(over="ignore", invalid="ignore"):
            times = self.motion.times(dt)[: len(points)]
            goal = true.at(times) if true.points is not None else points[:1]
            apart = np.linalg.norm(points - goal, axis=-1) / max(true.size, 1e-300)
            deviation = float(apart.max()) if np.all(np.isfinite(apart)) else np.inf
        if stopped or not deviation <= FAR:
            return MapCell(value, dt, EXPLODED, deviation, known, stopped, asked)
        if not known:
            return MapCell(value, dt, FINITE, np.nan, False, asked=asked)
        state = ACCURATE if deviation <= share else INACCURATE
        over = np.nan if asked is None else deviation / share
        return MapCell(value, dt, state, deviation, asked=asked, over=over)


def _not_run(label: str, runs: Sequence[Cell | None]) -> str:
    left = sum(run is None for run in runs)
    return f"{left} of {len(runs)} cells of {label}"


def _integrators(asked: str | Sequence[str]) -> list[str]:
    """Return the integrator names after checking them against `Settings`."""
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
    """Return positive numbers in ascending order, without repetition."""
    some = [_positive(f"{name}[{k}]", v) for k, v in enumerate(checks.several(name, values))]
    if len(set(some)) < len(some):
        raise ValueError(f"{name}: contains the same number twice")
    return sorted(some)
