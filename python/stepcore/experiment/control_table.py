"""Controls over time, and the tables of users that they come from.

`ControlTable`: a user's controls in rows, from an array, a file, a DataFrame or a dict.
`PositionTable`: recorded positions of joints, which servos follow. `ControlLog`: controls at times
of their own. `Controls`: what drives a motion: rows or a function, and servos that obey the rows.

The true controls are those of a log at its own times, held or interpolated. The controls of a step
are the mean of these over the step. The mean neither delays a row nor loses one, whatever the step:
the impulse of a motor is exact, and the rest of the sampling error falls as dt². (Controls that are
read at the beginning of a step come half a step late on average, so that their error falls as dt
and hides that of the integrator.) The error of a run at a coarse step includes the sampling error.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.control import Control
from stepcore.engine.model import Model
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.change import Servo
from stepcore.experiment.user_table import MCAP, TIME, mcap_rows, numbers, read_table, times_of
from stepcore.report.units import seconds

# The longest time step that is tried by default, in shipped ones. A period that follows from a log
# has at least as many of the model's steps.
LONGEST = 4
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
        log = replace(self.log, rows=self.log.rows[list(starts)])
        return replace(self, log=log)

    def joined(self, other: Controls) -> Controls:
        """Return the controls with those of further starts after these."""
        if self.shared or self.log is None or other.log is None:
            return self
        rows = np.concatenate([self.log.rows, other.log.rows])
        return replace(self, log=replace(self.log, rows=rows))


@dataclass(frozen=True, eq=False)
class ControlTable:
    """Controls in rows.

    rows: shape (n, columns).
    columns: the actuator or joint of each column; None for all actuators in order.
    times: when each row takes effect [s], relative to the first; None for one row per control
        period.
    source: the origin of the rows, in words.
    path: the file of the rows; None for rows of Python.
    """

    rows: np.ndarray
    columns: tuple[str, ...] | None = None
    times: np.ndarray | None = None
    source: str = "ctrl"
    path: str | None = None

    def __post_init__(self) -> None:
        if not self.rows.size:
            raise ValueError(f"{self.source}: is empty; must hold a row of controls")
        if self.rows.ndim < 2:
            object.__setattr__(self, "rows", self.rows.reshape(-1, 1))
        bad = np.argwhere(~np.isfinite(self.rows)).tolist()
        if bad:
            place = [str(index) for index in bad[0]]
            if self.columns is not None:
                place[1] = self.columns[bad[0][1]]
            value = self.rows[tuple(bad[0])]
            raise ValueError(f"{self.source}[{', '.join(place)}] = {value}: must be finite")
        if self.times is not None and not (np.diff(self.times) > 0).all():
            raise ValueError(f"{self.source}: its times must be finite and increase")

    def __repr__(self) -> str:
        return self.source

    @property
    def changes(self) -> bool:
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
        return "FILE.npy" if self.changes else self._first(",")

    def _first(self, separator: str) -> str:
        values = [f"{value:g}" for value in self.rows[0]]
        if self.columns is not None:
            values = [f"{name}={value}" for name, value in zip(self.columns, values, strict=True)]
        return separator.join(values)

    @property
    def duration(self) -> float:
        """The time from the first row to the last [s]; 0 without times."""
        return 0.0 if self.times is None else float(self.times[-1] - self.times[0])

    @property
    def gap(self) -> float | None:
        """The time between two rows [s]; None without times, or if it varies by more than 0.1 %."""
        if self.times is None or len(self.times) < 2:
            return None
        gaps = np.diff(self.times)
        gap = float(self.times[-1] - self.times[0]) / len(gaps)
        # Loggers jitter, and seconds since 1970 are rounded to 0.2 µs.
        return gap if np.allclose(gaps, gap, rtol=1e-3, atol=1e-6) else None

    def period(self, dt: float) -> float | None:
        """Return the control period [s], or None if the rows do not determine one; dt: [s].

        Rows without times have a period of dt. Rows at equal times have a period in which all steps
        can end on their times: the spacing or a whole part of it, in at least `LONGEST` steps of
        dt, so that longer steps can be tried.
        Otherwise the rows follow their own times whatever the period; see `ControlLog`.
        """
        if self.times is None:
            return dt
        gap = self.gap
        if gap is None or abs(gap - round(gap / dt) * dt) > 1e-6 * dt:
            return None
        steps = round(gap / dt)
        parts = [steps // k for k in range(1, steps + 1) if steps % k == 0]
        return min((n for n in parts if n >= LONGEST), default=0) * dt or None

    def paced(self, period: str) -> str:
        """Return when rows take effect, in words; period: the control period in words."""
        if self.times is None or len(self.times) < 2:
            return f"a row {period}"
        gap = self.gap
        return "rows at their own times" if gap is None else f"a row every {seconds(gap)}"

    def log(
        self,
        model: Any,
        held: np.ndarray,
        period: float,
        linear: bool = False,
        sampled: bool = False,
    ) -> ControlLog:
        """Return the controls over time.

        model: a Model, or what names actuators and their joints as one does.
        held: the controls of actuators without a column, (nu,). period: of rows without times [s].
        linear: whether to interpolate the rows. sampled: whether rows that are held take effect at
        the beginning of a period.

        Raises ValueError for a table that does not match the model's actuators.
        """
        if self.times is None and linear and self.changes:
            raise ValueError(f"{self.source}: has no times to interpolate between")
        rows = self._complete(model, held)
        if self.times is None:
            return ControlLog(period * np.arange(len(rows)), rows)
        times = self.times - self.times[0]
        if sampled and not linear:
            # A row that is in effect for less than a period, from its beginning on, is not seen.
            periods = period * np.arange(math.floor(times[-1] / period) + 2)
            index = np.searchsorted(times, periods + 1e-6 * period, side="right") - 1
            return ControlLog(periods, rows[index])
        return ControlLog(times, rows, linear)

    def _whole(self, count: int, limit: str) -> np.ndarray:
        """Return rows without names of columns, of which there must be so many."""
        if self.rows.ndim != 2 or self.rows.shape[1] != count:
            shape = f"{self.source} has shape {self.rows.shape}"
            raise ValueError(f"{shape}: must be (n, {count}), {limit}")
        return self.rows

    def _complete(self, model: Any, held: np.ndarray) -> np.ndarray:
        """Return the rows with the controls of all actuators, shape (n, nu)."""
        if self.columns is None:
            return self._whole(model.nu, "one row a period")
        values = np.tile(held, (len(self.rows), 1))
        values[:, _actuators(self.source, self.columns, model)] = self.rows
        return values


@dataclass(frozen=True, eq=False)
class PositionTable(ControlTable):
    """Positions of hinges and slides in rows; see `ControlTable`.

    Servos get the controls with which they are without force in the recorded position. Motors get
    servos in their place, with the gains of the default motion "hold".
    """

    @classmethod
    def of(cls, source: Any) -> PositionTable:
        """Return the table of a user's argument `follow`; see `Motion`."""
        if isinstance(source, PositionTable):
            return source
        table = control_table(source, "qpos")
        return cls(**{field.name: getattr(table, field.name) for field in fields(table)})

    def period(self, dt: float) -> float | None:
        return None if self.times is not None else dt

    def begin(self, model: Model, qpos: np.ndarray) -> np.ndarray:
        """Return the pose of the first row; qpos: that of the keyframe."""
        return self.poses(model, qpos)[0]

    def poses(self, model: Model, qpos: np.ndarray) -> np.ndarray:
        """Return a pose for each row, shape (n, nq); qpos: of the joints without a column."""
        if self.columns is None:
            return self._whole(model.nq, "or have columns by joint")
        poses: np.ndarray = np.tile(np.array(qpos, float), (len(self.rows), 1))
        names = model.called("joint")
        for name, column in zip(self.columns, self.rows.T, strict=True):
            joint = name.partition(".")[0]
            # Joints with several coordinates, of a recorded run, are not followed.
            if name in names and model.jnt_type[names.index(name)] in ("hinge", "slide"):
                poses[:, model.jnt_qposadr[names.index(name)]] = column
            elif joint not in names:
                near = checks.nearest(name, names)
                raise ValueError(f"{self.source}: no joint is named {checks.quoted(name)}{near}")
        return poses


