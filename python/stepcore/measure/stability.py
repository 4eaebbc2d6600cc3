"""`stability_map`: where in dt × a parameter of the scene is it stable, and accurate?"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple, Unpack

import numpy as np

from stepcore import checks
from stepcore.deadline import SEARCHED, OutOfTime
from stepcore.engine.linear_maps import implicit_kinds
from stepcore.engine.model import Model
from stepcore.engine.norm import apart, largest, rms
from stepcore.engine.parameters import own_value
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.arguments import MeasurementFields, Setup, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.engines import FAR, Engine, Stepcore, run
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import held_in_words, start_in_words, without_in_words
from stepcore.experiment.mujoco_engine import engine_of
from stepcore.experiment.predictable import until_in_words
from stepcore.experiment.schedule import divides, home, often
from stepcore.experiment.study import SHIPPED, Study
from stepcore.experiment.truth import Truth
from stepcore.lesson import maps
from stepcore.lesson.maps import MapCase, MapSetting, divisors, largest_stable_dt
from stepcore.report import units
from stepcore.report.report import not_shown
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, metres, seconds

__all__ = ["MapCell", "MapPanel", "StabilityMap", "stability_map"]

# Least horizon in steps of the largest dt, so that instabilities have time to grow.
STEPS = 25
# The default steps divide so many shipped steps: runs can be compared that often.
WHOLE = 20
# Motion fields that a map does not accept: every cell starts at the keyframe with its controls.
WITHOUT = ("starts", "seed", "control", "ctrl", "control_dt", "interpolation", "kind", "follow")
# Kinds of elements in the linear system of a scene.
LINEAR = ("spring", "damper", "actuator")
# The theory of a scene's map: the dt beyond which that system grows.
SPRINGS = "limit of springs"
LEFT_OUT = (
    "of the joint springs, dampers and servos at the start, without contacts, limits, friction and "
    "bounds of forces"
)
# The states of a cell, and their marks; "finite" is used only if the accuracy is unknown.
ACCURATE, INACCURATE, EXPLODED, FINITE = "accurate", "inaccurate", "exploded", "finite"
UNTRIED = "not run"
SYMBOLS = {ACCURATE: "·", INACCURATE: "o", EXPLODED: "X", FINITE: "?", UNTRIED: " "}


@dataclass(frozen=True)
class MapCell:
    """One run of a stability map.

    state: "accurate", "inaccurate" or "exploded"; "finite" if the accuracy is unknown.
    error: RMS position error against the true motion [m], never below what that is sure of; NaN if
        unknown.
    reason: why the run failed.
    asked: the accuracy asked for [m], in a map over accuracies.
    """

    value: float
    dt: float
    state: str
    error: float = math.nan
    reason: str | None = None
    asked: float | None = None

    @property
    def over(self) -> float:
        """The error delivered over the one asked for; NaN if unknown, or nothing was asked for."""
        return self.error / self.asked if self.asked else math.nan


@dataclass(frozen=True)
class MapPanel:
    """The cells of one setting, values outermost, and the theory.

    boundary: the theoretical limit of dt for each value [s]: 0 if no step is stable, inf if all
        are; None without a theory.
    beyond: the behaviour beyond the boundary.
    """

    label: str
    cells: list[MapCell]
    boundary: list[float] | None = None
    beyond: str = ""

    def at(self, value: float) -> list[MapCell]:
        """Return the cells of one value, by dt."""
        return [cell for cell in self.cells if cell.value == value]


@dataclass(eq=False, repr=False)
class StabilityMap(Result):
    """A map of stability and accuracy over dt, or over the accuracy asked for, and one parameter.

    `stepcore.stability_map` returns this map.

    path: the parameter that is varied.
    axis: the label of the parameter's axis, with the unit.
    values, dts [s]: the grid.
    accuracies: of the grid in place of dts [m], which then is the control period; or empty.
    deviation: the error above which a run is inaccurate [m].
    panels: one panel for each setting.

    >>> from stepcore import stability_map
    >>> stability_map(values=[100.0], dts=[0.001, 0.5], progress=False)
    <StabilityMap of spring: 16 cells in 8 panels>
    """

    kind = "stability"
    units: ClassVar = {"dt": "s", "theory": "s"} | dict.fromkeys(("error", "asked"), "m")

    settings: Any
    motion: Motion
    path: str
    axis: str
    values: Sequence[float]
    dts: Sequence[float]
    horizon: float
    deviation: float
    panels: list[MapPanel]
    accuracies: Sequence[float] = ()

    def __post_init__(self) -> None:
        unjudged = sum(cell.state == FINITE for cell in self.rows)
        if unjudged:
            self.notes.append(
                f"{counted(unjudged, 'finite run')}, marked {SYMBOLS[FINITE]}, cannot be judged "
                "for accuracy, because the true motion is not known well enough"
            )

    @property
    def title(self) -> str:
        """The quantity measured, in a few words."""
        what = "error delivered over asked" if self.accuracies else "stability and accuracy over dt"
        return f"{self.name}: {what} × {self.axis}"

    @property
    def setup(self) -> str:
        """The meaning of the cells' marks."""
        accurate, inaccurate, exploded = (f"{s} ({SYMBOLS[s]})" for s in list(SYMBOLS)[:3])
        if self.accuracies:
            return (
                f"Steps of {seconds(self.dts[0])} that keep an accuracy over {self.horizon:g} s. "
                f"{accurate}: the error is at most what was asked for; {inaccurate}: it is larger; "
                f"{exploded}: the run failed."
            )
        theory = any(panel.beyond == SPRINGS for panel in self.panels)
        return (
            f"{accurate}: the RMS position error is at most {metres(self.deviation)}; "
            f"{inaccurate}: it is larger; {exploded}: the run failed, a body went further than "
            f"{FAR:g} times the scene's size, or a hinge turned {FAR:g} times too fast."
        ) + f" {SPRINGS}: {LEFT_OUT}." * theory

    @property
    def sentences(self) -> list[str]:
        """The number of cells in each state for each setting, the scene's integrator first."""
        sentences = []
        for panel in sorted(self.panels, key=lambda panel: panel is not self._first):
            count = Counter(cell.state for cell in panel.cells)
            states = ", ".join(f"{count[state]} {state}" for state in SYMBOLS if count[state])
            sentences.append(f"{panel.label}: of {counted(len(panel.cells), 'run')}, {states}.")
            if held := self._held(panel):
                sentences.append(
                    f"{held} of the accurate runs have steps of more than twice the {SPRINGS}: "
                    "friction, contacts, bounds of forces or the end of the motion keep them from "
                    "exploding, and another motion may explode there."
                )
            if worst := [cell for cell in panel.cells if math.isfinite(cell.over)]:
                cell = max(worst, key=lambda cell: cell.over)
                sentences.append(
                    f"The most of what was asked for is {cell.over:.2g}, at {cell.value:.3g} where "
                    f"{metres(cell.asked or 0.0)} were."
                )
        return sentences

    def _held(self, panel: MapPanel) -> int:
        """Return how many accurate runs have steps that their springs alone do not bear."""
        if panel.beyond != SPRINGS or self.accuracies:
            return 0
        limits = self._limits(panel)
        good = [cell for cell in panel.cells if cell.state == ACCURATE]
        return sum(0 < 2 * limits.get(cell.value, math.inf) < cell.dt for cell in good)

    def _limits(self, panel: MapPanel) -> dict[float, float]:
        """Return the theoretical limit of dt of each value [s]; empty without a theory."""
        return dict(zip(self.values, panel.boundary or [], strict=False))

    @property
    def rows(self) -> list[MapCell]:
        """The cells of all panels."""
        return [cell for panel in self.panels for cell in panel.cells]

    @property
    def table(self) -> Table:
        """One row for each cell; theory: the largest stable dt of the cell's value [s]."""
        rows: list[dict[str, Any]] = []
        for panel in self.panels:
            theory = self._limits(panel)
            for cell in panel.cells:
                row = {"setting": panel.label, "value": cell.value, "dt": cell.dt}
                row |= {"state": cell.state, "error": cell.error, "theory": theory.get(cell.value)}
                row["reason"] = cell.reason
                if cell.asked:
                    row |= {"asked": cell.asked, "delivered over asked": cell.over}
                rows.append(row)
        return Table(rows)

    def tables(self, full: bool) -> list[Table]:
        """Return the panels with one row for each value and one mark for each dt.

        full: whether to return all panels rather than the first.
        """
        if full or len(self.panels) == 1:
            return [self._table(panel) for panel in self.panels]
        table, left = self._table(self._first), len(self.panels) - 1
        table.legend = not_shown(f"the maps of {counted(left, 'other setting')}")
        return [table]

    @property
    def _first(self) -> MapPanel:
        own = (panel for panel in self.panels if panel.label == self.settings.integrator)
        return next(own, self.panels[0])

    def _table(self, panel: MapPanel) -> Table:
        across = f"dt {seconds(self.dts[0])} to {seconds(self.dts[-1])}"
        if self.accuracies:
            across = f"asked {metres(self.accuracies[0])} to {metres(self.accuracies[-1])}"
        rows: list[dict[str, Any]] = []
        for k, value in enumerate(self.values):
            cells = panel.at(value)
            row = {"value": value, across: "".join(SYMBOLS[cell.state] for cell in cells)}
            if self.accuracies:
                shares = ("?" if math.isnan(c.over) else f"{c.over:.1g}" for c in cells)
                row["delivered over asked"] = " ".join(shares)
            else:
                good = [cell.dt for cell in cells if cell.state == ACCURATE]
                unknown = not good and any(cell.state in (FINITE, UNTRIED) for cell in cells)
                most = _dt(max(good, default=0.0))
                row["largest accurate"] = "unknown" if unknown else most
            if panel.boundary is not None:
                row[panel.beyond] = _dt(panel.boundary[k])
            rows.append(row)
        # A column with a format is not truncated.
        return Table(rows, formats={"value": ".3g", across: ""}, heading=panel.label)

    def details(self) -> dict[str, Any]:
        """Return the grid and the panels' theory as plain data."""
        return {
            "value": self.path,
            "values": list(self.values),
            "dts": list(self.dts),
            "accuracies": list(self.accuracies),
            "deviation": self.deviation,
            "panels": [
                {"setting": p.label, "theory": p.beyond or None, "boundary": p.boundary}
                for p in self.panels
            ],
        }

    def __repr__(self) -> str:
        return f"<StabilityMap of {self.name}: {len(self.rows)} cells in {len(self.panels)} panels>"


