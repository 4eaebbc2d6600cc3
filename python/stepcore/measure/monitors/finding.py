"""`Finding`: something that is wrong, or may be, as data; its sentence is made at the end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from stepcore.engine.element import Element
from stepcore.engine.model import Model

# The most severe first: what cannot be right, what will be noticed, what may be meant.
SEVERITIES = ("error", "warning", "remark")
# A sentence names the first element, and this many others.
OTHERS = 3


class Next(NamedTuple):
    """A command worth running next: its name, its arguments after the file, and why."""

    command: str
    why: str
    arguments: tuple[str, ...] = ()


PLOT = (Next("run", "energy over time", ("--plot", "run.png")),)


@dataclass(frozen=True)
class Finding:
    """One finding of `stepcore.check`.

    kind: what it is about, in a word or two, such as "overlap" or "creep".
    severity: "error" (cannot be right), "warning" (will be noticed) or "remark" (may be meant).
    problem: what is wrong.
    cure: what mends it; "" where nothing is known to.
    elements: those that have the problem, the worst first; none if it is the whole scene.
    value, unit: the number that it is judged by; None and "" where there is none.
    commands: what to run next because of it.
    settings: the settings that the cure changes, with their new values.
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

    @property
    def element(self) -> str:
        """The name of the worst element; "" if it is the whole scene."""
        return self.elements[0].name if self.elements else ""

    @property
    def text(self) -> str:
        """A sentence that says what is wrong, and what cures it."""
        # A problem of no element may begin with the name of a file.
        problem = capital(self.problem) if self.elements else self.problem
        return f"{problem}: {self.cure}." if self.cure else f"{problem}."

    def record(self) -> dict[str, Any]:
        """The finding as plain data."""
        names = ("kind", "severity", "element", "text", "value", "unit")
        return {name: getattr(self, name) for name in names}


def capital(text: str) -> str:
    """A text as the beginning of a sentence."""
    return text[:1].upper() + text[1:]


def ordered(findings: Iterable[Finding]) -> list[Finding]:
    """The most severe first, and otherwise in the order in which they were found."""
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def named(model: Model, kind: str, indices: Iterable[int]) -> tuple[Element, ...]:
    """Elements of one kind, each once and in this order."""
    return tuple(Element.of(model, kind, index) for index in dict.fromkeys(map(int, indices)))


def listed(elements: Sequence[Element], noun: str) -> str:
    """ "servo `a` (and servo `b`, servo `c` and 3 more servos)"; noun: of more than one."""
    first, *rest = (element.name for element in elements)
    return first + others(rest, noun)


def others(names: Sequence[str], noun: str) -> str:
    """ " (and `b`, `c` and 3 more contacts)", or "" without names."""
    if not names:
        return ""
    more = len(names) - OTHERS
    if more == 1:
        noun = noun.replace("bodies", "body").removesuffix("s")
    rest = f" and {more} more {noun}" if more > 0 else ""
    return f" (and {', '.join(names[:OTHERS])}{rest})"
