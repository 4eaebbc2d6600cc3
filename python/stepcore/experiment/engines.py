"""Engines, which run a change of a scene and count its work; all have the same truth and norm.

An `Engine` runs a `Schedule` under a `Change` and returns `Tracks`. `Stepcore` is this package's
engine; `stepcore.experiment.mujoco_engine` runs MuJoCo.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.control import Control, ControlError
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.follow import COUNTED, Followed, follow
from stepcore.engine.linear_maps import INTEGRATORS, STAGED
from stepcore.engine.model import Model
from stepcore.engine.norm import Matter, Tracks
from stepcore.engine.run_settings import converged_settings
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.executors import checkpoint
from stepcore.experiment.change import Change
from stepcore.experiment.elements import Elements, Source, contact_forces, elements_of
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import HORIZON, Schedule, scheduled
from stepcore.experiment.sizes import scene_size
from stepcore.report.units import seconds

# A run has failed if a body is this many sizes of the scene away from its start. A distance of a
# few sizes is reported as an error; at a hundred, bodies have left the modelled scene.
# Twice the distance of free fall is allowed in addition.
FAR = 100.0
# The integrators that are tried under MuJoCo's law, and under the laws on velocities.
CONVEX = ("rk4", "implicitfast", "euler", "semi-implicit", "discrete", "midpoint", "implicit")
ON_VELOCITIES = ("rk4", "semi-implicit", "midpoint", "explicit")
# Adaptive steps are not counted one by one if a run would take more operations: eight steps of
# solo12, falling onto its legs, took 49 s to count, steps of 22 humanoids 186 s.
# dm_control's humanoid has 3.5e9.
DEAR = 5e9
# Numbers of sweeps that are tried.
SWEEPS = (2, 8, 30)
# The arrays of a `Recording`.
RECORDED = ("qpos", "qvel", "act", "ctrl", "energy", "actuator_force")


@dataclass(frozen=True)
class Way:
    """A method for the converged motion: a ladder of changes, each rung finer than the last.

    name: of the method. at: returns the change of a rung, from 0 on.
    fixed: whether steps have a fixed length, so that perturbed runs can be compared bit by bit.
    """

    name: str
    at: Callable[[int], Change]
    fixed: bool = True


@dataclass(frozen=True, eq=False)
class Recording:
    """A run, recorded to be judged.

    times: of the samples [s], (n + 1,); the first is 0. arrays: the arrays `RECORDED` at the
    samples, (n + 1, …), NaN after a failure; "energy" has kinetic and potential energy [J].
    failure: why the run ended early, "" if it did not. reached: the simulated time [s].
    """

    times: np.ndarray
    arrays: dict[str, np.ndarray]
    failure: str
    reached: float

    def __getitem__(self, name: str) -> np.ndarray:
        return self.arrays[name]

    @property
    def last(self) -> Start:
        """The state of the last sample."""
        return Start(*(self.arrays[name][-1] for name in ("qpos", "qvel", "act")))


@dataclass(frozen=True, eq=False)
class Course:
    """A run to be recorded, apart from its change and start.

    steps, every: as in `follow`, as are ctrl, hold and control. bound: the largest distance of a
    body from its start [m].
    """

    steps: int
    every: int
    bound: float
    ctrl: np.ndarray | None = None
    hold: int = 1
    control: Control | None = None


class Engine(ABC):
    """Base class of the engines, each of which runs changes of one scene.

    name: of the engine. version: "MuJoCo 4.0.0"; "" for stepcore. title: of the scene. refusal: why
    stepcore has no model of it; else "".
    shipped: the settings of the scene. dt: its time step [s]. nv: the number of dofs.
    matter: the moving bodies. coordinates: of the states. size: the size of the scene [m].
    gravity: [m/s²]. integrators: their names. force_ranges: of the actuators, (nu, 2).
    nearby: the perturbation of a state whose growth is measured, relative to the size or in
    radians.
    """

    nearby = 1e-10
    # What is read at the samples, besides the poses of the bodies.
    sources: tuple[Source, ...] = ()
    # The number of readings at a sample.
    width = 0
    # A schedule of another scene's motion, which replaces that of any motion.
    schedule: Schedule | None = None
    version = ""
    name: str
    title: str
    shipped: Any
    matter: Matter
    coordinates: Coordinates
    nv: int
    size: float
    gravity: float
    integrators: tuple[str, ...]
    force_ranges: np.ndarray

    def __init__(self, model: Model | None, refusal: str = "") -> None:
        self._model, self.refusal = model, refusal
        self._counts = dict[Change, float]()

    def __getstate__(self) -> dict[str, Any]:
        # An executor pickles in another thread, while this thread counts on.
        state = dict(self.__dict__)
        return {name: dict(v) if isinstance(v, dict) else v for name, v in state.items()}

    @property
    def known(self) -> bool:
        """Whether stepcore has a model of the scene."""
        return self._model is not None

    @property
    def model(self) -> Model:
        """stepcore's model of the scene; ValueError if there is none."""
        if self._model is None:
            raise ValueError(f"stepcore cannot load this scene: {self.refusal}")
        return self._model

    def of(self, change: Change) -> Model:
        """Return stepcore's changed model; ValueError if there is none."""
        return change.of(self.model)

    @property
    def dt(self) -> float:
        return float(self.shipped.dt)

    @property
    @abstractmethod
    def elements(self) -> Elements:
        """The named elements of the scene."""

    def reading(self, sources: Sequence[Source]) -> Self:
        """Return the engine, which also records these readings in `Tracks.readings`."""
        engine = copy.copy(self) if sources else self
        engine.sources, shape = tuple(sources), self.elements.shape if sources else None
        whole = [one.array for one in sources if not one.indices and one.array != "contacts"]
        engine.width = len(sources) - len(whole)
        engine.width += sum(math.prod(shape(name)) for name in whole) if shape else 0
        return engine

    def farthest(self, schedule: Schedule) -> float:
        """Return the distance of a body from its start beyond which a run has failed [m]."""
        return FAR * self.size + self.gravity * schedule.horizon**2

    def scheduled(
        self, motion: Motion, period: float, starts: int | None = None, horizon: float = HORIZON
    ) -> Schedule:
        """Return the schedule of a motion; see `stepcore.experiment.schedule.scheduled`."""
        return scheduled(motion, self.model, period, starts, horizon)

    def settings(self, change: Change) -> Any:
        """Return all settings of a change; ValueError for settings that the engine lacks."""
        return self.shipped.replace(**dict(change.settings))

    @abstractmethod
    def compile(self, change: Change, schedule: Schedule) -> None:
        """Make the changed model; ValueError for parts that the scene or the engine lacks."""

    def work(self, change: Change, schedule: Schedule) -> float:
        """Count the operations of a simulated second; inf if no step can be made.

        The states are the same for all changes. A step costs about the same at all lengths, so each
        method is counted at one length; adaptive steps are counted at the change's length.
        """
        try:
            settings = self.settings(change)
            if settings.accuracy is None:
                change = change.also(Change(dt=self.dt))
            if change not in self._counts:
                self._counts[change] = self._counted(change, schedule)
        except (ValueError, SimulationError):
            self._counts[change] = math.inf
            return math.inf
        return self._counts[change] / float(settings.dt)

    def evaluation(self, change: Change, schedule: Schedule) -> float:
        """Count the operations of an evaluation of the forces in adaptive steps."""
        return math.nan

    def halved(self, schedule: Schedule, integrator: str) -> Way:
        """Return the method of an integrator whose steps are halved from rung to rung."""
        steps = schedule.steps(self.dt)

        def at(k: int) -> Change:
            return self._exact(integrator=integrator, dt=schedule.period / (steps * 2**k))

        return Way(integrator, at)

    @abstractmethod
    def follow(
        self, change: Change, schedule: Schedule, starts: Sequence[int], first: int = 1
    ) -> Tracks:
        """Run a change from some starts. `failures` has the runs that fail or are refused.

        first: 0 for tracks that have the start itself before the samples of the schedule.
        """

    # --- runs that are judged: see `stepcore.experiment.pairs` ------------------------------------

    @abstractmethod
    def converged(self) -> Engine:
        """Return the engine with rows solved to rounding, fixed steps, and without sleep.

        The largest stable step then belongs to the integrator alone, without the effects of an
        unfinished solve.
        """

    @abstractmethod
    def changed(self, change: Change) -> Engine:
        """Return the engine of the changed scene."""

    def driven(self, schedule: Schedule) -> Engine:
        """Return the engine of the scene with the servos that the controls need."""
        return self.changed(schedule.change) if schedule.controls.servos else self

    def finest(self, schedule: Schedule) -> Change:
        """Return the integrator of a converged motion at short steps."""
        return Change(integrator="implicitfast")

    @abstractmethod
    def record(self, change: Change, start: Start, course: Course) -> Recording:
        """Record a run of a change; ValueError or SimulationError if no step can be made."""

    @abstractmethod
    def inertia(self, start: Start) -> np.ndarray:
        """Return the diagonal of the mass matrix at a start, (nv,)."""

    @abstractmethod
    def operations_at(self, start: Start, ctrl: np.ndarray | None = None) -> float:
        """Return the operations of a step at a state; 0 if none can be made."""

    # --- truths and candidates --------------------------------------------------------------------

    @abstractmethod
    def ways(self, schedule: Schedule, goal: float) -> list[Way]:
        """Return methods for the converged motion; goal: its target uncertainty [m]."""

    @abstractmethod
    def families(self, schedule: Schedule) -> list[Change]:
        """Return the settings to try, all but the time step: integrators with solvers.

        One solver is enough if no row acts.
        """

    @abstractmethod
    def has_rows(self, schedule: Schedule) -> bool:
        """Return whether a contact, limit or other row acts at a sample of the shipped motion."""

    @abstractmethod
    def seconds(self, change: Change, schedule: Schedule) -> float:
        """Return the processor time of a run from the first start [s]; NaN if it fails."""

    @abstractmethod
    def _counted(self, change: Change, schedule: Schedule) -> float:
        """Return the operations of a step: the mean over states of the shipped motion."""

    @abstractmethod
    def _exact(self, **fields: Any) -> Change:
        """Return the change to settings of a converged motion."""


