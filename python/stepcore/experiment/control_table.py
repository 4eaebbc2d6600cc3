"""Controls over time, and the users' logs that they come from.

`ControlTable`: a user's log, played as controls. `PositionTable`: a log whose positions servos
follow. `ControlLog`: rows of controls with times. `Controls`: the input of a motion: rows or a
function, and servos that get the rows as targets.

The exact controls are the rows of a log at their times, held or interpolated. A step gets the mean
of the exact controls over the step. The mean neither delays a row nor loses one, whatever the step:
the impulse of a motor is exact, and the rest of the sampling error falls as dt². (Controls that are
read at the beginning of a step come half a step late on average, so that their error falls as dt
and hides the integrator's.) The error of a run at a coarse step includes the sampling error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from stepcore.engine.control import Control
from stepcore.engine.model import Model
from stepcore.experiment.change import Servo
from stepcore.experiment.log import Log
from stepcore.report.units import counted

# The longest time step that is tried by default, in shipped steps. A period that follows from a log
# has at least this many of the model's steps.
MOST_DT = 4
# A row takes effect at the beginning of a step if it is this close to it, in steps: rounding of
# the times of a file.
TIME_EPS = 1e-6


@dataclass(frozen=True, eq=False)
class ControlLog:
    """Rows of controls with times.

    times: when each row takes effect, from 0 on [s], shape (n,).
    rows: the controls of all actuators, (n, nu); or of several starts, (starts, n, nu).
    linear: whether the controls between two rows are interpolated; by default a row is held until
        the next. The last row stays to the end.
    """

    times: np.ndarray
    rows: np.ndarray
    linear: bool = False

    def steps(self, start: float, dt: float, count: int) -> np.ndarray:
        """Return the controls of `count` steps, shape (…, count, nu): the means over the steps.

        start: when the first step begins [s]. dt: the time step [s].
        """
        edges = start + dt * np.arange(count + 1)
        first, last = self._row(edges[:-1] + TIME_EPS * dt), self._row(edges[1:] - TIME_EPS * dt)
        values: np.ndarray = self._within(first, (edges[:-1] + edges[1:]) / 2)
        across = last > first
        if across.any():
            begin, end = edges[:-1][across], edges[1:][across]
            values[..., across, :] = (self._area(end) - self._area(begin)) / dt
        return values

    def slopes(self, start: float, dt: float, count: int) -> np.ndarray:
        """Return the derivatives of `steps` by a decreasing `start`, shape (…, count, nu)."""
        edges = start + dt * (np.arange(count + 1) - TIME_EPS)
        slopes: np.ndarray = np.diff(self._within(self._row(edges), edges), axis=-2) / dt
        return slopes

    def steps_per_row(self, dt: float) -> int:
        """Return the number of steps of dt [s] for which each row is held; 0 if it is not whole."""
        gaps = np.diff(self.times)
        if self.linear or not len(gaps):
            return int(not len(gaps))
        steps = round(float(gaps[0]) / dt)
        return steps if np.allclose(gaps, steps * dt, rtol=1e-9) else 0

    def ends_on(self, period: float) -> bool:
        """Return whether rows are held, and change only at the ends of periods; period: [s]."""
        count = self.times / period
        return not self.linear and bool(np.all(np.abs(count - np.round(count)) <= TIME_EPS))

    def _row(self, times: np.ndarray) -> np.ndarray:
        return np.maximum(np.searchsorted(self.times, times, side="right") - 1, 0)

    @cached_property
    def _slopes(self) -> np.ndarray:
        """The derivative of the controls after each row by time, shaped as the rows."""
        slopes = np.zeros_like(self.rows)
        if self.linear:
            slopes[..., :-1, :] = np.diff(self.rows, axis=-2) / np.diff(self.times)[:, None]
        return slopes

    def _within(self, row: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return the controls at times at which the given rows are in effect."""
        values: np.ndarray = self.rows[..., row, :]
        if self.linear:
            values = values + self._slopes[..., row, :] * (times - self.times[row])[:, None]
        return values

    @cached_property
    def _before(self) -> np.ndarray:
        """The integral of the controls from 0 to each row, shaped as the rows."""
        gaps, before = np.diff(self.times)[:, None], np.zeros_like(self.rows)
        parts = self.rows[..., :-1, :] * gaps + self._slopes[..., :-1, :] * gaps**2 / 2
        before[..., 1:, :] = np.cumsum(parts, axis=-2)
        return before

    def _area(self, times: np.ndarray) -> np.ndarray:
        """Return the integrals of the controls from 0 to the times."""
        row = self._row(times)
        since = (times - self.times[row])[:, None]
        area: np.ndarray = self._before[..., row, :] + self.rows[..., row, :] * since
        return area + self._slopes[..., row, :] * since**2 / 2 if self.linear else area


