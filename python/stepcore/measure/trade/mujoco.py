"""MuJoCo on the same motion: its integrators and solvers at many steps, against our reference.

The package mujoco is imported only here. The scene is read by MuJoCo from its own MJCF file, or
from what `Scene.to_mjcf` writes; starts, controls and samples are those of the trade. That both
engines compute the same physics is checked on the spot: MuJoCo's own converged run is compared
with the reference.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.engine.model import Model
from stepcore.experiment.cost import Timed, Watch, calls
from stepcore.experiment.errors import Errors, errors, far_off
from stepcore.experiment.reference import Reference
from stepcore.experiment.runner import Course, Path
from stepcore.loading import find_asset
from stepcore.measure.trade.moves import Steps
from stepcore.report.progress import Choice, Progress
from stepcore.report.units import metres, seconds

if TYPE_CHECKING:
    from stepcore.measure.trade.result import Trade

INTEGRATORS = {"euler": 0, "rk4": 1, "implicitfast": 3}
SOLVERS = {"pgs": 0, "newton": 2}
# Steps tried, over the shipped one.
FACTORS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)
# Two engines agree if they are this near, over what is known of both.
AGREE = 4.0
# The check: starts, and steps of the reference in one of its own.
CHECKED, COARSER = 2, 4.0


@dataclass
class Point:
    """MuJoCo under one setting. cost [µs per simulated second]; see `Trade.mujoco`.

    check: what MuJoCo's converged run says of the reference; the same for all points.
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
        """The root mean square of positions in the worst start [m]; inf if it failed."""
        return math.inf if self.errors is None else self.errors.high

    def cells(self) -> dict[str, Any]:
        """The point as a printed row."""
        record = {
            "": "m",
            "dt": f"{self.dt * 1e3:.4g}",
            "integrator": self.integrator,
            "solver": self.solver,
            "cost": "" if math.isnan(self.cost) else f"{self.cost:.{0 if self.cost > 99 else 1}f}",
        }
        if self.errors is None:
            return record | {"error": "failed"}
        e = self.errors
        numbers = (self.error, e.median, e.position_max)
        return record | {
            name: f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e")
            for name, value in zip(("error", "median", "max"), numbers, strict=True)
        }

    def record(self) -> dict[str, Any]:
        """The point as plain data."""
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
    """MuJoCo's rk4 at `dt` [s]: `apart` from the reference, `moved` by doubling its step [m].

    version: of MuJoCo.
    """

    version: str
    dt: float
    apart: float
    moved: float
    known: float

    @property
    def agrees(self) -> bool:
        """Whether both engines converge to the same motion, as far as both are known."""
        return self.apart <= AGREE * (self.moved + self.known)


def require() -> Any:
    """The module mujoco; ImportError with the way out where it is missing."""
    try:
        import mujoco  # type: ignore[import-untyped,unused-ignore]
    except ImportError:
        raise ImportError("mujoco=True needs MuJoCo: pip install mujoco") from None
    return mujoco


@contextmanager
def quiet() -> Iterator[None]:
    """No file of warnings in the working directory; and no timer inside, which costs time."""
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
    """MuJoCo's model of what was traded, under the shipped settings as far as it has them."""
    mujoco = require()
    if model.settings.law != "solref":
        raise ValueError(
            f"mujoco = True: the scene's law is '{model.settings.law}', which MuJoCo does not have"
        )
    if isinstance(source, (str, os.PathLike)) and not os.fsdecode(source).startswith("lesson:"):
        package, colon, name = os.fsdecode(source).partition(":")
        found = source if os.path.exists(source) or not colon else find_asset(package, name)
        with quiet():
            made = mujoco.MjModel.from_xml_path(os.fsdecode(found))
    else:
        with quiet():
            made = mujoco.MjModel.from_xml_string(model.scene.to_mjcf())
    ours, theirs = (model.nq, model.nv, model.nu), (made.nq, made.nv, made.nu)
    if ours != theirs:
        raise ValueError(f"mujoco = True: its model has nq, nv, nu = {theirs}, ours {ours}")
    made.opt.cone = ("pyramidal", "elliptic").index(model.settings.cone)
    made.opt.impratio = model.settings.impratio
    return made