def control_table(ctrl: Any, array: str = "ctrl") -> ControlTable:
    """Return the table of a user's argument `ctrl`; see `Motion` for the accepted types.

    array: the argument, and the array that is read from a recorded run: "ctrl" or "qpos".

    Raises ValueError for any other argument, and OSError for a file that cannot be read.
    """
    if isinstance(ctrl, ControlTable):
        return ctrl
    path = os.fsdecode(ctrl) if isinstance(ctrl, (str, os.PathLike)) else None
    if path is not None and MCAP.fullmatch(path):
        times, rows, columns = mcap_rows(path, array)
        return ControlTable(rows, columns, times, os.path.basename(path), path)
    source, content = read_table(ctrl, array)
    if isinstance(content, np.ndarray):
        return ControlTable(content, source=source, path=path)
    if not isinstance(content, Trajectory):
        return replace(_of_columns(source, content, array), path=path)
    if array not in content.data:
        raise ValueError(f"{source}: this run recorded no {array}")
    return replace(_recorded(source, content[array], None, content.time, array), path=path)


def _recorded(
    source: str,
    rows: np.ndarray,
    columns: tuple[str, ...] | None,
    times: np.ndarray | None,
    array: str,
) -> ControlTable:
    """Return an array of a recorded run; an instant has the controls of the last step."""
    if array == "ctrl" and times is not None:
        rows, times = rows[1:], times[:-1]
    return ControlTable(rows, columns, times, source)


