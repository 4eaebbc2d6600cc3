"""`compare`: why two models behave differently."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np

from stepcore import checks
from stepcore.engine.model import Model
from stepcore.engine.norm import Matter, Tracks, distances, rms
from stepcore.experiment.arguments import MeasurementFields, Setup, Source, measurement, set_up
from stepcore.experiment.change import Change, Servo
from stepcore.experiment.choose import greedy
from stepcore.experiment.control_table import ControlLog, Controls
from stepcore.experiment.engines import Stepcore
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import HORIZON, Schedule, time_steps
from stepcore.experiment.study import SHIPPED, Study
from stepcore.experiment.truth import KNOWN, SHARE, Truth
from stepcore.loading import find_model
from stepcore.measure.comparison.differences import (
    ROUNDING,
    Difference,
    Differences,
    Names,
    counterparts,
    differences,
    together,
)
from stepcore.measure.comparison.events import first_difference
from stepcore.measure.comparison.result import Attribution, Comparison, DifferenceEffect
from stepcore.report import units
from stepcore.report.units import metres
from stepcore.scene.layout import DOFS, QPOS

__all__ = ["Attribution", "Comparison", "Difference", "DifferenceEffect", "compare"]

# The distance of two runs that differ by rounding alone, as a share of the scene's size. For
# gymnasium's half_cheetah, stepcore and MuJoCo are less than 1e-12 m apart over 1 s.
SAME = 1e-9


@measurement()
def compare(
    model: Source,
    other: Source | None = None,
    motion: Motion | str | None = None,
    *,
    within: float | str | None = None,
    settings: Mapping[str, Any] | None = None,
    other_engine: str = "stepcore",
    **fields: Unpack[MeasurementFields],
) -> Comparison:
    """Explain why two models behave differently: the differences that change a motion.

    Elements are matched by name. Every value and setting that differs is a `Change` of A. `compare`
    runs A in A's motion with each difference alone, and with all differences but one. Then it
    searches for the smallest set of differences that brings A to B. Changes of the model are judged
    by converged motions, and numerical settings by the motions as shipped.

    model: A: a Model, a Scene, or the path of an MJCF or URDF file (or "package:name").
    other: B, likewise; by default A itself, in another engine or with other settings.
    motion: a `Motion`, or its fields as arguments; by default one that A could make, of about 1 s.
    within: the distance up to which motions count as equal: metres, "1mm", or "0.1%" of the scene's
        size. By default a tenth of the distance of A and B, and at least the uncertainty of their
        converged motions.
    settings: B's settings that replace those of its file, by name: ``{"dt": 0.005}``.
    other_engine: the engine that runs B: "stepcore" or "mujoco". A runs in stepcore.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    The result lists differences without running them if joints or actuators have no counterpart.

    Raises ValueError for an argument outside its limits, and for time steps without a common
    control period.

    >>> from stepcore import lesson
    >>> soft = lesson.spring().compile()
    >>> stiff = soft.with_values({"joint/spring/stiffness": 90.0})
    >>> result = compare(soft, stiff, horizon=0.2, starts=2)
    >>> [one.path for one in result.needed], result.unexplained
    (['joint/spring/stiffness'], 0.0)
    """
    if within is not None:
        # Check the length before minutes of work; the scene's size is known later.
        units.length("compare", "within", within, 1.0)
    if other is None and other_engine == "stepcore" and not settings:
        raise ValueError("other: must be a second model, unless settings or other_engine differ")
    missing = "no motion to compare"
    first = set_up(compare, model, motion, fields, missing=missing)
    other = first.model if other is None else other
    if settings:
        other = find_model(other).with_settings(**settings)
    second = set_up(compare, other, motion, fields, missing=missing, engine=other_engine)
    assert isinstance(first.engine, Stepcore)
    found = differences(first.model, second.model, first.engine)
    return _Comparing(first, second, found, within).result()


class _Comparing:
    """The runs of a comparison.

    study, other: of A and of B, in A's motion. starts: by index. scored: the samples that can be
    predicted; None for all. truth: A's converged motion; None if there is none. base, error: the
    settings in which changes of the model are compared, and A's error under them [m].
    """

    def __init__(
        self, first: Setup, second: Setup, found: Differences, within: float | str | None
    ) -> None:
        self.first, self.second, self.found, self.within = first, second, found, within
        self.time, self.scored = first.workers.deadline, None
        self.truth: Truth | None = None
        self.base, self.error = SHIPPED, math.nan
        self.comparison = Comparison(
            name=first.name,
            other=second.name,
            settings=first.engine.settings(SHIPPED),
            motion=first.motion,
            differences=found.changes,
            others=[one for one in found.others if one not in found.unmapped],
            unmapped=found.unmapped,
            rounding=found.rounding,
            engine=second.engine.version,
        )

    def result(self) -> Comparison:
        """Make the runs, as far as the time allows."""
        result = self.comparison
        if self.found.unmapped:
            return result
        if not (self.found.changes or result.others or result.engine):
            result.distance = result.unexplained = 0.0
            return result
        self._begin()
        result.same = result.distance <= SAME * self.study.size
        if result.same and not self.found.changes:
            return result
        with self.time.stage("integration errors, and effects on the converged motion", KNOWN):
            self._converge()
        models = [one for one in self.found.changes if one.change.models]
        settings = [one for one in self.found.changes if not one.change.models]
        if settings:
            # The numerical settings differ between A with B's model, and B.
            others, within = together(models), self._equal(result.distance)
            result.numerical = self._attributed(settings, SHIPPED, math.nan, others, within)
        if models:
            converged = self.truth is not None
            far = result.converged if converged else result.distance
            within = max(self._equal(far), result.uncertainty if converged else 0.0)
            with self.time.stage("cheaper settings of the converged motion"):
                self._cheaper(within)
            result.models = self._attributed(models, self.base, self.error, SHIPPED, within)
        return result

    def _equal(self, distance: float) -> float:
        """Return the distance up to which motions count as equal [m]; distance: of A and B [m]."""
        if self.within is None:
            return SHARE * distance
        return units.length("compare", "within", self.within, self.study.size)

    def _cheaper(self, within: float) -> None:
        """Find the longest steps whose error is at most half of a distance [m].

        The error of the distance of two such runs is then at most this distance.
        """
        while self.truth is not None:
            settings = self.study.engine.settings(self.base)
            longer, looser = 2 * settings.dt, 4 * (settings.accuracy or 0.0)
            if not looser and longer > self.study.schedule.period * (1 + ROUNDING):
                return
            change = self.base.also(Change(accuracy=looser) if looser else Change(dt=longer))
            (tracks,) = self.study.tracks([change], self.starts)
            error = max(self.far(tracks, self.truth.tracks), self._allowed(looser))
            if 2 * error > within:
                return
            self.base, self.error = change, error

    def _allowed(self, accuracy: float | None) -> float:
        """Return the error that adaptive steps may have [m]: two runs may be equal by chance."""
        return (accuracy or 0.0) * self.study.schedule.horizon

    def _begin(self) -> None:
        """Run A, B, and A with all differences as shipped."""
        first, second, result = self.first, self.second, self.comparison
        own, others, motion = first.engine.dt, second.engine.dt, first.motion
        dts = None if own == others else [own, others]
        length = motion.horizon or HORIZON
        period = time_steps(own, dts, motion.period(own), length)[1]
        names = Names(first.model), Names(second.model)
        mine, theirs = _common_bodies(first.engine.matter, second.engine.matter, names)
        first.engine.matter = mine
        self.study = Study(motion=motion, engine=first.engine, workers=first.workers, period=period)
        schedule = _for_counterpart(self.study.schedule, first.model, second.model, names)
        engine = copy.copy(second.engine)
        engine.schedule, engine.matter = schedule, theirs
        self.other = Study(motion=motion, engine=engine, workers=first.workers, period=period)
        self.starts = self.study.starts
        result.ran, result.notes = self.study.motion_ran, [*self.study.schedule.notes]
        self._measure()

    def _measure(self) -> None:
        """Measure the distances of the runs as shipped."""
        result, every = self.comparison, together(self.found.changes)
        a, with_all = self.study.tracks([SHIPPED, every], self.starts, "A and B")
        (b,) = self.other.tracks([SHIPPED], self.starts)
        result.failures = a.failure_from(self.starts), b.failure_from(self.starts)
        result.starts = len(self.starts)
        result.distance, result.unexplained = self.far(a, b), self.far(with_all, b)
        self._separate(a, b)
        self.time.so_far(f"as shipped A and B are {metres(result.distance)} apart")

    def _separate(self, a: Tracks, b: Tracks) -> None:
        """Find when the motions separate in the worst start, and the first event that differs."""
        result, limit = self.comparison, self._equal(self.comparison.distance)
        if not 0 < limit < math.inf:
            return
        far = distances(a, b, self.study.engine.matter)
        worst = int(np.argmax(rms(far, self.scored)))
        over = np.flatnonzero(np.sqrt(np.mean(far[worst] ** 2, axis=1)) > limit)
        if not len(over):
            return
        result.separated, result.separation = float(self.study.schedule.times[over[0]]), limit
        schedules, engines = (
            (self.study.schedule, self.other.schedule),
            (
                self.study.engine,
                self.other.engine,
            ),
        )
        with self.time.closing():
            event = first_difference(engines, schedules, self.starts[worst])
        result.event = event if event and event.time <= result.separated else None

    def far(self, a: Tracks, b: Tracks) -> float:
        """Return the distance of two motions in the worst start [m]; inf if one fails."""
        if a.failure or b.failure:
            return math.inf
        return float(rms(distances(a, b, self.study.engine.matter), self.scored).max(initial=0.0))

    def _converge(self) -> None:
        """Measure the integration errors, and the distance of the converged motions."""
        result, studies = self.comparison, (self.study, self.other)
        models = together([one for one in self.found.changes if one.change.models])
        a, changed = self.study.tracks([SHIPPED, models], self.starts)
        moved = self.far(a, changed) or result.distance
        # Half of the distance that counts as equal: see `_cheaper`.
        goal = self._equal(moved) / 2 / SHARE if 0 < moved < math.inf else None
        # Two engines that agree on the model separate by less than their errors.
        goal = None if result.engine and self.within is None else goal
        try:
            truths: list[Truth] = [study.truth(goal) for study in studies]
        except ValueError as error:
            result.notes.append(f"there is no converged motion: {checks.one_line(error)}")
            return
        starts = [s for s in truths[0].starts if s in truths[1].starts]
        of_a, of_b = (truth.part(starts) for truth in truths)
        self.starts, self.scored = tuple(starts), of_a.scored & of_b.scored
        result.converged = self.far(of_a.tracks, of_b.tracks)
        uncertainty = [max(t.error, self._allowed(t.settings.accuracy)) for t in (of_a, of_b)]
        result.uncertainty = sum(uncertainty)
        result.errors = tuple(
            study.score(SHIPPED, study.tracks([SHIPPED], starts)[0], truth).error
            for study, truth in zip(studies, (of_a, of_b), strict=True)
        )
        self.truth, self.base, self.error = of_a, of_a.change, uncertainty[0]
        self._measure()

    def _attributed(
        self, some: list[Difference], base: Change, error: float, others: Change, within: float
    ) -> Attribution:
        """Return the effects of some differences, and the smallest set of them.

        base, error: the settings of the runs, and A's error under them [m]; NaN as shipped.
        others: changes that all runs of the search have.
        within: the distance up to which motions count as equal [m].
        """
        runs = _Runs(self, some, base, others)
        with self.time.stage("some of the differences, alone and removed"):
            runs.alone_and_removed()
        with self.time.closing():
            rows = runs.effects()
        needed, left = None, math.nan
        with self.time.stage("the search for the smallest set"):
            if math.isfinite(within):
                needed, left = runs.smallest([row.difference for row in rows], within)
        rows = [dataclasses.replace(r, needed=r.difference in (needed or ())) for r in rows]
        return Attribution(base, error, rows, within, needed, left)


class _Runs:
    """The runs of some differences; see `_Comparing._attributed`."""

    def __init__(
        self, comparing: _Comparing, some: list[Difference], base: Change, others: Change
    ) -> None:
        self.study, self.far, self.starts = comparing.study, comparing.far, comparing.starts
        self.some, self.base, self.others = some, base, others

    def _tracks(self, change: Change) -> Tracks:
        return self.study.tracks([change], self.starts, "smallest set")[0]

    def _alone(self, one: Difference) -> Change:
        return one.change.also(self.base)

    def _without(self, dropped: Sequence[Difference]) -> Change:
        """Return all differences but some."""
        kept = together([one for one in self.some if one not in dropped])
        return self.others.also(kept).also(self.base)

    def alone_and_removed(self) -> None:
        """Run A with each difference alone, and with all but one."""
        self.study.tracks([self.base, self._without([])], self.starts)
        self.study.tracks([self._alone(one) for one in self.some], self.starts, "alone")
        self.study.tracks([self._without([one]) for one in self.some], self.starts, "removed")

    def effects(self) -> list[DifferenceEffect]:
        """Return the effect of each difference from the runs that were made, largest first."""
        made = set(self.study.changes(self.starts))

        def effect(one: Difference) -> DifferenceEffect:
            far, failure = [math.nan, math.nan], ""
            pairs = ((self.base, self._alone(one)), (self._without([]), self._without([one])))
            for k, (before, after) in enumerate(pairs):
                if {before, after} <= made:
                    tracks = self._tracks(after)
                    far[k] = self.far(self._tracks(before), tracks)
                    failure = failure or tracks.failure_from(self.starts)
            return DifferenceEffect(one, far[0], far[1], failure=failure)

        return sorted(map(effect, self.some), key=lambda row: -row.largest)

    def smallest(
        self, ranked: list[Difference], within: float
    ) -> tuple[list[Difference] | None, float]:
        """Return the smallest set found, and the distance that the other differences make [m].

        Differences are dropped greedily, the smallest effect first, while A with the
        others stays `within` a distance of A with all.
        """
        with_all = self._tracks(self._without([]))
        if with_all.failure:
            return None, math.nan

        def left(dropped: Sequence[Difference]) -> float:
            return self.far(self._tracks(self._without(dropped)), with_all)

        dropped = greedy(ranked[::-1], lambda some: left(some) <= within)
        return [one for one in ranked if one not in dropped], left(dropped)


def _common_bodies(a: Matter, b: Matter, names: tuple[Names, Names]) -> tuple[Matter, Matter]:
    """Return the moving bodies that both models have, in A's order, with A's centres of mass."""
    places = counterparts(*names, "body")
    at = {places[k]: k for k in b.moving}
    kept = [k for k, body in enumerate(a.moving) if body in at]
    if not kept:
        raise ValueError("no moving body has the same name in both models")
    moving = [a.moving[k] for k in kept]
    matter = a.ipos[kept], a.gyration[kept], a.mass[kept]
    return Matter(moving, *matter), Matter([at[k] for k in moving], *matter)


def _for_counterpart(
    schedule: Schedule, a: Model, b: Model, names: tuple[Names, Names]
) -> Schedule:
    """Return A's schedule with states and controls in B's order."""
    actuators = counterparts(*names, "actuator")
    qpos, qvel, act = list[int](), list[int](), list[int]()
    for joint in counterparts(*names, "joint"):
        kind, q, v = a.jnt_type[joint], int(a.jnt_qposadr[joint]), int(a.jnt_dofadr[joint])
        qpos += range(q, q + QPOS[kind])
        qvel += range(v, v + DOFS[kind])
    states = [actuator.law.states for actuator in a.scene.actuators]
    for k in actuators:
        act += range(sum(states[:k]), sum(states[: k + 1]))
    starts = tuple(
        dataclasses.replace(
            start,
            qpos=start.qpos[qpos],
            qvel=start.qvel[qvel],
            act=None if start.act is None else start.act[act],
        )
        for start in schedule.starts
    )
    controls = _controls(schedule.controls, actuators)
    return dataclasses.replace(schedule, starts=starts, controls=controls, _models={})


def _controls(controls: Controls, actuators: Sequence[int]) -> Controls:
    """Return controls in another order of actuators."""
    log = controls.log
    if log is None or log.rows.shape[-1] != len(actuators):
        return controls
    rows: Any = np.ascontiguousarray(log.rows[..., list(actuators)])

    def moved(servo: Servo) -> Servo:
        named = isinstance(servo.actuator, str)
        return servo if named else servo._replace(actuator=actuators.index(int(servo.actuator)))

    servos = tuple(map(moved, controls.servos))
    return dataclasses.replace(controls, log=ControlLog(log.times, rows, log.linear), servos=servos)
