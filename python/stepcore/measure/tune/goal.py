"""The goals of `tune`, the correction of proposals by runs, and the proposals themselves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.follow import follow
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim
from stepcore.engine.start import Start
from stepcore.experiment.change import Change
from stepcore.report.units import FREQUENCIES, Units, metres, quantity, seconds

# Largest relative deviation from a goal that is reached; corrections end at a quarter, or ROUNDS.
WITHIN, ROUNDS = 0.1, 5
# A step response has settled when it stays this close to its end.
SETTLED = 0.02
# The fewest steps that show whether a pose is held: an instability that grows by 15 % per step
# grows a millionfold.
FEWEST = 100
SHIPPED = Change()


def settles() -> float:
    """Return x = ωt from which a critically damped step response is settled: (1 + x) e⁻ˣ = 0.02."""
    x = 1.0
    for _ in range(30):
        x = math.log((1 + x) / SETTLED)
    return x


# A critically damped oscillator settles in SETTLES/ω, and has a gain of 1/√2 at PASSES ω.
SETTLES, PASSES = settles(), math.sqrt(math.sqrt(2) - 1)


class Goal(NamedTuple):
    """A wanted value. name: "bandwidth", "settling", "sag" or "depth"."""

    name: str
    value: float

    def words(self, value: float, unit: str = "") -> str:
        """Return a value of this goal with its unit. unit: for a sag, "rad" or "m"."""
        if self.name in ("settling", "depth"):
            return seconds(value) if self.name == "settling" else metres(value)
        sags: Units = ((unit, 1.0), (f"m{unit}", 1e-3), (f"µ{unit}", 1e-6))
        return quantity(value, FREQUENCIES if self.name == "bandwidth" else sags)

    def near(self, value: float, share: float = WITHIN) -> bool:
        """Return whether a value is near the wanted one. share: the largest relative deviation."""
        return bool(abs(value / self.value - 1) < share)

    def corrected(
        self,
        count: int,
        run: Callable[[np.ndarray], np.ndarray],
        first: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return requests to the closed form with which runs reach this goal, and measured values.

        Contacts, other joints and the time step make measured values differ from the closed form:
        a measured value is taken as a power of the request, and two runs give the exponent.

        count: number of elements. run: returns the measured value of each element for the request
        of each; nan without a value. first: the first requests, by default the goal.
        """
        goal, power, before = math.log(self.value), np.ones(count), None
        x = np.full(count, goal) if first is None else np.log(first)
        held, most, best = x, -1, x
        for last in reversed(range(ROUNDS)):
            shown = run(np.exp(x))
            held = np.where(shown > 0, x, held)
            off = np.log(np.where(shown > 0, shown, self.value)) - goal
            near = sum(map(self.near, shown))
            if near >= most:
                most, best = near, x
            if not last or np.abs(off).max() <= WITHIN / 4:
                break
            if before is not None:
                moved = x - before[0]
                rise = (off - before[1]) / np.where(moved == 0, 1.0, moved)
                power = np.where(moved == 0, power, np.clip(rise, 0.5, 4))
            before = x, off
            # Without a value, the request was too large: go halfway back to the last that gave one.
            x = np.where(shown > 0, x - np.clip(off / power, -1.0, 1.0), (x + held) / 2)
        # Values may jump where friction releases: take the last round with most elements near.
        return np.exp(best), shown if best is x else run(np.exp(best))


@dataclass
class Tuned:
    """The proposal for one element.

    kind, name: the element. goal: the wanted value. unit: the unit of a sag.
    change: the change of the model that was run. lines: the MJCF to paste.
    expected: the value by the closed form. measured: the value in the run with these lines; nan if
        that run did not come to rest.
    reached: whether a run with these lines met the goal: the measured value is within 10 % of the
        wanted one, and the distance of a servo from its target is less than the motion's width.
    why: why the goal is not reached. also: text to append to the sentence if it is.
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
    def called(self) -> str:
        """The element in words."""
        nameless = self.name.startswith(f"{self.kind} ")
        return self.name if nameless else f"{self.kind} `{self.name}`"

    @property
    def wanted(self) -> str:
        """The goal in words."""
        return f"{self.goal.name} of {self.goal.words(self.goal.value, self.unit)}"

    @property
    def sentence(self) -> str:
        """The element, the goal and the measured value in words."""
        return f"{self.called[0].upper()}{self.called[1:]}, {self.said}"

    @property
    def said(self) -> str:
        """The sentence without the element."""
        if not self.reached:
            return f"{self.wanted}: not reached. {self.why}."
        law = self.goal.words(self.expected, self.unit)
        closed = f", {law} by the closed form" if math.isfinite(self.expected) else ""
        return f"{self.wanted}: {self.result} in the run{closed}{self.also}."

    @property
    def result(self) -> str:
        """The measured value in words."""
        known = math.isfinite(self.measured)
        return self.goal.words(self.measured, self.unit) if known else "not reached"

    def record(self) -> dict[str, Any]:
        """Return the proposal as plain data."""
        names = ("kind", "name", "measured", "expected", "reached")
        goal = {"goal": self.goal.name, "wanted": self.goal.value, "mjcf": " ".join(self.lines)}
        return {name: getattr(self, name) for name in names} | goal


class At(NamedTuple):
    """The start of runs: the state, and the controls that are held."""

    start: Start
    ctrl: np.ndarray

    def states(self, model: Model, steps: int, **drive: Any) -> list[Start] | None:
        """Return the states before and after each step, or None if the run fails.

        drive: arguments of `follow` that replace the held controls.
        """
        drive, names = drive or {"ctrl": self.ctrl[None, None]}, ("qpos", "qvel", "act")
        ran = follow(model, [self.start], steps, record=names, **drive)
        rows = zip(*(ran[name][0] for name in names), strict=True)
        return None if ran.failures else [Start(q, v, act, self.start.mocap) for q, v, act in rows]

    def contacts(self, sim: Sim, state: Start) -> np.ndarray:
        """Return the contacts in a state."""
        state.put(sim)
        sim.ctrl = self.ctrl
        sim.forward()
        found: np.ndarray = sim.contacts
        return found


def steps_of(model: Model, omega: float) -> int:
    """Return the number of steps until an oscillator of frequency ω [rad/s] is at rest for good."""
    return max(FEWEST, math.ceil(5 * SETTLES / omega / model.settings.dt))


def settling(path: np.ndarray, dt: float) -> float:
    """Return the settling time of a step response, to 2 % [s]. dt: interval of its values [s]."""
    outside = np.flatnonzero(~(np.abs(path - path[-1]) <= SETTLED * abs(path[-1] - path[0])))
    return float(outside[-1]) * dt if len(outside) else 0.0


def pasted(model: Model, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Return values, by paths such as "actuator/#3/kp", as MJCF lines of elements, without −0."""
    lines = dict[str, str]()
    for path, value in values.items():
        kind, index, field = path.split("/")
        k = int(index[1:])
        tag = model.scene.actuators[k].type if kind == "actuator" else kind
        head = f'{tag} name="{model.called(kind)[k]}"' if model.names[kind][k] else tag
        text = "" if value is None else " ".join(f"{x + 0.0:.6g}" for x in np.atleast_1d(value))
        lines[head] = lines.get(head, "") + (f' {field}="{text}"' if text else "")
    return tuple(f"<{head}{fields}/>" for head, fields in lines.items())
