"""`stability_map`: the stable and accurate region over dt and one parameter of the scene."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Unpack

import numpy as np

from stepcore import checks
from stepcore.deadline import SEARCHED, OutOfTime
from stepcore.engine.linear_maps import implicit_kinds, step_matrix
from stepcore.engine.model import Model
from stepcore.engine.norm import distances, largest
from stepcore.engine.parameters import own_value
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.arguments import MeasurementFields, Setup, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.engines import FAR, Engine
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import held_in_words, start_in_words, without_in_words
from stepcore.experiment.predictable import until_in_words
from stepcore.experiment.quantity import Measure, Quantity, Wanted
from stepcore.experiment.schedule import divides, home, often
from stepcore.experiment.study import SHIPPED, Study
from stepcore.experiment.truth import Truth
from stepcore.report import units
from stepcore.report.report import not_shown
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import counted, seconds

__all__ = ["MapCell", "MapPanel", "StabilityMap", "stability_map"]

# Least horizon in steps of the largest dt, so that instabilities have time to grow.
STEPS = 25
# The default steps divide this many shipped steps, the interval at which runs are compared.
WHOLE = 20
# Motion fields that a map does not accept: every cell starts at the keyframe with its controls.
WITHOUT = ("starts", "seed", "control", "ctrl", "control_dt", "interpolation", "kind", "follow")
# Kinds of elements in the linear system of a scene.
LINEAR = ("spring", "damper", "actuator")
# Spectral radius above which motion grows: rounding moves a double eigenvalue by the square root of
# rounding.
GROWING = 1.0 + 1e-6
# The theoretical limit of a map: the dt beyond which the linear system grows.
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
    error: RMS position error [m], or the error of the quantity in its unit, at least the
        uncertainty of the converged motion; NaN if unknown.
    reason: why the run failed.
    """

    value: float
    dt: float
    state: str
    error: float = math.nan
    reason: str | None = None


@dataclass(frozen=True)
class MapPanel:
    """The cells of one integrator, values outermost, and the theoretical limit.

    boundary: the limit of springs for each value [s]: 0 if no step is stable, inf if all are; None
        if there is no such limit.
    """

    label: str
    cells: list[MapCell]
    boundary: list[float] | None = None

    def at(self, value: float) -> list[MapCell]:
        """Return the cells of one value, by dt."""
        return [cell for cell in self.cells if cell.value == value]


