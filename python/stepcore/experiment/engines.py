"""Engines: what runs a change of a scene and counts its work. Truth, norm and choices are theirs.

An `Engine` runs a `Schedule` under a `Change` and returns `Tracks`. `Stepcore` is this package's
own engine; `stepcore.experiment.mujoco_engine` runs MuJoCo.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.control import ControlError
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.follow import Followed, follow
from stepcore.engine.linear_maps import STAGED
from stepcore.engine.model import Model
from stepcore.engine.norm import Matter, Tracks
from stepcore.engine.run_settings import converged_settings
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.change import Change
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import HORIZON, Schedule, scheduled

# A run has failed if a body is so many sizes of the scene away from where it began. A distance of a
# few sizes is an error that is told; at a hundred, bodies have left the scene that was modelled.
FAR = 100.0
# States of the motion at which the work of a step is counted.
LOOKS = 8
# The integrators that are tried under MuJoCo's law, and under the laws on velocities.
CONVEX = ("rk4", "implicitfast", "euler", "semi-implicit", "discrete", "midpoint", "implicit")
ON_VELOCITIES = ("rk4", "semi-implicit", "midpoint", "explicit")
# Numbers of sweeps that are tried.
SWEEPS = (2, 8, 30)
# Control periods in the test whether a control function is repeatable.
REPEATED = 32


@dataclass(frozen=True)
class Way:
    """A way to the converged motion: a ladder of changes, each rung finer than the last.

    name: of the method. at: returns the change of a rung, from 0 on.
    fixed: whether steps have a fixed length, so that nudged runs can be compared bit by bit.
    """

    name: str
    at: Callable[[int], Change]
    fixed: bool = True


class Engine(Protocol):
    """What runs changes of one scene.

    name: of the engine. title: of the scene. matter: the moving bodies. coordinates: of the states.
    known: whether stepcore has a model of the scene.
    dt: the shipped time step [s]. nv: the number of dofs. size: the size of the scene [m].
    """

    name: str
    matter: Matter
    coordinates: Coordinates
    dt: float
    nv: int
    size: float

    @property
    def title(self) -> str: ...
    @property
    def known(self) -> bool: ...
    @property
    def model(self) -> Model:
        """stepcore's model of the scene; ValueError if there is none."""

    def scheduled(
        self, motion: Motion, period: float, starts: int | None = None, horizon: float = HORIZON
    ) -> Schedule:
        """Return the schedule of a motion; see `stepcore.experiment.schedule.scheduled`."""

    def settings(self, change: Change) -> Any:
        """Return all settings of a change."""

    def follow(
        self, change: Change, schedule: Schedule, starts: Sequence[int], first: int = 1
    ) -> Tracks:
        """Run a change from some starts. A run that fails, or is refused, is one of `failures`.

        first: 0 for tracks that have the start itself before the samples of the schedule.
        """

    def work(self, change: Change, schedule: Schedule) -> float:
        """Count the floating-point operations of a simulated second; inf where none can be run."""

    def evaluation(self, change: Change, schedule: Schedule) -> float:
        """Count the operations of an evaluation of the forces, in steps within an accuracy."""

    def ways(self, schedule: Schedule, goal: float) -> list[Way]:
        """Return ways to the converged motion; goal: how exact it should be [m]."""

    def families(self, schedule: Schedule) -> list[Change]:
        """Return the settings to try, all but the time step."""

    def has_rows(self, schedule: Schedule) -> bool:
        """Return whether a contact, limit or other row acts at a sample of the shipped motion."""

    def seconds(self, change: Change, schedule: Schedule) -> float:
        """Return the processor time of a run from the first start [s]; NaN if it fails."""


