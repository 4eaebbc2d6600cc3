"""`Finding`: a problem, or a possible problem, as data; the sentence is made last.

Also the one scale by which findings are judged, and the words that their sentences share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from stepcore.engine.element import Element
from stepcore.engine.model import Model
from stepcore.experiment.change import Change
from stepcore.report.units import counted

# Shares of a size (the thinner geom, the smaller body, a joint's range), of a load or of a time.
# Seen within a second or two, if one looks: the 11 mm/s at which half_cheetah's feet creep apart,
# the gap of 3 % of weldballs.xml, the sag of 2.6 % of op3.
SEEN = 0.01
# A twentieth: beyond a limit, more than an impact (finger.xml), louder than rounding (hopper.xml).
FEW = 0.05
# A depth that looks wrong (friction8.xml, cup.xml, jaco_arm.xml at 10 %), a way that is sliding.
DEEP = 0.1
# Most of something: a weight that a servo carries, a force beside another, a geom within another.
HALF = 0.5
# The share of a threshold that a cure is made to leave.
LEFT = 0.1
# Number of elements that a sentence names after the first.
OTHERS = 3

# Most severe first: certainly wrong, will be noticed, may be intended.
SEVERITIES = ("error", "warning", "remark")

T = TypeVar("T")


class Next(NamedTuple):
    """A command to run next.

    The fields are the command's name, the reason, and the arguments after the file.
    """

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
    again: makes the run that `left` reads with another model; by default the motion of the finding.
    """

    ways: tuple[tuple[Cure, ...], ...]
    left: Callable[[Any], float | None]
    enough: float
    say: Callable[[float], str]
    most: int = 1
    now: float | None = None
    needed: bool = False
    again: Callable[[Model], Any] | None = None


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
        return f"{problem}: {self.cure}." if self.cure else f"{problem}."

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
