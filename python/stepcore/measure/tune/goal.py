"""What `tune` reaches for: a goal, and what it found for one element."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from stepcore.report.units import FREQUENCIES, Units, metres, quantity, seconds

# A goal is reached within this share of it.
WITHIN = 0.1
# A critically damped oscillator of frequency ω [rad/s] settles within 2 % at SETTLES/ω (the root of
# (1 + x) exp(-x) = 0.02), rises from 10 to 90 % in RISES/ω, and has a gain of 1/√2 at PASSES ω.
SETTLES, RISES, PASSES = 5.834, 3.358, 0.6436


class Goal(NamedTuple):
    """One wanted value. name: "bandwidth", "settling", "sag", "stiffness", "depth" or "noise"."""

    name: str
    value: float

    def words(self, value: float, unit: str = "") -> str:
        """Return a value of this goal with its unit; unit: of a sag, "rad" or "m"."""
        if self.name == "bandwidth":
            return quantity(value, FREQUENCIES)
        if self.name == "settling":
            return seconds(value)
        if self.name == "sag":
            return quantity(value, ((unit, 1.0), (f"m{unit}", 1e-3), (f"µ{unit}", 1e-6)))
        if self.name == "depth":
            return metres(value)
        return quantity(value, STIFFNESSES if self.name == "stiffness" else NOISES)


STIFFNESSES: Units = (("MN/m", 1e6), ("kN/m", 1e3), ("N/m", 1.0))
NOISES: Units = (("kN", 1e3), ("N", 1.0), ("mN", 1e-3), ("µN", 1e-6), ("nN", 1e-9))


@dataclass
class Tuned:
    """The proposal for one element.

    kind, name: the element. goal: what was wanted. unit: of a sag.
    attributes: the MJCF attributes to paste, by element, such as {'joint name="knee"': ...}.
    expected: the value by the closed form. measured: the value in the run with these attributes;
        nan if that run did not come to rest.
    reached: whether the measured value is the wanted one within 10 %.
    why: why it is not reached. also: to append to the sentence of one that is reached.
    """

    kind: str
    name: str
    goal: Goal
    unit: str
    attributes: dict[str, str]
    expected: float
    measured: float
    reached: bool
    why: str = ""
    also: str = ""

    @property
    def result(self) -> str:
        """The measured value in words."""
        if not math.isfinite(self.measured):
            return "not reached"
        return self.goal.words(self.measured, self.unit)

    @property
    def sentence(self) -> str:
        """What was wanted, and what the run shows."""
        wanted = self.goal.words(self.goal.value, self.unit)
        head = f"{self.kind.capitalize()} `{self.name}`, {self.goal.name} of {wanted}: "
        if not self.reached:
            return f"{head}not reached. {self.why}."
        law = self.goal.words(self.expected, self.unit)
        closed = f", {law} by the closed form" if math.isfinite(self.expected) else ""
        return f"{head}{self.result} in the run{closed}{self.also}."

    @property
    def lines(self) -> list[str]:
        """The MJCF to paste."""
        return [f"<{tag} {values}/>" for tag, values in self.attributes.items()]

    def record(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "name": self.name,
            "goal": self.goal.name,
            "wanted": self.goal.value,
            "measured": self.measured,
            "expected": self.expected,
            "reached": self.reached,
            "mjcf": " ".join(self.lines),
        }