@dataclass(eq=False, repr=False)
class StabilityMap(Result):
    """A map of stability and accuracy over dt and one parameter; `stability_map` returns it.

    path: the parameter that is varied.
    values, dts [s]: the grid.
    deviation: the error above which a run is inaccurate [m], or in the unit of the quantity.
    measure: the quantity whose error is judged, by default the motion.
    panels: one panel for each integrator.

    >>> from stepcore import stability_map
    >>> grid = {"values": [100.0], "dts": [0.001, 0.5]}
    >>> stability_map("lesson:spring", path="joint/spring/stiffness", **grid, progress=False)
    <StabilityMap of spring: 2 cells in 1 panel>
    """

    kind = "stability"
    settings: Any
    motion: Motion
    path: str
    values: Sequence[float]
    dts: Sequence[float]
    horizon: float
    deviation: float
    panels: list[MapPanel]
    measure: Measure

    def __post_init__(self) -> None:
        unjudged = sum(cell.state == FINITE for cell in self.rows)
        if unjudged:
            self.notes.append(
                f"{counted(unjudged, 'finite run')}, marked {SYMBOLS[FINITE]}, cannot be judged "
                "for accuracy, because the converged motion is too uncertain or was not run in the "
                "time available"
            )

    @property
    def units(self) -> dict[str, str]:  # type: ignore[override]
        """The units of the columns of `table`."""
        return {"dt": "s", "theory": "s", "error": self.measure.unit}

    @property
    def title(self) -> str:
        """The measured quantity in a few words."""
        is_motion = self.measure.quantity.is_motion
        accuracy = "accuracy" if is_motion else f"accuracy of {self.measure.quantity.name}"
        return f"{self.name}: stability and {accuracy} over dt × {self.path}"

    @property
    def setup(self) -> str:
        """The meaning of the cells' marks."""
        accurate, inaccurate, exploded = (f"{s} ({SYMBOLS[s]})" for s in list(SYMBOLS)[:3])
        theory = any(panel.boundary for panel in self.panels)
        return (
            f"{accurate}: the {self.measure.error_words} is at most "
            f"{self.measure.words(self.deviation)}; "
            f"{inaccurate}: it is larger; {exploded}: the run failed, or a body went further than "
            f"{FAR:g} times the scene's size."
        ) + f" {SPRINGS}: {LEFT_OUT}." * theory

    @property
    def sentences(self) -> list[str]:
        """The number of cells in each state for each integrator, the scene's first."""
        sentences = []
        for panel in sorted(self.panels, key=lambda panel: panel is not self._first):
            count = Counter(cell.state for cell in panel.cells)
            states = ", ".join(f"{count[state]} {state}" for state in SYMBOLS if count[state])
            sentences.append(f"{panel.label}: of {counted(len(panel.cells), 'cell')}, {states}.")
            if number := self._beyond_twice(panel):
                sentences.append(
                    f"{number} of the accurate runs have steps of more than twice the {SPRINGS}: "
                    "friction, contacts, bounds of forces or the end of the motion keep them from "
                    "exploding, and another motion may explode there."
                )
        return sentences

    def _beyond_twice(self, panel: MapPanel) -> int:
        """Return the number of accurate runs whose step exceeds twice the limit of springs."""
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
                rows.append(row | {"reason": cell.reason})
        return Table(rows)

    def tables(self, full: bool) -> list[Table]:
        """Return the panels with one row for each value and one mark for each dt.

        full: whether to return all panels rather than the first.
        """
        if full or len(self.panels) == 1:
            return [self._table(panel) for panel in self.panels]
        table, left = self._table(self._first), len(self.panels) - 1
        table.legend = not_shown(f"the maps of {counted(left, 'other integrator')}")
        return [table]

    @property
    def _first(self) -> MapPanel:
        shipped = (panel for panel in self.panels if panel.label == self.settings.integrator)
        return next(shipped, self.panels[0])

    def _table(self, panel: MapPanel) -> Table:
        across = f"dt {seconds(self.dts[0])} to {seconds(self.dts[-1])}"
        rows: list[dict[str, Any]] = []
        for k, value in enumerate(self.values):
            cells = panel.at(value)
            row = {"value": value, across: "".join(SYMBOLS[cell.state] for cell in cells)}
            good = [cell.dt for cell in cells if cell.state == ACCURATE]
            unknown = not good and any(cell.state in (FINITE, UNTRIED) for cell in cells)
            most = max(good, default=0.0)
            longer = any(c.dt > most and c.state in (FINITE, UNTRIED) for c in cells)
            row["largest accurate"] = "unknown" if unknown else "≥ " * longer + _dt(most)
            if panel.boundary is not None:
                row[SPRINGS] = _dt(panel.boundary[k])
            rows.append(row)
        # A column with a format is not truncated.
        return Table(rows, formats={"value": ".3g", across: ""}, heading=panel.label)

    def details(self) -> dict[str, Any]:
        """Return the grid and the panels' theory as plain data."""
        return {
            "value": self.path,
            "values": list(self.values),
            "dts": list(self.dts),
            "deviation": self.deviation,
            "quantity": self.measure.quantity.name,
            "panels": [{"setting": p.label, "boundary": p.boundary} for p in self.panels],
        }

    def __repr__(self) -> str:
        cells, panels = counted(len(self.rows), "cell"), counted(len(self.panels), "panel")
        return f"<StabilityMap of {self.name}: {cells} in {panels}>"


def _dt(value: float) -> str:
    if value == 0 or math.isnan(value):
        return "" if value else "none"
    return seconds(value) if math.isfinite(value) else "any"