def spread(states: np.ndarray) -> np.ndarray:
    """Return the indices of a few finite states, evenly spread over a motion; states: (n, …)."""
    whole = np.flatnonzero(np.isfinite(states).all(axis=-1))
    return whole[np.unique(np.linspace(0, len(whole) - 1, COUNTED).astype(int))]


class Stepcore(Engine):
    """This package's engine, for one model."""

    name = "stepcore"

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        self.title, self.shipped = model.scene.name or "scene", model.settings
        self.matter, self.coordinates, self.nv = Matter.of(model), Coordinates(model), model.nv
        self.size, self.gravity = scene_size(model.scene), 0.0
        if model.scene.features.gravity:
            self.gravity = math.hypot(*model.scene.gravity)
        self.integrators, self.force_ranges = tuple(INTEGRATORS), model.actuator_forcerange
        self._models: dict[Change, Model] = {}
        self._looks: list[tuple[np.ndarray, ...]] = []
        self._evaluations: dict[Change, float] = {}
        self._rows: bool | None = None

    def of(self, change: Change) -> Model:
        """Return the changed model; each physics is compiled once."""
        physics = change.physics
        if physics not in self._models:
            self._models[physics] = physics.of(self.model)
        return change.with_settings(self._models[physics])

    def compile(self, change: Change, schedule: Schedule) -> None:
        schedule.driven_model(self.of(change))

    def follow(
        self, change: Change, schedule: Schedule, starts: Sequence[int], first: int = 1
    ) -> Tracks:
        try:
            model = self.of(change)
            ran = run(
                model,
                schedule,
                starts,
                record=("xpos", "xquat", *self._arrays),
                probe=self._probe,
                bound=self.farthest(schedule),
            )
        except ControlError:
            raise
        except (ValueError, SimulationError) as error:
            shape = (len(starts), len(schedule.times) + 1 - first, len(self.matter.moving))
            why = dict.fromkeys(range(len(starts)), one_line(error))
            nothing = np.full((*shape, 4), np.nan)
            readings = np.full((*shape[:2], self.width), np.nan) if self.sources else None
            return Tracks(nothing[..., :3], nothing, why, readings=readings)
        failures = {k: one_line(error) for k, error in ran.failures.items()}
        tracks = self.matter.tracks(ran["xpos"][:, first:], ran["xquat"][:, first:], failures)
        evaluations = ran.inner if model.settings.accuracy is not None else None
        readings = self._read(ran)[:, first:] if self.sources else None
        return dataclasses.replace(tracks, evaluations=evaluations, readings=readings)

    @property
    def elements(self) -> Elements:
        return elements_of(self.model, self.matter.moving)

    @property
    def _arrays(self) -> tuple[str, ...]:
        """The arrays that are read, besides the poses."""
        return tuple(dict.fromkeys(one.array for one in self.sources if one.array != "contacts"))

    @property
    def _probe(self) -> Callable[[Sim], np.ndarray] | None:
        contacts = [source for source in self.sources if source.array == "contacts"]
        return partial(contact_forces, sources=contacts) if contacts else None

    def _read(self, ran: Followed) -> np.ndarray:
        """Return the readings of runs, (starts, n, k)."""
        readings, contacts = list[np.ndarray](), 0
        for source in self.sources:
            if source.array == "contacts":
                readings.append(ran["probe"][..., [contacts]])
                contacts += 1
            elif source.indices:
                some = ran[source.array][..., list(source.indices)]
                readings.append(some.sum(axis=-1, keepdims=True))
            else:
                whole = ran[source.array]
                readings.append(whole.reshape(*whole.shape[:2], -1))
        return np.concatenate(readings, axis=-1)

    def evaluation(self, change: Change, schedule: Schedule) -> float:
        self.work(change, schedule)
        return self._evaluations.get(change, math.inf)

    def seconds(self, change: Change, schedule: Schedule) -> float:
        try:
            ran = run(self.of(change), schedule, schedule.indices[:1], record=())
        except (ValueError, SimulationError):
            return math.nan
        return math.nan if ran.failures else ran.seconds

    def _counted(self, change: Change, schedule: Schedule) -> float:
        names = ("qpos", "qvel", "act", "ctrl")
        if not self._looks:
            seen = run(self.model, schedule, schedule.indices[:1], record=names)
            places = spread(seen["qpos"][0])
            self._looks = [tuple(seen[name][0, k] for name in names) for k in places]
        model = schedule.driven_model(self.of(change))
        once = change.also(Change(accuracy=None, dt=self.dt))
        if model.settings.accuracy is not None:
            if once not in self._evaluations:
                # Steps of full length may fail where adaptive ones do not.
                with contextlib.suppress(SimulationError):
                    self._counts[once] = self._counted(once, schedule)
            # An evaluation takes about as long at another accuracy.
            each = self._evaluations.get(once, 0.0)
            if each and (dear := self._dear(model, schedule, DEAR / each)):
                self._evaluations[change] = each
                return dear * each
        counts, evaluations, failed = list[int](), 0, None
        sim = unwatched(Sim(model))
        for look in self._looks:
            checkpoint()
            sim.reset()
            for name, values in zip(names, look, strict=True):
                getattr(sim, name)[:] = values
            before = sim._core.evaluations
            try:
                # The second step is warm-started from the first one's impulses.
                sim.step(1)
                count = sim.count_flops()
                if sim.settings.accuracy is not None:
                    before = sim._core.evaluations
                    sim.step(1)
            except SimulationError as error:
                # If the shipped motion blows up, no step can be made from its late states.
                failed = error
                continue
            counts.append(count)
            evaluations += sim._core.evaluations - before
        if failed is not None and not counts:
            raise failed
        self._evaluations[change] = self._evaluations[once] = sum(counts) / max(1, evaluations)
        return sum(counts) / len(counts)

    def _dear(self, model: Model, schedule: Schedule, often: float) -> float:
        """Return the force evaluations of an adaptive step, if they are too many to be counted.

        The result is a lower bound of the mean over states; 0 if operations can be counted.

        often: the largest number of force evaluations of a run.
        """
        starts = [Start(qpos, qvel, act) for qpos, qvel, act, _ in self._looks]
        ctrl = np.array([look[3:] for look in self._looks]) if model.nu else None
        most = often * model.settings.dt / schedule.horizon
        ran = follow(model, starts, 1, ctrl=ctrl, record=("qpos",), most=most)
        return float(np.mean(ran.inner)) if ran.failures else 0.0

    def converged(self) -> Stepcore:
        shipped = self.shipped
        count = 200 if shipped.sweeps == "auto" else max(shipped.sweeps, 200)
        exact = converged_settings(shipped, sweeps=count, tolerance=1e-14)
        if shipped.sweeps == "auto":
            exact = exact.replace(sweeps="auto")
        return Stepcore(self.model.with_settings(exact.replace(sleep=False)))

    def changed(self, change: Change) -> Stepcore:
        return Stepcore(change.of(self.model))

    def record(self, change: Change, start: Start, course: Course) -> Recording:
        ran = follow(self.of(change), [start], record=RECORDED, **vars(course))
        failed = ran.failures.get(0)
        reached = float(ran.times[-1]) if failed is None else float(failed.time)
        # The text of the error itself would need an analysis of the last steps.
        why = "" if failed is None else f"diverged in step {failed.step} at {seconds(reached)}"
        return Recording(ran.times, {name: ran[name][0] for name in RECORDED}, why, reached)

    def inertia(self, start: Start) -> np.ndarray:
        sim = unwatched(Sim(self.model))
        start.put(sim)
        return np.diag(np.array(sim.mass_matrix()))

    def operations_at(self, start: Start, ctrl: np.ndarray | None = None) -> float:
        sim = unwatched(Sim(self.model))
        start.put(sim)
        if ctrl is not None:
            sim.ctrl[:] = ctrl
        try:
            return float(sim.count_flops())
        except (SimulationError, ValueError):
            return 0.0

    def has_rows(self, schedule: Schedule) -> bool:
        if self._rows is None:
            some = visits(self.model, schedule, schedule.indices[:8], schedule.every)
            self._rows = any(len(sim.rows) > 0 for _, _, sim in some)
        return bool(self._rows)

    def families(self, schedule: Schedule) -> list[Change]:
        shipped = self.model.settings
        convex, rows = shipped.law == "solref", self.has_rows(schedule)
        names = dict.fromkeys([shipped.integrator, *(CONVEX if convex else ON_VELOCITIES)])
        solvers: list[dict[str, Any]] = [{}] if convex and shipped.solver == "newton" else []
        if rows or not solvers:
            solvers += [{"solver": "pgs", "sweeps": n} for n in SWEEPS]
            solvers += [{"solver": "newton", "sweeps": 100}] * (convex and {} not in solvers)
        if shipped.accuracy:
            solvers = [{**solver, "accuracy": None} for solver in solvers]
        able = [name for name in names if not (shipped.sleep and name in STAGED)]
        return [Change(integrator=name, **solver) for name in able for solver in solvers]

    def _exact(self, **fields: Any) -> Change:
        # The rows of the converged motion are as soft as the scene's.
        shipped = self.shipped.replace(sleep=False)
        exact = converged_settings(shipped, warm_start=True, refsafe=False, **fields)
        return Change.between(exact, self.shipped)

    def ways(self, schedule: Schedule, goal: float) -> list[Way]:
        convex = self.shipped.law == "solref"

        def within(k: int) -> Change:
            fixed = self._exact(integrator="rk4", dt=schedule.period)
            return fixed.also(Change(accuracy=goal / schedule.horizon / 4**k))

        second = "implicitfast" if convex else "semi-implicit"
        ways = [self.halved(schedule, second), self.halved(schedule, "rk4")]
        adapts = convex and schedule.control is None and schedule.log is None
        return [*ways, Way("accuracy", within, fixed=False)] if adapts else ways