def _dt(value: float) -> str:
    if value == 0 or math.isnan(value):
        return "" if value else "none"
    return seconds(value) if math.isfinite(value) else "any"


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
    engine: str = "stepcore",
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
    dts: the time steps [s]; by default 12 from a tenth to ten times the scene's dt.
    accuracies: the errors asked for over the horizon: metres, "1mm", or "0.1%" of the scene's size.
        Steps of the scene's dt then keep them, and the map shows the error delivered over the one
        asked for. By default, if the model's steps keep an accuracy, seven around it.
    integrators: one or several, one panel each; by default the scene's own.
    deviation: the error above which a run is inaccurate: metres, "1mm", or "10%" of the scene's
        size. It is the RMS position error of `stepcore.engine.norm`, as in every measurement.
    engine: "stepcore", or "mujoco", which also runs files that stepcore cannot load.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    The true motion of a value is the converged motion of the scene with that value, known to a
    tenth of `deviation`, or of the finest accuracy asked for.

    A cell is *exploded* if the run failed, a body is further than 100 sizes of the scene from where
    it began or belongs, or a hinge turns 100 times as fast as in the true motion. It is
    *inaccurate* if the error is larger than `deviation`, and *accurate* otherwise; *finite* if that
    is not known, because the true motion is less sure.

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
    units.length("stability_map", "deviation", deviation, 1.0)
    lesson = _lesson(model, path, deviation) if engine == "stepcore" else None
    source: Source = "lesson:spring" if model is None else model
    if lesson is not None and lesson.model is not None:
        source = lesson.model
    missing = "no motion to map"
    setup = set_up(stability_map, source, motion, fields, missing=missing, engine=engine)
    names = None if integrators is None else _integrators(setup.engine, integrators)
    kept = _accuracies(setup.engine, accuracies, dts)
    if lesson is None:
        case = _case(setup, path, values, names)
    else:
        case = _narrowed(lesson, names, setup.motion.key, kept)
    if values is not None:
        case.values = _ascending("values", values)
    if dts is not None:
        given = enumerate(checks.several("dts", dts))
        steps = [units.time(f"dts[{k}]", dt) for k, dt in given]
        case.dts, case.horizon = _ascending("dts", steps), None
    if kept:
        case.dts = [setup.engine.dt]
    horizon = setup.motion.horizon or case.horizon or max(1.0, STEPS * max(case.dts))
    if horizon < max(case.dts):
        raise ValueError(f"horizon = {horizon:g}: must be >= the largest dt")
    runs = _Runs(setup, case, horizon, kept, deviation)
    runs.make()
    with setup.workers.deadline.closing():
        panels = [runs.panel(setting) for setting in case.settings]
    if all(cell.state == UNTRIED for panel in panels for cell in panel.cells):
        raise OutOfTime("no cell has been run")
    ends = dict[float, float]()
    for (_, value), truth in runs.truths.items():
        if truth is not None:
            ends[value] = min(truth.growth.overall, ends.get(value, math.inf))
    return StabilityMap(
        name=setup.name,
        settings=setup.engine.settings(SHIPPED),
        motion=dataclasses.replace(setup.motion, horizon=horizon, key=case.key),
        path=case.path,
        axis=case.axis,
        values=case.values,
        dts=case.dts,
        horizon=horizon,
        deviation=runs.deviation,
        panels=panels,
        ran=_ran(setup.engine, case, horizon),
        accuracies=kept,
        notes=until_in_words(np.array([*ends.values()]), horizon, "at", "value"),
    )