@measurement(without=WITHOUT)
def stability_map(
    model: Source,
    motion: Motion | str | None = None,
    *,
    path: str | None = None,
    values: Sequence[float] | None = None,
    dts: Sequence[float | str] | None = None,
    integrators: str | Sequence[str] | None = None,
    deviation: float | str = "10%",
    quantity: Wanted = None,
    engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> StabilityMap:
    """Map stability and accuracy over dt × a parameter of the scene, with one run for each pair.

    model: a Model, a Scene, or anything that `stepcore.load` accepts.
    motion: a `Motion`, or its fields as arguments: the horizon (by default 1 s, or 25 of the
        largest dt if longer) and the keyframe to start from (by default the first), whose controls
        are held constant. The motion has one start and no other controls.
    path: the parameter that is varied, as in `Model.with_values`: "joint/knee/stiffness",
        "body/arm/mass", "actuator/grip/kp".
    values: the parameter's values, sorted ascending in the map; by default 13 from a hundredth to a
        hundred times the present value.
    dts: the time steps [s]; by default 12 from a tenth to ten times the scene's dt.
    integrators: one or several, one panel each; by default the scene's integrator.
    deviation: the error above which a run is inaccurate: metres, "1mm", or "10%" of the scene's
        size. It is the RMS position error of `stepcore.engine.norm`, as in every measurement; of a
        quantity, its error in its unit, or "10%" of its range over the shipped motion.
    quantity: the quantity whose error is judged, such as "site/tip" or "max(contact/foot)"; see
        `stepcore.experiment.Quantity`. By default the motion of all bodies.
    engine: "stepcore", or "mujoco", which also runs files that stepcore cannot load.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Each run is compared with the converged motion of the scene with that value, whose uncertainty
    is at most a tenth of `deviation`.

    A cell is *exploded* if the run failed, or if a body is further than 100 sizes of the scene from
    its start or its converged position. It is *inaccurate* if the error is larger than `deviation`,
    and *accurate* otherwise; *finite* if the uncertainty of the converged motion is too large to
    decide.

    The theoretical boundary is the stability limit of the linear system of joint springs, dampers
    and servos at the start: the dt beyond which the system's step matrix has a spectral radius
    above 1.

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
    quantity = Quantity.of(quantity)
    if quantity.is_motion:
        units.length("stability_map", "deviation", deviation, 1.0)
    setup = set_up(stability_map, model, motion, fields, missing="no motion to map", engine=engine)
    names = _integrators(setup.engine, integrators)
    path, values, key = _parameter(setup, path, values)
    steps = _steps(setup.engine.dt, dts)
    horizon = setup.motion.horizon or max(1.0, STEPS * max(steps))
    if horizon < max(steps):
        raise ValueError(f"horizon = {horizon:g}: must be >= the largest dt")
    held: dict[str, Any] = {"kind": "hold"}
    if setup.engine.known:
        ctrl = home(setup.engine.model, key)[1]
        held = {"ctrl": ctrl[None]} if len(ctrl) else {}
    motion = Motion(horizon=horizon, key=key, starts=1, **held)
    runs = _Runs(setup, motion, quantity, deviation)
    cells = {name: [*runs.cells(path, values, steps, name)] for name in names}
    runs.make([cell for panel in cells.values() for cell in panel])
    with setup.workers.deadline.closing():
        panels = [runs.panel(name, cells[name], path, values) for name in names]
    if all(cell.state == UNTRIED for panel in panels for cell in panel.cells):
        raise OutOfTime("no cell has been run")
    return StabilityMap(
        name=setup.name,
        settings=setup.engine.settings(SHIPPED),
        motion=dataclasses.replace(setup.motion, horizon=horizon, key=key),
        path=path,
        values=values,
        dts=steps,
        horizon=horizon,
        deviation=runs.deviation,
        measure=runs.shipped.measure,
        panels=panels,
        ran=_ran(setup.engine, key, horizon),
        notes=until_in_words(runs.predictable(), horizon, "at", "value"),
    )


class _Cell(NamedTuple):
    """A cell to run, and its study."""

    value: float
    dt: float
    study: Study
    change: Change
    scene: Change


class _Runs:
    """The runs of a map: a Study for each period of comparison.

    deviation: the error above which a cell is inaccurate [m].
    shipped: the study of the shipped step.
    truths: the converged motions, by study and value; None if none converges.
    """

    def __init__(
        self, setup: Setup, motion: Motion, quantity: Quantity, deviation: float | str
    ) -> None:
        self.engine, self.workers, self.motion = setup.engine, setup.workers, motion
        self.quantity = quantity
        self.studies: dict[float, Study] = {}
        self.shipped = self.study(self.engine.dt)
        self.deviation = self.shipped.error_of("stability_map", deviation, "deviation")
        self.truths: dict[tuple[Study, float], Truth | None] = {}

    def cells(
        self, path: str, values: Sequence[float], dts: Sequence[float], integrator: str
    ) -> Any:
        """Yield the cells of one integrator, values outermost."""
        adaptive = self.engine.settings(SHIPPED).accuracy is not None
        fixed: dict[str, Any] = {"accuracy": None} if adaptive else {}
        for value in values:
            for dt in dts:
                change = Change({path: value}, integrator=integrator, dt=dt, **fixed)
                yield _Cell(value, dt, self.study(dt), change, Change({path: value}))

    def study(self, dt: float) -> Study:
        """Return the Study for a time step.

        Time steps share a Study if they divide its period. Any other time step has a Study whose
        period is a multiple of it.
        """
        shipped, horizon = self.engine.dt, self.motion.horizon or math.inf
        period = often(WHOLE * shipped, shipped, horizon)
        if not divides(dt, period):
            period = dt * max(1, round(shipped / dt))
        if period not in self.studies:
            how: Any = {"engine": self.engine, "period": period, "workers": self.workers}
            self.studies[period] = Study(motion=self.motion, quantity=self.quantity, **how)
        return self.studies[period]

    def make(self, cells: Sequence[_Cell]) -> None:
        """Run the converged motions, then all cells, as far as the time allows."""
        wanted = {(cell.study, cell.value): cell.scene for cell in cells}
        deadline = self.workers.deadline
        with (
            deadline.stage("all converged motions", SEARCHED),
            self.workers.bar("converged motion", len(wanted)) as bar,
        ):
            for (study, value), scene in wanted.items():
                try:
                    truth = study.truth(self.deviation, physics=scene)
                except ValueError:
                    truth = None
                self.truths[study, value] = truth
                bar.advance()

        def left_out() -> str:
            left = sum(not cell.study.ran(cell.change, 0) for cell in cells)
            return f"{left} of {counted(len(cells), 'cell')}"

        with deadline.stage(left_out):
            for study in dict.fromkeys(cell.study for cell in cells):
                changes = [cell.change for cell in cells if cell.study is study]
                study.tracks(changes, study.starts, "cells")

    def panel(
        self, integrator: str, cells: Sequence[_Cell], path: str, values: Sequence[float]
    ) -> MapPanel:
        """Judge the cells of one integrator."""
        judged, boundary = [self.judged(cell) for cell in cells], list[float]()
        if self.engine.known:
            models = (self.engine.model.with_values({path: value}) for value in values)
            boundary = [limit_of_springs(model, self.motion.key, integrator) for model in models]
        known = not all(map(math.isnan, boundary))
        return MapPanel(integrator, judged, boundary if known else None)

    def judged(self, cell: _Cell) -> MapCell:
        """Return one cell with its state; see `stability_map`."""
        study, result = cell.study, MapCell(cell.value, cell.dt, UNTRIED)
        if not study.ran(cell.change, 0):
            return result
        (tracks,) = study.tracks([cell.change], study.starts)
        truth = self.truths.get((study, cell.value))
        if tracks.failure:
            reason = tracks.failure.removeprefix("start 0: ")
            return dataclasses.replace(result, state=EXPLODED, reason=reason)
        if truth is None:
            return dataclasses.replace(result, state=FINITE)
        distance = distances(tracks, truth.tracks, study.engine.matter)
        error = float(study.measure.error(tracks, truth.tracks, truth.scored)[0])
        most = float(largest(distance)[0])
        if most > FAR * self.engine.size:
            return dataclasses.replace(result, state=EXPLODED, error=error)
        decided = abs(error - self.deviation) >= truth.error
        state = ACCURATE if error <= self.deviation else INACCURATE
        state = state if decided else FINITE
        return dataclasses.replace(result, state=state, error=max(error, truth.error))

    def predictable(self) -> np.ndarray:
        """Return the shortest predictable time of each value's motions [s]."""
        ends = dict[float, float]()
        for (_, value), truth in self.truths.items():
            if truth is not None:
                ends[value] = min(truth.growth.overall, ends.get(value, math.inf))
        return np.array([*ends.values()])


def _ran(engine: Engine, key: str | int | None, horizon: float) -> str:
    """Return the motion and the contact law in words."""
    if not engine.known:
        drive = f"{seconds(horizon)} from the start; the keyframe's controls"
        return f"{drive}; in {engine.version} alone"
    model = engine.model
    drive = held_in_words(model, home(model, key)[1])
    begin, without = start_in_words(model, key), without_in_words(model)
    return f"{seconds(horizon)} from {begin}; {drive}; law {model.settings.law}{without}"


def _parameter(
    setup: Setup, path: str | None, values: Sequence[float] | None
) -> tuple[str, list[float], str | int | None]:
    """Return the path, its values in ascending order, and the keyframe to start from."""
    engine, key, present = setup.engine, setup.motion.key, None
    if path is None:
        joints = [joint.name for joint in setup.model.scene.joints] if engine.known else []
        joint = next(filter(None, joints), "knee")
        raise ValueError(f'path = None: must name the value to vary, as "joint/{joint}/damping"')
    if engine.known:
        # Use the first number of a vector, because the map replaces only that.
        present = next(iter(np.ravel(own_value(setup.model, path)).tolist()), None)
        if key is not None:
            setup.model.index("key", key)
        elif setup.model.keys:
            key = 0
    number = checks.number(present)
    if values is None and (number is None or number <= 0):
        shown = checks.shown(present) if engine.known else "unknown to stepcore"
        raise ValueError(f"values = None: must be given, because {path} is {shown}")
    if values is None:
        values = (np.geomspace(0.01, 100.0, 13) * (number or 1.0)).tolist()
    return path, _ascending("values", values), key


def _steps(shipped: float, dts: Sequence[float | str] | None) -> list[float]:
    """Return the time steps in ascending order [s]; the default ones divide WHOLE shipped steps."""
    if dts is not None:
        items = enumerate(checks.nonempty("dts", dts))
        return _ascending("dts", [units.time(f"dts[{k}]", dt) for k, dt in items])
    counts = {round(WHOLE / share) for share in np.geomspace(0.1, 10.0, 13).tolist()}
    return [WHOLE * shipped / count for count in sorted(counts, reverse=True)]


def limit_of_springs(model: Model, key: str | int | None, integrator: str) -> float:
    """Return the largest stable dt of a scene's joint springs, dampers and servos at its start [s].

    NaN if the scene has none of these elements, or if the exact motion of the linear system grows.
    Contacts, limits, gravity and Coriolis terms are left out.
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
    mass, identity = sim.mass_matrix(), np.eye(model.nv)
    pulled, braked = (np.linalg.solve(mass, matrix) for matrix in (stiffness, damping))
    rates = np.linalg.eigvals(np.block([[none, identity], [-pulled, -braked]]))
    # Rounding moves a double eigenvalue by the square root of rounding.
    if rates.real.max() > (GROWING - 1.0) * np.abs(rates).max():
        return float("nan")
    return largest_stable_dt(integrator, mass, stiffness, damping, late)


def largest_stable_dt(
    integrator: str,
    mass: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    implicit: np.ndarray,
) -> float:
    """Return the dt [s] beyond which the motion grows: 0 if always, inf if never."""

    def grows(dt: float) -> bool:
        matrix = step_matrix(integrator, dt, mass, stiffness, damping, implicit)
        return bool(np.abs(np.linalg.eigvals(matrix)).max() > GROWING)

    rates = np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)))
    drags = np.abs(np.linalg.eigvals(np.linalg.solve(mass, damping)))
    fastest = max(float(np.sqrt(rates.max())), float(drags.max()))
    if fastest == 0.0:
        return np.inf
    steps = np.geomspace(2e-2, 1e3, 200) / fastest
    first = next((k for k, dt in enumerate(steps) if grows(dt)), None)
    if not first:
        return 0.0 if first == 0 else np.inf
    low, high = steps[first - 1], steps[first]
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if grows(middle) else (middle, high)
    return float(low)


def _integrators(engine: Engine, integrators: str | Sequence[str] | None) -> list[str]:
    if integrators is None:
        return [str(engine.settings(SHIPPED).integrator)]
    names = [integrators] if isinstance(integrators, str) else list(integrators)
    if not names:
        raise ValueError("integrators = []: must name at least one")
    for name in names:
        engine.settings(Change(integrator=name))
    return names


def _ascending(name: str, values: Sequence[float]) -> list[float]:
    """Return positive numbers in ascending order, without repetition."""
    numbers = [checks.number(value) for value in checks.nonempty(name, values)]
    for k, number in enumerate(numbers):
        if number is None or number <= 0:
            shown = checks.shown(values[k])
            raise ValueError(f"{name}[{k}] = {shown}: must be a finite number > 0")
    if len(set(numbers)) < len(numbers):
        raise ValueError(f"{name}: contains the same number twice")
    return sorted(number for number in numbers if number is not None)
