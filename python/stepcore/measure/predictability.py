"""`predictability`: how long the motion of a scene can be predicted at all."""

from __future__ import annotations

import math
import os
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.executors import check_executor
from stepcore.experiment.coordinates import movable
from stepcore.experiment.growth import DIRECTIONS, GROWTH, NEARBY, Growth
from stepcore.experiment.motion import Control, motion, time_steps
from stepcore.experiment.reference import Search
from stepcore.experiment.runner import Course
from stepcore.loading import find_model
from stepcore.report.progress import Choice, Progress
from stepcore.report.result import Result
from stepcore.report.table import Table, jsonable
from stepcore.report.units import seconds
from stepcore.scene.scene import Scene


@dataclass(eq=False, repr=False)
class Predictability(Result):
    """How fast small differences grow in a scene; made by `stepcore.predictability`.

    name: of the scene. horizon, dt [s], integrator: what was run. growth: see
    `stepcore.experiment.growth.Growth`. time: when the first start can no longer be predicted [s],
    inf if all can over the horizon.
    """

    name: str
    horizon: float
    dt: float
    integrator: str
    growth: Growth

    @property
    def time(self) -> float:
        """When the first of the starts can no longer be predicted [s]; inf beyond the horizon."""
        return self.growth.overall

    @property
    def title(self) -> str:
        """What was measured, in a few words."""
        return f"{self.name}: how long it can be predicted"

    @property
    def table(self) -> Table:
        """One row a start: until when it can be predicted [s], and how much twins grew apart."""
        found = self.growth
        return Table(
            {
                "start": k,
                "predictable": float(end),
                "growth": float(factor[-1]),
                "largest growth": float(factor.max()),
            }
            for k, (end, factor) in enumerate(zip(found.ends, found.factor, strict=True))
        )

    def text(self, width: int | None = None) -> str:
        """The printed result, at most `width` characters wide."""
        over = seconds(self.horizon)
        if math.isinf(self.time):
            most = float(self.growth.factor.max())
            said = f"It can be predicted over all of {over}: twins grow {most:.2g} times apart."
        else:
            lost = np.isfinite(self.growth.ends)
            said = (
                f"It can be predicted for {seconds(self.time)}; {int(lost.sum())} of "
                f"{len(lost)} starts are lost within {over}."
            )
            if self.horizon < 2 * self.time:
                said += " Over a longer horizon twins may come back together, and be forgiven."
        how = (
            f"Twins begin {NEARBY:g} of the scene's size apart, in {DIRECTIONS} directions; a "
            f"start is lost when they are more than {GROWTH:g} times as far apart "
            f"({self.integrator}, dt {seconds(self.dt)})."
        )
        return "\n".join([f"{self.title}, {over}", "", self.table.text(width), "", said, how])

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data; what is not finite is None."""
        found = self.growth
        plain: dict[str, Any] = jsonable(
            {
                "model": self.name,
                "horizon": self.horizon,
                "dt": self.dt,
                "integrator": self.integrator,
                "predictable": self.time,
                "predictable_starts": found.ends,
                "times": found.times,
                "growth": found.factor,
                "limit": GROWTH,
                "nearby": NEARBY,
                "units": {"times": "s", "predictable": "s", "growth": "1"},
            }
        )
        return plain

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Growth over time, one line a start; written to `path` if given. Needs matplotlib.

        Returns the matplotlib Figure.
        """
        from stepcore.report.plot.growth import plot_growth

        return plot_growth(self, path)

    def __repr__(self) -> str:
        return f"<Predictability of {self.name}: {self.time:.3g} s of {self.horizon:.3g} s>"


def predictability(
    model: Model | Scene | str | os.PathLike[str],
    *,
    horizon: float | None = None,
    key: str | int | None = None,
    control: Control | None = None,
    control_dt: float | None = None,
    ctrl: ArrayLike | None = None,
    starts: int = 8,
    seed: int = 0,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Choice = None,
) -> Predictability:
    """How long a scene can be predicted: until twins a rounding apart separate.

    From every start runs begin 1e-9 of the scene's size apart in three seeded directions, under
    rk4 at a 16th of the shipped time step (a quarter of that, or another integrator, where that
    fails), rows solved to rounding. The scene can be predicted until they are 1e3 times as far
    apart as they began; beyond that only statistics of its motion mean anything.

    horizon: simulated time [s], by default 10 s. The other arguments are those of
    `stepcore.trade`; executor: in place of threads, any `concurrent.futures.Executor`.

    Raises ValueError for an argument outside its limits, or if the scene cannot be run.

    >>> from stepcore import lesson
    >>> found = predictability(lesson.spring(), horizon=2.0, starts=1)
    >>> found.time, round(float(found.growth.factor.max()), 2)
    (inf, 1.0)
    """
    model = find_model(model)
    checks.told("predictability", progress)
    starts, seed = checks.count("starts", starts), checks.count("seed", seed, least=0)
    workers = checks.threads(threads)
    check_executor("predictability", executor)
    dofs = movable(model.scene, "no motion to predict")
    horizon = 10.0 if horizon is None else horizon
    steps, period = time_steps(model.settings.dt, None, control_dt, horizon)
    motive = motion(
        model,
        dofs,
        horizon=horizon,
        period=period,
        key=key,
        ctrl=ctrl,
        control=control,
        count=starts,
        seed=seed,
    )
    search = Search(Course(model, dofs, motive), model.settings, min(steps), 0.0, workers, executor)
    with Progress("predictability", (2 + DIRECTIONS) * starts, progress) as bar:
        level, found = search.alone(bar)
    name = model.scene.name or "scene"
    return Predictability(name, motive.horizon, level.dt, level.integrator, found)
