"""The runs of a map: the points on the bodies at given times, and the true motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.model import Model
from stepcore.engine.plan import makes_rows
from stepcore.engine.run_settings import converged_settings
from stepcore.experiment.bodies import Bodies
from stepcore.experiment.controls import ControlLog, Controls
from stepcore.experiment.run import Probe, Run
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule, home
from stepcore.experiment.sizes import scene_size
from stepcore.measure.stability.result import Tolerance

# Number of readings in a run; a run with fewer steps is read at every step.
READINGS = 32
# Least number of steps in the first run of a true motion, largest number of halvings, and largest
# number of steps. dt is halved until two runs agree to 1/FINER of the tolerance, or halving no
# longer helps: STALLS halvings brought two runs no nearer to each other than by the factor NEARER.
FIRST, HALVINGS, MOST_STEPS = 1024, 9, 200_000
FINER = 10.0
STALLS, NEARER = 2, 0.7

# The points at given times [s] for a value of the grid, shape (times, sets, 4, 3).
Form = Callable[[float, np.ndarray], np.ndarray]


class BodyPoints:
    """Four points on each moving body with a mass: the centre, and three on the axes.

    The three points are one radius of gyration away, so that a rotation also counts as a length.
    Points on a wheel stay near however fast the wheel turns. So each hinge has one more set of
    points: the hinge angle times that radius, along a straight line.
    """

    def __init__(self, bodies: Bodies) -> None:
        model, heavy = bodies.model, bodies.mass > 0
        self.index = np.array(bodies.moving, int)[heavy]
        self.radius, self.centre = bodies.gyration[heavy], bodies.ipos[heavy]
        radius_of = dict(zip(self.index.tolist(), self.radius.tolist(), strict=True))
        hinges = [j for j, kind in enumerate(model.jnt_type) if kind == "hinge"]
        self.angle = model.jnt_qposadr[hinges]
        # A body without mass moves its descendants, and gets the largest radius.
        largest = float(self.radius.max(initial=0.0))
        self.arm = np.array([radius_of.get(int(model.jnt_body[j]), largest) for j in hinges])

    def at(self, sim: Any) -> np.ndarray:
        """Return the current points [m], shape (bodies + hinges, 4, 3)."""
        turn = sim.xmat[self.index]
        centre = sim.xpos[self.index] + np.einsum("bij,bj->bi", turn, self.centre)
        around = centre[:, None] + self.radius[:, None, None] * turn.transpose(0, 2, 1)
        turned = np.zeros((len(self.arm), 4, 3))
        turned[..., 0] = (sim.qpos[self.angle] * self.arm)[:, None]
        return np.concatenate([np.concatenate([centre[:, None], around], axis=1), turned])


class Readings(Probe):
    """A probe that records the points at given times [s], interpolated between two steps.

    The first time is 0. The interpolation error is at most dt²/8 of the acceleration; halving dt
    reveals this error with all others.
    """

    def __init__(self, bodies: Bodies, times: np.ndarray, dt: float) -> None:
        self.points = BodyPoints(bodies)
        before, share = np.divmod(times / dt, 1.0)
        self.before = (before + (share > 1 - 1e-6)).astype(int)
        self.share = np.where((share < 1e-6) | (share > 1 - 1e-6), 0.0, share)
        self.steps = np.unique([self.before, self.before + (self.share > 0)]).tolist()
        self.read: list[np.ndarray] = []

    def stop(self, done: int, steps: int) -> int:
        step: int = self.steps[len(self.read)]
        return step

    def begin(self, sim: Any) -> None:
        self.read.append(self.points.at(sim))

    def step(self, sim: Any) -> None:
        self.read.append(self.points.at(sim))

    def at_times(self) -> np.ndarray:
        """Return the points at all times that the run reached, shape (times, sets, 4, 3)."""
        read = np.array(self.read)
        first = np.searchsorted(self.steps, self.before)
        last = np.searchsorted(self.steps, self.before + (self.share > 0))
        first, last, share = (part[last < len(read)] for part in (first, last, self.share))
        share = share[:, None, None, None]
        between = (1 - share) * read[first] + share * read[last]
        return np.where(share > 0, between, read[first])


class Step(NamedTuple):
    """A step of a length [s], or one of that length that keeps an accuracy over a run [m]."""

    dt: float
    accuracy: float | None = None

    def of(self, settings: Settings, horizon: float) -> Settings:
        """Return settings with this step for a run."""
        rate = None if self.accuracy is None else self.accuracy / horizon
        return settings.replace(dt=self.dt, accuracy=rate)


@dataclass(frozen=True)
class MapMotion:
    """The motion of every cell: a start at a keyframe, with its controls held constant.

    horizon: the simulated time [s].
    key: the keyframe, or None for the scene's pose.
    """

    horizon: float
    key: str | int | None

    def times(self, dt: float) -> np.ndarray:
        """Return when the points of a cell are read, including the start [s]."""
        steps = max(1, round(self.horizon / dt))
        return np.array(sorted({round(steps * k / READINGS) for k in range(READINGS + 1)})) * dt

    def all_times(self, dts: Sequence[float]) -> np.ndarray:
        """Return all times at which the points of any cell are read [s]."""
        return np.unique(np.concatenate([self.times(dt) for dt in dts]))

    def run(self, model: Model, step: Step, times: np.ndarray) -> tuple[np.ndarray, str | None]:
        """Return the points at the times that a run reaches, and why the run failed."""
        dt = step.dt
        start, ctrl = home(model, self.key)
        steps = max(1, int(np.ceil(times[-1] / dt - 1e-6)))
        schedule = Schedule(
            steps * dt, 1, 1, (start,), Controls(ControlLog(np.zeros(1), ctrl[None]))
        )
        runner = Runner(model, schedule)
        probe = Readings(runner.bodies, times, dt)
        try:
            runner.follow(runner.sim(step.of(model.settings, self.horizon)), 0, [probe])
        except SimulationError as error:
            return probe.at_times(), one_line(error)
        return probe.at_times(), None

    def cell(
        self, model: Model, path: str, cell: tuple[float, Step]
    ) -> tuple[np.ndarray, str | None]:
        """Return the points of a cell (a value and its step) at its times, and why it failed."""
        value, step = cell
        return self.run(model.with_values({path: value}), step, self.times(step.dt))


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """The points at all times at which any cell is read.

    points: None if every run failed.
    size: the length that errors are relative to [m].
    error: the distance of the two finest runs, relative to the size; 0 for a closed form; inf if
        unknown.
    """

    times: np.ndarray
    points: np.ndarray | None
    size: float
    error: float = 0.0

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return the points at some of the times."""
        assert self.points is not None
        return self.points[np.searchsorted(self.times, times)]


