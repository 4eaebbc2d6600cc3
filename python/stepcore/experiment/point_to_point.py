"""`PointToPoint`: controls that move servos and motors to a pose and back, with minimum jerk.

The path from pose to pose is q(t) = q₀ + s(t) d with s = 10x³ − 15x⁴ + 6x⁵, x = t/T: of all paths
that begin and end at rest, the one with the least squared jerk (Flash and Hogan, 1985).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stepcore.experiment.control_log import ControlLog

# The longest time for which the controls of servos are held [s]: a power of two of them make a
# control period. In 8 ms, a pose that moves at 1 rad/s would jump by 8 mrad, which a stiff servo
# answers with its whole force.
HELD = 1e-3
# The duration of a move, and of the rest after it [s].
MOVE, REST = 0.8, 0.2


def profile(times: Any) -> tuple[Any, Any]:
    """Return the share of the way s and its rate ds/dt [1/s]: there, a rest, back, a rest, ….

    times: since the beginning [s].
    """
    turn, within = np.divmod(times, MOVE + REST)
    x = np.minimum(within / MOVE, 1.0)
    way = x**3 * (10 + x * (6 * x - 15))
    rate = 30 * x**2 * (1 - x) ** 2 / MOVE
    back = turn % 2 == 1
    return np.where(back, 1 - way, way), np.where(back, -rate, rate)


@dataclass(frozen=True)
class JointGains:
    """PD control of joints by motors: force = load + kp (target − q) + kd (rate − v).

    actuators: the motors. at, dofs: the coordinate and the dof of each. unit: the force on the
        joint per unit of control. pose: the pose that is held. load: the force that the pose needs
        at rest. low, high: the bounds of the controls. All have shape (motors,).
    """

    actuators: Sequence[int]
    at: np.ndarray
    dofs: np.ndarray
    unit: np.ndarray
    pose: np.ndarray
    load: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def controls(self, sim: Any, change: np.ndarray, way: float, rate: float) -> np.ndarray:
        """Return the controls of the motors at the present state of a Sim or a Batch."""
        behind = self.pose + way * change - sim.qpos[..., self.at]
        force = self.load + self.kp * behind + self.kd * (rate * change - sim.qvel[..., self.dofs])
        result: np.ndarray = np.clip(force / self.unit, self.low, self.high)
        return result


@dataclass(frozen=True, eq=False)
class PointToPoint:
    """The controls of the moves of several starts; a control function of (time, sim).

    held: the controls at the start, (nu,).
    spans: the change of the controls from the start to the target, (starts, nu).
    rates: the controls per 1/s of ds/dt, of velocity servos, (starts, nu).
    gains: the control of motors, or None.
    changes: the way of each motor's joint, (starts, motors).
    start: the index of the start that a call is for. begin: the time of the start [s].
    """

    held: np.ndarray
    spans: np.ndarray
    rates: np.ndarray
    gains: JointGains | None
    changes: np.ndarray
    start: int = 0
    begin: float = 0.0

    @property
    def starts(self) -> range:
        return range(len(self.spans))

    def rows(self, times: np.ndarray) -> np.ndarray:
        """Return the controls of servos at some times, (starts, times, nu)."""
        way, rate = profile(times)
        moved = way[:, None] * self.spans[:, None] + rate[:, None] * self.rates[:, None]
        rows: np.ndarray = self.held + moved
        return rows

    def log(self, periods: int, period: float, whole: bool = False) -> ControlLog:
        """Return the controls of servos as a log of rows that are held for at most `HELD`.

        Its rows have the controls of every start, one start after the other.

        whole: whether the rows are held for a period.
        """
        parts = 1 if whole else 1 << max(0, math.ceil(math.log2(period / HELD)))
        times = period / parts * np.arange(periods * parts)
        rows = self.rows(times + period / parts / 2)
        return ControlLog(times, rows.transpose(1, 0, 2).reshape(len(times), -1))

    def __call__(self, time: float, sim: Any) -> np.ndarray:
        return self.controls(time, sim, self.start)

    def controls(self, time: float, sim: Any, start: Any) -> np.ndarray:
        """Return the controls of a Sim, (nu,), or of the worlds of a Batch, (worlds, nu).

        start: the index of the start, or those of all worlds.
        """
        way, rate = profile(time - self.begin + 1e-9)
        ctrl: np.ndarray = self.held + way * self.spans[start] + rate * self.rates[start]
        if self.gains is not None:
            forces = self.gains.controls(sim, self.changes[start], way, rate)
            ctrl[..., list(self.gains.actuators)] = forces
        return ctrl

    def of(self, start: int) -> PointToPoint:
        """Return the control function of one start."""
        return replace(self, start=start)

    def picked(self, indices: Sequence[int]) -> PointToPoint:
        """Return the controls of some starts, which may be repeated."""
        k = list(indices)
        spans, rates, changes = self.spans[k], self.rates[k], self.changes[k]
        return replace(self, spans=spans, rates=rates, changes=changes, start=0)

    def scaled(self, factor: float) -> PointToPoint:
        """Return controls to poses that are nearer by a factor."""
        spans, rates, changes = factor * self.spans, factor * self.rates, factor * self.changes
        return replace(self, spans=spans, rates=rates, changes=changes)

    @classmethod
    def together(cls, parts: Sequence[PointToPoint]) -> PointToPoint:
        """Return the controls of all starts of some parts, whose gains are the same."""
        return replace(
            parts[0],
            spans=np.concatenate([part.spans for part in parts]),
            rates=np.concatenate([part.rates for part in parts]),
            changes=np.concatenate([part.changes for part in parts]),
            start=0,
        )
