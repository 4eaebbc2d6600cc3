"""`predictability`: how long the motion of a scene can be predicted at all."""

from __future__ import annotations

import math
import os
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, ClassVar

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
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, seconds
from stepcore.scene.scene import Scene


@dataclass(eq=False, repr=False)
class Predictability(Result):
    """How fast small differences grow in a scene; made by `stepcore.predictability`.

    name: of the scene. horizon, dt [s], integrator: what was run. growth: see
    `stepcore.experiment.growth.Growth`. time: when the first start can no longer be predicted [s],
    inf if all can over the horizon.
    """

    kind = "predictability"
    units: ClassVar = {"predictable": "s", "growth": "1", "largest growth": "1", "times": "s"}

    name: str
    horizon: float
    dt: float
    integrator: str
    growth: Growth
    notes: list[str] = field(default_factory=list)

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
        """One row a start: how long it can be predicted [s], and how a perturbation grew."""
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

    @property
    def setup(self) -> str:
        """How it was measured, in a line."""
        return (
            f"{seconds(self.horizon)} from {counted(len(self.growth.ends), 'start')} under "
            f"{self.integrator}, dt {seconds(self.dt)}. From each start the motion is run again "
            f"from {DIRECTIONS} perturbed states, {compact(NEARBY)} of the scene's size away; it "
            f"is lost when they are more than {GROWTH:g} times as far away."
        )

    @property
    def sentences(self) -> list[str]:
        """How long the motion can be predicted."""
        over = seconds(self.horizon)
        if math.isinf(self.time):
            most = float(self.growth.factor.max())
            return [
                f"The motion can be predicted over all of {over}: perturbed runs end up at most "
                f"{most:.2g} times as far apart as they began."
            ]
        lost = np.isfinite(self.growth.ends)
        said = [
            f"The motion can be predicted for {seconds(self.time)}: {int(lost.sum())} of "
            f"{counted(len(lost), 'start')} are lost within {over}."
        ]
        if self.horizon < 2 * self.time:
            said.append(
                "Over a longer horizon perturbed runs may reconverge; they then count as "
                "predictable."
            )
        return said

    def tables(self, full: bool) -> list[Table]:
        """The starts."""
        heading = (
            "By start: predictable for [s]; growth of the perturbation, at the end and at most"
        )
        return [Table(self.table, heading=heading)]

    def details(self) -> dict[str, Any]:
        """The growth over time."""
        return {
            "horizon": self.horizon,
            "dt": self.dt,
            "integrator": self.integrator,
            "predictable": self.time,
            "predictable_starts": self.growth.ends,
            "times": self.growth.times,
            "growth": self.growth.factor,
            "limit": GROWTH,
            "nearby": NEARBY,
        }

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
    """How long a scene can be predicted: until runs that start a rounding apart separate.

    From every start the motion runs again from three states, 1e-9 of the scene's size away, under
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