class _Cell(NamedTuple):
    """A cell to run. step: its time step [s], or the error that it asks for [m]."""

    value: float
    step: float
    study: Study
    change: Change


class _Runs:
    """The runs of a map: a Study for each time grid.

    accuracies: asked for over the horizon [m], in place of time steps; or none.
    deviation: the error above which a cell is inaccurate [m].
    truths: the true motions, by study and value; None where none converges.
    """

    def __init__(
        self,
        setup: Setup,
        case: MapCase,
        horizon: float,
        accuracies: Sequence[float],
        deviation: float | str,
    ) -> None:
        self.engine, self.workers, self.case = setup.engine, setup.workers, case
        if case.truth is not None:
            # The true motion of all panels is that of other settings.
            true = setup.model.with_settings(**case.truth)
            self.engine = engine_of(true, "stepcore", setup.motion)
        self.horizon, self.accuracies = horizon, accuracies
        self.size = case.size or self.engine.size
        self.deviation = units.length("stability_map", "deviation", deviation, self.size)
        held: dict[str, Any] = {"kind": "hold"}
        if self.engine.known:
            ctrl = home(self.engine.model, case.key)[1]
            held = {"ctrl": ctrl[None]} if len(ctrl) else {}
        self.motion = Motion(horizon=horizon, key=case.key, starts=1, **held)
        self.studies: dict[float, Study] = {}
        self.truths: dict[tuple[Study, float], Truth | None] = {}
        self.cells = {setting.label: [*self._of(setting)] for setting in case.settings}

    def _of(self, setting: MapSetting) -> Iterator[_Cell]:
        """Yield the cells of one panel, values outermost."""
        adapts = self.engine.settings(SHIPPED).accuracy is not None
        for value in self.case.values:
            for step in self.accuracies or self.case.dts:
                fields: dict[str, Any] = {"dt": step} | ({"accuracy": None} if adapts else {})
                if self.accuracies:
                    fields = {"dt": self.engine.dt, "accuracy": step / self.horizon}
                change = Change({self.case.path: value}, **setting.settings, **fields)
                yield _Cell(value, step, self.study(fields["dt"]), change)

    def study(self, dt: float) -> Study:
        """Return the Study for a time step.

        Time steps share a Study if they divide its period; any other has one of its own, whose true
        motion is sampled at its times.
        """
        own = self.engine.dt
        period = own if self.accuracies else self.case.period or WHOLE * own
        period = often(period, own, self.horizon)
        if not divides(dt, period):
            period = dt * max(1, round(own / dt))
        if period not in self.studies:
            how: dict[str, Any] = {"period": period, "workers": self.workers}
            self.studies[period] = Study(motion=self.motion, engine=self.engine, **how)
        return self.studies[period]

    def make(self) -> None:
        """Make the true motions, and then all cells, as far as the time allows."""
        every = [cell for cells in self.cells.values() for cell in cells]
        wanted = dict.fromkeys((cell.study, cell.value) for cell in every)
        deadline = self.workers.deadline
        finest = min(self.accuracies, default=self.deviation)
        with (
            deadline.stage("all true motions", SEARCHED),
            self.workers.bar("true motion", len(wanted)) as bar,
        ):
            for study, value in wanted:
                try:
                    truth = study.truth(finest, physics=Change({self.case.path: value}))
                except ValueError:
                    truth = None
                self.truths[study, value] = truth
                bar.advance()
        for label, cells in self.cells.items():

            def left_out(label: str = label, cells: Sequence[_Cell] = cells) -> str:
                left = sum(not cell.study.ran(cell.change, 0) for cell in cells)
                return f"{left} of {len(cells)} cells of {label}"

            with deadline.stage(left_out):
                for study in dict.fromkeys(cell.study for cell in cells):
                    own = [cell.change for cell in cells if cell.study is study]
                    study.tracks(own, study.starts, label)

    def panel(self, setting: MapSetting) -> MapPanel:
        """Judge the cells of one setting."""
        cells = [self.judged(cell) for cell in self.cells[setting.label]]
        boundary = None
        if setting.boundary is not None and not self.accuracies:
            boundary = setting.boundary(self.case.values)
        if boundary is None or all(np.isnan(limit) for limit in boundary):
            return MapPanel(setting.label, cells)
        return MapPanel(setting.label, cells, boundary, setting.beyond)

    def judged(self, own: _Cell) -> MapCell:
        """Return one cell with its state; see `stability_map`."""
        study, asked = own.study, own.step if self.accuracies else None
        dt = self.engine.dt if self.accuracies else own.step
        cell = MapCell(own.value, dt, UNTRIED, asked=asked)
        if not study.ran(own.change, 0):
            return cell
        (tracks,) = study.tracks([own.change], study.starts)
        truth = self.truths.get((study, own.value))
        if tracks.failure:
            reason = tracks.failure.removeprefix("start 0: ")
            return dataclasses.replace(cell, state=EXPLODED, reason=reason)
        if truth is None:
            return dataclasses.replace(cell, state=FINITE)
        far = apart(tracks, truth.tracks, study.engine.matter)
        error, most = float(rms(far, truth.scored)[0]), float(largest(far)[0])
        bound = asked or self.deviation
        if most > FAR * self.size or (
            error > bound and self.spin(study, own.change) > FAR * self.spin(study, truth.change)
        ):
            return dataclasses.replace(cell, state=EXPLODED, error=error)
        # Within what the true motion is unsure of, a cell cannot be judged.
        sure = abs(error - bound) >= truth.error
        state = FINITE if not sure else ACCURATE if error <= bound else INACCURATE
        return dataclasses.replace(cell, state=state, error=max(error, truth.error))

    def spin(self, study: Study, change: Change) -> float:
        """Return the largest speed of a hinge in a run [rad/s], but at least a turn a horizon.

        A hinge that spins ever faster brings no body further away.
        """
        least, engine = 2 * np.pi / self.horizon, study.engine
        if not isinstance(engine, Stepcore):
            return least
        model = engine.model
        hinges = [j for j, kind in enumerate(model.jnt_type) if kind == "hinge"]
        speeds = run(engine.of(change), study.schedule, [0], record=("qvel",))["qvel"]
        fastest = np.abs(speeds[0][:, model.jnt_dofadr[hinges]]).max(initial=0.0)
        return max(least, float(fastest))


