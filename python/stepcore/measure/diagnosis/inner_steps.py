"""What the steps of a model that keeps an accuracy are made of, and who makes them short."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from stepcore._core import SimulationError
from stepcore.checks import one_line
from stepcore.engine.element import Element, Elements
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.executors import checkpoint
from stepcore.experiment.motion import Motion
from stepcore.experiment.run import Probe
from stepcore.experiment.runner import Runner
from stepcore.experiment.schedule import scheduled
from stepcore.measure.diagnosis.elements import acting_elements
from stepcore.report.units import counted, metres, percent, seconds

# How many bodies are named, each with a share of the evaluations that is at least this.
NAMED, SHARE = 3, 0.05


@dataclass(frozen=True)
class HardStep:
    """A step that was made of shorter ones.

    time: when it begins [s]. evaluations: how often forces were evaluated in it.
    shortest: the shortest of the steps that it is made of [s].
    body: the name of the body whose error made them short; "" if they diverged.
    begins, ends: the rows that act at its end and not at its start, and the reverse.
    """

    time: float
    evaluations: int
    shortest: float
    body: str
    begins: tuple[Element, ...]
    ends: tuple[Element, ...]


@dataclass(frozen=True)
class InnerSteps:
    """What the steps of a motion within an accuracy are made of.

    accuracy: the error asked for [m per simulated second]. period: the length of a step [s].
    time: the simulated time [s]. evaluations: how often forces were evaluated.
    shortest: the shortest inner step [s].
    shares: by body, the share of the evaluations in steps that it makes short.
    hardest: by body, its step of the most evaluations.
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
        """What the steps are made of, and the bodies that make them short, the costliest first."""
        steps = max(1, round(self.time / self.period))
        yield (
            f"Within {metres(self.accuracy)} a second, a step of {seconds(self.period)} takes "
            f"{counted(round(self.evaluations / steps), 'evaluation')} of the forces on average; "
            f"the shortest inner step is {seconds(self.shortest)}."
        )
        if self.failure:
            yield f"The run ended early: {self.failure}."
        named = [body for body, share in self.shares.items() if share >= SHARE][:NAMED]
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


def inner_steps(model: Model, motion: Motion) -> InnerSteps:
    """Run a motion once from its start, and return what its steps are made of.

    model: its settings have an accuracy. motion: it has a horizon.
    """
    dt = model.settings.dt
    runner = Runner(model, scheduled(motion, model, motion.period(dt) or dt, starts=1))
    sim, probe, failure = runner.sim(model.settings), _Stretches(), ""
    try:
        runner.follow(sim, 0, [probe])
    except SimulationError as error:
        failure = one_line(error)
    costs: Counter[str] = Counter()
    hardest: dict[str, HardStep] = {}
    for step in probe.steps:
        costs[step.body] += step.evaluations
        if step.body not in hardest or step.evaluations > hardest[step.body].evaluations:
            hardest[step.body] = step
    asked = model.settings.accuracy
    assert asked is not None
    return InnerSteps(
        accuracy=asked,
        period=dt,
        time=sim.time,
        evaluations=probe.evaluations,
        shortest=probe.shortest,
        shares={body: cost / probe.evaluations for body, cost in costs.most_common()},
        hardest=hardest,
        failure=failure,
    )


class _Stretches(Probe):
    """A probe that keeps each step that was made of shorter ones."""

    def __init__(self) -> None:
        self.steps: list[HardStep] = []
        self.evaluations, self.shortest = 0, float("inf")

    def stride(self, steps: int) -> int | None:
        return 1

    def begin(self, sim: Sim) -> None:
        self.acting = frozenset(acting_elements(sim))
        self.time, self.count = sim.time, sim._core.evaluations

    def step(self, sim: Sim) -> None:
        checkpoint()
        shortest, refused = sim._core.stretches
        evaluations = sim._core.evaluations - self.count
        acting = frozenset(acting_elements(sim))
        self.evaluations += evaluations
        self.shortest = min(self.shortest, shortest)
        if refused is not None:
            body = refused[1]
            name = "" if body is None else sim.model.element_name("body", body)
            begins, ends = sorted(acting - self.acting), sorted(self.acting - acting)
            self.steps.append(
                HardStep(self.time, evaluations, shortest, name, tuple(begins), tuple(ends))
            )
        self.acting, self.time, self.count = acting, sim.time, sim._core.evaluations
