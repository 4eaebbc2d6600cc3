"""The states at which a step is linearised: the start, and some along the user's motion.

Contacts and limits come alive on the way: of every set of rows that acts somewhere along a run at
a small step one state is kept, and a few more evenly spaced in time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.experiment.schedule import Schedule
from stepcore.measure.diagnosis.linear_step import State, acting, placed

# The most states, steps and looks at the rows of one run.
STATES, STEPS, LOOKS = 8, 20_000, 200
# So many dofs at all states together, and at least two states.
DOFS = 200
# Part of the motion in which controls that nobody gave come in.
EASING = 0.25


@dataclass(frozen=True)
class Visit:
    """The states, the step [s] at which the run was made, and how far it came [s]."""

    states: list[State]
    dt: float
    reached: float
    failure: str = ""


def eased(motion: Schedule, ctrl: Floats) -> Schedule:
    """The motion with its controls coming in from `ctrl`: a jump would be no motion of the user's,
    and a stiff servo answers it with a blow."""
    if motion.ctrl is None:
        return motion
    share = np.minimum(1.0, np.arange(motion.periods) / (EASING * motion.periods))[:, None]
    return replace(motion, ctrl=ctrl + share * (motion.ctrl - ctrl))


def start(model: Model, motion: Schedule) -> State:
    """Where the motion begins."""
    first = motion.starts[0]
    ctrl = np.zeros(model.nu) if motion.ctrl is None else motion.ctrl[0, 0]
    state = State("the start", 0.0, np.array(first.qpos), np.array(first.qvel), np.array(ctrl))
    sim = placed(model, state)
    sim.forward()
    return State(state.label, 0.0, state.qpos, state.qvel, state.ctrl, acting(sim))


def visited(model: Model, motion: Schedule, safe: float) -> Visit:
    """States along the motion at a step of at most `safe` [s]; the start first."""
    first = start(model, motion)
    each = max(1, math.ceil(motion.period / safe))
    sim = placed(model, first, integrator="implicitfast", dt=motion.period / each)
    periods = max(1, min(motion.periods, STEPS // each))
    look = max(1, periods // LOOKS)
    seen: list[State] = []
    failure = ""
    for period in range(periods):
        if motion.control is not None:
            sim.ctrl[:] = motion.control(sim.time, sim)
        elif motion.ctrl is not None:
            sim.ctrl[:] = motion.ctrl[0, period]
        try:
            # A period longer than all steps there are is cut short.
            sim.step(min(each, STEPS))
            if period % look == look - 1 or period == periods - 1:
                sim.forward()
                seen.append(_now(sim))
        except SimulationError as error:
            failure = str(error)
            break
    states = _chosen([first, *seen])
    return Visit(states, sim.settings.dt, sim.time, failure)


def _now(sim: Sim) -> State:
    qpos, qvel, ctrl = (np.array(x) for x in (sim.qpos, sim.qvel, sim.ctrl))
    return State(f"t = {sim.time:.3g} s", sim.time, qpos, qvel, ctrl, acting(sim))


def _chosen(seen: Sequence[State]) -> list[State]:
    """The first; the last with each set of rows, the largest sets first; then evenly in time.

    Fewer of a large model, whose linearised step takes long.
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