def _ran(engine: Engine, case: MapCase, horizon: float) -> str:
    """Return the motion in words, and the contact law if all panels have the same."""
    if not engine.known:
        return f"{seconds(horizon)} from the start; the keyframe's controls; in MuJoCo alone"
    model = engine.model
    laws = {str(s.settings.get("law", model.settings.law)) for s in case.settings}
    law = f"; law {laws.pop()}" if len(laws) == 1 else ""
    drive = held_in_words(model, home(model, case.key)[1])
    begin = start_in_words(model, case.key)
    return f"{seconds(horizon)} from {begin}; {drive}{law}{without_in_words(model)}"


# --- what is mapped -------------------------------------------------------------------------------


def _lesson(model: Any, path: str | None, deviation: float | str) -> MapCase | None:
    """Return the lesson's map that is asked for, or None."""
    if path is not None or model not in (None, "lesson:spring", "lesson:stack"):
        return None
    if model == "lesson:stack":
        return maps.stack(units.length("stability_map", "deviation", deviation, maps.SMALL))
    return maps.spring()


def _narrowed(
    case: MapCase, names: list[str] | None, key: str | int | None, accuracies: Sequence[float]
) -> MapCase:
    """Return a map of the lesson, reduced to the named integrators."""
    if accuracies:
        raise ValueError("accuracies: the lesson's maps are over dt; name a value to map it")
    if key is not None:
        text = "must be None, because the lesson's maps have their own start"
        raise ValueError(f"key = {checks.shown(key)}: {text}")
    if names is None:
        return case
    if case.truth is not None:
        text = "the map of the stack is by law and sweeps; name a value to map it by integrator"
        raise ValueError(f"integrators = {checks.shown(names)}: must be None, because {text}")
    chosen = [setting for setting in case.settings if setting.label in names]
    return dataclasses.replace(case, settings=chosen)


