"""`ControlLog`: controls at times of their own, as the steps of a run get them.

The true controls are those of the log at its own times, held or interpolated. The controls of a
step are the mean of these over the step. The mean neither delays a row nor loses one, whatever the
step: the impulse of a motor is exact, and the rest of the sampling error falls as dt². (Controls
that are read at the beginning of a step come half a step late on average, so that their error
falls as dt and hides that of the integrator.) The error of a run at a coarse step includes the
sampling error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

# A row takes effect at the beginning of a step if it is this close to it, in steps: rounding of
# the times of a file.
ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class ControlLog:
    """Controls at times of their own.

    times: when each row takes effect, from 0 on [s], shape (n,).
    rows: the controls of all actuators, shape (n, nu).
    linear: whether the controls between two rows are interpolated; by default a row is held until
        the next. The last row stays to the end.
    """

    times: np.ndarray
    rows: np.ndarray
    linear: bool = False

    def steps(self, start: float, dt: float, count: int) -> np.ndarray:
        """Return the controls of `count` steps, shape (count, nu): the means over the steps.

        start: when the first step begins [s]. dt: the time step [s].
        """
        edges = start + dt * np.arange(count + 1)
        first, last = self._row(edges[:-1] + ROUNDING * dt), self._row(edges[1:] - ROUNDING * dt)
        values: np.ndarray = self._within(first, (edges[:-1] + edges[1:]) / 2)
        across = last > first
        if across.any():
            begin, end = edges[:-1][across], edges[1:][across]
            values[across] = (self._area(end) - self._area(begin)) / dt
        return values

    def slopes(self, start: float, dt: float, count: int) -> np.ndarray:
        """Return the derivatives of `steps` by `start`, as it falls, shape (count, nu)."""
        edges = start + dt * (np.arange(count + 1) - ROUNDING)
        slopes: np.ndarray = np.diff(self._within(self._row(edges), edges), axis=0) / dt
        return slopes

    def ends_on(self, period: float) -> bool:
        """Return whether rows are held from one end of a period to another [s]."""
        count = self.times / period
        return not self.linear and bool(np.all(np.abs(count - np.round(count)) <= ROUNDING))

    def _row(self, times: np.ndarray) -> np.ndarray:
        """Return the index of the row that is in effect."""
        return np.maximum(np.searchsorted(self.times, times, side="right") - 1, 0)

    @cached_property
    def _slopes(self) -> np.ndarray:
        """The derivative of the controls after each row by time, shape (n, nu)."""
        slopes = np.zeros_like(self.rows)
        if self.linear:
            slopes[:-1] = np.diff(self.rows, axis=0) / np.diff(self.times)[:, None]
        return slopes

    def _within(self, row: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return the controls at times at which the given rows are in effect."""
        if not self.linear:
            return self.rows[row]
        values: np.ndarray = self.rows[row] + self._slopes[row] * (times - self.times[row])[:, None]
        return values

    @cached_property
    def _before(self) -> np.ndarray:
        """The integral of the controls from 0 to each row, shape (n, nu)."""
        gaps = np.diff(self.times)[:, None]
        parts = self.rows[:-1] * gaps + self._slopes[:-1] * gaps**2 / 2
        return np.concatenate([np.zeros((1, self.rows.shape[1])), np.cumsum(parts, axis=0)])

    def _area(self, times: np.ndarray) -> np.ndarray:
        """Return the integrals of the controls from 0 to the times."""
        row = self._row(times)
        since = (times - self.times[row])[:, None]
        held = self._before[row] + self.rows[row] * since
        area: np.ndarray = held + self._slopes[row] * since**2 / 2
        return area


def changes(rows: np.ndarray) -> list[int]:
    """Return the indices of the steps at which the controls change, the first step included.

    >>> changes(np.array([[1.0], [1.0], [2.0]]))
    [0, 2]
    """
    rows = rows.reshape(len(rows), -1)
    return [0, *(1 + np.flatnonzero(np.any(rows[1:] != rows[:-1], axis=1))).tolist()]
