"""`replay`: a failure once more, and what every element did on the way."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import _core
from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats, digest
from stepcore.report.result import Result
from stepcore.report.table import Table

if TYPE_CHECKING:
    from stepcore.engine.replay import Replay

# Steps, and elements, that are printed.
PRINTED_STEPS = 12
PRINTED_ELEMENTS = 5
WIDTH = 100


@dataclass(repr=False)
class PostMortem(Result):
    """A failure that was run again: its paragraph, and who fed energy in, step by step.

    same: it failed in the same step with the same bits. time: after each step [s], shape (n,).
    energy: of motion, springs and penalty contacts [J], before the first step and after each,
    shape (n + 1,). work: by element, what it fed in in each step [J], shape (n,): work on the
    motion and the change of what it stores, so that the sum of all is the change of the whole
    energy, gravity's included; an exact motion of a conservative element feeds in nothing.
    shares: its part of the growth, the largest first.

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

    replay: Replay
    same: bool
    time: Floats
    energy: Floats
    work: dict[str, Floats]

    @property
    def paragraph(self) -> str:
        """What the error said."""
        return str(self.replay.happened["text"])

    @property
    def shares(self) -> dict[str, float]:
        """Each element's part of the growth, the largest first."""
        shares: dict[str, float] = self.replay.happened["shares"]
        return shares

    @property
    def title(self) -> str:
        """What was run again."""
        return f"Post-mortem{f' of {self.replay.name}' if self.replay.name else ''}"

    def leading(self, most: int) -> list[str]:
        """The elements that matter most: by their share, then by what they moved."""
        moved = {
            name: float(np.abs(work[np.isfinite(work)]).max(initial=0.0))
            for name, work in self.work.items()
        }
        rest = sorted((name for name in moved if name not in self.shares), key=lambda n: -moved[n])
        names = [name for name in self.shares if name in self.work]
        return (names + [name for name in rest if moved[name] > 0])[:most]

    def text(self, width: int | None = None, full: bool = False) -> str:
        """The paragraph, whether it came again, and the last steps as a table."""
        lines = [self.title, "", textwrap.fill(self.paragraph, min(width or WIDTH, WIDTH)), ""]
        happened = self.replay.happened
        again = f"It fails again after {self.replay.steps} steps, with the same bits."
        other = f"It does not fail again in step {happened['step']} with the same bits."
        lines.append(again if self.same else other)
        if len(self.time):
            names = self.leading(PRINTED_ELEMENTS)
            steps = happened["step"] - len(self.time) + np.arange(1, len(self.time) + 1)
            records = [
                {"after step": int(steps[k]), "energy J": float(self.energy[k + 1])}
                | {name: float(self.work[name][k]) for name in names}
                for k in range(max(len(self.time) - PRINTED_STEPS, 0), len(self.time))
            ]
            lines += ["", "Energy of motion and springs, and what was fed in per step [J]:", ""]
            lines.append(Table(records, formats=dict.fromkeys(names, ".3g")).text(width))
        else:
            lines += ["", "Settings with ledger=True keep the steps before a failure as well."]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {
            "name": self.replay.name,
            "settings": self.replay.settings.as_dict(),
            "steps": self.replay.steps,
            "same": self.same,
            "happened": self.replay.happened,
            "time": self.time,
            "energy": self.energy,
            "work": self.work,
        }


def run_again(failure: Replay) -> PostMortem:
    """See `Replay.run`."""
    settings = failure.settings.replace(ledger=False)
    model = _core.compile(failure.scene)
    sim = _core.Sim(model, settings)
    sim.restore(failure.state)
    changes = {step: arrays for step, *arrays in failure.inputs}
    time, energy, steps = [], [], []
    for step in range(failure.steps):
        _put(sim, changes.get(step))
        before, after, fed = sim.taped_step()
        energy += [before, after] if step == 0 else [after]
        time.append(sim.time)
        steps.append(dict(fed))
    _put(sim, changes.get(failure.steps))
    elements = sorted({element for fed in steps for element in fed})
    return PostMortem(
        replay=failure,
        same=_fails(failure, sim),
        time=np.array(time),
        energy=np.array(energy),
        work={
            model.element_name(*element): np.array([fed.get(element, 0.0) for fed in steps])
            for element in elements
        },
    )


def _put(sim: _core.Sim, arrays: list[list[float]] | None) -> None:
    if arrays is not None:
        sim.ctrl[:], sim.qfrc_applied[:] = arrays[0], arrays[1]
        sim.xfrc_applied.reshape(-1)[:] = arrays[2]


def _fails(failure: Replay, sim: _core.Sim) -> bool:
    """Whether the state at hand is the one that was kept, and fails as it did."""
    happened = failure.happened
    if digest(sim.qpos, sim.qvel) != happened["state"]:
        return False
    if happened["gained"]:
        return True
    try:
        sim.step(1)
    except SimulationError as error:
        return error.step == happened["step"]
    return False