def _case(
    setup: Setup, path: str | None, values: Sequence[float] | None, names: list[str] | None
) -> MapCase:
    """Return the map of a scene over a parameter, with one panel for each integrator."""
    engine, key = setup.engine, setup.motion.key
    if path is None:
        joints = [joint.name for joint in setup.model.scene.joints] if engine.known else []
        own = next(filter(None, joints), "knee")
        raise ValueError(f'path = None: must name the value to vary, as "joint/{own}/damping"')
    names = names or [str(engine.settings(SHIPPED).integrator)]
    model, present = None, None
    if engine.known:
        model = setup.model
        # Of a vector the first, which a number replaces.
        present = next(iter(np.ravel(own_value(model, path)).tolist()), None)
        if key is not None:
            model.index("key", key)
        elif model.keys:
            key = 0
    number = checks.number(present)
    if values is None and (number is None or number <= 0):
        known = checks.shown(present) if engine.known else "not known to stepcore"
        raise ValueError(f"values = None: must be given, because {path} is {known}")
    theory = {} if model is None else {n: partial(_linear, model, path, key, n) for n in names}
    return MapCase(
        model,
        path=path,
        axis=path,
        values=(np.geomspace(0.01, 100.0, 13) * (number or 1.0)).tolist(),
        dts=divisors(WHOLE * engine.dt, engine.dt * np.geomspace(0.1, 10.0, 13)),
        settings=[MapSetting(n, {"integrator": n}, theory.get(n), SPRINGS) for n in names],
        key=key,
    )