@dataclass(frozen=True, eq=False)
class Controls:
    """The input of a motion.

    log: rows over time; None with a function.
    function: the user's function of (time, sim), which is called once a control period.
    words: the description of default controls; "" for the user's controls.
    remarks: sentences on limitations of default controls.
    servos: replace actuators of the model, and get the rows as their targets.
    """

    log: ControlLog | None = None
    function: Control | None = None
    words: str = ""
    remarks: tuple[str, ...] = ()
    servos: tuple[Servo, ...] = ()

    @property
    def nu(self) -> int:
        """The number of controls in a row."""
        return 0 if self.log is None else self.log.rows.shape[-1]

    @property
    def shared(self) -> bool:
        """Whether all starts have the same controls."""
        return self.log is None or self.log.rows.ndim == 2

    def rows(self, starts: Sequence[int], dt: float, count: int) -> tuple[np.ndarray | None, int]:
        """Return the controls of some starts, and the number of steps for which a row is held.

        The shape is (starts, rows, nu), or (1, rows, nu) for controls that all starts share; None
        without controls.

        dt: time step [s]. count: the number of steps.
        """
        if self.log is None or not self.nu:
            return None, count
        log = self.picked(starts).log
        assert log is not None
        repeats = log.steps_per_row(dt)
        rows = log.rows if repeats else log.steps(0.0, dt, count)
        return rows[None] if rows.ndim == 2 else rows, max(1, repeats)

    def picked(self, starts: Sequence[int]) -> Controls:
        """Return the controls of some starts, which may be repeated."""
        if self.shared or self.log is None:
            return self
        log = replace(self.log, rows=self.log.rows[list(starts)])
        return replace(self, log=log)

    def joined(self, other: Controls) -> Controls:
        """Return these controls, followed by the controls of more starts."""
        if self.shared or self.log is None or other.log is None:
            return self
        rows = np.concatenate([self.log.rows, other.log.rows])
        return replace(self, log=replace(self.log, rows=rows))


