"""What a cell is compared with: a closed form, or the scene's own converged run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.engine.model import Model
from stepcore.engine.plan import makes_rows
from stepcore.engine.sim import Sim, unwatched
from stepcore.executors import steps
from stepcore.experiment.arguments import Workers
from stepcore.experiment.converged import converged_settings
from stepcore.measure.stability.points import BodyPoints, CellMotion
from stepcore.measure.sweep import sweep
from stepcore.report import units

# The first run has at least so many steps. Then dt is halved until two runs agree to a tenth of the
# tolerance, a run would have too many steps, or halving no longer helps: in so many halvings two
# runs came no nearer to each other than by this factor.
FIRST, HALVINGS, MOST_STEPS = 1024, 9, 200_000
FINER = 10.0
STALLS, NEARER = 2, 0.7

# Points at these times [s] for a value of the grid, shape (times, sets, 4, 3).
Form = Callable[[float, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Tolerance:
    """The error from which a run is inaccurate: metres, "1mm", or "10%" of the motion's size.

    Raises ValueError for anything else.
    """

    error: float | str

    def __post_init__(self) -> None:
        _ = self.number

    @property
    def relative(self) -> bool:
        """Whether it is a share of the motion's size."""
        return isinstance(self.error, str) and "%" in self.error

    @property
    def number(self) -> float:
        """A share where it is relative, else a length [m]."""
        return units.length("stability_map", "error", self.error, 1.0)

    def share(self, size: float) -> float:
        """As a share of a motion of this size [m]."""
        return self.number if self.relative else self.number / max(size, 1e-300)

    def __str__(self) -> str:
        if self.relative:
            return f"{units.percent(self.number)} of the size of the true motion"
        return units.metres(self.number)


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """The points at all times at which some cell is read. size: how far any of them goes [m].

    error: the distance of the two finest runs over the size; 0 for a closed form; inf where no run
    came through. dt: of the finest run, 0 for a closed form.
    """

    times: np.ndarray
    points: np.ndarray | None
    size: float
    error: float = 0.0
    dt: float = 0.0

    def at(self, times: np.ndarray) -> np.ndarray:
        """The points at some of the times."""
        assert self.points is not None
        return self.points[np.searchsorted(self.times, times)]


def closed_form(form: Form, value: float, times: np.ndarray, size: float | None) -> TrueMotion:
    """The true motion where there is a formula for it."""
    points = form(value, times)
    return TrueMotion(times, points, reach(points) if size is None else size)


def reach(points: np.ndarray) -> float:
    """How far any point goes from where it starts [m]."""
    return float(np.linalg.norm(points - points[0], axis=-1).max())


def converged_runs(
    model: Model,
    path: str,
    values: list[float],
    motion: CellMotion,
    dts: list[float],
    tolerance: Tolerance,
    size: float | None,
    workers: Workers,
) -> list[TrueMotion]:
    """One converged run for each value of the grid; they are made where the cells are."""
    exact = model.with_settings(reference_settings(model))
    job = partial(converged_run, motion, dts, tolerance, size)
    runs = []
    for record in sweep(exact, {path: values}, job, **workers.arguments):
        if record.get("failure"):
            raise ValueError(f"{path} = {record[path]:g}: {record['failure']}")
        runs.append(record["run"])
    return runs


def reference_settings(model: Model) -> Settings:
    """The scene's own laws, with converged rows and the integrator of the highest order allowed."""
    settings = model.settings
    integrator = settings.integrator
    if not makes_rows(model):
        integrator = "rk4"
    elif integrator == "explicit":
        integrator = "semi-implicit"
    return converged_settings(
        settings,
        sweeps=1000,
        tolerance=0.0 if settings.law == "solref" else 1e-12,
        warm_start=True,
        integrator=integrator,
    )


def converged_run(
    motion: CellMotion, dts: list[float], tolerance: Tolerance, size: float | None, sim: Sim
) -> dict[str, TrueMotion]:
    """The converged run of one value: dt is halved until the run no longer changes."""
    model, times = sim.model, motion.all_times(dts)
    dt = min(*dts, motion.horizon / FIRST)
    # What counts as no motion.
    floor = 0.01 * BodyPoints(model).largest
    last: np.ndarray | None = None
    best = TrueMotion(times, None, size or floor, np.inf, dt)
    errors: list[float] = []
    for _ in range(HALVINGS + 1):
        if motion.horizon / dt > MOST_STEPS and last is not None:
            break
        points = points_at(motion, model, dt, times)
        if points is not None:
            span = size or max(reach(points), floor)
            error = np.inf
            if last is not None:
                error = float(np.linalg.norm(points - last, axis=-1).max()) / span
            best = TrueMotion(times, points, span, error, dt)
            errors.append(error)
            if error <= tolerance.share(span) / FINER or _stalled(errors):
                break
        last = points
        dt /= 2
    return {"run": best}


def _stalled(errors: list[float]) -> bool:
    """Whether halving no longer helps: the motion is chaotic, or jumps with the steps."""
    return len(errors) > STALLS + 1 and errors[-1] > NEARER * errors[-1 - STALLS]


def points_at(motion: CellMotion, model: Model, dt: float, times: np.ndarray) -> np.ndarray | None:
    """The points at any times, interpolated between two steps; None if the run fails.

    Between steps the error is at most dt²/8 of the acceleration; halving shows it with the rest.
    """
    sim = unwatched(Sim(model, dt=dt))
    motion.begin(sim)
    points = BodyPoints(model)
    done, here = 0, points.at(sim)
    result = np.empty((len(times), *here.shape))
    after: np.ndarray | None = None
    try:
        for k, time in enumerate(times):
            step, share = divmod(time / dt, 1.0)
            if share > 1 - 1e-6:
                step, share = step + 1, 0.0
            while done < int(step):
                if after is not None:
                    done, here, after = done + 1, after, None
                else:
                    steps(sim, int(step) - done)
                    done, here = int(step), points.at(sim)
            if share < 1e-6:
                result[k] = here
                continue
            if after is None:
                sim.step()
                after = points.at(sim)
            result[k] = (1 - share) * here + share * after
    except SimulationError:
        return None
    return result