def _of_columns(source: str, content: Mapping[str, Any], array: str) -> ControlTable:
    """Return a table of named columns; a single number applies to all rows.

    Columns such as "ctrl[knee]" are of a run that `Trajectory.save` or `to_pandas` wrote.
    """
    if source.endswith(".npz") and array in content:
        rows = numbers(source, content[array])
        return ControlTable(rows, None, times_of(source, content.get("time"), len(rows)), source)
    columns = {
        str(name): np.ravel(numbers(f"{source}, column {name}", values))
        for name, values in content.items()
    }
    count = max(map(len, columns.values()), default=0)
    for name, values in columns.items():
        if len(values) not in (1, count):
            raise ValueError(f"{source}: column {checks.quoted(name)} has another length")
    clock = next((name for name in columns if TIME.fullmatch(name)), None)
    times = None if clock is None else np.broadcast_to(columns.pop(clock), count)
    own = re.compile(rf"{array}\[(.+)\]")
    recorded = {found[1]: columns[name] for name in columns if (found := own.fullmatch(name))}
    some = recorded if recorded and clock else columns
    rows = np.array([np.broadcast_to(values, count) for values in some.values()])
    rows = rows.reshape(len(some), count).T
    if some is recorded:
        return _recorded(source, rows, tuple(some), times, array)
    return ControlTable(rows, tuple(some), times, source)


def _actuators(source: str, columns: Sequence[str], model: Any) -> list[int]:
    """Return the index of the actuator of each column, by the name of the actuator or its joint."""
    by_joint: dict[str, list[int]] = {}
    for index, joint in enumerate(model.actuator_joint.tolist()):
        if joint >= 0 and model.joint_names[joint]:
            by_joint.setdefault(model.joint_names[joint], []).append(index)
    indices = []
    for name in columns:
        if name and name in model.called("actuator"):
            indices.append(model.called("actuator").index(name))
        elif len(by_joint.get(name, ())) == 1:
            indices += by_joint[name]
        elif name in by_joint:
            drives = ", ".join(model.called("actuator")[k] for k in by_joint[name])
            raise ValueError(f"{source}: several actuators drive joint {name}: {drives}")
        else:
            near = checks.nearest(name, dict.fromkeys([*model.actuator_names, *by_joint]))
            raise ValueError(f"{source}: no actuator is named {checks.quoted(name)}{near}")
        if indices[-1] in indices[:-1]:
            raise ValueError(f"{source}: {checks.quoted(name)} is controlled by two columns")
    return indices
