"""`Controls`: what drives a motion: rows over time or a function, and servos that obey the rows.

The true controls are those of a log at its own times, held or interpolated. The controls of a step
are the mean of these over the step. The mean neither delays a row nor loses one, whatever the step:
the impulse of a motor is exact, and the rest of the sampling error falls as dt². (Controls that are
read at the beginning of a step come half a step late on average, so that their error falls as dt
and hides that of the integrator.) The error of a run at a coarse step includes the sampling error.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stepcore.engine.control import Control
from stepcore.experiment.change import Servo

# A row takes effect at the beginning of a step if it is this close to it, in steps: rounding of
# the times of a file.
ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class ControlLog:
    """Controls at times of their own.

    times: when each row takes effect, from 0 on [s], shape (n,).
    rows: the controls of all actuators, (n, nu); or those of several starts, (starts, n, nu).
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
        first, last = self._row(edges[:-1] + ROUNDING * dt), self._row(edges[1:] - ROUNDING * dt)
        values: np.ndarray = self._within(first, (edges[:-1] + edges[1:]) / 2)
        across = last > first
        if across.any():
            begin, end = edges[:-1][across], edges[1:][across]
            values[..., across, :] = (self._area(end) - self._area(begin)) / dt
        return values

    def slopes(self, start: float, dt: float, count: int) -> np.ndarray:
        """Return the derivatives of `steps` by `start`, as it falls, shape (…, count, nu)."""
        edges = start + dt * (np.arange(count + 1) - ROUNDING)
        slopes: np.ndarray = np.diff(self._within(self._row(edges), edges), axis=-2) / dt
        return slopes

    def held(self, dt: float) -> int:
        """Return for how many steps of dt [s] every row is held; 0 if they are no whole steps."""
        gaps = np.diff(self.times)
        if self.linear or not len(gaps):
            return int(not len(gaps))
        steps = round(float(gaps[0]) / dt)
        return steps if np.allclose(gaps, steps * dt, rtol=1e-9) else 0

    def ends_on(self, period: float) -> bool:
        """Return whether rows are held from one end of a period to another [s]."""
        count = self.times / period
        return not self.linear and bool(np.all(np.abs(count - np.round(count)) <= ROUNDING))

    def _row(self, times: np.ndarray) -> np.ndarray:
        """Return the index of the row that is in effect."""
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
    """What drives a motion.

    log: rows over time; None with a function.
    function: the user's function of (time, sim), which is called once a control period.
    words: of controls that nobody gave; "" for the user's own.
    remarks: sentences on what controls that nobody gave could not do.
    servos: take the place of actuators of the model, and get the rows as their targets.
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
        """Return the controls of some starts, and for how many steps a row is held.

        The shape is (starts, rows, nu), or (1, rows, nu) for controls that all starts share; None
        without controls.

        dt: time step [s]. count: the number of steps.
        """
        if self.log is None or not self.nu:
            return None, count
        log = self.picked(starts).log
        assert log is not None
        held = log.held(dt)
        rows = log.rows if held else log.steps(0.0, dt, count)
        return rows[None] if rows.ndim == 2 else rows, max(1, held)

    def picked(self, starts: Sequence[int]) -> Controls:
        """Return the controls of some starts, which may be repeated."""
        if self.shared or self.log is None:
            return self
        log = dataclasses.replace(self.log, rows=self.log.rows[list(starts)])
        return dataclasses.replace(self, log=log)

    def joined(self, other: Controls) -> Controls:
        """Return the controls with those of further starts after these."""
        if self.shared or self.log is None or other.log is None:
            return self
        rows = np.concatenate([self.log.rows, other.log.rows])
        return dataclasses.replace(self, log=dataclasses.replace(self.log, rows=rows))
