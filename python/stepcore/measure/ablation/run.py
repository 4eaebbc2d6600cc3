"""Running a motion with features switched off, and what it costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter, thread_time

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Dofs
from stepcore.experiment.errors import errors
from stepcore.experiment.motion import Motion
from stepcore.experiment.runner import Course, Path
from stepcore.measure.ablation.changes import Change, Seen, made

# Steps of the first start whose operations are counted, spread over the motion.
COUNTED = 40
# Looks at the contacts and limits of a start, at most.
LOOKS = 500
ROUNDS = 5


@dataclass(frozen=True)
class Measured:
    """One variant of a scene on the motion.

    added [m]: root mean square of the distance from the whole model's motion at the same
    settings, in every start; added_max: of any body, sample and start. error [m]: from the
    converged motion of the whole model, in every start. flops: floating-point operations, None
    where they cannot be counted; row_updates; both per simulated second. failure: why it failed.
    """

    added: tuple[float, ...] = ()
    added_max: float = np.nan
    error: tuple[float, ...] = ()
    flops: float | None = None
    row_updates: float = np.nan
    failure: str | None = None

    @property
    def worst(self) -> float:
        """Error added in the worst start [m]."""
        return max(self.added, default=np.inf) if self.failure is None else np.inf

    @property
    def median(self) -> float:
        """Error added in the median start [m]."""
        return float(np.median(self.added)) if self.failure is None else np.inf


@dataclass(frozen=True)
class Motive:
    """The user's motion, and how the whole model does it: what every variant is held against."""

    model: Model
    motion: Motion
    paths: tuple[Path, ...]
    truth: tuple[Path, ...] | None
    scored: np.ndarray

    @property
    def settings(self) -> Settings:
        return self.model.settings


def measured(motive: Motive, changes: Sequence[Change]) -> Measured:
    """The motion without some features."""
    try:
        scene = made(motive.model.scene.with_settings(motive.settings), changes)
        model = scene.compile()
    except ValueError as error:
        return Measured(failure=one_line(error))
    course = Course(model, Dofs(model.scene), motive.motion)
    paths = []
    for start in range(len(motive.motion.starts)):
        paths.append(course.run(model.settings, start))
        if paths[-1].failure:
            return Measured(failure=f"start {start}: {paths[-1].failure}")
    apart = errors(paths, motive.paths, motive.scored)
    truth = None if motive.truth is None else errors(paths, motive.truth, motive.scored)
    rows = float(np.mean([path.row_updates for path in paths])) / motive.motion.horizon
    flops = counted(course, model.settings)
    return Measured(apart.each, apart.position_max, truth.each if truth else (), flops, rows)


def counted(course: Course, settings: Settings) -> float | None:
    """Floating-point operations per simulated second of the first start's motion.

    Counted exactly in about `COUNTED` steps spread evenly over it.
    """
    motion = course.motion
    sim = course.sim(settings)
    if not hasattr(sim, "count_flops"):
        return None
    course.place(sim, 0)
    drive, count = course.drive(0), motion.steps(settings.dt)
    every = max(1, motion.periods // COUNTED)
    total, steps = 0, 0
    try:
        for period in range(motion.periods):
            drive(sim, period)
            if period % every == 0:
                total += sim.count_flops(1)
                steps += 1
            sim.step(count)
    except SimulationError:
        return None
    return total / steps / settings.dt


def watched(course: Course, settings: Settings) -> Seen:
    """Which pairs of bodies touch and which joints meet a limit in any start."""
    motion, model = course.motion, course.model
    owner = model.geom_body.tolist()
    # As the engine names their rows.
    joints = {
        f"limit of joint `{name}`" if name else f"limit of joint {i}": i
        for i, name in enumerate(model.joint_names)
    }
    touched: set[tuple[int, int]] = set()
    limited: set[int] = set()
    count = motion.steps(settings.dt)
    stride = max(1, count * motion.periods // LOOKS)
    for start in range(len(motion.starts)):
        sim = course.sim(settings)
        course.place(sim, start)
        drive = course.drive(start)
        for period in range(motion.periods):
            drive(sim, period)
            for first in range(0, count, stride):
                sim.step(min(stride, count - first))
                met = sim.contacts
                for a, b in zip(met["geom1"].tolist(), met["geom2"].tolist(), strict=True):
                    touched.add((min(owner[a], owner[b]), max(owner[a], owner[b])))
                rows = sim.rows
                names = rows["name"][rows["kind"] == "limit"] if len(rows) else ()
                limited.update(joints[name] for name in names if name in joints)
    return Seen(frozenset(touched), frozenset(limited))


def timed(motive: Motive, variants: Sequence[Sequence[Change]]) -> list[float]:
    """Computing time of variants [µs per simulated second]: median of interleaved rounds.

    The first start's motion; only `Sim.step` is timed, and of that the share in which the
    thread had a core to itself. NaN for what fails.
    """
    runs: list[Course | None] = []
    for changes in variants:
        try:
            model = made(motive.model.scene.with_settings(motive.settings), changes).compile()
            runs.append(Course(model, Dofs(model.scene), motive.motion))
        except ValueError:
            runs.append(None)
    spent: list[list[float]] = [[] for _ in runs]
    for _ in range(ROUNDS):
        for course, times in zip(runs, spent, strict=True):
            if course is not None:
                times.append(_once(course))
    horizon = motive.motion.horizon
    return [1e6 * float(np.median(times)) / horizon if times else np.nan for times in spent]


def _once(course: Course) -> float:
    settings, motion = course.model.settings, course.motion
    sim, drive = course.sim(settings), course.drive(0)
    count = motion.steps(settings.dt)
    course.place(sim, 0)
    spent, first, own = 0.0, perf_counter(), thread_time()
    try:
        for period in range(motion.periods):
            drive(sim, period)
            begin = perf_counter()
            sim.step(count)
            spent += perf_counter() - begin
    except SimulationError:
        return float("nan")
    whole, own = perf_counter() - first, thread_time() - own
    return spent * min(1.0, own / whole) if whole > 0 else spent
