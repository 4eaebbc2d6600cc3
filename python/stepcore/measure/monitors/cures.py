"""Cures of findings: each is made on a copy of the scene, run again, and its effect measured.

A finding proposes cures, and how to measure what is left of the problem (`Remedy`). `verified`
runs the motion again with each cure until one holds, and writes into the finding what that run
shows. A cure that was not run, or that did not help, promises nothing.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from stepcore import deadline
from stepcore._core import Settings, SimulationError
from stepcore.engine.element import OVERRIDE, Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.measure.monitors.finding import HALF, Cure, Finding, Next, Remedy
from stepcore.report.units import seconds

# The cost of all cures' runs, in steps × (dofs + 2). Go2 takes 0.35 s for 10⁵ of that, its findings
# included.
EFFORT = 3e5
# The parts of a time step that are tried.
PARTS = (1, 2, 4)

# Runs the motion of a finding with another model, and returns the `Recording`; None if that fails.
Again = Callable[[Model], Any]


def verified(
    findings: Iterable[Finding], model: Model, again: Again = lambda model: None, steps: int = 0
) -> list[Finding]:
    """Return findings with the cures that were seen to hold, and with what they leave.

    Cures whose runs would cost more than `EFFORT` are named without a promise.

    model: the model of the run. again: runs the same motion with another model; by default only
    cures with a motion of their own are run. steps: the number of time steps of the run.
    """
    trials = _Trials(model, again, float(steps * (model.nv + 2)))
    return [cured for finding in findings if (cured := trials.cured(finding)) is not None]


@dataclasses.dataclass
class _Trials:
    """The runs of cures. cost: of one run. effort: what is left."""

    model: Model
    again: Again
    cost: float
    effort: float = EFFORT

    def cured(self, finding: Finding) -> Finding | None:
        """Return a finding with the best of its cures, or None if it needed one."""
        remedy = finding.remedy
        if remedy is None:
            return finding
        now = remedy.now if remedy.now is not None else finding.value
        helps = math.inf if now is None else HALF * abs(now)
        held, helped, tried, untried = self._run(remedy, helps)
        said = held or sorted(helped, key=lambda entry: entry[0])[:1]
        words, also = finding.cure, f", or {finding.cure}" if finding.cure else ""
        commands, settings = finding.commands, finding.settings
        if said:
            best = said[0][1].change
            words = ", or ".join(f"{cure.words} leaves {remedy.say(left)}" for left, cure in said)
            words, settings = words + also, dict(best.settings)
            commands = (*_commands(best), *commands)
        elif remedy.needed and (tried or finding.severity == "remark"):
            return None
        elif untried:
            words = f"try {untried[0].words}{also}"
        elif tried and not words:
            # Of each way the first; the stronger ones have been tried, too.
            first = [way[0].words for way in remedy.ways if way and way[0] in tried]
            words = f"tried without success, and more of it: {'; '.join(first)}"
        return dataclasses.replace(
            finding, cure=words, settings=settings, commands=commands, remedy=None
        )

    def _run(
        self, remedy: Remedy, helps: float
    ) -> tuple[list[tuple[float, Cure]], list[tuple[float, Cure]], list[Cure], list[Cure]]:
        """Try the cures of each way; return those that held and helped, and the (un)tried.

        helps: a cure that leaves at most this much is named if none holds.
        """
        held, helped = list[tuple[float, Cure]](), list[tuple[float, Cure]]()
        tried, untried = list[Cure](), list[Cure]()
        for way in remedy.ways:
            if len(held) == remedy.most:
                break
            for cure in way:
                ran, left = self._tried(remedy, cure)
                (tried if ran else untried).append(cure)
                if not ran:
                    break
                if left is not None and left <= remedy.enough:
                    held.append((left, cure))
                    break
                if left is not None and left <= helps:
                    helped.append((left, cure))
        return held, helped, tried, untried

    def _tried(self, remedy: Remedy, cure: Cure) -> tuple[bool, float | None]:
        """Run a cure: whether there was time for it, and what it leaves.

        What it leaves is None if its run fails, or makes an error of its own.
        """
        dt = self.model.settings.dt
        cost = max(1.0, dt / dict(cure.change.settings).get("dt", dt)) * self.cost
        if cost > self.effort:
            return False, None
        self.effort -= cost
        ran, left = False, None
        with (deadline.current() or deadline.Deadline()).stage("runs of all cures"):
            try:
                seen = (remedy.again or self.again)(cure.change.of(self.model))
                left = None if seen is None else remedy.left(seen)
            except (ValueError, SimulationError):
                left = None
            ran = True
        return ran, left


def _commands(change: Change) -> tuple[Next, ...]:
    """Return the command that shows a cure; only settings can be given on a command line."""
    if change.size or not change.settings:
        return ()
    values = (
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in change.settings
    )
    sets = tuple(word for value in values for word in ("--set", value))
    return (Next("run", "the same with this cure", sets),)


def assigned(
    model: Model, elements: Iterable[Element], values: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the fields of elements with new values, by path; values: by the name of the field."""
    return {
        of.path or f"{of.kind}/#{of.index}/{of.name}": values[of.name]
        for element in elements
        for of in element.fields(model)
        if of.name in values and of.kind != OVERRIDE
    }


def finer(settings: Settings, most: float) -> float:
    """Return the largest whole part of the time step that is at most `most` [s]."""
    return settings.dt / max(1, math.ceil(settings.dt / most * (1 - 1e-9)))


def shorter(dts: Iterable[float]) -> tuple[Cure, ...]:
    """Return the cures by shorter time steps [s]."""
    return tuple(Cure(f"a dt of {seconds(dt)}", Change(dt=dt)) for dt in dict.fromkeys(dts))