class Stepcore:
    """This package's engine, for one model.

    size: the size of the scene [m].
    """

    name, known = "stepcore", True

    def __init__(self, model: Model, size: float) -> None:
        self.model, self.size = model, size
        self.matter, self.coordinates = Matter.of(model), Coordinates(model)
        self.dt, self.nv = float(model.settings.dt), model.nv
        self._models: dict[Change, Model] = {}
        self._looks: list[tuple[np.ndarray, ...]] = []
        self._counts: dict[Change, float] = {}
        self._evaluations: dict[Change, float] = {}
        self._rows: bool | None = None

    @property
    def title(self) -> str:
        return self.model.scene.name or "scene"

    def scheduled(
        self, motion: Motion, period: float, starts: int | None = None, horizon: float = HORIZON
    ) -> Schedule:
        return scheduled(motion, self.model, period, starts, horizon)

    def of(self, change: Change) -> Model:
        """Return the changed model; each physics is compiled once."""
        physics = change.physics
        if physics not in self._models:
            self._models[physics] = physics.of(self.model)
        return change.with_settings(self._models[physics])

    def settings(self, change: Change) -> Any:
        return self.model.settings.replace(**dict(change.settings))

    def follow(
        self, change: Change, schedule: Schedule, starts: Sequence[int], first: int = 1
    ) -> Tracks:
        try:
            model = self.of(change)
            ran = run(model, schedule, starts, bound=FAR * self.size)
        except ControlError:
            raise
        except (ValueError, SimulationError) as error:
            shape = (len(starts), len(schedule.times) + 1 - first, len(self.matter.moving))
            why = dict.fromkeys(range(len(starts)), one_line(error))
            return Tracks(np.full((*shape, 3), np.nan), np.full((*shape, 4), np.nan), why)
        failures = {k: one_line(error) for k, error in ran.failures.items()}
        tracks = self.matter.tracks(ran["xpos"][:, first:], ran["xquat"][:, first:], failures)
        within = model.settings.accuracy is not None
        return dataclasses.replace(tracks, evaluations=ran.inner) if within else tracks

    def work(self, change: Change, schedule: Schedule) -> float:
        """Count the operations of a simulated second, at the same states for all changes.

        A step costs about the same at all lengths, so each method is counted at one of them. Steps
        within an accuracy are counted at their own.
        """
        settings = self.settings(change)
        if settings.accuracy is None:
            change = change.also(Change(dt=self.dt))
        if change not in self._counts:
            self._counts[change] = self._counted(change, schedule)
        return self._counts[change] / settings.dt

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
        """Count the operations of a step: the mean over states of the shipped motion."""
        if not self._looks:
            names = ("qpos", "qvel", "act", "ctrl")
            seen = run(self.model, schedule, schedule.indices[:1], record=names)
            whole = np.flatnonzero(np.isfinite(seen["qpos"][0]).all(axis=-1))
            some = whole[np.unique(np.linspace(0, len(whole) - 1, LOOKS).astype(int))]
            self._looks = [tuple(seen[name][0, k] for name in names) for k in some]
        total = evaluations = 0
        try:
            sim = unwatched(Sim(schedule.on(self.of(change))))
            for qpos, qvel, act, ctrl in self._looks:
                sim.reset()
                sim.qpos[:], sim.qvel[:], sim.act[:], sim.ctrl[:] = qpos, qvel, act, ctrl
                # The second step has impulses to begin from.
                sim.step(1)
                total += sim.count_flops()
                if sim.settings.accuracy is not None:
                    before = sim._core.evaluations
                    sim.step(1)
                    evaluations += sim._core.evaluations - before
        except (ValueError, SimulationError):
            return math.inf
        self._evaluations[change] = total / max(1, evaluations)
        return total / len(self._looks)

    def has_rows(self, schedule: Schedule) -> bool:
        if self._rows is None:
            some = visits(self.model, schedule, schedule.indices[:8], schedule.every)
            self._rows = any(len(sim.rows) > 0 for _, _, sim in some)
        return bool(self._rows)

    def families(self, schedule: Schedule) -> list[Change]:
        """Return every integrator with every solver; one solver is enough where no row acts."""
        shipped = self.model.settings
        convex, rows = shipped.law == "solref", self.has_rows(schedule)
        names = dict.fromkeys([shipped.integrator, *(CONVEX if convex else ON_VELOCITIES)])
        solvers: list[dict[str, Any]] = [{}] if convex and shipped.solver == "newton" else []
        if rows or not solvers:
            solvers += [{"solver": "pgs", "sweeps": n} for n in SWEEPS]
            solvers += [{"solver": "newton", "sweeps": 100}] * (convex and {} not in solvers)
        staged = [name for name in names if not (shipped.sleep and name in STAGED)]
        every = [Change(integrator=name, **solver) for name in staged for solver in solvers]
        return (
            [family.also(Change(accuracy=None)) for family in every] if shipped.accuracy else every
        )

    def ways(self, schedule: Schedule, goal: float) -> list[Way]:
        shipped = self.model.settings.replace(sleep=False)
        steps, convex = schedule.steps(self.dt), shipped.law == "solref"

        def exact(**fields: Any) -> Change:
            # As the scene's rows are, so soft are those of its converged motion.
            full = {"warm_start": True, "refsafe": False, **fields}
            return Change.between(converged_settings(shipped, **full), self.model.settings)

        def halved(integrator: str) -> Way:
            def at(k: int) -> Change:
                return exact(integrator=integrator, dt=schedule.period / (steps * 2**k))

            return Way(integrator, at)

        def within(k: int) -> Change:
            fixed = exact(integrator="rk4", dt=schedule.period)
            return fixed.also(Change(accuracy=goal / schedule.horizon / 4**k))

        second = "implicitfast" if convex else "semi-implicit"
        ways = [halved(second), halved("rk4")]
        adapts = convex and schedule.control is None and schedule.log is None
        return [*ways, Way("accuracy", within, fixed=False)] if adapts else ways


