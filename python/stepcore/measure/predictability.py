"""`predict`: the time over which the motion of a scene can be predicted."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, ClassVar, Unpack

import numpy as np

from stepcore._core import Settings
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.growth import DIRECTIONS, GROWTH, NEARBY, Growth
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import motion_in_words
from stepcore.experiment.reference import ReferenceRuns
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import STARTS, scheduled, time_steps
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, seconds, times

# The default horizon [s].
HORIZON = 10.0


@dataclass(frozen=True)
class StartGrowth:
    """The growth of perturbations from one start, relative to their initial size.

    start: the index of the start.
    predictable: how long the motion can be predicted [s]; inf beyond the horizon.
    growth: the growth at the end of the run.
    largest: the largest growth at any time.
    """

    start: int
    predictable: float
    growth: float
    largest: float


@dataclass(eq=False, repr=False)
class Predictability(Result):
    """The result of `stepcore.predict`: how long a scene can be predicted.

    name, settings: the name and the settings of the scene.
    motion: the motion that was run, over `horizon` [s] in steps of `dt` [s] under `integrator`.
    growth: the growth of the perturbations; see `stepcore.experiment.growth.Growth`.
    """

    kind = "predictability"
    units: ClassVar = {"predictable": "s", "growth": "1", "largest": "1", "times": "s"}

    settings: Settings
    motion: Motion
    horizon: float
    dt: float
    integrator: str
    growth: Growth

    @property
    def time(self) -> float:
        """Time over which the motion from every start is predictable [s]; inf beyond horizon."""
        return self.growth.overall

    @property
    def limit(self) -> float:
        """Growth of a perturbation above which a motion counts as unpredictable."""
        return GROWTH

    @property
    def title(self) -> str:
        """Title of the report."""
        return f"{self.name}: how long it can be predicted"

    @property
    def rows(self) -> list[StartGrowth]:
        """The growth from each start."""
        starts = zip(self.growth.ends, self.growth.factor, strict=True)
        return [
            StartGrowth(start, float(end), float(factor[-1]), float(factor.max()))
            for start, (end, factor) in enumerate(starts)
        ]

    @property
    def table(self) -> Table:
        """Table with one row for each start; see `StartGrowth`."""
        return Table(map(vars, self.rows))

    @property
    def setup(self) -> str:
        """The method of the measurement, in one line."""
        return (
            f"Run under {self.integrator}, dt {seconds(self.dt)}. Each start runs again from "
            f"{DIRECTIONS} perturbed states, {compact(NEARBY)} of the scene's size away; it can be "
            f"predicted until a perturbation has grown more than {times(GROWTH)}."
        )

    @property
    def sentences(self) -> list[str]:
        """The predictable time, in words."""
        over = seconds(self.horizon)
        if math.isinf(self.time):
            most = float(self.growth.factor.max())
            return [
                f"The motion can be predicted over all of {over}: perturbations grow at most "
                f"{times(most)}."
            ]
        ends = np.isfinite(self.growth.ends)
        lost, starts = int(ends.sum()), counted(len(ends), "start")
        double = self.time / math.log2(GROWTH)
        said = [
            f"The motion can be predicted for {seconds(self.time)}: from {lost} of {starts} nearby "
            f"motions diverge within {over}, at the fastest doubling every {seconds(double)}."
        ]
        if self.horizon < 2 * self.time:
            said.append(
                "Over a longer horizon perturbed runs may reconverge; they then count as "
                "predictable."
            )
        return said

    def tables(self, full: bool) -> list[Table]:
        """Return the table of the starts."""
        heading = (
            "For each start: how long the motion can be predicted [s]; the growth of the "
            "perturbation at the end, and the largest"
        )
        return [Table(self.table, heading=heading)]

    def details(self) -> dict[str, Any]:
        """Return the numbers of the result, with the growth over time."""
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

    def __repr__(self) -> str:
        return f"<Predictability of {self.name}: {self.time:.3g} s of {self.horizon:.3g} s>"


@measurement()
def predict(
    model: Source,
    motion: Motion | str | None = None,
    **fields: Unpack[MeasurementFields],
) -> Predictability:
    """Measure how long the motion of a scene can be predicted.

    Each start runs again from three perturbed states, 1e-10 of the scene's size away. The motion
    counts as predictable until the distance between these runs has grown by a factor of 1e3. After
    that, only statistics of the motion are meaningful. The runs use rk4 at a quarter of the shipped
    time step, with rows solved to rounding. If such a run fails, a quarter of that step or another
    integrator is used.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    motion: a `Motion`, or its fields as arguments. By default 10 s, and 8 starts.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, or if the scene cannot be run.

    >>> from stepcore import lesson
    >>> spring = predict(lesson.spring(), horizon=2.0, starts=1)
    >>> spring.time, round(float(spring.growth.factor.max()), 2)
    (inf, 1.0)
    """
    setup = set_up(predict, model, motion, fields, missing="no motion to predict")
    model, (_, motion, workers) = setup.model, setup
    horizon = HORIZON if motion.horizon is None else motion.horizon
    motion = dataclasses.replace(motion, horizon=horizon, starts=motion.starts or STARTS)
    own = model.settings.dt
    steps, period = time_steps(own, None, motion.period(own), horizon)
    runner = Runner(model, scheduled(motion, model, period))
    runner.check_repeatable()
    # Sleeping bodies would hide the growth of perturbations.
    runs = ReferenceRuns(runner, model.settings.replace(sleep=False), min(steps), 0.0, workers)
    with workers.bar("runs", 1 + (1 + DIRECTIONS) * runs.starts) as bar:
        level, growth = runs.growth(bar)
    lost = runs.starts - len(growth.ends)
    if lost:
        starts = f"{lost} of {counted(runs.starts, 'start')}"
        workers.deadline.left_out.append(starts)
    return Predictability(
        name=setup.name,
        settings=model.settings,
        motion=motion,
        horizon=runner.schedule.horizon,
        dt=level.dt,
        integrator=level.integrator,
        growth=growth,
        batches=workers.speedup.sentences,
        ran=motion_in_words(model, motion, runner.schedule),
    )
