"""`PostMortem`: a repeated failure, with the energy that each element injected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from stepcore import _core
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import INPUTS, Floats, digest
from stepcore.report.result import Result
from stepcore.report.table import Table

if TYPE_CHECKING:
    from stepcore.engine.replay import Replay

# The number of steps, and of elements, that are printed.
PRINTED_STEPS = 12
PRINTED_ELEMENTS = 5


@dataclass(repr=False)
class PostMortem(Result):
    """A repeated failure, with the energy that each element injected in each step.

    same: whether the replay failed in the same step with the same bits.
    time: the time after each step [s], shape (n,).
    energy: kinetic energy plus the energy of springs and penalty contacts [J], before the first
        step and after each step, shape (n + 1,).
    work: for each element, the energy that the element injected in each step [J], shape (n,): the
        work on the motion plus the change of the stored energy. The sum over all elements is the
        change of the total energy, including gravity. In an exact motion a conservative element
        injects no energy.
    shares: each element's share of the energy injected, the largest first.

    >>> import stepcore as sc
    >>> sim = sc.Sim(sc.lesson.spring(), dt=0.1, integrator="explicit", ledger=True)
    >>> sim.reset("start")
    >>> try:
    ...     sim.step(1000)
    ... except sc.SimulationError as error:
    ...     again = error.replay.run()
    >>> bool(again.energy[-1] > 1e9 * again.energy[0]), list(again.shares)
    (True, ['spring of joint `spring`'])
    """

    kind = "postmortem"
    units: ClassVar = {"energy": "J", "time": "s", "work": "J"}

    replay: Replay
    same: bool
    time: Floats
    energy: Floats
    work: dict[str, Floats]

    @property
    def settings(self) -> Settings:
        """The settings of the run."""
        return self.replay.settings

    @property
    def paragraph(self) -> str:
        """The text of the error."""
        return str(self.replay.happened["text"])

    @property
    def shares(self) -> dict[str, float]:
        """Share of each element in the injected energy, largest first."""
        shares: dict[str, float] = self.replay.happened["shares"]
        return shares

    @property
    def title(self) -> str:
        """Title of the post-mortem."""
        return f"{self.name}: post-mortem"

    @property
    def sentences(self) -> list[str]:
        """The text of the error, and whether the replay reproduced the failure."""
        text = self.paragraph
        step = self.replay.happened["step"]
        again = f"The replay fails again after {self.replay.steps} steps, with the same bits."
        other = f"The replay does not fail in step {step} with the same bits as the run."
        said = [text[:1].upper() + text[1:].removesuffix(".") + ".", again if self.same else other]
        if not len(self.time):
            said.append(
                "With ledger=True in its settings a run records the steps before a failure."
            )
        return said

    @property
    def table(self) -> Table:
        """For each step, the energy after the step and the energy injected by each element [J]."""
        return self._steps(list(self.work), len(self.time))

    def tables(self, full: bool) -> list[Table]:
        """Return the last steps of the leading elements; `full`: all steps and elements."""
        if not len(self.time):
            return []
        names = self.leading(len(self.work) if full else PRINTED_ELEMENTS)
        table = self._steps(names, len(self.time) if full else PRINTED_STEPS)
        table.heading = (
            "Kinetic and spring energy [J], and what each element injected in the step [J]"
        )
        return [table]

    def _steps(self, names: list[str], most: int) -> Table:
        count = len(self.time)
        first = self.replay.happened["step"] - count + 1
        records = [
            {"step": first + k, "energy": float(self.energy[k + 1])}
            | {name: float(self.work[name][k]) for name in names}
            for k in range(max(count - most, 0), count)
        ]
        return Table(records, ["step", "energy", *names], dict.fromkeys(names, ".3g"))

    def details(self) -> dict[str, Any]:
        """Return the recorded steps as arrays, and the data of the failure."""
        return {
            "steps": self.replay.steps,
            "same": self.same,
            "happened": self.replay.happened,
            "time": self.time,
            "energy": self.energy,
            "work": self.work,
        }

    def leading(self, most: int) -> list[str]:
        """Return the leading elements: by share, then by the largest energy moved in a step."""
        moved = {
            name: float(np.abs(work[np.isfinite(work)]).max(initial=0.0))
            for name, work in self.work.items()
        }
        rest = sorted((name for name in moved if name not in self.shares), key=lambda n: -moved[n])
        names = [name for name in self.shares if name in self.work]
        return (names + [name for name in rest if moved[name] > 0])[:most]


def run_again(failure: Replay) -> PostMortem:
    """Repeat a failure; see `Replay.run`."""
    settings = failure.settings.replace(ledger=False)
    model = _core.compile(failure.scene)
    sim = _core.Sim(model, settings)
    sim.unwatch()
    sim.restore(failure.state, None)
    own = dict(sim.arrays())
    changes = {step: arrays for step, *arrays in failure.inputs}
    time, energy, steps = [], [], []
    for step in range(failure.steps):
        _put(own, changes.get(step))
        try:
            before, after, injected = sim.taped_step()
        except SimulationError:
            # The replay fails too early, so `same` will be False.
            break
        energy += [before, after] if step == 0 else [after]
        time.append(sim.time)
        steps.append(dict(injected))
    _put(own, changes.get(failure.steps))
    elements = sorted({element for injected in steps for element in injected})
    return PostMortem(
        name=failure.name or "scene",
        replay=failure,
        same=_fails(failure, sim, own),
        time=np.array(time),
        energy=np.array(energy),
        work={
            model.element_name(*element): np.array([step.get(element, 0.0) for step in steps])
            for element in elements
        },
    )


def _put(own: dict[str, Floats], inputs: list[list[float]] | None) -> None:
    if inputs is not None:
        for name, values in zip(INPUTS, inputs, strict=True):
            if own[name].size != len(values):
                text = f"has {len(values)} numbers; the scene takes {own[name].size}"
                raise ValueError(f"an input of {name} {text}")
            own[name].reshape(-1)[:] = values


def _fails(failure: Replay, sim: _core.Sim, own: dict[str, Floats]) -> bool:
    """Return whether the present state equals the failure's last finite state and fails too."""
    happened = failure.happened
    if digest(own["qpos"], own["qvel"]) != happened["state"]:
        return False
    if happened["gained"]:
        return True
    try:
        sim.step(1)
    except SimulationError as error:
        return error.step == happened["step"]
    return False