class Opponent:
    """MuJoCo on a course."""

    def __init__(self, source: Any, course: Course, reference: Reference, size: float) -> None:
        self.model = load(source, course.model)
        self.course, self.reference, self.size = course, reference, size
        self.shipped = course.model.settings

    def players(self, steps: Steps, progress: Choice) -> list[Player]:
        """Points that can be timed: integrators × solvers × steps, all run from every start."""
        solvers = SOLVERS if any(path.rows for path in self.reference.paths) else ("newton",)
        pieces = sorted({max(1, round(steps.own / factor)) for factor in FACTORS})
        asked = [(n, i, s) for n in pieces for i in INTEGRATORS for s in solvers]
        starts = len(self.course.motion.starts)
        with Progress("MuJoCo", len(asked) * starts, progress) as bar, quiet():
            check = self.check(bar)
            return [
                Player(self, self.point(steps.dt(n), integrator, solver, check, bar))
                for n, integrator, solver in asked
            ]

    def check(self, bar: Progress) -> Check:
        """MuJoCo's own limit, beside the reference."""
        ref, motion = self.reference, self.course.motion
        few = range(min(CHECKED, len(motion.starts)))
        # At most so many times the reference's step: this is to be seen, not to be the truth.
        dt = motion.period / max(1, int(motion.period / ref.settings.dt / COARSER + 1e-9))
        runs = [self.paths(step, "rk4", "newton", bar, few, exact=True) for step in (dt, dt / 2)]
        apart, moved, dt = math.inf, math.inf, dt / 2
        if not any(path.failure for some in runs for path in some):
            truth, scored = ref.paths[: len(few)], ref.scored[: len(few)]
            apart = errors(runs[1], truth, scored).high
            moved = errors(runs[1], runs[0], scored).high
        return Check(require().__version__, dt, apart, moved, ref.high)

    def point(self, dt: float, integrator: str, solver: str, check: Check, bar: Progress) -> Point:
        """One setting of MuJoCo's, from every start."""
        starts, ref = range(len(self.course.motion.starts)), self.reference
        paths = self.paths(dt, integrator, solver, bar, starts)
        failure = next((f"start {i}: {p.failure}" for i, p in enumerate(paths) if p.failure), None)
        failure = failure or far_off(paths, ref.paths, self.size)
        found = None if failure else errors(paths, ref.paths, ref.scored, self.size)
        return Point(dt, integrator, solver, found, check, failure=failure)

    def configure(self, dt: float, integrator: str, solver: str, exact: bool = False) -> None:
        """Sets MuJoCo's options; exact: its rows solved to rounding."""
        option = self.model.opt
        option.timestep, option.integrator = dt, INTEGRATORS[integrator]
        option.solver = SOLVERS[solver]
        option.iterations, option.tolerance = (200, 1e-15) if exact else (100, 1e-8)
        option.ls_iterations, option.ls_tolerance = (200, 1e-6) if exact else (50, 1e-2)

    def paths(
        self,
        dt: float,
        integrator: str,
        solver: str,
        bar: Progress,
        starts: Sequence[int],
        exact: bool = False,
    ) -> list[Path]:
        """The motion from these starts."""
        self.configure(dt, integrator, solver, exact)
        data = require().MjData(self.model)
        found = []
        for start in starts:
            found.append(self.path(data, dt, start))
            bar.advance()
        return found

    def path(self, data: Any, dt: float, start: int) -> Path:
        mujoco, motion = require(), self.course.motion
        drive, count, path = self.drive(start), motion.steps(dt), Path()
        self.place(data, start)
        qpos, qvel = [], []
        for period in range(motion.periods):
            drive(data, period)
            mujoco.mj_step(self.model, data, nstep=count)
            if (period + 1) % motion.every == 0:
                qpos.append(data.qpos.copy())
                qvel.append(data.qvel.copy())
        path.failure = _warned(data)
        if path.failure is None:
            seen = self.course.poses(np.array(qpos), np.array(qvel))
            path.com, path.quat = seen.com, seen.quat
            path.gyration = self.course.gyration
        return path

    def place(self, data: Any, start: int) -> None:
        """Puts MuJoCo at a start of the motion, nothing warm."""
        require().mj_resetData(self.model, data)
        begin = self.course.motion.starts[start]
        data.qpos[:], data.qvel[:] = begin.qpos, begin.qvel

    def drive(self, start: int) -> Any:
        """Sets MuJoCo's controls; a control function sees a Sim in MuJoCo's state."""
        motion = self.course.motion
        if motion.control is None:
            assert motion.ctrl is not None
            values = motion.ctrl[start]

            def replay(data: Any, period: int) -> None:
                data.ctrl[:] = values[period]

            return replay
        sim, ask = self.course.sim(self.shipped), self.course.drive(start)

        def shown(data: Any, period: int) -> None:
            sim.qpos, sim.qvel, sim.time = data.qpos, data.qvel, data.time
            ask(sim, period)
            data.ctrl[:] = sim.ctrl

        return shown


class Player(Timed):
    """A point of MuJoCo's that is timed in turn with ours: `mj_step` as we call `Sim.step`."""

    def __init__(self, opponent: Opponent, point: Point) -> None:
        super().__init__()
        self.opponent, self.point = opponent, point
        self.failed = point.failure is not None
        self.count, self.periods = calls(opponent.course, point.dt)
        self.data: Any = None

    def once(self) -> float:
        opponent, point, mujoco = self.opponent, self.point, require()
        opponent.configure(point.dt, point.integrator, point.solver)
        if self.data is None:
            self.data = mujoco.MjData(opponent.model)
            self.drive = opponent.drive(0)
        opponent.place(self.data, 0)
        with quiet():
            watch = Watch()
            for period in range(self.periods):
                self.drive(self.data, period)
                watch.start()
                mujoco.mj_step(opponent.model, self.data, nstep=self.count)
                watch.stop()
            return watch.total()


def _warned(data: Any) -> str | None:
    """What MuJoCo says of a state that it could not go on from."""
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


def against(trade: Trade) -> list[str]:
    """Whether both engines compute the same, and what MuJoCo costs where stepcore is as good."""
    check = trade.mujoco[0].check
    found = [
        f"MuJoCo {check.version} on the same motion: its converged run (rk4, newton, dt "
        f"{seconds(check.dt)}) is {metres(check.apart)} from the reference, and "
        f"{metres(check.moved)} from itself at twice that step"
        + (": the same physics." if check.agrees else ": NOT the same physics; do not compare.")
    ]
    own = trade.shipped
    for p in trade.mujoco:
        s = own.settings
        if (p.dt, p.integrator, p.solver) == (s.dt, s.integrator, s.solver) and p.errors:
            text = f"As shipped MuJoCo is {metres(p.error)} wrong"
            if not math.isnan(p.cost / own.cost):
                text += f", and takes {p.cost / own.cost:.2f} times as long as stepcore"
            found.append(text + ".")
    return found
