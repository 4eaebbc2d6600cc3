"""`Finding`: a problem of a scene as data, the scale by which it is judged, and cures that are run.

A finding proposes cures, and how to measure what is left of the problem (`Remedy`). `verified`
makes each on a copy of the scene, runs the motion again until one holds, and writes into the
finding what that run shows. A cure that was not run, or that did not help, promises nothing.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from stepcore import deadline
from stepcore._core import Settings, SimulationError
from stepcore.engine.element import OVERRIDE, Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.report.units import counted, seconds

# Shares of a size (the thinner geom, the smaller body, a joint's range), of a load or of a time;
# and the scenes nearest to them.
# A hundredth is seen within seconds, if one looks: contacts of dm_control's stacker and manipulator
# creep by 1.7 and 1.9 of it in one; op3's servos sag by 1.4 of it. isaacfranka.xml has 0.7.
SEEN = 0.01
# A twentieth is more than an impact does: 0.75 of it at a limit of decimation.xml, 1.3 of it in
# humanoidstandup. A force of dm_control's hopper is noisy by 2.4 of it.
FEW = 0.05
# A tenth looks wrong: contacts rest 1.7 and 2 of it deep in cup.xml and worm02.xml, and only 0.91
# and 0.96 of it under the feet of half_cheetah and h1.
DEEP = 0.1
# Most of something: hopper's torso is pressed into the floor by just half of its thickness, things
# of binpack.xml by 0.86 of theirs.
HALF = 0.5
# The share of a threshold that a cure is made to leave.
LEFT = 0.1
# Number of elements that a sentence names after the first.
OTHERS = 3
# The cost of all cures' runs, in steps × (dofs + 2). Go2 takes 0.35 s for 10⁵ of that, its findings
# included; what cures cup.xml is known after 6e5.
EFFORT = 1e6
# By how much gravity is changed to see whether a run is chaotic: far below what a scene means, and
# above the rounding by which two engines differ.
NUDGE = 1e-6
# The parts of a time step that are tried.
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


class Cure(NamedTuple):
    """A change that may cure a finding, and its words, such as 'solref="0.005 1"'."""

    words: str
    change: Change


@dataclass(frozen=True)
class Remedy:
    """The cures that are proposed for a finding, and how to measure their effect.

    ways: alternative cures, the preferred first. Each is a sequence of stronger and stronger
        ones, of which the first that holds is named.
    left: returns what is left of the problem in the `Recording` of a run; None if it cannot tell.
    enough: the amount that is no longer a problem.
    say: what is left, in words.
    most: the largest number of alternatives that are named.
    now: the problem itself, measured as by `left`; by default the finding's value.
    needed: whether the finding stands only if a cure holds, which shows its cause.
    by: the share of the run in which the problem is seen. A cure is first run so far, since most
        that fail do so at once.
    again: makes the run that `left` reads with another model; by default the motion of the finding.
    compared: whether the alternatives that failed are named beside those that hold.
    """

    ways: tuple[tuple[Cure, ...], ...]
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
    cure: the cure in words; "" if no cure is known.
    elements: the elements with the problem, worst first; empty for the whole scene.
    value, unit: the number by which the finding is judged; None and "" without a number.
    commands: the commands to run next because of the finding.
    settings: the settings that the cure changes, with their new values.
    remedy: cures that have not been tried yet; `verified` tries them, and writes what they leave.
    lines: MJCF elements to paste, where the cure is more than one.
    ran: whether the cure's words say of each change whether it was run.
    """

    kind: str
    severity: str
    problem: str
    cure: str = ""
    elements: tuple[Element, ...] = ()
    value: float | None = None
    unit: str = ""
    commands: tuple[Next, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    remedy: Remedy | None = field(default=None, repr=False, compare=False)
    lines: tuple[str, ...] = ()
    ran: bool = False

    @property
    def element(self) -> str:
        """The name of the worst element; "" for the whole scene."""
        return self.elements[0].name if self.elements else ""

    @property
    def text(self) -> str:
        """The problem and the cure as a sentence."""
        # A problem without an element may begin with a file name, which keeps its case.
        begin = self.problem[:1].upper() if self.elements else self.problem[:1]
        problem = begin + self.problem[1:]
        suggested = self.cure if self.ran else f"{self.cure} (not run)"
        return f"{problem}: {suggested}." if self.cure else f"{problem}."

    def record(self) -> dict[str, Any]:
        """Return the finding as plain data."""
        names = ("kind", "severity", "element", "text", "value", "unit")
        return {name: getattr(self, name) for name in names}


def ordered(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings sorted by severity; equally severe findings stay in order."""
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def worst(cases: Iterable[T], over: Callable[[T], float]) -> list[T]:
    """Return the cases that are over their threshold, the furthest first.

    over: how often a case has its threshold.
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


# Runs a share of the motion of a finding with another model, and returns the `Recording`; None if
# that fails.
Again = Callable[[Model, float], Any]


def verified(
    findings: Iterable[Finding],
    model: Model,
    again: Again = lambda model, share: None,
    steps: int = 0,
) -> list[Finding]:
    """Return findings with the cures that were seen to hold, and with what they leave.

    Cures whose runs would cost more than `EFFORT` are named without a promise.

    model: the model of the run. again: runs the same motion with another model; by default only
    cures with a motion of their own are run. steps: the number of time steps of the run.
    """
    trials = _Trials(model, again, steps)
    return [cured for finding in findings if (cured := trials.cured(finding)) is not None]


class _Held(NamedTuple):
    """A cure that holds, what it leaves, the share of the run in which that was seen, and a doubt.

    doubt: why it may not hold elsewhere, in words; "" if nothing shows that.
    """

    left: float
    cure: Cure
    share: float
    doubt: str = ""


@dataclass
class _Trials:
    """The runs of cures. steps: of one run.

    effort: what is left of `EFFORT` for cures. doubts: what is left for runs with another gravity.
    """

    model: Model
    again: Again
    steps: int
    effort: float = EFFORT
    doubts: float = HALF * EFFORT

    def cured(self, finding: Finding) -> Finding | None:
        """Return a finding with the best of its cures, or None if it needed one."""
        remedy = finding.remedy
        if remedy is None:
            return finding
        finding = dataclasses.replace(finding, remedy=None)
        also = f"; not run: {finding.cure}" if finding.cure else ""
        held, failed, untried = self._run(remedy, finding.value)
        if held:
            words = ", or ".join(self._words(remedy, one) for one in held)
            if remedy.compared and failed:
                words += f" (run without success: {'; '.join(failed)})"
            change = held[0].cure.change
            commands = (*_commands(change), *finding.commands)
            return dataclasses.replace(
                finding,
                cure=words + also,
                settings=dict(change.settings),
                commands=commands,
                ran=True,
            )
        if remedy.needed and (failed or finding.severity == "remark"):
            return None
        if untried:
            return dataclasses.replace(finding, cure=f"try {untried}{also}", ran=True)
        words = f"run without success, as stronger ones were: {'; '.join(failed)}" if failed else ""
        if not words:
            return finding
        return dataclasses.replace(finding, cure=words + also, ran=True)

    def _words(self, remedy: Remedy, held: _Held) -> str:
        length = held.share * self.steps * self.model.settings.dt
        within = f" in the first {seconds(float(f'{length:.2g}'))}" if held.share < 1 else ""
        return f"{held.cure.words} leaves {remedy.say(held.left)}{within}{held.doubt}"

    def _run(self, remedy: Remedy, value: float | None) -> tuple[list[_Held], list[str], str]:
        """Return cures that hold, those without a doubt first, or else the one that helps most.

        Then the first cures of the ways that failed, and the first that there was no time for.
        """
        now = value if remedy.now is None else remedy.now
        helps = math.inf if now is None else HALF * abs(now)
        held, helped, failed, untried = list[_Held](), list[_Held](), list[str](), ""
        for way in remedy.ways:
            if sum(not one.doubt for one in held) >= remedy.most:
                break
            ran = False
            for cure in way:
                share, left, seen = self._tried(remedy, cure)
                if not share:
                    untried = untried or cure.words
                    break
                ran = True
                if left is not None and left <= remedy.enough:
                    held.append(_Held(left, cure, share, self._doubt(remedy, cure, seen)))
                    ran = False
                    break
                if left is not None and left <= helps:
                    helped.append(_Held(left, cure, share))
            failed += [one.words for one in way[:1] if ran]
        best = sorted(held, key=lambda one: bool(one.doubt))[: remedy.most]
        return best or sorted(helped)[:1], failed, untried

    def _tried(self, remedy: Remedy, cure: Cure) -> tuple[float, float | None, Any]:
        """Run a cure: the share of the motion that there was time for, what it leaves, and the run.

        What it leaves is None if its run fails, or makes an error of its own.
        """
        ran, left, seen = 0.0, None, None
        for share in sorted({min(remedy.by, 1.0), 1.0}):
            cost = self._cost(cure.change, share)
            if cost > self.effort:
                return ran, left, seen
            self.effort -= cost
            tried = self._left(remedy, cure.change, share)
            if tried is None:
                return ran, left, seen
            (left, seen), ran = tried, share
            if left is None or left > remedy.enough:
                return 1.0, left, seen
        return ran, left, seen

    def _cost(self, change: Change, share: float) -> float:
        dt = self.model.settings.dt
        finer = max(1.0, dt / dict(change.settings).get("dt", dt))
        return finer * share * self.steps * (self.model.nv + 2)

    def _left(
        self, remedy: Remedy, change: Change, share: float, nudge: float = 0.0
    ) -> tuple[float | None, Any] | None:
        """Run a change, and return what it leaves and the run; None if the time was over.

        nudge: the change of gravity.
        """
        found = None
        with (deadline.current() or deadline.Deadline()).stage("runs of all fixes"):
            try:
                changed = change.of(self.model)
                if nudge:
                    changed = _nudged(changed, nudge)
                seen = remedy.again(changed) if remedy.again else self.again(changed, share)
                found = (None if seen is None else remedy.left(seen)), seen
            except (ValueError, SimulationError):
                found = None, None
        return found

    def _doubt(self, remedy: Remedy, cure: Cure, seen: Any) -> str:
        """Return why a cure that holds may not hold elsewhere; "" if nothing shows that."""
        if remedy.again is not None or not self.model.npair:
            return ""
        with (deadline.current() or deadline.Deadline()).stage("runs of all fixes"):
            if seen.unsolved:
                return ", but its rows are not solved, so that it may fail with another solver"
        cost = self._cost(cure.change, 1.0)
        if cost > self.doubts or not any(self.model.scene.gravity):
            return ""
        self.doubts -= cost
        tried = self._left(remedy, cure.change, 1.0, NUDGE)
        left = 0.0 if tried is None else tried[0]
        if left is not None and left <= remedy.enough:
            return ""
        what = "the run fails" if left is None else f"it leaves {remedy.say(left)}"
        return f", but {what} if gravity is changed by {NUDGE:g} of itself"


def _nudged(model: Model, nudge: float) -> Model:
    """Return the model under a gravity that is changed by a share of itself."""
    scene = model.scene.with_settings(model.settings)
    scene.gravity = tuple((1 + nudge) * value for value in scene.gravity)
    return scene.compile()


def _commands(change: Change) -> tuple[Next, ...]:
    """Return the command that shows a cure; only settings can be given on a command line."""
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
