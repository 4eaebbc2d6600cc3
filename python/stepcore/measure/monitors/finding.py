"""`Finding`: a problem of a scene as data, the scale by which it is judged, and fixes that are run.

A finding proposes fixes, and a measure of what remains of the problem (`Proposals`). `verified`
applies each fix to a copy of the scene and repeats the motion, until one succeeds. The finding then
reports the result of that run. No effect is claimed for a fix that was not run or did not help.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from stepcore import deadline
from stepcore._core import Settings, SimulationError
from stepcore.engine.element import OVERRIDE, Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.experiment.proposal import Proposal, evaluate
from stepcore.report.units import counted, seconds

# Fractions of a size (the thinner geom, the smaller body, a joint's range), of a load or of a time;
# and the scenes closest to each fraction.
# A hundredth is visible within seconds: contacts of dm_control's stacker and manipulator creep by
# 1.7 and 1.9 times this in one second; op3's servos sag by 1.4 times this. isaacfranka.xml has 0.7.
SEEN = 0.01
# A twentieth is more than the effect of an impact: 0.75 times this at a limit of decimation.xml,
# 1.3 times in humanoidstandup. The noise of a force in dm_control's hopper is 2.4 times this.
FEW = 0.05
# A tenth looks wrong: contacts rest 1.7 and 2 times this deep in cup.xml and worm02.xml, and only
# 0.91 and 0.96 times under the feet of half_cheetah and h1.
DEEP = 0.1
# Most of a size: hopper's torso is pressed into the floor by just half of its thickness, objects in
# binpack.xml by 0.86 of theirs.
HALF = 0.5
# Target residual of a fix, as a fraction of the threshold.
LEFT = 0.1
# Number of elements that a sentence names after the first.
OTHERS = 3
# Maximum cost of all runs of fixes, in steps × (dofs + 2). Go2 takes 0.35 s for 10⁵, its findings
# included; the fix of cup.xml is found after 6e5.
EFFORT = 1e6
# Relative change of gravity that shows whether a run is chaotic: far below the precision of a
# scene, and above the rounding by which two engines differ.
NUDGE = 1e-6
# Divisors of a time step, or factors of a gain, that are tried.
PARTS = (1, 2, 4)

# Most severe first: certainly wrong, will be noticed, may be intended.
SEVERITIES = ("error", "warning", "remark")

T = TypeVar("T")


class Next(NamedTuple):
    """A command to run next: its name, the reason, and the arguments after the file."""

    command: str
    why: str
    arguments: tuple[str, ...] = ()


PLOT = (Next("run", "energy over time", ("--plot", "run.png")),)
TEST_CONTACTS = (
    Next("converge", "whether the contacts are solved"),
    Next("run", "energy and overlap over time", ("--plot", "run.png")),
)


@dataclass(frozen=True)
class Proposals:
    """The fixes that are proposed for a finding, and the measure of their effect.

    ways: alternative fixes, the preferred first. Each is a sequence of increasingly strong fixes,
        of which the first that succeeds is named.
    left: returns the remaining problem in the `Recording` of a run; None if that is unmeasurable.
    enough: the amount that is no longer a problem.
    say: returns the remaining problem in words.
    most: the largest number of alternatives that are named.
    now: the problem itself, measured as by `left`; by default the finding's value.
    needed: whether the finding is reported only if a fix succeeds, which shows its cause.
    by: the fraction of the run in which the problem appears. A fix is first run for this fraction,
        since most that fail do so at once.
    again: runs another model for `left`; by default the motion of the finding is repeated.
    compared: whether alternatives that failed are named next to those that succeed.
    """

    ways: tuple[tuple[Proposal, ...], ...]
    left: Callable[[Any], float | None]
    enough: float
    say: Callable[[float], str]
    most: int = 1
    now: float | None = None
    needed: bool = False
    by: float = 1.0
    again: Callable[[Model], Any] | None = None
    compared: bool = False


@dataclass(frozen=True)
class Finding:
    """One finding of `stepcore.check`.

    kind: the subject in a word or two, such as "overlap" or "creep".
    severity: "error" (certainly wrong), "warning" (will be noticed) or "remark" (may be intended).
    problem: the problem in words.
    fix: the fix in words; "" without one.
    elements: the elements with the problem, worst first; empty for the whole scene.
    value, unit: the number by which the finding is judged; None and "" without a number.
    commands: the commands to run next because of the finding.
    settings: the settings that the fix changes, with their new values.
    proposals: fixes that have not been tried yet; `verified` tries them and adds the results.
    lines: MJCF elements to paste, if the fix consists of several.
    ran: whether `fix` states for each change if it was run.
    observation: the problem without its reason, for findings that give one.
    """

    kind: str
    severity: str
    problem: str
    fix: str = ""
    elements: tuple[Element, ...] = ()
    value: float | None = None
    unit: str = ""
    commands: tuple[Next, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    proposals: Proposals | None = field(default=None, repr=False, compare=False)
    lines: tuple[str, ...] = ()
    ran: bool = False
    observation: str = ""

    @property
    def element(self) -> str:
        """The name of the worst element; "" for the whole scene."""
        return self.elements[0].name if self.elements else ""

    @property
    def text(self) -> str:
        """The problem and the fix as a sentence."""
        # A problem without an element may begin with a file name, which keeps its case.
        begin = self.problem[:1].upper() if self.elements else self.problem[:1]
        problem = begin + self.problem[1:]
        suggested = self.fix if self.ran else f"{self.fix} (not run)"
        return f"{problem}: {suggested}." if self.fix else f"{problem}."

    def record(self) -> dict[str, Any]:
        """Return the finding as plain data."""
        names = ("kind", "severity", "element", "text", "fix", "value", "unit")
        return {name: getattr(self, name) for name in names}


def ordered(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings sorted by severity; equally severe findings stay in order."""
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def worst(cases: Iterable[T], over: Callable[[T], float]) -> list[T]:
    """Return the cases that are above their threshold, the largest ratio first.

    over: returns the ratio of a case to its threshold.
    """
    return sorted((case for case in cases if over(case) > 1), key=over, reverse=True)


