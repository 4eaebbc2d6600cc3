"""What `tune` reaches for, how it corrects a proposal by its run, and what it found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.follow import follow
from stepcore.engine.model import Model
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.report.units import FREQUENCIES, Units, metres, quantity, seconds

# A goal is reached within this share of it; corrections by the run end at a quarter of it.
WITHIN, ROUNDS = 0.1, 5
# A critically damped oscillator of frequency ω [rad/s] settles within 2 % at SETTLES/ω (the root of
# (1 + x) exp(-x) = 0.02), rises from 10 to 90 % in RISES/ω, and has a gain of 1/√2 at PASSES ω.
SETTLED, SETTLES, RISES, PASSES = 0.02, 5.834, 3.358, 0.6436
STIFFNESSES: Units = (("MN/m", 1e6), ("kN/m", 1e3), ("N/m", 1.0))
SHIPPED = Change()
NOISES: Units = (("kN", 1e3), ("N", 1.0), ("mN", 1e-3), ("µN", 1e-6), ("nN", 1e-9))


class Goal(NamedTuple):
    """One wanted value. name: "bandwidth", "settling", "sag", "stiffness", "depth" or "noise"."""

    name: str
    value: float

    def words(self, value: float, unit: str = "") -> str:
        """Return a value of this goal with its unit; unit: of a sag, "rad" or "m"."""
        if self.name == "settling":
            return seconds(value)
        if self.name == "depth":
            return metres(value)
        units: dict[str, Units] = {
            "bandwidth": FREQUENCIES,
            "sag": ((unit, 1.0), (f"m{unit}", 1e-3), (f"µ{unit}", 1e-6)),
            "stiffness": STIFFNESSES,
            "noise": NOISES,
        }
        return quantity(value, units[self.name])

    def near(self, value: float, share: float = WITHIN) -> bool:
        """Return whether a value is the wanted one, within a share of it."""
        return abs(value / self.value - 1) < share


class At(NamedTuple):
    """Where runs begin: the state, and the controls that are held."""

    start: Start
    ctrl: np.ndarray

    def after(self, model: Model, time: float) -> Start | None:
        """Return the state after some time [s], or None if the run fails."""
        steps, names = max(1, math.ceil(time / model.settings.dt - 1e-9)), ("qpos", "qvel", "act")
        held = self.ctrl[None, None]
        ran = follow(model, [self.start], steps, steps, ctrl=held, record=names)
        if ran.failures:
            return None
        qpos, qvel, act = (ran[name][0, -1] for name in names)
        return Start(qpos, qvel, act, self.start.mocap)


def settling(share: np.ndarray, dt: float) -> float:
    """Return when a step response stays within 2 % of its end [s]; dt: between its values [s]."""
    outside = np.flatnonzero(~(np.abs(share - 1) <= SETTLED))
    return (int(outside[-1]) + 1 if len(outside) else 0) * dt


def pasted(model: Model, values: Mapping[str, Any]) -> list[str]:
    """Return values, by paths such as "actuator/#3/kp", as MJCF to paste: an element a line."""
    lines = dict[str, str]()
    for path, value in values.items():
        kind, index, field = path.split("/")
        k = int(index[1:])
        name, tag = model.called(kind)[k], kind
        tag = model.scene.actuators[k].type if kind == "actuator" else kind
        head = f'{tag} name="{name}"' if model.names[kind][k] else tag
        text = " ".join(f"{number:.6g}" for number in np.atleast_1d(value)) if value else ""
        lines[head] = lines.get(head, "") + (f' {field}="{text}"' if value is not None else "")
    return [f"<{head}{fields}/>" for head, fields in lines.items()]


@dataclass
class Tuned:
    """The proposal for one element.

    kind, name: the element. goal: what was wanted. unit: of a sag.
    change: of the model, as it was run. lines: the MJCF to paste.
    expected: the value by the closed form. measured: the value in the run with these lines; nan if
        that run did not come to rest.
    reached: whether the measured value is the wanted one within 10 %.
    why: why it is not reached. also: to append to the sentence of one that is reached.
    """

    kind: str
    name: str
    goal: Goal
    unit: str = ""
    change: Change = SHIPPED
    lines: tuple[str, ...] = ()
    expected: float = math.nan
    measured: float = math.nan
    reached: bool = False
    why: str = ""
    also: str = ""

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
    def result(self) -> str:
        """The measured value in words."""
        known = math.isfinite(self.measured)
        return self.goal.words(self.measured, self.unit) if known else "not reached"

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
