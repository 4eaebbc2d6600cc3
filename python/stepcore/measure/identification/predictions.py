"""`Predictions`: a model's predictions of logs for values of its parameters, and derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.arrays import STATE, Floats
from stepcore.engine.batch import Batch, unwatched
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.gradients import Steps, sensitivities
from stepcore.engine.model import Model
from stepcore.engine.parameters import columns, own_value, split_entry
from stepcore.executors import checkpoint
from stepcore.experiment.change import Change
from stepcore.measure.identification.log import (
    DELAY,
    MEASURED,
    MeasuredLog,
    entries_of,
    is_delay,
    late_entries,
)
from stepcore.measure.identification.readings import Readings


class Part(NamedTuple):
    """A measured number of a log over time.

    log: its index. array, entry: the quantity. label: such as "qpos[knee]". times: of the rows [s].
    values: NaN where it was not measured. late: the indices of the parameters that delay it.
    """

    log: int
    array: str
    entry: int
    label: str
    times: np.ndarray
    values: np.ndarray
    late: tuple[int, ...]


class Predictions:
    """Runs of a model over logs for values x: the parameters, then the correction of each log's
    first state, a position and a velocity per dof.

    labels: the parameters, in this order. parts: the measured quantities. measured: all measured
    numbers, part after part, as in predictions; known: which of them are not NaN. kinds: the index
    in `quantities` of each. threads: for the linearisation. steps: the number of time steps.
    linearised: the number of these that were also linearised.
    """

    def __init__(
        self,
        model: Model,
        logs: Sequence[MeasuredLog],
        labels: Sequence[str],
        scales: Mapping[str, float] | None = None,
        threads: int = 1,
    ) -> None:
        self.threads = threads
        self.base, self.logs, self.labels = model, logs, tuple(labels)
        self.paths = [label for label in labels if not is_delay(label)]
        self.free = 2 * model.nv * len(logs)
        self.steps = self.linearised = 0
        self.parts = _parts(model, logs, labels)
        self.quantities = list(dict.fromkeys(part.label for part in self.parts))
        self.scales = _scales(self.parts) if scales is None else scales
        counts = [len(part.times) for part in self.parts]
        kinds = [self.quantities.index(part.label) for part in self.parts]
        self.kinds = np.repeat(kinds, counts)
        self.measured = np.concatenate([part.values for part in self.parts])
        self.known = np.isfinite(self.measured)
        self._units = np.repeat([self.scales[part.label] for part in self.parts], counts)
        # Keep the first run, and the last one, to which the method returns from a refused step.
        self._runs = lru_cache(3)(lambda key: self._made(np.frombuffer(key)))

    def until(self, share: float) -> Predictions:
        """Return the predictions of the beginning of each log, in the same units."""
        logs = [log.between(0.0, share * log.duration) for log in self.logs]
        return Predictions(self.base, logs, self.labels, self.scales, self.threads)

    def model(self, x: np.ndarray) -> Model:
        """Return the model with these values of the parameters."""
        changed: dict[str, Any] = {}
        for label, value in zip(self.labels, x, strict=False):
            if not is_delay(label):
                path, entry = split_entry(label)
                entries = changed.setdefault(path, own_value(self.base, path))
                entries[() if entry is None else entry] = value
        return Change({path: value.tolist() for path, value in changed.items()}).of(self.base)

    def runs(self, x: np.ndarray) -> list[Run]:
        """Return the runs of all logs; the last ones are cached."""
        return self._runs(np.asarray(x, float).tobytes())

    def _made(self, x: np.ndarray, finer: int = 1) -> list[Run]:
        model = self.model(x)
        short = Change(dt=model.settings.dt / finer).of(model)
        # The batches, one per log, use copies of the model that share these models.
        _ = short.around
        runs = []
        for nth in range(len(self.logs)):
            checkpoint()
            runs.append(Run(self, short, x, nth))
        return runs

    def predicted(self, x: np.ndarray, finer: int = 1) -> np.ndarray:
        """Return the predictions of all parts. finer: the number of steps that replace one."""
        runs = self.runs(x) if finer == 1 else self._made(x, finer)
        return np.concatenate([runs[part.log].predictions(part) for part in self.parts])

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Return prediction minus measurement for all measured numbers, in units of the scales."""
        return self.residual_of(self.predicted(x))

    def residual_of(self, predicted: np.ndarray) -> np.ndarray:
        """Return the residual of predictions."""
        return ((predicted - self.measured) / self._units)[self.known]

    def in_units(self, sizes: Sequence[float]) -> np.ndarray:
        """Convert sizes of the quantities, in their units, to sizes of all residuals."""
        scaled: np.ndarray = (np.asarray(sizes)[self.kinds] / self._units)[self.known]
        return scaled

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivative of the residuals with respect to x."""
        runs, count, nv, parts = self.runs(x), len(self.labels), self.base.nv, []
        for part in self.parts:
            slopes, place = runs[part.log].derivatives(part), count + 2 * nv * part.log
            rows = np.zeros((len(slopes), count + self.free))
            rows[:, :count], rows[:, place : place + 2 * nv] = slopes[:, :count], slopes[:, count:]
            parts.append(rows)
        scaled: np.ndarray = (np.concatenate(parts) / self._units[:, None])[self.known]
        return scaled

    def rms(self, first: np.ndarray, second: np.ndarray) -> dict[str, float]:
        """Return the RMS difference of each quantity in two predictions at measured rows."""
        squares = np.where(self.known, (second - first) ** 2, 0.0)
        means = np.bincount(self.kinds, squares) / np.bincount(self.kinds, self.known)
        return dict(zip(self.quantities, np.sqrt(means).tolist(), strict=True))


class Run:
    """The run of a log for values x of its `Predictions`, and its derivatives.

    Derivatives are with respect to the parameters and this log's first state: parameters + 2 nv.
    """

    def __init__(self, fit: Predictions, model: Model, x: np.ndarray, nth: int) -> None:
        self.fit, self.x, self.log, self.model = fit, x, fit.logs[nth], model
        self.dt, nv = model.settings.dt, model.nv
        # The corrections of the first position and velocity.
        self.off = x[len(fit.labels) :].reshape(-1, 2, nv)[nth]
        self.delay = float(x[fit.labels.index(DELAY)]) if DELAY in fit.labels else 0.0
        batch = unwatched(Batch(model, 1, threads=fit.threads))
        batch.qpos = Coordinates(model).nudged(self.log.start[0], self.off[0])
        batch.qvel = self.log.start[1] + self.off[1]
        count = self.log.steps(self.dt)
        # The controls of one more step, which sensors at the end read.
        self.ctrl = self.log.controls.steps(-self.delay, self.dt, count + 1)
        steps = Steps(batch, self.ctrl[None, :-1], fit.paths)
        # A long log ends at the deadline too.
        self.steps = steps.roll(lambda *_: checkpoint())
        fit.steps += count

    @cached_property
    def _pushes(self) -> Floats:
        """The derivatives of the controls, which the delay shifts; (steps + 1, nu, size)."""
        labels = self.fit.labels
        pushes = np.zeros((*self.ctrl.shape, len(labels) + 2 * self.model.nv))
        if DELAY in labels:
            slopes = self.log.controls.slopes(-self.delay, self.dt, len(self.ctrl))
            pushes[..., labels.index(DELAY)] = -slopes
        return pushes

    @cached_property
    def slopes(self) -> Floats:
        """The derivatives of the states, shape (steps + 1, size of x, parameters + 2 nv)."""
        fit, steps, nv = self.fit, self.steps, self.model.nv
        fit.steps += steps.count
        fit.linearised += steps.count
        count, late = len(fit.labels), [k for k, name in enumerate(fit.labels) if name == DELAY]
        tangents = sensitivities(steps, 0, self._pushes[:-1][..., late])
        places = [*map(fit.labels.index, fit.paths), *late]
        slopes = np.zeros((*tangents.shape[:2], count + 2 * nv))
        slopes[..., places] = tangents[..., : len(places)]
        slopes[..., count:] = tangents[..., len(places) : len(places) + 2 * nv]
        # The correction of the first position turns a quaternion from its value in the log, not
        # from the corrected one.
        turns, start = steps.tangents, np.tile(self.log.start[0], (nv, 1))
        here = start + turns.of_dofs(start, np.tile(self.off[0], (nv, 1)))
        turned = turns.changed(here, turns.of_dofs(start, np.eye(nv)))
        slopes[..., count : count + nv] = slopes[..., count : count + nv] @ turned.T
        return slopes

    def _between(self, part: Part) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the states before and after each row of a part, and the row's place between them.

        A row at a state needs only that state, if no parameter shifts it.
        """
        times, late = (part.times - sum(self.x[k] for k in part.late)) / self.dt, bool(part.late)
        before = np.clip(np.floor(times + 1e-9).astype(int), 0, self.steps.count - late)
        share = times - before
        after = before + (late | (share > 1e-9))
        return before, np.minimum(after, self.steps.count), share

    def _interpolated(self, rows: np.ndarray, part: Part) -> np.ndarray:
        """Interpolate values at the states to the rows of a part."""
        before, after, share = self._between(part)
        share = np.clip(share, 0.0, 1.0).reshape(-1, *[1] * (rows.ndim - 1))
        values: np.ndarray = rows[before] + share * (rows[after] - rows[before])
        return values

    def predictions(self, part: Part) -> np.ndarray:
        """Return the predictions of a part, shape (T,)."""
        return self._interpolated(self._table(part.array)[:, part.entry], part)

    def derivatives(self, part: Part) -> np.ndarray:
        """Return the derivatives of the predictions of a part, shape (T, parameters + 2 nv)."""
        slopes = self._interpolated(self._moved(part.array)[:, part.entry], part)
        if part.late:
            (before, after, share), rows = self._between(part), self._table(part.array)
            rates = (rows[after] - rows[before])[:, part.entry] / self.dt
            slopes[:, part.late] -= np.where((share >= 0) & (share <= 1), rates, 0.0)[:, None]
        return slopes

    def _table(self, array: str) -> Floats:
        return self._sensed if array == "sensordata" else self.steps.states[array][0]

    def _moved(self, array: str) -> Floats:
        """Return the derivatives of an array at the states of the run."""
        nv = self.model.nv
        if array == "qvel":
            return self.slopes[:, nv : 2 * nv]
        return self._moved_qpos if array == "qpos" else self._moved_sensed

    @cached_property
    def _moved_qpos(self) -> Floats:
        ways = np.moveaxis(self.slopes[:, : self.model.nv], -1, 0)
        qpos = self.steps.states["qpos"][0]
        return np.stack([self.steps.tangents.of_dofs(qpos, way) for way in ways], axis=-1)

    @cached_property
    def _near(self) -> np.ndarray:
        """The states next to the times at which sensors were read."""
        parts = [part for part in self.fit.parts if self.fit.logs[part.log] is self.log]
        sensed = [self._between(part)[:2] for part in parts if part.array == "sensordata"]
        return np.unique(np.concatenate([np.concatenate(each) for each in sensed]))

    @cached_property
    def _readings(self) -> Readings:
        states = {name: self.steps.states[name][0, self._near] for name in STATE}
        return Readings(self.model, states | {"ctrl": self.ctrl[self._near]})

    @cached_property
    def _sensed(self) -> Floats:
        """The sensors' readings at the states in `_near`; NaN elsewhere."""
        values = self._readings.values()
        table = np.full((self.steps.count + 1, values.shape[1]), np.nan)
        table[self._near] = values
        return table

    @cached_property
    def _moved_sensed(self) -> Floats:
        labels, near = self.fit.labels, self._near
        by = [None if is_delay(label) else columns(self.model, [label])[0] for label in labels]
        # Sensors do not depend on past controls.
        ways = self.slopes[near, : 2 * self.model.nv + self.model.na]
        slopes = self._readings.slopes(ways, self._pushes[near], [*by, *[None] * 2 * self.model.nv])
        table = np.full((self.steps.count + 1, *slopes.shape[1:]), np.nan)
        table[near] = slopes
        return table