def run(
    model: Model,
    schedule: Schedule,
    starts: Sequence[int],
    record: Sequence[str] = ("xpos", "xquat"),
    probe: Callable[[Sim], np.ndarray] | None = None,
    bound: float = math.inf,
    threads: int = 1,
) -> Followed:
    """Run a schedule under a model's settings, from some of its starts; see `follow`.

    The samples are the start itself, then the samples of the schedule.
    """
    dt, model = model.settings.dt, schedule.driven_model(model)
    count = schedule.steps(dt)
    begin = [schedule.starts[k] for k in starts]
    how: dict[str, Any] = {"record": record, "probe": probe, "bound": bound, "threads": threads}
    how["most"] = schedule.most
    steps, every = schedule.periods * count, schedule.every * count
    if schedule.control is not None:
        return follow(model, begin, steps, every, control=schedule.control, hold=count, **how)
    ctrl, hold = schedule.rows(starts, dt)
    return follow(model, begin, steps, every, ctrl=ctrl, hold=hold, **how)


def visits(
    model: Model, schedule: Schedule, starts: Sequence[int], every: int
) -> Iterator[tuple[int, float, Sim]]:
    """Yield a Sim at states of a motion, after `forward`, with its start and its time [s].

    every: control periods between two states, a divisor of the periods. A run ends at a failure, or
    just before one, at a state without finite accelerations.
    """
    names = ("qpos", "qvel", "act", "ctrl")
    often = dataclasses.replace(schedule, every=every)
    seen, sim = run(model, often, starts, record=names), unwatched(Sim(model))
    for place, start in enumerate(starts):
        schedule.starts[start].put(sim)
        for time, *state in zip(seen.times, *(seen[name][place] for name in names), strict=True):
            checkpoint()
            if not np.isfinite(state[0]).all():
                break
            for name, values in zip(names, state, strict=True):
                getattr(sim, name)[:] = values
            try:
                sim.forward()
            except SimulationError:
                break
            yield start, float(time), sim


def check_repeatable(model: Model, schedule: Schedule, control: Control) -> None:
    """Raise ControlError if the user's control function of a schedule is not repeatable.

    The beginning of a run is simulated twice. If the controls differ, they depend on more than the
    motion, and runs cannot be compared.
    """
    beginning = dataclasses.replace(schedule, periods=min(32, schedule.periods), every=1)
    first, again = (run(model, beginning, [0], record=("ctrl",))["ctrl"] for _ in range(2))
    if not np.array_equal(first, again, equal_nan=True):
        raise ControlError.not_repeatable(control, "the same run was made again")