def _linear(
    model: Model, path: str, key: str | int | None, integrator: str, values: Sequence[float]
) -> list[float]:
    return [limit_of_springs(model.with_values({path: v}), key, integrator) for v in values]


def limit_of_springs(model: Model, key: str | int | None, integrator: str) -> float:
    """Return the largest stable dt of a scene's joint springs, dampers and servos at its start [s].

    NaN if the scene has none of these elements, or they grow by themselves, at any dt. Contacts,
    limits, gravity and Coriolis terms are left out.
    """
    sim = unwatched(Sim(model))
    sim.reset(key=key)
    slopes = {e: s for e, s in sim.element_slopes().items() if e.kind in LINEAR}
    implicit = implicit_kinds(integrator, model.scene.features.eulerdamp)
    none = np.zeros((model.nv, model.nv))
    stiffness = sum((s.stiffness for s in slopes.values()), none)
    damping = sum((s.damping for s in slopes.values()), none)
    late = sum((s.damping for e, s in slopes.items() if e.kind in implicit), none)
    if not (stiffness.any() or damping.any()):
        return float("nan")
    mass, one = sim.mass_matrix(), np.eye(model.nv)
    pulled, braked = (np.linalg.solve(mass, matrix) for matrix in (stiffness, damping))
    rates = np.linalg.eigvals(np.block([[none, one], [-pulled, -braked]]))
    # Rounding moves a double eigenvalue by the square root of rounding.
    if rates.real.max() > (maps.GROWING - 1.0) * np.abs(rates).max():
        return float("nan")
    return largest_stable_dt(integrator, mass, stiffness, damping, late)