def closed_form(
    form: Form, model: Model, value: float, times: np.ndarray, size: float | None
) -> TrueMotion:
    """Return the true motion by a formula."""
    points = form(value, times)
    return TrueMotion(times, points, size or size_of(model, points))


def size_of(model: Model, points: np.ndarray) -> float:
    """Return the size of the scene and its motion [m]; see `scene_size`."""
    hinges = list(model.jnt_type).count("hinge")
    return scene_size(model.scene, [Run(com=points[:, : points.shape[1] - hinges, 0])])


def converged(
    model: Model,
    path: str,
    dts: Sequence[float],
    size: float | None,
    motion: MapMotion,
    tolerance: Tolerance,
    value: float,
) -> TrueMotion:
    """Return the scene's own converged run: dt is halved until the run no longer changes."""
    model = model.with_values({path: value})
    model, times = model.with_settings(reference_settings(model)), motion.all_times(dts)
    dt = min(*dts, motion.horizon / FIRST)
    last: np.ndarray | None = None
    best = TrueMotion(times, None, size or scene_size(model.scene), np.inf)
    errors: list[float] = []
    for _ in range(HALVINGS + 1):
        if motion.horizon / dt > MOST_STEPS and last is not None:
            break
        read, failure = motion.run(model, Step(dt), times)
        points = None if failure else read
        if points is not None:
            span = size or size_of(model, points)
            error = np.inf
            if last is not None:
                error = float(np.linalg.norm(points - last, axis=-1).max()) / span
            best = TrueMotion(times, points, span, error)
            errors.append(error)
            if error <= tolerance.share(span) / FINER or _stalled(errors):
                break
        last = points
        dt /= 2
    return best


def within(
    model: Model,
    path: str,
    steps: Sequence[Step],
    size: float | None,
    motion: MapMotion,
    value: float,
) -> TrueMotion:
    """Return the scene's run whose steps keep a hundredth of the finest accuracy asked for.

    Its error is the distance from the run of a tenth.
    """
    model = model.with_values({path: value}).with_settings(precision="f64")
    period, finest = steps[0].dt, min(step.accuracy or np.inf for step in steps)
    times = motion.times(period)
    runs = [
        motion.run(model, Step(period, finest / part), times) for part in (FINER, FINER * FINER)
    ]
    if any(failure for _, failure in runs):
        return TrueMotion(times, None, size or scene_size(model.scene), np.inf)
    (coarse, _), (fine, _) = runs
    span = size or size_of(model, fine)
    error = float(np.linalg.norm(fine - coarse, axis=-1).max()) / span
    return TrueMotion(times, fine, span, error)


def _stalled(errors: Sequence[float]) -> bool:
    """Return whether halving no longer helps: the motion is chaotic or changes abruptly with dt."""
    return len(errors) > STALLS + 1 and errors[-1] > NEARER * errors[-1 - STALLS]


def reference_settings(model: Model) -> Settings:
    """Return the scene's own laws, with converged rows and the integrator of highest order allowed.

    Few sweeps suffice, because each of the many steps starts from the previous step's impulses.
    """
    settings = model.settings
    integrator = settings.integrator
    if not makes_rows(model):
        integrator = "rk4"
    elif integrator == "explicit":
        integrator = "semi-implicit"
    return converged_settings(
        settings, sweeps=1000, refsafe=False, warm_start=True, integrator=integrator
    )
