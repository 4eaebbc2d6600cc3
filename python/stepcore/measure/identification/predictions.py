"""`Predictions`: what a model says of logs under values of its parameters, and the derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stepcore.engine.arrays import STATE
from stepcore.engine.batch import Batch, unwatched
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.gradients import Steps, sensitivities
from stepcore.engine.model import Model
from stepcore.engine.parameters import own_value, split_entry
from stepcore.measure.identification.delays import DELAY, is_delay, late_entries
from stepcore.measure.identification.log import MEASURED, MeasuredLog, entries_of
from stepcore.measure.identification.sensors import Readings

# As many runs are kept.
KEPT = 3
# Arrays over the times of a log, each of shape (T, n).
Arrays = Mapping[str, np.ndarray]


class Quantity(NamedTuple):
    """A measured number over time. array, entry: its place. label: such as "qpos[knee]"."""

    array: str
    entry: int
    label: str


class Predictions:
    """Runs of a model over logs, under values x: those of the parameters, then what the first state
    of each log is off, a position and a velocity a dof.

    labels: the parameters, in this order. quantities: what was measured. steps: time steps made in
    all. linearised: of these, how many were linearised too.
    """

    def __init__(
        self,
        model: Model,
        logs: Sequence[MeasuredLog],
        labels: Sequence[str],
        scales: Mapping[str, float] | None = None,
    ) -> None:
        self.base, self.logs, self.labels = model, logs, tuple(labels)
        self.paths = [label for label in labels if not is_delay(label)]
        # By array and entry: the numbers of the parameters by which its rows are late.
        self.late: dict[tuple[str, int], tuple[int, ...]] = {}
        for k, label in enumerate(labels):
            if is_delay(label) and label != DELAY:
                array, entries = late_entries(model, label)
                for entry in entries:
                    self.late[array, entry] = (*self.late.get((array, entry), ()), k)
        self.free = 2 * model.nv * len(logs)
        self.steps = self.linearised = 0
        self.quantities = _quantities(model, logs)
        self.scales = _scales(logs, self.quantities) if scales is None else scales
        self._kept: dict[bytes, tuple[list[Steps], list[dict[str, np.ndarray]]]] = {}
        self._slopes: tuple[bytes, list[np.ndarray]] | None = None

    def until(self, share: float) -> Predictions:
        """Return the predictions of the beginning of each log, in the same units."""
        logs = [log.until(share * log.duration) for log in self.logs]
        return Predictions(self.base, logs, self.labels, self.scales)

    def model(self, x: np.ndarray) -> Model:
        """Return the model with these values of the parameters."""
        changed: dict[str, Any] = {}
        for label, value in zip(self.labels, x, strict=False):
            if not is_delay(label):
                path, entry = split_entry(label)
                own = changed.setdefault(path, own_value(self.base, path))
                own[() if entry is None else entry] = value
        return self.base.with_values({path: value.tolist() for path, value in changed.items()})

    def delay(self, x: np.ndarray) -> float:
        """Return the delay of controls [s]."""
        return float(x[self.labels.index(DELAY)]) if DELAY in self.labels else 0.0

    def _run(self, model: Model, x: np.ndarray, nth: int) -> Steps:
        """Run a log under a model with these values."""
        log, nv, dt = self.logs[nth], model.nv, model.settings.dt
        batch = unwatched(Batch(model, 1, threads=1))
        off = x[len(self.labels) :].reshape(-1, 2, nv)[nth]
        batch.qpos = Coordinates(model).nudged(log.start[0], off[0])
        batch.qvel = log.start[1] + off[1]
        ctrl = log.ctrl(dt, log.steps(dt), self.delay(x))[None]
        self.steps += ctrl.shape[1]
        return Steps(batch, ctrl, self.paths).roll()

    def _all(self, x: np.ndarray) -> tuple[list[Steps], list[dict[str, np.ndarray]]]:
        """Return the runs of all logs with the predictions of them; the last few are kept."""
        key = x.tobytes()
        if key not in self._kept:
            model = self.model(x)
            runs = [self._run(model, x, nth) for nth in range(len(self.logs))]
            self._kept[key] = runs, self._of_runs(x, runs)
            for old in list(self._kept)[:-KEPT]:
                del self._kept[old]
        return self._kept[key]

    def _of_runs(self, x: np.ndarray, runs: Sequence[Steps]) -> list[dict[str, np.ndarray]]:
        """Return the predicted arrays at the times of each log."""
        made = []
        for steps, log in zip(runs, self.logs, strict=True):
            arrays = {key: np.empty_like(series.values) for key, series in log.measured.items()}
            for key, rows in arrays.items():
                for between, entries, _ in self._parts(x, steps, log, key):
                    near = self._rows(x, steps, log, key, between)
                    rows[:, entries] = between(near)[:, entries]
            made.append(arrays)
        return made

    def _parts(
        self, x: np.ndarray, steps: Steps, log: MeasuredLog, key: str
    ) -> list[tuple[_Between, list[int], tuple[int, ...]]]:
        """Return where an array's rows are in a run: entries that are alike late, and by what."""
        times, values = log.measured[key]
        groups: dict[tuple[int, ...], list[int]] = {}
        for entry in range(values.shape[1]):
            groups.setdefault(self.late.get((key, entry), ()), []).append(entry)
        return [
            (_Between(steps, times - sum(x[k] for k in late), bool(late)), entries, late)
            for late, entries in groups.items()
        ]

    def _rows(
        self, x: np.ndarray, steps: Steps, log: MeasuredLog, key: str, between: _Between
    ) -> np.ndarray:
        """Return an array of the states near."""
        if key != "sensordata":
            return between.rows(steps, key)
        states = between.states(steps, self._ctrl(x, steps, log))
        return Readings(steps.models[0], ()).at(states)

    def _ctrl(self, x: np.ndarray, steps: Steps, log: MeasuredLog) -> np.ndarray:
        """Return the controls of the steps and of one more, which sensors at the end read."""
        return log.ctrl(steps.models[0].settings.dt, steps.count + 1, self.delay(x))

    def predicted(self, x: np.ndarray, finer: int = 1) -> list[dict[str, np.ndarray]]:
        """Return the predictions of each log by array; finer: by so many steps for one."""
        if finer == 1:
            return self._all(x)[1]
        model = self.model(x)
        short = model.with_settings(dt=model.settings.dt / finer)
        return self._of_runs(x, [self._run(short, x, nth) for nth in range(len(self.logs))])

    @property
    def measured(self) -> list[Arrays]:
        """What was measured, in arrays as those of the predictions."""
        return [{key: s.values for key, s in log.measured.items()} for log in self.logs]

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Return prediction less measurement of all that was measured, in units of the scales."""
        return self.residual_of(self.predicted(x))

    def residual_of(self, predicted: Sequence[Arrays]) -> np.ndarray:
        """Return the residual of predictions."""
        parts = []
        for log, made in zip(self.logs, predicted, strict=True):
            for quantity, known in _measured(log, self.quantities):
                off = made[quantity.array] - log.measured[quantity.array].values
                parts.append(off[known, quantity.entry] / self.scales[quantity.label])
        return np.concatenate(parts)

    def kinds(self) -> np.ndarray:
        """Return the number of the quantity of each residual."""
        number = {quantity.label: k for k, quantity in enumerate(self.quantities)}
        parts = [
            np.full(int(known.sum()), number[quantity.label])
            for log in self.logs
            for quantity, known in _measured(log, self.quantities)
        ]
        return np.concatenate(parts)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivative of the residuals by x."""
        parts, runs = [], self._all(x)[0]
        count, nv = len(self.labels), self.base.nv
        for nth, (log, slopes) in enumerate(zip(self.logs, self.sensitivities(x), strict=True)):
            steps, place = runs[nth], count + 2 * nv * nth
            moved = {key: self._moved(x, nth, steps, slopes, key) for key in log.measured}
            for quantity, known in _measured(log, self.quantities):
                own = moved[quantity.array][known, quantity.entry] / self.scales[quantity.label]
                rows = np.zeros((len(own), count + self.free))
                rows[:, :count], rows[:, place : place + 2 * nv] = own[:, :count], own[:, count:]
                parts.append(rows)
        return np.concatenate(parts)

    def slopes(self, x: np.ndarray, nth: int, steps: Steps) -> np.ndarray:
        """Return the derivatives of a log's states by the parameters and its first state.

        Shape (steps + 1, size of x, parameters + 2 nv).
        """
        late, nv, first = int(DELAY in self.labels), self.base.nv, len(self.labels)
        self.steps += steps.count
        self.linearised += steps.count
        found = sensitivities(steps, 0, self._pushes(x, nth)[:-1, :, None][..., :late])
        own = len(self.paths) + late
        slopes = np.zeros((*found.shape[:2], first + 2 * nv))
        slopes[..., first:] = found[..., own : own + 2 * nv]
        for k, label in enumerate(self.labels):
            if label in self.paths:
                slopes[..., k] = found[..., self.paths.index(label)]
            elif label == DELAY:
                slopes[..., k] = found[..., len(self.paths)]
        # What the first position is off turns a quaternion from that of the log on, not from where
        # it has come to.
        turns, off = steps.tangents, x[first:].reshape(-1, 2, nv)[nth, 0]
        start = np.tile(self.logs[nth].start[0], (nv, 1))
        here = start + turns.of_dofs(start, np.tile(off, (nv, 1)))
        turned = turns.changed(here, turns.of_dofs(start, np.eye(nv)))
        slopes[..., first : first + nv] = slopes[..., first : first + nv] @ turned.T
        return slopes

    def _pushes(self, x: np.ndarray, nth: int) -> np.ndarray:
        """Return the derivatives of a log's controls by the delay, shape (steps + 1, nu)."""
        log, dt = self.logs[nth], self.base.settings.dt
        return log.ctrl_slopes(dt, log.steps(dt) + 1, self.delay(x))

    def _moved(
        self, x: np.ndarray, nth: int, steps: Steps, slopes: np.ndarray, key: str
    ) -> np.ndarray:
        """Return the derivatives of an array at a log's times, (T, entries, parameters + 2 nv).

        slopes: those of the states.
        """
        log = self.logs[nth]
        whole = np.zeros((*log.measured[key].values.shape, slopes.shape[2]))
        for between, entries, late in self._parts(x, steps, log, key):
            near = self._moved_near(x, nth, steps, slopes, key, between)
            whole[:, entries] = between(near)[:, entries]
            if late:
                rates = between.rates(self._rows(x, steps, log, key, between))
            for k in late:
                whole[:, entries, k] -= rates[:, entries]
        return whole

    def _moved_near(
        self,
        x: np.ndarray,
        nth: int,
        steps: Steps,
        slopes: np.ndarray,
        key: str,
        between: _Between,
    ) -> np.ndarray:
        """Return the derivatives of an array of the states near."""
        near, nv = slopes[between.near], self.base.nv
        if key == "qvel":
            return near[:, nv : 2 * nv]
        if key == "qpos":
            qpos = between.rows(steps, "qpos")
            ways = np.moveaxis(near[:, :nv], -1, 0)
            return np.stack([steps.tangents.of_dofs(qpos, way) for way in ways], axis=-1)
        readings, pushes = Readings(steps.models[0], self.paths), self._pushes(x, nth)
        ctrl = self._ctrl(x, steps, self.logs[nth])
        by_x, by_values, by_push = readings.slopes(
            between.states(steps, ctrl), pushes[between.near]
        )
        # Sensors do not read past controls.
        whole: np.ndarray = by_x @ near[:, : by_x.shape[2]]
        for k, label in enumerate(self.labels):
            if label in self.paths:
                whole[..., k] += by_values[..., self.paths.index(label)]
            elif label == DELAY:
                whole[..., k] += by_push
        return whole

    def rms(self, first: Sequence[Arrays], second: Sequence[Arrays]) -> dict[str, float]:
        """Return the RMS difference of each quantity in two sets of arrays of all logs."""
        out = {}
        for key, entry, label in self.quantities:
            pairs = [(a[key], b[key]) for a, b in zip(first, second, strict=True) if key in a]
            every = np.concatenate([(b - a)[:, entry] for a, b in pairs])
            out[label] = float(np.sqrt(np.nanmean(every**2)))
        return out

    def sensitivities(self, x: np.ndarray) -> list[np.ndarray]:
        """Return the derivatives of the states of each log; those of the last Jacobian are kept."""
        runs = self._all(x)[0]
        if self._slopes is None or self._slopes[0] != x.tobytes():
            made = [self.slopes(x, nth, steps) for nth, steps in enumerate(runs)]
            self._slopes = x.tobytes(), made
        return self._slopes[1]