def _accuracies(
    engine: Engine, given: Sequence[float | str] | None, dts: Sequence[float | str] | None
) -> list[float]:
    """Return the accuracies of a map over them [m], ascending; empty of a map over dt."""
    own = engine.settings(SHIPPED).accuracy
    if given is None:
        return [] if own is None or dts is not None else (own * np.geomspace(0.1, 100, 7)).tolist()
    if dts is not None:
        raise ValueError("accuracies and dts: give one of them, because steps choose their length")
    if engine.name != "stepcore":
        raise ValueError("accuracies: must be None, because MuJoCo's steps have a fixed length")
    said = [
        units.length("stability_map", f"accuracies[{k}]", value, engine.size)
        for k, value in enumerate(checks.several("accuracies", given))
    ]
    return _ascending("accuracies", said)


def _integrators(engine: Engine, asked: str | Sequence[str]) -> list[str]:
    names = [asked] if isinstance(asked, str) else list(asked)
    if not names:
        raise ValueError("integrators = []: must name at least one")
    for name in names:
        engine.settings(Change(integrator=name))
    return names


def _ascending(name: str, values: Sequence[float]) -> list[float]:
    """Return positive numbers in ascending order, without repetition."""
    numbers = [checks.number(value) for value in checks.several(name, values)]
    for k, number in enumerate(numbers):
        if number is None or number <= 0:
            shown = checks.shown(values[k])
            raise ValueError(f"{name}[{k}] = {shown}: must be a finite number > 0")
    if len(set(numbers)) < len(numbers):
        raise ValueError(f"{name}: contains the same number twice")
    return sorted(number for number in numbers if number is not None)