def named(model: Model, kind: str, indices: Iterable[int]) -> tuple[Element, ...]:
    """Return elements of one kind, in order and without duplicates."""
    return tuple(Element.of(model, kind, index) for index in dict.fromkeys(map(int, indices)))


def listed(elements: Sequence[Element], noun: str) -> str:
    """Return "servo `a` (and servo `b`, servo `c` and 3 more servos)"; noun: the singular."""
    return elements[0].name + others(elements[1:], noun)


def others(elements: Sequence[Element], noun: str) -> str:
    """Return " (and `b`, `c` and 3 more contacts)", or "" without elements; noun: the singular."""
    if not elements:
        return ""
    more = len(elements) - OTHERS
    rest = f" and {counted(more, f'more {noun}')}" if more > 0 else ""
    return f" (and {', '.join(of.name for of in elements[:OTHERS])}{rest})"


# Runs a fraction of a finding's motion with another model; returns the `Recording`, or None if that
# fails.
Again = Callable[[Model, float], Any]


def verified(
    findings: Iterable[Finding],
    model: Model,
    again: Again = lambda model, share: None,
    steps: int = 0,
) -> list[Finding]:
    """Return findings with the fixes that succeeded in a run, and with the results.

    Fixes whose runs would cost more than `EFFORT` are suggested without a result.

    model: the model of the run. again: runs the same motion with another model; by default only
    fixes with `Proposals.again` are run. steps: the number of time steps of the run.
    """
    trials = _Trials(model, again, steps)
    results = (trials.with_fix(finding) for finding in findings)
    return [finding for finding in results if finding is not None]