class ControlTable(Log):
    """A log that is played as controls; see `Motion`."""

    expected, can_follow = "ctrl", True

    def __init__(self, source: Any, name: str = "") -> None:
        super().__init__(source, name or self.expected)

    def __repr__(self) -> str:
        return self.source

    @property
    def rows(self) -> np.ndarray:
        """The numbers of all columns, shape (n, columns)."""
        return np.column_stack([*self.columns.values()])

    @property
    def varies(self) -> bool:
        """Whether any two rows differ."""
        return bool(np.any(self.rows != self.rows[:1]))

    @property
    def constants(self) -> str:
        """The first row in words: "a=1, b=3", or "1, 3" without column names."""
        count = len(self.rows[0])
        return f"{count} constant controls" if count > 8 else self._first(", ")

    @property
    def option(self) -> str:
        """The value of the option --ctrl; a placeholder for rows of Python that change."""
        if self.path is not None:
            return self.path
        return "FILE.npy" if self.varies else self._first(",")

    def _first(self, separator: str) -> str:
        values = [f"{value:g}" for value in self.rows[0]]
        if "" not in self.columns:
            values = [f"{name}={value}" for name, value in zip(self.columns, values, strict=True)]
        return separator.join(values)

    def period(self, dt: float) -> float | None:
        """Return the control period [s], or None if the rows do not determine one; dt: [s].

        Rows without times have a period of dt. Equally spaced rows have a period that divides the
        spacing, so that steps can end on the times of rows: the shortest one of at least `MOST_DT`
        steps of dt, so that longer steps can be tried.
        Other rows follow their times whatever the period; see `ControlLog`.
        """
        if self.times is None:
            return dt
        gap = self.gap
        if gap is None or abs(gap - round(gap / dt) * dt) > 1e-6 * dt:
            return None
        steps = round(gap / dt)
        parts = [steps // k for k in range(1, steps + 1) if steps % k == 0]
        return min((n for n in parts if n >= MOST_DT), default=0) * dt or None

    def control_log(
        self,
        model: Any,
        key_ctrl: np.ndarray,
        period: float,
        linear: bool = False,
        sampled: bool = False,
    ) -> ControlLog:
        """Return the controls over time.

        model: a Model, or an object that names actuators and their joints in the same way.
        key_ctrl: the controls of actuators without a column, (nu,). period: of rows without times
        [s]. linear: whether to interpolate the rows. sampled: whether held rows take effect at
        the beginning of a period.

        Raises ValueError for a log that does not match the model's actuators.
        """
        if self.times is None and linear and self.varies:
            raise ValueError(f"{self.source}: has no times to interpolate between")
        rows = self.controls(model, key_ctrl)
        if self.times is None:
            return ControlLog(period * np.arange(len(rows)), rows)
        if sampled and not linear:
            # Only the row in effect at the beginning of each period counts.
            periods = period * np.arange(math.floor(self.duration / period) + 2)
            index = np.searchsorted(self.times, periods + 1e-6 * period, side="right") - 1
            return ControlLog(periods, rows[index])
        return ControlLog(self.times, rows, linear)

    def clamping(self, model: Model, rows: np.ndarray) -> tuple[str, ...]:
        """Return a remark on controls beyond their ctrlrange, if any; rows: (n, nu)."""
        low, high = model.actuator_ctrlrange.T
        if not model.scene.features.clampctrl or not len(rows):
            return ()
        over = np.maximum(low - rows, rows - high) > 1e-9 * np.maximum(1.0, np.abs(rows))
        outside = np.flatnonzero(over.any(axis=0))
        if not len(outside):
            return ()
        k = int(outside[0])
        value = rows[int(over[:, k].argmax()), k]
        limits = f"clamped to its ctrlrange of {low[k]:.4g} to {high[k]:.4g}"
        more = f", and {len(outside) - 1} more actuators" if len(outside) > 1 else ""
        some = f"{counted(int(over[:, k].sum()), 'row')} of {len(rows)}"
        share = f" ({some}{more})" if len(rows) > 1 else more
        named = model.called("actuator")[k]
        return (f"the control {value:.4g} of {named} is {limits}{share}",)


class PositionTable(ControlTable):
    """A log whose positions of hinges and slides are followed; see `Motion`.

    Servos get the controls at which their force is zero in the recorded position. Motors are
    replaced by servos, with the gains of the default motion "hold".
    """

    expected, follows = "qpos", True

    def period(self, dt: float) -> float | None:
        return None if self.times is not None else dt

    def poses(self, model: Model, qpos: np.ndarray) -> np.ndarray:
        """Return a pose for each row, shape (n, nq); qpos: of the joints without a column.

        The poses of joints with several coordinates can only come from arrays.
        """
        placed = self.placed(model)
        if "qpos" not in placed.arrays:
            raise ValueError(f"{self.source}: has no positions to follow, but {placed.words}")
        poses = placed.arrays["qpos"]
        bad = np.argwhere(np.isnan(poses) & np.isin(np.arange(model.nq), placed.of("qpos")))
        if len(bad):
            row, k = bad[0].tolist()
            limit = "must be a number in each row"
            raise ValueError(f"{self.at(row, placed.titles['qpos', k])} is empty or nan: {limit}")
        return np.where(np.isnan(poses), qpos, poses)


def control_table(ctrl: Any) -> ControlTable:
    """Return the table of a user's argument `ctrl`; see `Motion` for the accepted types."""
    return ctrl if isinstance(ctrl, ControlTable) else ControlTable(ctrl)
