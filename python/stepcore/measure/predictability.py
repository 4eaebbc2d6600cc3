"""`predict`: the time for which the motion of a scene can be predicted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Unpack

import numpy as np

from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.engines import Engine
from stepcore.experiment.motion import Motion
from stepcore.experiment.predictable import GROWTH, Asking, Growth, growth_requests, growths
from stepcore.experiment.quantity import MOTION, Measure, Quantity, Wanted
from stepcore.experiment.schedule import Schedule
from stepcore.experiment.study import SHIPPED, Study
from stepcore.experiment.truth import FINER
from stepcore.report.progress import Progress
from stepcore.report.result import Result
from stepcore.report.table import Table
from stepcore.report.units import compact, counted, seconds, times

# The default horizon [s].
HORIZON = 10.0
# Growth up to which coarse steps are trusted. In 40 scenes over 3 s, 70 starts stayed below it at a
# quarter of the shipped step: all were predictable with shorter steps. Of 23 above it, 5 were not.
TRUSTED = 10.0
# The perturbed runs of each start. Any perturbation soon contains the direction of fastest growth.
DIRECTIONS = 3


@dataclass(eq=False, repr=False)
class Predictability(Result):
    """The result of `stepcore.predict`: the time for which a scene can be predicted.

    motion: the motion that was run, over `horizon` [s] in steps of `dt` [s] under `integrator`.
    growth: the growth of the perturbations; see `stepcore.experiment.predictable.Growth`.
    nearby: the size of the perturbations, relative to the scene's size.
    quantity: the series that is predicted, by default the motion.
    """

    kind = "predictability"
    units: ClassVar = {"predictable": "s", "growth": "1", "largest": "1", "times": "s"}

    settings: Any
    motion: Motion
    horizon: float
    dt: float
    integrator: str
    growth: Growth
    nearby: float
    quantity: str = MOTION

    @property
    def time(self) -> float:
        """The time for which motions from all starts are predictable [s]; inf beyond horizon."""
        return self.growth.overall

    @property
    def limit(self) -> float:
        """The growth of a perturbation above which a motion counts as unpredictable."""
        return GROWTH

    @property
    def title(self) -> str:
        """The title of the report."""
        subject = "it" if self.quantity == MOTION else self.quantity
        return f"{self.name}: how long {subject} can be predicted"

    @property
    def table(self) -> Table:
        """One row per start: its predictable time, and its growth at the end and at most.

        predictable: [s]; inf beyond the horizon.
        """
        own = (self.growth.ends, self.growth.factor[:, -1], self.growth.factor.max(axis=1))
        numbers = zip(*(column.tolist() for column in own), strict=True)
        names = ("start", "predictable", "growth", "largest")
        heading = "For each start: how long it can be predicted [s]; the growth at the end, at most"
        rows = [dict(zip(names, (k, *row), strict=True)) for k, row in enumerate(numbers)]
        return Table(rows, heading=heading)

    @property
    def setup(self) -> str:
        """The method of the measurement, in one line."""
        relative = "" if self.quantity == MOTION else f", relative to the range of {self.quantity}"
        return (
            f"Run under {self.integrator}, dt {seconds(self.dt)}. Each start runs again from "
            f"{DIRECTIONS} perturbed states, {compact(self.nearby)} of the scene's size away; it "
            f"can be predicted until a perturbation has grown more than {times(GROWTH)}{relative}."
        )

    @property
    def sentences(self) -> list[str]:
        """The predictable time in words."""
        over, ends = seconds(self.horizon), np.isfinite(self.growth.ends)
        subject = "The motion" if self.quantity == MOTION else self.quantity
        if math.isinf(self.time):
            most = times(float(self.growth.factor.max()))
            how = f"over all of {over}: perturbations grow at most {most}"
            return [f"{subject} can be predicted {how}."]
        lost = f"from {int(ends.sum())} of {counted(len(ends), 'start')}"
        double = f"at the fastest doubling every {seconds(self.time / math.log2(GROWTH))}"
        said = [
            f"{subject} can be predicted for {seconds(self.time)}: {lost} nearby motions diverge "
            f"within {over}, {double}."
        ]
        if self.horizon < 2 * self.time:
            again = "perturbed runs may reconverge; they then count as predictable"
            said.append(f"Over a longer horizon {again}.")
        return said

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
            "nearby": self.nearby,
            "quantity": self.quantity,
        }

    def __repr__(self) -> str:
        return f"<Predictability of {self.name}: {self.time:.3g} s of {self.horizon:.3g} s>"


@measurement()
def predict(
    model: Source,
    motion: Motion | str | None = None,
    *,
    quantity: Wanted = None,
    engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> Predictability:
    """Measure how long the motion of a scene can be predicted.

    Each start is run again from three perturbed states, 1e-10 of the scene's size away (1e-6 in
    MuJoCo, whose solver has a larger error than 1e-10). The motion counts as predictable until the
    distance between these runs has grown by a factor of 1e3. After that, only statistics of the
    motion are meaningful. The runs use implicitfast at a quarter of the shipped time step, with
    rows solved to rounding error. If a start becomes unpredictable, shorter steps must give the
    same time; if they do not agree closely, rk4 is run too, and only growth in both counts. If no
    perturbation grows by more than 1e3 but one grows tenfold, rk4 must agree; if it does not, the
    shortest steps of implicitfast decide.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    motion: a `Motion`, or its fields as arguments. By default 10 s, and 8 starts.
    quantity: the series that is predicted, such as "site/tip" or "contact/foot"; by default the
        motion of all bodies. The distance of its runs then counts relative to its range, and the
        perturbation relative to the scene's size.
    engine: "stepcore", or "mujoco", which also runs files that stepcore cannot load.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError for an argument outside its limits, for a quantity that is not one series, or
    if the scene cannot be run.

    >>> from stepcore import lesson
    >>> spring = predict(lesson.spring(), horizon=2.0, starts=1)
    >>> spring.time, round(float(spring.growth.factor.max()), 2)
    (inf, 1.0)
    """
    quantity = Quantity.of(quantity)
    if quantity.has_scalars or quantity.parts:
        raise ValueError(f"quantity: {quantity.name}: must be one series, such as site/tip")
    setup = set_up(predict, model, motion, fields, missing="no motion to predict", engine=engine)
    motion = dataclasses.replace(setup.motion, horizon=setup.motion.horizon or HORIZON)
    study = Study(motion=motion, engine=setup.engine, quantity=quantity, workers=setup.workers)
    measure = None if quantity.is_motion else study.measure
    whole, rest = study.schedule, study.starts[1:]
    # The perturbed runs of two starts fill a register; one thread per start has less wall time.
    pair = 1 if len(rest) <= setup.workers.threads else 2
    others = [rest[k : k + pair] for k in range(0, len(rest), pair)]
    job = partial(grown, study.engine, whole, study.size, measure=measure)
    known: list[list[tuple[Growth, Change]] | None] = [None] * len(others)
    deadline, count = setup.workers.deadline, counted(len(study.starts), "start")
    # A tenth of the first start is the first partial answer; the whole first start is the second.
    ran = dataclasses.replace(whole, periods=whole.every * max(1, len(whole.times) // 10))

    def left_out() -> str:
        left = f"{len(rest) - sum(len(part or ()) for part in known)} of {count}"
        return left if ran is whole else f"what follows {seconds(ran.horizon)}; {left}"

    with setup.workers.bar("runs", len(study.starts)) as bar:
        first = grown(study.engine, ran, study.size, study.starts[:1], measure)
        deadline.so_far(f"from 1 start, {_said(first[0][0], ran.horizon)}; the rest is run now")
        with deadline.stage(left_out):
            (first,) = setup.workers.each(job, [study.starts[:1]], bar)
            ran, over = whole, _said(first[0][0], whole.horizon)
            deadline.so_far(f"from 1 start, {over}; others are run now")
            setup.workers.each(job, others, bar, known, partial(_counted, bar))
    every = [one for part in (first, *known) for one in part or ()]
    finest = min((study.engine.settings(change) for _, change in every), key=lambda s: s.dt)
    study.schedule, study.starts = ran, study.starts[: len(every)]
    return Predictability(
        name=setup.name,
        settings=study.engine.settings(SHIPPED),
        motion=dataclasses.replace(motion, starts=len(every), horizon=ran.horizon),
        horizon=ran.horizon,
        dt=finest.dt,
        integrator=finest.integrator,
        growth=Growth.joined([growth for growth, _ in every]),
        nearby=study.engine.nearby,
        quantity=quantity.name,
        ran=study.motion_ran,
    )


def _counted(bar: Progress, _: range, parts: list[list[tuple[Growth, Change]]]) -> None:
    """Count starts, not parts."""
    bar.advance(sum(len(part) - 1 for part in parts))


def _said(growth: Growth, horizon: float) -> str:
    end = growth.overall
    over = f"for {seconds(end)}" if math.isfinite(end) else f"over all of {seconds(horizon)}"
    return f"the motion can be predicted {over}"


def grown(
    engine: Engine,
    schedule: Schedule,
    size: float,
    starts: Sequence[int],
    measure: Measure | None = None,
) -> list[tuple[Growth, Change]]:
    """Measure the growth from some starts; starts that need the same change run together."""
    asking = {start: growing(engine, schedule) for start in starts}
    asked, known = {start: next(one) for start, one in asking.items()}, dict[int, Any]()
    while asked:
        change = next(iter(asked.values()))[0]
        own = [start for start, (other, _) in asked.items() if other == change]
        over = [asked[start][1] for start in own]
        found = growths(engine, change, over, own, size, DIRECTIONS, measure)
        for start, growth in zip(own, found, strict=True):
            try:
                asked[start] = asking[start].send(growth)
            except StopIteration as end:
                known[start] = end.value
                del asked[start]
    return [known[start] for start in starts]


def growing(engine: Engine, schedule: Schedule) -> Asking[tuple[Growth, Change]]:
    """Request the growth from one start, with the quicker method first.

    Growth may be an instability of the method (under rk4 a servo whose damping is too quick for the
    step). If a start becomes unpredictable, the other method is run too, unless two steps of the
    first agree closely on the time. The method that predicts for longer is right; if both predict
    for equally long, the one with less growth.

    A coarse motion may also miss an event that separates nearby motions, such as a fall. If a start
    stays predictable but a perturbation grows, the other method is run too. If the start is
    unpredictable with that, it must also be with the shortest steps of the first method.
    """
    found, whole = list[tuple[Growth, Change]](), None
    ways = [way for way in engine.ways(schedule, 1.0) if way.fixed]
    # Start from a quarter of the shipped step.
    ladders = [[way.at(2 + finer) for finer in range(FINER + 1)] for way in ways]
    for rungs in ladders:
        growth, change, closely = yield from growth_requests(rungs, schedule, 1, whole)
        kept = math.isinf(growth.overall)
        if not growth.failure:
            found.append((growth, change))
            if kept and (len(found) > 1 or growth.factor.max() <= TRUSTED):
                break
            if closely and 10 * growth.times[0] < growth.overall < math.inf:
                break
            # A user's control may make the whole motion fail, which is reported.
            whole = growth if schedule.control is None and not kept else None
        elif found and math.isinf(found[0][0].overall):
            break
        elif change != rungs[-1] and growth.overall > growth.times[0]:
            # If other steps also become unpredictable and fail, the motion itself fails.
            found.clear()
    if not found:
        text = f"the motion fails{schedule.driven}, at shorter steps too"
        raise ValueError(f"{text}: {growth.failure}")
    if len(found) > 1 and math.isinf(found[0][0].overall) and not kept:
        finest = yield ladders[0][-1], schedule
        if not finest.failure:
            found[0] = finest, ladders[0][-1]
    return max(found, key=lambda one: (one[0].overall, -one[0].factor.max()))
