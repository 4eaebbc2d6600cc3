"""MuJoCo on the same motion: several integrators and solvers at many time steps.

The package mujoco is imported only here. MuJoCo reads the scene from the scene's MJCF file, or from
the output of `Scene.to_mjcf`. Starts, controls and samples are those of the trade. To check that
both engines compute the same physics, MuJoCo's converged run is compared with the reference.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.control import Control
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.experiment.arguments import Workers
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.cost import TimedRun
from stepcore.experiment.errors import Errors, errors, pareto
from stepcore.experiment.experiment import Experiment
from stepcore.experiment.reference import Reference
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule
from stepcore.loading import find_asset
from stepcore.measure.trade.methods import Steps
from stepcore.measure.trade.rows import TradeRow
from stepcore.report.units import metres, seconds

# MuJoCo's enumeration of integrators.
INTEGRATORS = {"euler": 0, "rk4": 1, "implicit": 2, "implicitfast": 3, "discrete": 4}
TRIED = ("euler", "rk4", "implicitfast")
SOLVERS = {"pgs": 0, "newton": 2}
# Time steps to try, relative to the shipped one.
FACTORS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)
# Largest distance between two agreeing engines, relative to the sum of their errors.
AGREE = 4.0
# The check: number of starts, and the ratio of the check's step to the reference's.
CHECKED, COARSER = 2, 4.0


@dataclass(frozen=True)
class Point:
    """The result of one MuJoCo setting; see `Trade.mujoco`.

    cost: computing time [µs per simulated second].
    check: the comparison of MuJoCo's converged run with the reference, equal for all points.
    """

    dt: float
    integrator: str
    solver: str
    errors: Errors | None
    check: Check
    cost: float = math.nan
    failure: str | None = None
    best: bool = False

    @property
    def error(self) -> float:
        """RMS position error of the worst start [m]; inf if a run failed."""
        return math.inf if self.errors is None else self.errors.high

    def record(self) -> dict[str, Any]:
        """Return the point as plain data."""
        e = self.errors
        return {
            "dt": self.dt,
            "integrator": self.integrator,
            "solver": self.solver,
            "position": None if e is None else e.position,
            "position_high": None if e is None else e.high,
            "position_max": None if e is None else e.position_max,
            "cost": None if math.isnan(self.cost) else self.cost,
            "failure": self.failure,
        }


@dataclass(frozen=True)
class Check:
    """The comparison of MuJoCo's rk4 at a small time step with the reference.

    version: the version of MuJoCo.
    dt: the time step of the run [s].
    apart: the distance from the reference [m].
    moved: the change when the time step is doubled [m].
    known: the error of the reference [m].
    """

    version: str
    dt: float
    apart: float
    moved: float
    known: float

    @property
    def agrees(self) -> bool:
        """Whether both engines converge to the same motion, within their uncertainties."""
        return self.apart <= AGREE * (self.moved + self.known)


def require() -> Any:
    """Return the module mujoco; raise ImportError with the install command if missing."""
    try:
        import mujoco  # type: ignore[import-untyped,unused-ignore]
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        raise ImportError("mujoco=True needs MuJoCo: pip install mujoco") from None
    except ImportError as error:
        # If Ctrl-C interrupts the import of a compiled module, only the error's text says so.
        if "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from None
        raise
    return mujoco


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress MuJoCo's warning file and internal timer; the timer costs time."""
    mujoco = require()
    timer = mujoco.get_mjcb_time()
    mujoco.set_mju_user_warning(lambda text: None)
    mujoco.set_mjcb_time(None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)
        mujoco.set_mjcb_time(timer)


def load(source: Any, model: Model) -> Any:
    """Return MuJoCo's model of the scene, under the equivalents of the shipped settings."""
    mujoco = require()
    if model.settings.law != "solref":
        raise ValueError(
            f"mujoco = True: the scene's law is '{model.settings.law}', which MuJoCo does not have"
        )
    if isinstance(source, (str, os.PathLike)) and not os.fsdecode(source).startswith("lesson:"):
        package, colon, name = os.fsdecode(source).partition(":")
        path = source if os.path.exists(source) or not colon else find_asset(package, name)
        with quiet():
            made = mujoco.MjModel.from_xml_path(os.fsdecode(path))
    else:
        with quiet():
            made = mujoco.MjModel.from_xml_string(model.scene.to_mjcf())
    ours, theirs = (model.nq, model.nv, model.nu), (made.nq, made.nv, made.nu)
    if ours != theirs:
        raise ValueError(f"mujoco = True: its model has nq, nv, nu = {theirs}, ours {ours}")
    made.opt.cone = ("pyramidal", "elliptic").index(model.settings.cone)
    made.opt.impratio = model.settings.impratio
    return made