def run(
    model: Model,
    schedule: Schedule,
    starts: Sequence[int],
    record: Sequence[str] = ("xpos", "xquat"),
    bound: float = math.inf,
    threads: int = 1,
) -> Followed:
    """Run a schedule under a model's settings, from some of its starts; see `follow`.

    Samples are those of the schedule, after the start itself.
    """
    dt, model = model.settings.dt, schedule.on(model)
    count = schedule.steps(dt)
    begin = [schedule.starts[k] for k in starts]
    how: dict[str, Any] = {"record": record, "bound": bound, "threads": threads}
    steps, every = schedule.periods * count, schedule.every * count
    if schedule.control is not None:
        return follow(model, begin, steps, every, control=schedule.control, hold=count, **how)
    ctrl, hold = schedule.rows(starts, dt)
    return follow(model, begin, steps, every, ctrl=ctrl, hold=hold, **how)


def visits(
    model: Model, schedule: Schedule, starts: Sequence[int], every: int
) -> Iterator[tuple[int, float, Sim]]:
    """Yield a Sim at states of a motion, after `forward`, with its start and its time [s].

    every: control periods between two states, a divisor of the periods. A run that fails ends.
    """
    names = ("qpos", "qvel", "act", "ctrl")
    often = dataclasses.replace(schedule, every=every)
    seen, sim = run(model, often, starts, record=names), unwatched(Sim(model))
    for place, start in enumerate(starts):
        schedule.starts[start].put(sim)
        for time, *state in zip(seen.times, *(seen[name][place] for name in names), strict=True):
            if not np.isfinite(state[0]).all():
                break
            for name, values in zip(names, state, strict=True):
                getattr(sim, name)[:] = values
            sim.forward()
            yield start, float(time), sim


def check_repeatable(model: Model, schedule: Schedule) -> None:
    """Raise ControlError if the user's control function is not repeatable.

    The beginning of a run is made twice. If the controls differ, they depend on more than the
    motion, and runs cannot be compared.
    """
    periods = min(REPEATED, schedule.periods)
    beginning = dataclasses.replace(schedule, periods=periods, every=1)
    first, again = (run(model, beginning, [0], record=("ctrl",))["ctrl"] for _ in range(2))
    if schedule.control is not None and not np.array_equal(first, again, equal_nan=True):
        raise ControlError.not_repeatable(schedule.control, "the same run was made again")
