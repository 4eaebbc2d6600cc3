"""Examine the motion of a model: states along it, the largest stable dt, and runs that judge it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from typing import Any

import numpy as np

from stepcore.deadline import Deadline
from stepcore.engine.model import Model
from stepcore.measure.diagnosis.limits import (
    LONGEST,
    SHORTEST,
    Limit,
    StepStability,
    dt_limit,
)
from stepcore.measure.diagnosis.motion_check import Judge, Runaway, judge
from stepcore.measure.diagnosis.motion_limit import judged_limit
from stepcore.measure.diagnosis.motion_runs import MotionRuns
from stepcore.measure.diagnosis.saturation import Observation, holds_when_kicked, kicked, look
from stepcore.measure.diagnosis.shares import Shares
from stepcore.measure.diagnosis.visited_states import Visit
from stepcore.report.units import seconds

# A slower oscillation, over the fastest, counts as rounding.
SLOWEST = 1e-6
# A function of (job, items, label, done) that fills `done` with the results of a job at every item.
Each = Callable[[Callable[[Any], Any], Sequence[Any], str, list[Any]], object]
# The shares of the time at which the limits of the linearised step and the runs of the motion end.
LINEAR, RUN = 0.4, 0.75


@dataclass(frozen=True)
class Examination:
    """The largest stable dt of a model along a motion, under some integrators.

    model: the model.
    wanted: the wanted step [s].
    visited: the states along the motion.
    check: the runs of the motion, or how it blows up; None where no run can judge.
    limits, shares: the limit and the elements' shares in it, by integrator.
    seen: the motion at the wanted step, under the model's own integrator.
    """

    model: Model
    wanted: float
    visited: Visit
    check: Judge | Runaway | None
    limits: dict[str, Limit]
    shares: dict[str, Shares]
    seen: Observation

    @property
    def here(self) -> StepStability:
        """The linearised step at the states; a run of the motion confirms it if one can."""
        if not isinstance(self.check, Judge):
            return self.visited.here
        return replace(self.visited.here, holds=partial(holds_when_kicked, self.check))

    @property
    def slowest(self) -> float:
        """The period of the slowest oscillation at any state [s]; 0 for none."""
        rates = np.concatenate([np.abs(rates.imag) for rates in self.visited.here.rates])
        turning = rates[rates > SLOWEST * rates.max(initial=0.0)]
        return 2 * math.pi / float(turning.min()) if len(turning) else 0.0

    def observed(self, integrator: str) -> Observation:
        """Return the motion at the wanted step under an integrator that was examined."""
        if integrator == self.model.settings.integrator:
            return self.seen
        return look(self.check, self.limits[integrator], self.shares[integrator], self.wanted)


def _one_by_one(
    job: Callable[[Any], Any], items: Sequence[Any], label: str, done: list[Any]
) -> None:
    done[:] = [job(item) for item in items]


def _without(done: Sequence[Any], integrators: Sequence[str]) -> list[str]:
    """Return the integrators whose result is missing."""
    return [name for name, one in zip_longest(integrators, done) if one is None]


def examine(
    model: Model,
    visited: Visit,
    horizon: float,
    wanted: float,
    integrators: Sequence[str],
    each: Each = _one_by_one,
    time: Deadline | None = None,
) -> Examination:
    """Return the largest stable dt of each integrator, corrected by runs of the motion.

    model: the model, whose own integrator is one of `integrators`.
    visited, horizon: the states along the motion, and its length [s].
    wanted: the wanted step [s].
    each: how to call a job for all integrators.
    time: the deadline, after which the limits of some integrators, and some runs, are left out; the
        model's own integrator is then the first. None for an examination that must be whole.

    Raises OutOfTime if the limit of the first integrator is not known in time.
    """

    def stage(words: str | Callable[[], str], share: float) -> AbstractContextManager[None]:
        return nullcontext() if time is None else time.stage(words, share)

    settings, own = model.settings, model.settings.integrator
    here = visited.here
    longest = max(LONGEST, 2 * wanted, 2 * settings.dt)
    shortest = min(SHORTEST, wanted / 2, settings.dt / 2)
    limit_of = partial(dt_limit, here, longest=longest, shortest=shortest)
    linear: list[Limit | None] = []
    with stage(lambda: f"the limits under {', '.join(_without(linear, integrators))}", LINEAR):
        each(limit_of, integrators, "limits", linear)
    if not linear or linear[0] is None:
        # The answer needs this limit, which may therefore take all the time.
        linear[:1] = [limit_of(integrators[0])]
    known = [limit for limit in linear if limit is not None]
    if time is not None:
        stable = f"the linearised step is stable under {own} up to dt {seconds(known[0].dt)}"
        time.so_far(f"{stable}; the motion is run at this step now")
    check = None
    if not any(state.feedback is not None and state.feedback.order for state in here.states):
        with stage("runs of the motion at other steps", RUN):
            # A run with other steps would give a control function with memory another history.
            check = judge(MotionRuns(model, visited.driven, horizon), visited.dt)
    by = check if isinstance(check, Judge) else None
    judged: list[tuple[Limit, Shares] | None] = []
    with stage("runs of the motion under all integrators", RUN):
        each(partial(judged_limit, here, by, wanted), known, "motion", judged)
    # Without these runs the linearised step decides.
    with nullcontext() if time is None else time.closing():
        pairs = [
            pair or judged_limit(here, None, wanted, limit)
            for pair, limit in zip_longest(judged, known)
        ]
    limits = {limit.integrator: limit for limit, _ in pairs}
    shares = {limit.integrator: its_shares for limit, its_shares in pairs}
    seen = Observation(limits[own], shares[own])
    with stage("the run at the wanted step", RUN):
        seen = look(check, limits[own], shares[own], wanted)
    limits[own], shares[own] = seen.limit, seen.shares
    if by is not None and any(servo.severe and not servo.reached for servo in seen.saturations):
        # The kick that causes severe chatter is repeated under the other integrators stable at dt.
        with stage("kicks of the servos under all integrators", RUN):
            for name in limits:
                if name != own and wanted <= limits[name].dt:
                    limits[name], shares[name], _ = kicked(by, limits[name], shares[name], wanted)
    return Examination(model, wanted, visited, check, limits, shares, seen)