class Setting(NamedTuple):
    """One setting of MuJoCo; exact: whether rows are solved to rounding."""

    dt: float
    integrator: str
    solver: str
    exact: bool = False


class World:
    """MuJoCo's data under one setting, which `Runner.follow` steps."""

    def __init__(self, model: Any, settings: Setting) -> None:
        self.model, self.settings = model, settings
        self.data = require().MjData(model)

    @property
    def ctrl(self) -> np.ndarray:
        """The controls, shape (nu,)."""
        ctrl: np.ndarray = self.data.ctrl
        return ctrl

    def step(self, count: int) -> None:
        require().mj_step(self.model, self.data, nstep=count)

    def configure(self) -> None:
        """Set the options of the model, which all worlds share."""
        option, settings = self.model.opt, self.settings
        option.timestep, option.integrator = settings.dt, INTEGRATORS[settings.integrator]
        option.solver = SOLVERS[settings.solver]
        option.iterations, option.tolerance = (200, 1e-15) if settings.exact else (100, 1e-8)
        option.ls_iterations, option.ls_tolerance = (200, 1e-6) if settings.exact else (50, 1e-2)


class MujocoRunner(Runner):
    """A runner that runs the schedule with MuJoCo; theirs: MuJoCo's model of the scene."""

    def __init__(self, model: Model, schedule: Schedule, theirs: Any) -> None:
        super().__init__(model, schedule)
        self.theirs = theirs
        # The Sim that a control function receives, set to MuJoCo's state.
        self.shown = unwatched(Sim(model))

    def sim(self, settings: Any) -> World:
        return World(self.theirs, settings)

    def follow(self, sim: World, *args: Any, **options: Any) -> None:
        sim.configure()
        with quiet():
            super().follow(sim, *args, **options)

    def place(self, sim: World, start: int) -> None:
        require().mj_resetData(self.theirs, sim.data)
        begin = self.schedule.starts[start]
        sim.data.qpos[:], sim.data.qvel[:] = begin.qpos, begin.qvel
        sim.data.act[:] = 0.0 if begin.act is None else begin.act
        if begin.mocap is not None:
            sim.data.mocap_pos[:], sim.data.mocap_quat[:] = begin.mocap

    def control(self, sim: World, start: int, period: int, function: Control | None) -> None:
        data, shown = sim.data, self.shown
        if function is not None:
            shown.qpos, shown.qvel, shown.time = data.qpos, data.qvel, data.time
        super().control(shown, start, period, function)
        data.ctrl[:] = shown.ctrl


class Poses(Probe):
    """A probe that records MuJoCo's states at the samples, and the poses of the bodies."""

    def __init__(self, bodies: Bodies) -> None:
        self.bodies = bodies
        self.qpos: list[np.ndarray] = []
        self.qvel: list[np.ndarray] = []

    def sample(self, sim: World) -> None:
        self.qpos.append(sim.data.qpos.copy())
        self.qvel.append(sim.data.qvel.copy())

    def end(self, sim: World, run: Run) -> None:
        run.failure = _warned(sim.data)
        if run.failure is None:
            seen = self.bodies.states(np.array(self.qpos), np.array(self.qvel))
            run.com, run.quat, run.gyration = seen.com, seen.quat, self.bodies.gyration


