"""The states at which a step is linearised: the start, and some along the user's motion.

Contacts and limits begin to act on the way: for every set of rows that acts somewhere along a run
at a small step one state is kept, and a few more evenly spaced in time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.probe import Probe
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import Schedule
from stepcore.measure.diagnosis.linear_step import State, sim_at, state_of

# The most states that are kept, and the most steps and samples of the run.
STATES, STEPS, SAMPLES = 8, 20_000, 200
# The most dofs at all states together, with at least two states.
DOFS = 200
# The share of the motion over which the seeded controls are blended in.
EASING = 0.25


@dataclass(frozen=True)
class Visit:
    """The states, the step at which the run was made [s], the time it reached [s], and why it
    ended early."""

    states: list[State]
    dt: float
    reached: float
    failure: str = ""


def eased(schedule: Schedule, ctrl: Floats) -> Schedule:
    """The schedule with its controls blended in from `ctrl`.

    A jump of the controls would make a stiff servo act with a shock that nobody asked for.
    """
    if schedule.ctrl is None:
        return schedule
    share = np.minimum(1.0, np.arange(schedule.periods) / (EASING * schedule.periods))[:, None]
    return replace(schedule, ctrl=ctrl + share * (schedule.ctrl - ctrl))


def start(model: Model, schedule: Schedule) -> State:
    """Where the motion begins."""
    first = schedule.starts[0]
    ctrl = np.zeros(model.nu) if schedule.ctrl is None else schedule.ctrl[0, 0]
    sim = sim_at(model, State("the start", 0.0, first.qpos, first.qvel, ctrl))
    sim.forward()
    return state_of(sim, "the start", 0.0)


def visited(model: Model, schedule: Schedule, safe: float) -> Visit:
    """States along the motion at a step of at most `safe` [s]; the start comes first."""
    count = max(1, math.ceil(schedule.period / safe))
    dt = schedule.period / count
    # A period longer than all the steps that are allowed is cut short.
    period = min(count, STEPS) * dt
    periods = max(1, min(schedule.periods, STEPS // count))
    run = replace(schedule, period=period, periods=periods, every=max(1, periods // SAMPLES))
    runner = Runner(model, run)
    sim = runner.sim(model.settings.replace(integrator="implicitfast", dt=dt))
    sampled, failure = _SampledStates(), ""
    try:
        runner.follow(sim, 0, [sampled])
        if periods % run.every:
            sampled.sample(sim)
    except SimulationError as error:
        failure = one_line(error)
    return Visit(_chosen([start(model, schedule), *sampled.states]), dt, sim.time, failure)


class _SampledStates(Probe):
    """Keeps the states of a run at its samples."""

    def __init__(self) -> None:
        self.states: list[State] = []

    def sample(self, sim: Sim) -> None:
        sim.forward()
        self.states.append(state_of(sim, f"t = {sim.time:.3g} s", sim.time))


def _chosen(seen: Sequence[State]) -> list[State]:
    """The first; the last with each set of rows, the largest sets first; then evenly in time.

    A large model, whose linearised step takes long, has fewer.
    """
    most = max(2, min(STATES, DOFS // len(seen[0].qvel)))
    kept = {0}
    sets = {frozenset(state.rows): k for k, state in enumerate(seen)}
    for k in sorted(sets.values(), key=lambda k: -len(seen[k].rows))[: max(1, most - 3)]:
        kept.add(k)
    for k in np.linspace(0, len(seen) - 1, most).round().astype(int):
        if len(kept) >= most:
            break
        kept.add(int(k))
    return [seen[k] for k in sorted(kept)]