class _Between:
    """Linear interpolation between the states of a run, of which only the near ones are needed.

    late: the times move with a parameter, so that they are between states everywhere.
    """

    def __init__(self, steps: Steps, times: np.ndarray, late: bool = False) -> None:
        self.dt = steps.models[0].settings.dt
        grid = np.arange(steps.count + 1) * self.dt
        before = np.clip(np.searchsorted(grid, times, "right") - 1, 0, steps.count - 1)
        share = (times - grid[before]) / (grid[before + 1] - grid[before])
        self.within = (share >= 0) & (share <= 1)
        share = np.clip(share, 0.0, 1.0)
        if not late:
            share[np.abs(share) < 1e-9] = 0.0
            share[np.abs(share - 1) < 1e-9] = 1.0
        first = before + (0 if late else share == 1)
        second = before + (1 if late else share > 0)
        self.near, places = np.unique([first, second], return_inverse=True)
        self.before, self.after = places.reshape(2, -1)
        self.share = np.where(first == second, 0.0, share)

    def rates(self, rows: np.ndarray) -> np.ndarray:
        """Return how what is between rows of the states near changes by time [1/s]."""
        rates = (rows[self.after] - rows[self.before]) / self.dt
        return np.where(self.within[:, None], rates, 0.0)

    def rows(self, steps: Steps, key: str) -> np.ndarray:
        """Return an array of the states near."""
        found: np.ndarray = steps.states[key][0, self.near]
        return found

    def states(self, steps: Steps, ctrl: np.ndarray) -> dict[str, np.ndarray]:
        """Return the states near, with their controls of these, shape (steps + 1, nu)."""
        states = {key: self.rows(steps, key) for key in STATE}
        return states | {"ctrl": ctrl[self.near]}

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Return what is between rows of the states near."""
        share = self.share.reshape(-1, *[1] * (rows.ndim - 1))
        found: np.ndarray = rows[self.before] + share * (rows[self.after] - rows[self.before])
        return found


def _quantities(model: Model, logs: Sequence[MeasuredLog]) -> list[Quantity]:
    found = []
    for key in MEASURED:
        tables = [log.measured[key].values for log in logs if key in log.measured]
        for entry in range(tables[0].shape[1] if tables else 0):
            if any(np.isfinite(table[:, entry]).any() for table in tables):
                name = entries_of(model, key, tables[0].shape[1])[entry]
                found.append(Quantity(key, entry, f"{key}[{name}]"))
    return found


def _measured(
    log: MeasuredLog, quantities: Sequence[Quantity]
) -> list[tuple[Quantity, np.ndarray]]:
    """Return the quantities of a log, with the rows in which they were measured."""
    own = [quantity for quantity in quantities if quantity.array in log.measured]
    return [(q, np.isfinite(log.measured[q.array].values[:, q.entry])) for q in own]


def _scales(logs: Sequence[MeasuredLog], quantities: Sequence[Quantity]) -> dict[str, float]:
    """Return the unit of each quantity: how much it moves; of positions the one that moves most."""
    spread = {}
    for quantity in quantities:
        tables = [log.measured[quantity.array] for log in logs if quantity.array in log.measured]
        columns = [table.values[:, quantity.entry] for table in tables]
        known = [column[np.isfinite(column)] for column in columns]
        spread[quantity.label] = max(float(np.std(column)) for column in known if len(column))
    scales = {}
    for quantity in quantities:
        alike = [q.label for q in quantities if q.array == quantity.array]
        own = [quantity.label] if quantity.array == "sensordata" else alike
        scales[quantity.label] = max(spread[label] for label in own) or 1.0
    return scales