class MujocoTrials:
    """The runs of MuJoCo's settings on a trade's motion, one after the other on a shared model."""

    def __init__(self, source: Any, experiment: Experiment, reference: Reference) -> None:
        self.experiment = Experiment(experiment.model, experiment.schedule, size=experiment.size)
        theirs = load(source, experiment.model)
        self.experiment.runner = MujocoRunner(experiment.model, experiment.schedule, theirs)
        self.reference = reference

    def points(self, steps: Steps, workers: Workers) -> tuple[list[Point], list[TimedRun]]:
        """Run integrators × solvers × steps from every start; return points and runs to time."""
        solvers = SOLVERS if any(run.rows for run in self.reference.runs) else ("newton",)
        pieces = sorted({max(1, round(steps.shipped_pieces / factor)) for factor in FACTORS})
        asked = [Setting(steps.dt(n), i, s) for n in pieces for i in TRIED for s in solvers]
        starts = len(self.reference.runs)
        with workers.bar("MuJoCo", len(asked) * starts) as bar:
            check = self._check()
            points = []
            for setting in asked:
                points.append(self._point(setting, check))
                bar.advance(starts)
        runner = self.experiment.runner
        runs = [
            TimedRun(runner, setting, failed=point.failure is not None)
            for setting, point in zip(asked, points, strict=True)
        ]
        return points, runs

    def _check(self) -> Check:
        """Compare MuJoCo's converged run with the reference."""
        ref, period = self.reference, self.experiment.schedule.period
        few = range(min(CHECKED, len(ref.runs)))
        # The step is coarser than the reference's: the run is a check, not a reference.
        dt = period / max(1, int(period / ref.settings.dt / COARSER + 1e-9))
        coarse, fine = (
            self._runs(Setting(step, "rk4", "newton", exact=True), few) for step in (dt, dt / 2)
        )
        apart, moved = math.inf, math.inf
        if not any(run.failure for run in (*coarse, *fine)):
            truth, scored = ref.runs[: len(few)], ref.scored[: len(few)]
            apart = errors(fine, truth, scored).high
            moved = errors(fine, coarse, scored).high
        return Check(require().__version__, dt / 2, apart, moved, ref.high)

    def _point(self, setting: Setting, check: Check) -> Point:
        """Run one of MuJoCo's settings from every start."""
        runs = self._runs(setting, range(len(self.reference.runs)))
        failure = self.experiment.failure(runs, self.reference)
        wrong = None if failure else self.experiment.errors(runs, self.reference)
        return Point(setting.dt, setting.integrator, setting.solver, wrong, check, failure=failure)

    def _runs(self, setting: Any, starts: range) -> list[Run]:
        """Run from some starts, until a run fails."""
        return self.experiment.run(setting, starts, lambda runner: [Poses(runner.bodies)])


def timed(points: Sequence[Point], runs: Sequence[TimedRun]) -> list[Point]:
    """Return the points with their costs, and mark those that no other point beats."""
    costs = [run.cost for run in runs]
    best = pareto(costs, [point.error for point in points])
    return [
        dataclasses.replace(point, cost=cost, best=mark)
        for point, cost, mark in zip(points, costs, best, strict=True)
    ]


def _warned(data: Any) -> str | None:
    """Return MuJoCo's warning about a state that ended the run, or None."""
    bad = {
        "its position is not finite": "mjWARN_BADQPOS",
        "its velocity is not finite": "mjWARN_BADQVEL",
        "its acceleration is not finite": "mjWARN_BADQACC",
        "its control is not finite": "mjWARN_BADCTRL",
        "contacts do not fit": "mjWARN_CONTACTFULL",
        "rows do not fit": "mjWARN_CNSTRFULL",
    }
    kinds = require().mjtWarning
    for text, name in bad.items():
        if hasattr(kinds, name) and data.warning[int(getattr(kinds, name))].number:
            return text
    return None


def compared_with_mujoco(points: Sequence[Point], shipped: TradeRow) -> Iterator[str]:
    """Yield whether both engines agree, and the cost of MuJoCo's shipped settings."""
    check = points[0].check
    same = "computes the same physics" if check.agrees else "does NOT compute the same physics"
    yield (
        f"MuJoCo {check.version} {same}: on the same motion its converged run (rk4, newton, dt "
        f"{seconds(check.dt)}) is {metres(check.apart)} from the reference, and "
        f"{metres(check.moved)} from its own run at twice that step."
    )
    s = shipped.settings
    for point in points:
        alike = (point.dt, point.integrator, point.solver) == (s.dt, s.integrator, s.solver)
        if alike and point.errors is not None:
            times = point.cost / shipped.cost
            slower = f", and it takes {times:.2f} times as long as stepcore"
            known = "" if math.isnan(times) else slower
            yield f"As shipped MuJoCo's error is {metres(point.error)}{known}."
