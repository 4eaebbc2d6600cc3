"""`Finding`: one thing that is wrong, or may be, in a sentence with its cure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

# The most severe first: what cannot be right, what will be noticed, what may be meant.
SEVERITIES = ("error", "warning", "remark")
# The most names in a sentence.
NAMES = 3


@dataclass(frozen=True)
class Finding:
    """One finding of `stepcore.check`.

    kind: what it is about, in a word or two, such as "overlap" or "creep".
    severity: "error" (cannot be right), "warning" (will be noticed) or "remark" (may be meant).
    element: the element that it names first, "" if it is the whole scene.
    text: a sentence that says what is so, and what cures it.
    value, unit: the number that it is judged by, None and "" where there is none.
    """

    kind: str
    severity: str
    element: str
    text: str
    value: float | None = None
    unit: str = ""


def ordered(findings: Iterable[Finding]) -> list[Finding]:
    """The most severe first, and otherwise in the order in which they were found."""
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def others(names: Sequence[str], noun: str) -> str:
    """ " (and `a`, `b` and 3 more contacts)" after the first of some names; "" if it is alone.
    A name that comes again, as of two contacts of one pair, is told once.

    noun: of more than one.
    """
    rest = list(dict.fromkeys(names))[1:]
    if not rest:
        return ""
    more = len(rest) - NAMES
    shown = ", ".join(rest[:NAMES])
    if more == 1:
        noun = noun.replace("bodies", "body").removesuffix("s")
    return f" (and {shown}{f' and {more} more {noun}' if more > 0 else ''})"
