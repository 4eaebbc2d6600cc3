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
from stepcore.measure.monitors.finding import Cure, Finding, Next, Remedy

# A cure that leaves more than a finding's threshold is still named if it leaves at most this share
# of the problem.
HELPS = 0.5
# The cost of all cures' runs, in steps × (dofs + 2). Go2 takes 0.35 s for 10⁵ of that, its findings
# included.
EFFORT = 3e5

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
    cured = (trials.cured(finding) for finding in findings)
    return [finding for finding in cured if finding is not None]


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
        finding = dataclasses.replace(finding, remedy=None)
        before = next((x for x in (remedy.now, finding.value) if x is not None), math.inf)
        held, helped = list[tuple[float, Cure]](), list[tuple[float, Cure]]()
        tried, untried = list[Cure](), list[Cure]()
        for way in remedy.ways:
            if len(held) == remedy.most:
                break
            for cure in way:
                ran, left = self._tried(remedy, cure)
                (tried if ran else untried).append(cure)
                if left is not None and left <= remedy.enough:
                    held.append((left, cure))
                elif left is not None and left <= HELPS * abs(before):
                    helped.append((left, cure))
                if not ran or (held and held[-1][1] is cure):
                    break
        also = f", or {finding.cure}" if finding.cure else ""
        named = held or sorted(helped, key=lambda entry: entry[0])[:1]
        if named:
            said = ", or ".join(f"{cure.words} leaves {remedy.say(left)}" for left, cure in named)
            settings = dict(named[0][1].change.settings)
            commands = (*_commands(named[0][1]), *finding.commands)
            return dataclasses.replace(
                finding, cure=said + also, settings=settings, commands=commands
            )
        if remedy.needed and (tried or finding.severity == "remark"):
            return None
        if untried:
            return dataclasses.replace(finding, cure=f"try {untried[0].words}{also}")
        # Of each way the first; the stronger ones have been tried, too.
        first = [way[0].words for way in remedy.ways if way and way[0] in tried]
        failed = f"tried without success, and more of it: {'; '.join(first)}" if first else ""
        return dataclasses.replace(finding, cure=finding.cure or failed)

    def _tried(self, remedy: Remedy, cure: Cure) -> tuple[bool, float | None]:
        """Run a cure: whether there was time for it, and what it leaves.

        What it leaves is None if its run fails, or makes an error of its own.
        """
        dt = self.model.settings.dt
        runs = max(1.0, dt / dict(cure.change.settings).get("dt", dt))
        if runs * self.cost > self.effort:
            return False, None
        self.effort -= runs * self.cost
        ran, left = False, None
        with (deadline.current() or deadline.Deadline()).stage("runs of all cures"):
            try:
                seen = (remedy.again or self.again)(cure.change.of(self.model))
                left = None if seen is None else remedy.left(seen)
            except (ValueError, SimulationError):
                left = None
            ran = True
        return ran, left


def _commands(cure: Cure) -> tuple[Next, ...]:
    """Return the command that shows a cure; only settings can be given on a command line."""
    if cure.change.size or not cure.change.settings:
        return ()
    values = (
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in cure.change.settings
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