def _parts(model: Model, logs: Sequence[MeasuredLog], labels: Sequence[str]) -> list[Part]:
    """Return the measured quantities, log by log."""
    late: dict[tuple[str, int], tuple[int, ...]] = {}
    for k, label in enumerate(labels):
        if is_delay(label) and label != DELAY:
            array, entries = late_entries(model, label)
            for entry in entries:
                late[array, entry] = (*late.get((array, entry), ()), k)
    return [
        Part(nth, array, k, f"{array}[{name}]", times, values[:, k], late.get((array, k), ()))
        for nth, log in enumerate(logs)
        for array in MEASURED
        if array in log.measured
        for times, values in [log.measured[array]]
        for k, name in enumerate(entries_of(model, array, values.shape[1]))
        if np.isfinite(values[:, k]).any()
    ]


def _scales(parts: Sequence[Part]) -> dict[str, float]:
    """Return the unit of each quantity: the standard deviation, for qpos and qvel the largest."""
    spread: dict[str, float] = {}
    group = {part.label: part.label if part.array == "sensordata" else part.array for part in parts}
    for part in parts:
        key = group[part.label]
        spread[key] = max(spread.get(key, 0.0), float(np.nanstd(part.values)))
    return {label: spread[key] or 1.0 for label, key in group.items()}
