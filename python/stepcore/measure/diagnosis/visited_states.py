"""Choose the states at which a step is linearised: the start, and some along the user's motion.

Contacts and limits begin to act during the motion. A run at a small step keeps one state for every
set of rows that acts somewhere, and a few more states evenly spaced in time.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.control import Control, fresh
from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.controls import Controls
from stepcore.experiment.coordinates import Coordinates
from stepcore.experiment.motion import Motion
from stepcore.experiment.run import Probe
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule, scheduled
from stepcore.measure.diagnosis.control import with_feedback
from stepcore.measure.diagnosis.isolated import closed_form_bound
from stepcore.measure.diagnosis.limits import SHORTEST, StepStability, dt_limit, step_stability
from stepcore.measure.diagnosis.linear_step import State, sim_at, state_now, state_of

# The control period over the horizon, unless one step of the scene is longer.
PERIOD = 1 / 200
# The step of the run over the least step that limits the start.
SAFE = 0.25
# A run that diverges is made again with these parts of its step.
FINER = (4, 16)
# The most states, and the most steps and samples of the run.
STATES, STEPS, SAMPLES = 8, 20_000, 200
# The most dofs at all states combined, with at least two states.
DOFS = 200
# The most sets of overlaps and limits whose deepest state is kept, and about how many steps of a
# run are searched for them.
PATTERNS, LOOKS = 32, 5_000
# A start is pushed by this velocity [rad/s or m/s] if the motion grows by more e-folds than this in
# the horizon.
UNSTABLE, NUDGE = 5.0, 1e-6

# The limits that are exceeded, and the pairs of geoms that overlap.
Pattern = tuple[bytes, frozenset[int]]


@dataclass(frozen=True)
class Visit:
    """The states along a motion.

    here: the linearised step at the states.
    schedule: the motion, with controls held for the user's control period.
    driven: the motion, with controls held as in runs of the real step.
    dt: the step of the run [s].
    reached: the time that the run reached [s].
    failure: the reason why the run ended early, "" if it did not.
    """

    here: StepStability
    schedule: Schedule
    driven: Schedule
    dt: float
    reached: float
    failure: str = ""


def visit(model: Model, motion: Motion, horizon: float) -> Visit:
    """Return the states along a motion, the start first, with the step linearised at each.

    The run is made at a fraction of the least step that limits the start.

    horizon: the length of the motion [s].
    """
    settings, control = model.settings, motion.control  # The user's, if any.
    controlled = motion.period(settings.dt)
    period = min(horizon, controlled or max(settings.dt, horizon * PERIOD))
    schedule = scheduled(motion, model, period, starts=1)
    model = schedule.on(model)
    begin = _start(model, schedule)
    if control is not None:
        (begin,) = with_feedback(model, [begin], control, period, horizon)
    at_start = step_stability(model, [begin], horizon)
    limit = min(dt_limit(at_start, "implicitfast").dt, closed_form_bound(model))
    safe = max(min(SAFE * limit, settings.dt), SHORTEST)
    schedule = driven = _nudged(schedule, model, float(at_start.rates[0].real.max(initial=0.0)))
    if control is not None and not (motion.control_dt and begin.feedback is None):
        # The controls are sampled often enough to keep the run stable.
        driven = _sampled_often(schedule, safe)
    states, run = _along(model, driven, safe)
    for part in FINER if control is None else ():
        if not run[-1]:
            break
        # A run that diverged visits states that the motion does not have.
        states, run = _along(model, driven, safe / part)
    if control is not None:
        states = with_feedback(model, states, control, period, horizon, motion.control_dt)
    here = step_stability(model, states, horizon)
    # Without a control period of its own, a control is sampled at every step.
    return Visit(here, schedule, schedule if motion.control_dt else driven, *run)


def _nudged(schedule: Schedule, model: Model, growth: float) -> Schedule:
    """Return the schedule with its start pushed if the motion grows by more than `UNSTABLE`.

    Without a push, rounding decides when a body tumbles that spins exactly about its middle axis.

    growth: the fastest growth of the motion at the start [1/s].
    """
    if growth * schedule.horizon < UNSTABLE:
        return schedule
    first, push = schedule.starts[0], NUDGE * (-1.0) ** np.arange(model.nv)
    return replace(schedule, starts=(replace(first, qvel=first.qvel + push),))


def _sampled_often(schedule: Schedule, dt: float) -> Schedule:
    """Return the schedule with a control period of at most dt [s]."""
    count = max(1, math.ceil(schedule.period / dt * (1 - 1e-9)))
    return replace(
        schedule,
        period=schedule.period / count,
        periods=schedule.periods * count,
        every=schedule.every * count,
    )


def _start(model: Model, schedule: Schedule) -> State:
    """Return the first state of the motion."""
    first = schedule.starts[0]
    ctrl = np.zeros(model.nu) if schedule.ctrl is None else schedule.ctrl[0, 0]
    act = np.zeros(0) if first.act is None else first.act
    sim = sim_at(model, State("the start", 0.0, first.qpos, first.qvel, ctrl, act=act))
    sim.forward()
    return state_of(sim, "the start", 0.0)


def _along(
    model: Model, schedule: Schedule, safe: float
) -> tuple[list[State], tuple[float, float, str]]:
    """Return states along the motion, the start first, and a record of the run.

    The record is the step [s], the time reached [s], and the reason why the run ended early.

    safe: the longest step of the run [s].
    """
    count = max(1, math.ceil(schedule.period / safe))
    dt = schedule.period / count
    # A period longer than the step budget is cut short.
    period = min(count, STEPS) * dt
    periods = max(1, min(schedule.periods, STEPS // count))
    run = replace(schedule, period=period, periods=periods, every=max(1, periods // SAMPLES))
    control = None
    if schedule.control is not None:
        # The probe copies the object that the run uses; `follow` does not copy a plain function.
        control = fresh(schedule.control)
        run = replace(run, controls=Controls(function=_handed_on(control)))
    runner = Runner(model, run)
    sim = runner.sim(model.settings.replace(integrator="implicitfast", dt=dt))
    sampled, brief, failure = _SampledStates(control), _BriefStates(model, count * periods), ""
    try:
        runner.follow(sim, 0, [sampled, brief])
        if periods % run.every:
            sampled.sample(sim)
    except SimulationError as error:
        failure = one_line(error)
    states = [_start(model, schedule), *sampled.states]
    known = {_acting(state) for state in states}
    states += [state for state in brief.states(model) if _acting(state) not in known]
    states.sort(key=lambda state: state.time)
    return _chosen(states), (dt, sim.time, failure)


def _acting(state: State) -> frozenset[Element]:
    """Return the elements whose rows act at a state, and the contacts of `penalty`."""
    return frozenset((*state.rows, *state.touching))


def _handed_on(control: Control) -> Control:
    """Return a plain function that calls this object."""

    @functools.wraps(control)
    def function(time: float, sim: Sim) -> ArrayLike:
        return control(time, sim)

    return function


class _SampledStates(Probe):
    """A probe that keeps the states of a run at its samples."""

    def __init__(self, control: Control | None) -> None:
        self.control = control
        self.states: list[State] = []

    def sample(self, sim: Sim) -> None:
        sim.forward()
        state = state_of(sim, f"t = {sim.time:.3g} s", sim.time)
        control = None if self.control is None else fresh(self.control)
        self.states.append(replace(state, control=control))


class _BriefStates(Probe):
    """A probe that keeps the deepest state of each set of overlaps and reached limits.

    States between samples count too.
    """

    def __init__(self, model: Model, steps: int) -> None:
        joints = Coordinates(model).joints
        limited = [(q, limits) for _, q, _, limits in joints if limits is not None]
        self.at = np.array([q for q, _ in limited], int)
        self.low, self.high = np.array([limits for _, limits in limited]).reshape(-1, 2).T
        self.every, self.steps = max(1, steps // LOOKS), 0
        self.deepest: dict[Pattern, tuple[float, State]] = {}

    def stride(self, steps: int) -> int | None:
        return 1

    def step(self, sim: Sim) -> None:
        self.steps += 1
        if self.steps % self.every:
            return
        over, pairs = np.zeros(0), frozenset[int]()
        if len(self.at):
            angles = sim.qpos[self.at]
            over = np.maximum(self.low - angles, angles - self.high)
        depth = max(sim.overlap, float(over.max(initial=0.0)))
        if depth <= 0:
            return
        if sim.overlap > 0:
            contacts = sim.contacts
            pairs = frozenset(contacts["index"][contacts["dist"] < 0].tolist())
        pattern = (over > 0).tobytes(), pairs
        known = self.deepest.get(pattern)
        if (known is None and len(self.deepest) < PATTERNS) or (known and depth > known[0]):
            self.deepest[pattern] = depth, state_now(sim, f"t = {sim.time:.3g} s", sim.time)

    def states(self, model: Model) -> Iterator[State]:
        """Yield the kept states, with the rows that act there."""
        for _, state in self.deepest.values():
            sim = sim_at(model, state)
            try:
                sim.forward()
            except SimulationError:
                # A run that blew up kept a state whose accelerations overflow.
                continue
            yield state_of(sim, state.label, state.time)


def _chosen(seen: Sequence[State]) -> list[State]:
    """Return the start, one state for each set of rows, and others evenly spaced in time.

    The state for a set is the last one, and the largest sets come first. A large model has fewer
    states, because its linearised step takes long.
    """
    most = max(2, min(STATES, DOFS // len(seen[0].qvel)))
    kept = {0}
    sets = {_acting(state): k for k, state in enumerate(seen)}
    for k in sorted(sets.values(), key=lambda k: -len(_acting(seen[k])))[: max(1, most - 3)]:
        kept.add(k)
    for k in np.linspace(0, len(seen) - 1, most).round().astype(int):
        if len(kept) >= most:
            break
        kept.add(int(k))
    return [seen[k] for k in sorted(kept)]
