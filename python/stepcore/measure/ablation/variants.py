"""Variants of a model without some features: their motion, what it costs, what it uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter, thread_time

import numpy as np

from stepcore._core import Settings, SimulationError
from stepcore.checks import one_line
from stepcore.engine.features import Removal, Usage, without
from stepcore.engine.model import Model
from stepcore.experiment.coordinates import Dofs
from stepcore.experiment.errors import errors
from stepcore.experiment.motion import Motion
from stepcore.experiment.runner import Course, Path

# Steps of the first start whose operations are counted, spread over the motion.
COUNTED = 40
# Contacts and limits of a start are read this often, at most.
READINGS = 500
ROUNDS = 5


@dataclass(frozen=True)
class Outcome:
    """How one variant of a model does the motion.

    added [m]: RMS distance from the whole model's motion at the same settings, in every start;
    added_max: of any body, sample and start. error [m]: RMS distance from the converged motion of
    the whole model, in every start. flops: floating-point operations, None where they cannot be
    counted; row_updates; both per simulated second. failure: why it failed.
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
class Baseline:
    """The whole model's motion at its own settings, which every variant is compared with.

    truth: its converged motion, None where there is none; scored: which samples count.
    """

    model: Model
    motion: Motion
    paths: tuple[Path, ...]
    truth: tuple[Path, ...] | None
    scored: np.ndarray

    @property
    def settings(self) -> Settings:
        """The model's own."""
        return self.model.settings


def variant(baseline: Baseline, removals: Sequence[Removal]) -> Course:
    """The motion's runner for the model without some features."""
    scene = without(baseline.model.scene.with_settings(baseline.settings), removals)
    model = scene.compile()
    return Course(model, Dofs(model.scene), baseline.motion)


def outcome_of(baseline: Baseline, removals: Sequence[Removal]) -> Outcome:
    """The motion without some features."""
    try:
        course = variant(baseline, removals)
    except ValueError as error:
        return Outcome(failure=one_line(error))
    settings = course.model.settings
    paths = []
    for start in range(len(baseline.motion.starts)):
        paths.append(course.run(settings, start))
        if paths[-1].failure:
            return Outcome(failure=f"start {start}: {paths[-1].failure}")
    added = errors(paths, baseline.paths, baseline.scored)
    truth = baseline.truth
    off = () if truth is None else errors(paths, truth, baseline.scored).each
    rows = float(np.mean([path.row_updates for path in paths])) / baseline.motion.horizon
    flops = flops_per_second(course, settings)
    return Outcome(added.each, added.position_max, off, flops, rows)


def flops_per_second(course: Course, settings: Settings) -> float | None:
    """Floating-point operations per simulated second of the first start's motion.

    Counted exactly in about `COUNTED` steps spread evenly over it.
    """
    motion = course.motion
    sim = course.sim(settings)
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


def usage_of(course: Course, settings: Settings) -> Usage:
    """Which pairs of bodies touch and which joints reach a limit in any start."""
    motion, model = course.motion, course.model
    owner = model.geom_body.tolist()
    touched: set[tuple[int, int]] = set()
    limited: set[int] = set()
    count = motion.steps(settings.dt)
    stride = max(1, count * motion.periods // READINGS)
    for start in range(len(motion.starts)):
        sim = course.sim(settings)
        course.place(sim, start)
        drive = course.drive(start)
        for period in range(motion.periods):
            drive(sim, period)
            for first in range(0, count, stride):
                sim.step(min(stride, count - first))
                contacts = sim.contacts
                pairs = zip(contacts["geom1"].tolist(), contacts["geom2"].tolist(), strict=True)
                for a, b in pairs:
                    touched.add((min(owner[a], owner[b]), max(owner[a], owner[b])))
                rows = sim.rows
                limited.update(rows["index"][rows["kind"] == "limit"].tolist())
    return Usage(frozenset(touched), frozenset(limited))


def times_of(baseline: Baseline, variants: Sequence[Sequence[Removal]]) -> list[float]:
    """Computing time of variants [µs per simulated second]: median of interleaved rounds.

    The first start's motion; only `Sim.step` is timed, and of that the share in which the thread
    had a core to itself. NaN for a variant that fails.
    """
    runs: list[Course | None] = []
    for removals in variants:
        try:
            runs.append(variant(baseline, removals))
        except ValueError:
            runs.append(None)
    spent: list[list[float]] = [[] for _ in runs]
    for _ in range(ROUNDS):
        for course, times in zip(runs, spent, strict=True):
            if course is not None:
                times.append(_time_of(course))
    horizon = baseline.motion.horizon
    return [1e6 * float(np.median(times)) / horizon if times else np.nan for times in spent]


def _time_of(course: Course) -> float:
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
