"""Cures of findings: each is made on a copy of the scene, run again, and its effect measured.

A monitor proposes cures, and how to measure what is left of the problem (`Remedy`). `verified`
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
from stepcore.engine.element import Element, SceneField
from stepcore.engine.model import Model
from stepcore.measure.monitors.finding import Cure, Finding, Next, Remedy

# A cure that leaves more than a finding's threshold is still named if it leaves at most this share
# of the problem.
HELPS = 0.5
# The runs of all cures: their number, where a run with half the time step counts as two, and their
# cost in steps × (dofs + 2). A Go2 takes 0.3 s for 500 steps with the monitor, so 7 s in all.
RUNS, EFFORT = 24.0, 3e5
# The largest number of time steps of a cure's run, relative to the run.
FINER = 16.0


# Runs the motion of a finding with another model, and returns the monitor; None if the run fails.
Again = Callable[[Model], Any]


def verified(findings: Iterable[Finding], model: Model, again: Again, steps: int) -> list[Finding]:
    """Return findings with the cures that were seen to hold, and with what they leave.

    Cures whose runs would cost more than `RUNS` and `EFFORT` are named without a promise.

    model: the model of the run. again: runs the same motion with another model.
    steps: the number of time steps of the run.
    """
    trial = _Trial(model, again, steps)
    cured = (trial.cured(finding) for finding in findings)
    return [finding for finding in cured if finding is not None]


def proven(findings: Iterable[Finding], model: Model) -> list[Finding]:
    """Return findings about a scene that was not run; their cures are run in their own motion."""
    return verified(findings, model, lambda other: None, 0)


class _Trial:
    def __init__(self, model: Model, again: Again, steps: int) -> None:
        self.model, self.again = model, again
        self.runs, self.effort = RUNS, EFFORT
        self.cost = float(steps * (model.nv + 2))
        self.time = deadline.current() or deadline.Deadline()

    def cured(self, finding: Finding) -> Finding | None:
        """Return a finding with the best of its cures, or None if it needed one."""
        remedy = finding.remedy
        if remedy is None:
            return finding
        finding = dataclasses.replace(finding, remedy=None)
        held: list[tuple[float, Cure]] = []
        helped: list[tuple[float, Cure]] = []
        untried: list[Cure] = []
        tried: list[Cure] = []
        before = next((x for x in (remedy.now, finding.value) if x is not None), math.inf)
        for way in remedy.ways:
            if len(held) == remedy.most:
                break
            for cure in way:
                if not self._affordable(cure):
                    untried.append(cure)
                    break
                left: float | None = None
                known = False
                with self.time.stage("runs of all cures"):
                    left, known = self._left(remedy, cure), True
                if not known:
                    untried.append(cure)
                    break
                tried.append(cure)
                if left is not None and left <= remedy.enough:
                    held.append((left, cure))
                    break
                if left is not None and left <= HELPS * abs(before):
                    helped.append((left, cure))
        named = held or sorted(helped, key=lambda entry: entry[0])[:1]
        if named:
            said = ", or ".join(f"{cure.words} leaves {remedy.say(left)}" for left, cure in named)
            cure = named[0][1]
            also = f", or {finding.cure}" if finding.cure else ""
            commands = (*_commands(cure), *finding.commands)
            return dataclasses.replace(
                finding, cure=said + also, settings=cure.settings, commands=commands
            )
        if remedy.needed and (tried or finding.severity == "remark"):
            return None
        if untried:
            also = f", or {finding.cure}" if finding.cure else ""
            return dataclasses.replace(finding, cure=f"try {untried[0].words}{also}")
        # Of each way the first; the stronger ones have been tried, too.
        first = [way[0].words for way in remedy.ways if way and way[0] in tried]
        failed = f"tried without success, and more of it: {'; '.join(first)}" if first else ""
        return dataclasses.replace(finding, cure=finding.cure or failed)

    def _affordable(self, cure: Cure) -> bool:
        """Whether the run of a cure is within what is left for runs, which it then takes."""
        finer = self.model.settings.dt / cure.settings.get("dt", self.model.settings.dt)
        runs = max(1.0, finer)
        if finer > FINER or runs > self.runs or runs * self.cost > self.effort:
            return False
        self.runs, self.effort = self.runs - runs, self.effort - runs * self.cost
        return True

    def _left(self, remedy: Remedy, cure: Cure) -> float | None:
        """Return what a cure leaves; None if its run fails, or makes an error of its own."""
        try:
            monitor = (remedy.again or self.again)(cure.made(self.model))
        except (ValueError, SimulationError):
            return None
        return None if monitor is None else remedy.left(monitor)


def _commands(cure: Cure) -> tuple[Next, ...]:
    """Return the command that shows a cure; only settings can be given on a command line."""
    if cure.changes or not cure.settings:
        return ()
    values = {
        name: f"{value:g}" if isinstance(value, float) else f"{value}"
        for name, value in cure.settings.items()
    }
    sets = [word for name, value in values.items() for word in ("--set", f"{name}={value}")]
    return (Next("run", "the same with this cure", tuple(sets)),)


def assigned(
    model: Model, elements: Iterable[Element], values: Mapping[str, Any]
) -> tuple[tuple[SceneField, Any], ...]:
    """Return the fields of elements with new values; each field once.

    values: the new values by the name of the field.
    """
    changes = {
        (of.kind, of.index, of.name): (of, values[of.name])
        for element in elements
        for of in element.fields(model)
        if of.name in values
    }
    return tuple(changes.values())


def finer(settings: Settings, most: float) -> float:
    """Return the largest whole part of the time step that is at most `most` [s]."""
    return settings.dt / max(1, math.ceil(settings.dt / most * (1 - 1e-9)))


def setting_words(settings: Mapping[str, Any]) -> str:
    """Return settings in words: 'cone="elliptic" with impratio="100"'."""
    first, *rest = (f'{name}="{value}"' for name, value in settings.items())
    return f"{first} with {' and '.join(rest)}" if rest else first
