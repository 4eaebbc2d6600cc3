"""What a cell is judged against: a closed form, or the scene's own converged run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.executors import steps
from stepcore.measure.stability.course import Bodies, Course
from stepcore.measure.sweep import sweep

# The first run has at least so many steps; then dt is halved until two runs agree to a tenth of
# what makes a cell inaccurate, a run would have too many steps, or halving no longer helps: in
# that many halvings two runs came no nearer to each other than by this factor.
FIRST, HALVINGS, MOST = 1024, 9, 200_000
FINER = 10.0
VAIN, NEARER = 2, 0.7

# Points at these times [s] for a value of the grid, shape (times, sets, 4, 3).
Form = Callable[[float, np.ndarray], np.ndarray]


@dataclass
class Truth:
    """The points at the union of all looks. size: how far any of them goes [m].

    error: how far the two finest runs are apart, over the size; 0 for a closed form; inf where
    no run came through. dt: of the finest run, 0 for a closed form.
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


def union(course: Course, dts: list[float]) -> np.ndarray:
    """All times at which any cell is looked at, the start included [s]."""
    return np.unique(np.concatenate([[0.0], *(course.times(dt) for dt in dts)]))


def closed(form: Form, value: float, times: np.ndarray, size: float | None) -> Truth:
    """The truth where there is a formula for it."""
    points = form(value, times)
    return Truth(times, points, extent(points) if size is None else size)


def extent(points: np.ndarray) -> float:
    """How far any point goes from where it starts [m]."""
    return float(np.linalg.norm(points - points[0], axis=-1).max())


def least(model: Model) -> float:
    """What counts as no motion: a hundredth of the largest radius of gyration [m]."""
    return 0.01 * float(Bodies(model).radius.max(initial=0.0))


def converged(
    model: Model,
    path: str,
    values: list[float],
    course: Course,
    dts: list[float],
    tolerance: float,
    size: float | None,
    workers: dict[str, Any],
) -> list[Truth]:
    """One truth a value of the grid; the runs go wherever the cells go."""
    exact = model.with_settings(**reference_settings(model))
    job = partial(halve, course, dts, tolerance, size)
    found = sweep(exact, {path: values}, job, **workers)
    truths = []
    for record in found:
        if record.get("failure"):
            raise ValueError(f"{path} = {record[path]:g}: {record['failure']}")
        truths.append(record["truth"])
    return truths


def reference_settings(model: Model) -> dict[str, Any]:
    """The scene's own laws, solved to rounding by the integrator of the highest order it allows."""
    settings = model.settings
    chosen: dict[str, Any] = {"precision": "f64", "warm_start": True}
    if smooth(model):
        chosen["integrator"] = "rk4"
    elif settings.integrator == "explicit":
        chosen["integrator"] = "semi-implicit"
    if settings.law == "solref":
        chosen |= {"solver": "newton", "sweeps": 100, "tolerance": 0.0, "acceleration": "none"}
    else:
        chosen |= {"solver": "pgs", "sweeps": 1000, "tolerance": 1e-12, "acceleration": "none"}
    return chosen


def smooth(model: Model) -> bool:
    """Nothing in the scene can make a row."""
    scene = model.scene
    rows = any(j.range is not None or j.frictionloss > 0 for j in scene.joints)
    return not rows and not model.pairs and not scene.equalities


def halve(
    course: Course, dts: list[float], tolerance: float, size: float | None, sim: Sim
) -> dict[str, Truth]:
    """The converged run of one value: dt is halved until it no longer matters."""
    model, times = sim.model, union(course, dts)
    dt = min(*dts, course.horizon / FIRST)
    floor = least(model)
    last: np.ndarray | None = None
    best = Truth(times, None, size or floor, np.inf, dt)
    errors: list[float] = []
    for _ in range(HALVINGS + 1):
        if course.horizon / dt > MOST and last is not None:
            break
        points = dense(course, model, dt, times)
        if points is not None:
            span = size or max(extent(points), floor)
            error = np.inf
            if last is not None:
                error = float(np.linalg.norm(points - last, axis=-1).max()) / span
            best = Truth(times, points, span, error, dt)
            errors.append(error)
            if error <= tolerance / FINER or _in_vain(errors):
                break
        last = points
        dt /= 2
    return {"truth": best}


def _in_vain(errors: list[float]) -> bool:
    """Halving does not help: the motion is chaotic, or jumps with the steps."""
    return len(errors) > VAIN + 1 and errors[-1] > NEARER * errors[-1 - VAIN]


def dense(course: Course, model: Model, dt: float, times: np.ndarray) -> np.ndarray | None:
    """The points at any times, straight between two steps; None if the run does not come through.

    Between steps the error is at most dt²/8 of the acceleration; halving finds it with the rest.
    """
    sim = Sim(model, dt=dt)
    course.begin(sim)
    bodies = Bodies(model)
    done, here = 0, bodies.points(sim)
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
                    done, here = int(step), bodies.points(sim)
            if share < 1e-6:
                result[k] = here
                continue
            if after is None:
                sim.step()
                after = bodies.points(sim)
            result[k] = (1 - share) * here + share * after
    except SimulationError:
        return None
    return result