@dataclass
class _Trials:
    """The runs of fixes. steps: of one run.

    effort: the rest of `EFFORT` for fixes. doubts: the rest for runs with another gravity.
    """

    model: Model
    again: Again
    steps: int
    effort: float = EFFORT
    doubts: float = HALF * EFFORT

    def with_fix(self, finding: Finding) -> Finding | None:
        """Return a finding with the best of its fixes, or None if it needs one and has none."""
        proposals = finding.proposals
        if proposals is None:
            return finding
        value = finding.value if proposals.now is None else proposals.now
        helps = math.inf if value is None else HALF * abs(value)
        run = functools.partial(self._run, proposals)
        best, failed, untried = evaluate(proposals.ways, run, proposals.most, helps)
        finding = dataclasses.replace(finding, proposals=None)
        also = f"; not run: {finding.fix}" if finding.fix else ""
        failures = "; ".join(proposal.words for proposal in failed)
        if best:
            words = ", or ".join(self._words(proposals, proposal) for proposal in best)
            if proposals.compared and failed:
                words += f" (run without success: {failures})"
            change = best[0].change
            return dataclasses.replace(
                finding,
                fix=words + also,
                settings=dict(change.settings),
                commands=(*_commands(change), *finding.commands),
                ran=True,
            )
        if proposals.needed and (failed or finding.severity == "remark"):
            return None
        if untried:
            return dataclasses.replace(finding, fix=f"try {untried.words}{also}", ran=True)
        if not failed:
            return finding
        words = f"run without success, as stronger ones were: {failures}"
        return dataclasses.replace(finding, fix=words + also, ran=True)

    def _words(self, proposals: Proposals, fix: Proposal) -> str:
        length = fix.share * self.steps * self.model.settings.dt
        within = f" in the first {seconds(float(f'{length:.2g}'))}" if fix.share < 1 else ""
        return f"{fix.words} leaves {proposals.say(fix.measured or 0.0)}{within}{fix.doubt}"

    def _run(self, proposals: Proposals, fix: Proposal) -> Proposal:
        """Run a fix, first for the fraction of the motion in which the problem appears.

        The measured value of the result is None if the run fails or raises an error.
        """
        run = None
        for share in sorted({min(proposals.by, 1.0), 1.0}):
            cost = self._cost(fix.change, share)
            if cost > self.effort:
                break
            self.effort -= cost
            result = self._measured(proposals, fix.change, share)
            if result is None:
                break
            left, run = result
            sufficient = left is not None and left <= proposals.enough
            fix = dataclasses.replace(fix, measured=left, share=share, sufficient=sufficient)
            if not sufficient:
                return dataclasses.replace(fix, share=1.0)
        if not fix.sufficient:
            return fix
        return dataclasses.replace(fix, doubt=self._doubt(proposals, fix, run))

    def _cost(self, change: Change, share: float) -> float:
        dt = self.model.settings.dt
        finer = max(1.0, dt / dict(change.settings).get("dt", dt))
        return finer * share * self.steps * (self.model.nv + 2)

    def _measured(
        self, proposals: Proposals, change: Change, share: float, nudge: float = 0.0
    ) -> tuple[float | None, Any] | None:
        """Run a change, and return the remaining problem and the run; None if time ran out.

        nudge: the relative change of gravity.
        """
        result = None
        with (deadline.current() or deadline.Deadline()).stage("runs of all fixes"):
            try:
                changed = change.of(self.model)
                if nudge:
                    changed = _nudged(changed, nudge)
                run = proposals.again(changed) if proposals.again else self.again(changed, share)
                result = (None if run is None else proposals.left(run)), run
            except (ValueError, SimulationError):
                result = None, None
        return result

    def _doubt(self, proposals: Proposals, fix: Proposal, run: Any) -> str:
        """Return why a fix that succeeds may fail elsewhere; "" without a reason."""
        if proposals.again is not None or not self.model.npair:
            return ""
        with (deadline.current() or deadline.Deadline()).stage("runs of all fixes"):
            if run.unsolved:
                return ", but its rows are not solved, so that it may fail with another solver"
        cost = self._cost(fix.change, 1.0)
        if cost > self.doubts or not any(self.model.scene.gravity):
            return ""
        self.doubts -= cost
        result = self._measured(proposals, fix.change, 1.0, NUDGE)
        left = 0.0 if result is None else result[0]
        if left is not None and left <= proposals.enough:
            return ""
        effect = "the run fails" if left is None else f"it leaves {proposals.say(left)}"
        return f", but {effect} if gravity is changed by {NUDGE:g} of itself"


def _nudged(model: Model, nudge: float) -> Model:
    """Return the model with its gravity changed by a fraction."""
    scene = model.scene.with_settings(model.settings)
    scene.gravity = tuple((1 + nudge) * value for value in scene.gravity)
    return scene.compile()


def _commands(change: Change) -> tuple[Next, ...]:
    """Return the command that shows a fix; a command line accepts settings only."""
    if change.size or not change.settings:
        return ()
    values = (
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in change.settings
    )
    sets = tuple(word for value in values for word in ("--set", value))
    return (Next("run", "the same with this fix", sets),)


def assigned(
    model: Model, elements: Iterable[Element], values: Mapping[str, Any]
) -> dict[str, Any]:
    """Return new values of fields of elements, by path; values: by the name of the field."""
    return {
        of.path or f"{of.kind}/#{of.index}/{of.name}": values[of.name]
        for element in elements
        for of in element.fields(model)
        if of.name in values and of.kind != OVERRIDE
    }


def finer(settings: Settings, most: float) -> float:
    """Return the time step over the smallest integer that makes it at most `most` [s]."""
    return settings.dt / max(1, math.ceil(settings.dt / most * (1 - 1e-9)))


def shorter(dts: Iterable[float]) -> tuple[Proposal, ...]:
    """Return fixes that shorten the time step to each of `dts` [s]."""
    return tuple(Proposal(f"a dt of {seconds(dt)}", Change(dt=dt)) for dt in dict.fromkeys(dts))
