"""`NewValue`: a value of a scene before and after a change, and how much of a change it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from stepcore.measure.diagnosis.element_names import named

DIGITS = 3
# The most values that are written out in one text.
WRITTEN = 3


@dataclass(frozen=True)
class NewValue:
    """A value of the scene before and after a change.

    owner: the name of the element that has it, such as "servo `elbow`". field: which of its fields,
    as in `Scene`. before, after: the numbers, in `unit`. size: |log| of the factor by which it
    changes the gain, or the inertia or the damping that it adds to.
    """

    owner: str
    field: str
    before: tuple[float, ...]
    after: tuple[float, ...]
    unit: str = ""
    size: float = 0.0

    @property
    def text(self) -> str:
        """The change in words."""
        return f"change {self.field} of {self.owner} {self.way}"

    @property
    def way(self) -> str:
        """From which numbers to which."""
        old, new = (" ".join(f"{x:.6g}" for x in side) for side in (self.before, self.after))
        unit = f" {self.unit}" if self.unit else ""
        return f"from {old} to {new}{unit}"


def text_of(values: Sequence[NewValue]) -> str:
    """Several changes in words; equal ones together, and no more than a few written out."""
    alike: dict[tuple[str, str], list[str]] = {}
    for value in values:
        alike.setdefault((value.field, value.way), []).append(value.owner)
    texts = [f"change {field} of {named(owners)} {way}" for (field, way), owners in alike.items()]
    if len(texts) <= WRITTEN:
        return ", ".join(texts)
    # Of one field, with a value for each owner.
    fields = " and ".join(dict.fromkeys(value.field for value in values))
    low, high = min(v.after[-1] for v in values), max(v.after[-1] for v in values)
    unit = f" {values[0].unit}" if values[0].unit else ""
    owners = named(list(dict.fromkeys(value.owner for value in values)))
    return f"change {fields} of {owners}, to {low:.3g} to {high:.3g}{unit}"


def ratio(before: float, after: float) -> float:
    """|log| of the factor between two numbers; 0 where there is none."""
    if before == 0 or after == 0:
        return 0.0
    return abs(math.log(abs(after)) - math.log(abs(before)))


def rounded(value: float, *, up: bool) -> float:
    """A number >= 0 rounded to three digits, upwards or downwards.

    >>> rounded(1234.5, up=False), rounded(0.0012341, up=True)
    (1230.0, 0.00124)
    """
    if value <= 0 or not math.isfinite(value):
        return max(value, 0.0)
    place = math.floor(math.log10(value)) - DIGITS + 1
    # As text: a power of ten of a small number leaves the range of numbers.
    count = float(f"{value:.16e}".split("e")[0]) * 10.0 ** (DIGITS - 1)
    # A number that has three digits already stays as it is.
    whole = round(count)
    if not math.isclose(count, whole, rel_tol=1e-9):
        whole = math.ceil(count) if up else math.floor(count)
    return float(f"{whole}e{place}")
