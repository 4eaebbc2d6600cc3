"""The inner steps of a model with adaptive steps, and the bodies that make them short."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.element import Element, Elements
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.trajectory import pieces
from stepcore.executors import checkpoint
from stepcore.experiment.schedule import Schedule
from stepcore.measure.diagnosis.linear import acting_elements
from stepcore.report.units import counted, metres, percent, seconds


@dataclass(frozen=True)
class HardStep:
    """An adaptive step that was made of shorter ones.

    time: its start [s]. evaluations: the number of force evaluations in it.
    shortest: its shortest inner step [s].
    body: the name of the body whose error made them short; "" if longer ones diverged.
    begins, ends: the rows that act at its end but not at its start, and the reverse.
    """

    time: float
    evaluations: int
    shortest: float
    body: str
    begins: tuple[Element, ...]
    ends: tuple[Element, ...]


@dataclass(frozen=True)
class InnerSteps:
    """The inner steps of a motion with adaptive steps.

    accuracy: the tolerance [m per simulated second]. period: the length of a step [s].
    time: the simulated time [s]. evaluations: the number of force evaluations.
    shortest: the shortest inner step [s].
    shares: by body, the share of the evaluations in steps that it makes short.
    hardest: by body, its step with the most evaluations.
    failure: why the run ended early, "" if it did not.
    """

    accuracy: float
    period: float
    time: float
    evaluations: int
    shortest: float
    shares: dict[str, float]
    hardest: dict[str, HardStep]
    failure: str = ""

    @property
    def mean(self) -> float:
        """The simulated time for each evaluation [s]."""
        return self.time / max(1, self.evaluations)

    @property
    def sentences(self) -> Iterator[str]:
        """The inner steps in words, and the bodies that make them short, the costliest first."""
        steps = max(1, round(self.time / self.period))
        yield (
            f"Within {metres(self.accuracy)} a second, a step of {seconds(self.period)} takes "
            f"{counted(round(self.evaluations / steps), 'evaluation')} of the forces on average; "
            f"the shortest inner step is {seconds(self.shortest)}."
        )
        if self.failure:
            yield f"The run ended early: {self.failure}."
        named = [body for body, share in self.shares.items() if share >= 0.05]
        if not named:
            yield "No body makes steps shorter than that for more than a few of them."
        for body in named:
            step = self.hardest[body]
            parts = [
                f"{Elements(rows).summary} {verb if len(rows) == 1 else verb[:-1]}"
                for rows, verb in ((step.begins, "begins"), (step.ends, "ends"))
                if rows
            ]
            cause = f", where {' and '.join(parts)}" if parts else ""
            who = body or "what diverges in a longer one"
            yield (
                f"{percent(self.shares[body])} of the evaluations are in steps that {who} makes "
                f"short, the most of them, {step.evaluations}, at {seconds(step.time)}{cause}."
            )


def inner_steps(model: Model, schedule: Schedule) -> InnerSteps:
    """Run a motion once from its start, and return its inner steps.

    model: a model with adaptive steps. schedule: its controls are held for whole steps.
    """
    dt, failure = model.settings.dt, ""
    sim = unwatched(Sim(schedule.driven_model(model)))
    schedule.starts[0].put(sim)
    rows, hold = schedule.rows([0], dt)
    drive = schedule.function() if rows is None else rows[0]
    count = schedule.steps(dt)
    costs, hardest = Counter[str](), dict[str, HardStep]()
    least, before, was, time = math.inf, 0, frozenset[Element](), 0.0
    steps = schedule.periods * count
    try:
        for done in pieces(sim, steps, drive, count if rows is None else hold, pauses=(1,)):
            checkpoint()
            if not done:
                continue
            shortest, refused = sim._core.stretches
            evaluations, before = sim._core.evaluations - before, sim._core.evaluations
            now, least = frozenset(acting_elements(sim)), min(least, shortest)
            if refused is not None:
                body = "" if refused[1] is None else model.element_name("body", refused[1])
                begins, ends = tuple(sorted(now - was)), tuple(sorted(was - now))
                costs[body] += evaluations
                if body not in hardest or evaluations > hardest[body].evaluations:
                    hardest[body] = HardStep(time, evaluations, shortest, body, begins, ends)
            was, time = now, sim.time
    except SimulationError as error:
        failure = one_line(error)
    accuracy = model.settings.accuracy
    assert accuracy is not None
    shares = {body: cost / before for body, cost in costs.most_common()}
    return InnerSteps(accuracy, dt, sim.time, before, least, shares, hardest, failure)
