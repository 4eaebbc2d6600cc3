"""`follow`: complete motions of a model from several starts, under controls over time."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time, thread_time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import _core, checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats, numbers
from stepcore.engine.control import (
    Control,
    ControlError,
    batch_controls,
    is_batched,
    new_control,
    not_finite,
)
from stepcore.engine.model import Model
from stepcore.engine.replay import attach
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.engine.trajectory import (
    OF_WORLDS,
    pieces,
    recordable,
    sample_request,
    sampled,
    samples,
)
from stepcore.executors import checkpoint

# The states of a run at which operations are counted.
COUNTED = 8
DEAR = "the accuracy takes more evaluations of the forces than the run may"
# The number of batches kept for a call with the same model, settings and number of starts: a search
# uses a few settings repeatedly. Ten steps of eight half_cheetahs take 54 µs with a kept batch, and
# 196 µs with a new one.
MOST_BATCHES = 4


@dataclass(frozen=True, eq=False)
class Followed:
    """Motions from several starts.

    times: times of the samples [s], (n + 1,); the first is 0, the start.
    data: recorded arrays by name, (starts, n + 1, …); NaN after a run has ended.
    failures: the errors of runs that ended early, by the index of the start.
    steps_made: the number of steps of each start, (starts,).
    inner: evaluations of the forces of adaptive steps, with the setting `accuracy`; else as
        `steps_made`; (starts,).
    counted: the operations, or a function that counts them.
    seconds: processor time of the call [s].
    """

    times: Floats
    data: dict[str, Floats]
    failures: dict[int, SimulationError]
    steps_made: np.ndarray
    inner: np.ndarray
    counted: Floats | Callable[[], Floats]
    seconds: float

    def __getitem__(self, name: str) -> Floats:
        """Return a recorded array; raise KeyError with the nearest name if there is none."""
        if name not in self.data:
            near = checks.nearest(name, self.data)
            raise KeyError(f"{checks.shown(name)} was not recorded{near}")
        return self.data[name]

    @functools.cached_property
    def operations(self) -> Floats:
        """Floating-point operations of each start, (starts,); NaN if they were not counted.

        They are counted at the first access: the run is repeated, and eight of its steps are
        counted by `Sim.count_flops`. The count of all steps was within 5 % of this estimate on four
        robots, and within 16 % on a walking Go2.
        """
        return self.counted() if callable(self.counted) else self.counted


def follow(
    model: Model,
    starts: Sequence[Start],
    steps: int,
    every: int = 1,
    *,
    ctrl: ArrayLike | None = None,
    hold: int = 1,
    control: Control | None = None,
    record: Sequence[str] = ("xpos", "xquat"),
    probe: Callable[[Sim], Floats] | None = None,
    bound: float = np.inf,
    most: float = np.inf,
    threads: int = 1,
) -> Followed:
    """Run a model from several starts, and record the motions.

    The motions are bit-identical to `Sim.step`, at any number of starts and threads. A run that
    fails ends, and the others go on. Energies are checked only with the setting ``ledger``.

    model: the model, with the settings of the runs.
    steps: the number of steps, a multiple of `every`.
    every: the number of steps from one sample to the next.
    ctrl: controls, of shape (starts, rows, nu), or (1, rows, nu) for all starts. Each row is held
        for `hold` steps, the last one to the end. None leaves the initial controls.
    control: a function of (time, sim) that returns the controls, called every `hold` steps with the
        Sim of each start. A callable object is copied for each start.
    record: names as in `Sim.run`, read at the start and at each sample.
    probe: a function of a Sim, read with them and recorded as "probe". Starts then run one by one.
    bound: the largest distance of a body from its position at the start [m]; a run ends at the
        first sample beyond it.
    most: the number of force evaluations at which an adaptive run ends. A run with a control
        function, or with quantities that the engine does not sample, ends after the step.
    threads: the number of threads that share the starts.

    Raises ValueError for arguments outside their limits, ControlError for a control function that
    fails under any settings, and OutOfTime at the deadline of this thread.

    >>> from stepcore import lesson
    >>> from stepcore.engine.start import Start
    >>> import numpy as np
    >>> starts = [Start(np.array([height]), np.zeros(1)) for height in (1.0, 2.0)]
    >>> run = follow(lesson.drop().compile(), starts, 100, 50, record=("qpos",))
    >>> run.times.tolist(), run["qpos"].shape
    ([0.0, 0.1, 0.2], (2, 3, 1))
    """
    run = _Run(model, starts, steps, every, ctrl, hold, control, record, probe, bound, most)
    threads = checks.threads(threads)
    clock = thread_time if threads == 1 else process_time
    begun = clock()
    checkpoint()
    free = probe is None and bool(run.steps)
    if control is None and free and sampled(run.names, model.settings):
        run.run_all(threads)
    elif is_batched(control) and free and model.settings.accuracy is None:
        run.together(threads)
    else:
        for start in range(len(starts)):
            run.alone(start)
    times = np.arange(0, run.steps + 1, run.every, dtype=np.float64) * model.settings.dt
    steps_done = run.steps_made, run.inner, run.operations
    return Followed(times, run.data, run.failures, *steps_done, clock() - begun)


def of_one_run(error: SimulationError) -> SimulationError:
    """Remove the world from the text of an error, where each world is a run on its own."""
    text, *more = error.args
    error.args = (text.replace(f" in world {error.world}.", ".", 1), *more)
    return error


class _Run:
    """The checked arguments of `follow`, and its partial result."""

    def __init__(
        self,
        model: Model,
        starts: Sequence[Start],
        steps: int,
        every: int,
        ctrl: ArrayLike | None,
        hold: int,
        control: Control | None,
        record: Sequence[str],
        probe: Callable[[Sim], Floats] | None,
        bound: float,
        most: float,
    ) -> None:
        if not len(starts):
            raise ValueError("starts: must be at least one")
        self.model, self.starts, self.control = model, starts, control
        self.bound, self.most, self.probe = bound, most, probe
        self.steps = checks.count("steps", steps, 0)
        self.every, self.hold = checks.count("every", every), checks.count("hold", hold)
        if self.steps % self.every:
            raise ValueError(f"steps = {self.steps}: must be a multiple of every = {self.every}")
        if not bound > 0:
            raise ValueError(f"bound = {checks.shown(bound)}: must be a distance [m] > 0")
        if ctrl is not None and control is not None:
            raise ValueError("control: must be None where ctrl is given")
        self.names = recordable(record, OF_WORLDS)
        self.ctrl = None if ctrl is None else self.table(ctrl)
        self.steps_made = np.full(len(starts), self.steps)
        self.inner = self.steps_made.copy()
        self.data: dict[str, Floats] = {}
        self.failures: dict[int, SimulationError] = {}
        # Positions of the bodies at the start of each run.
        self.home: dict[int, Floats] = {}

    def table(self, ctrl: ArrayLike) -> Floats:
        table, n, nu = numbers("ctrl", ctrl), len(self.starts), self.model.nu
        shape = table.shape if table.ndim == 3 else (0, 0, 0)
        if shape[0] not in (1, n) or not shape[1] or shape[2] != nu:
            limit = f"({n} or 1, rows, {nu}) with at least one row"
            raise ValueError(f"ctrl has shape {table.shape}: must be {limit}")
        if where := not_finite(self.model, table):
            raise ValueError(f"ctrl{list(where)} = {table[where]}: must be finite")
        return table

    def record(self, start: int, sample: int, sim: Sim) -> None:
        """Record a sample of a run, and end the run if a body is beyond the bound."""
        values = {name: np.asarray(getattr(sim, name)) for name in self.names}
        if self.probe is not None:
            values["probe"] = self.probe(sim)
        for name, value in values.items():
            if name not in self.data:
                shape = (len(self.starts), self.steps // self.every + 1, *value.shape)
                self.data[name] = np.full(shape, np.nan)
            self.data[name][start, sample] = value
        if np.isfinite(self.bound):
            home, step = self.home.setdefault(start, sim.xpos), sample * self.every
            far = float(np.linalg.norm(sim.xpos - home, axis=-1).max(initial=0.0))
            if far > self.bound:
                self._end_beyond(start, step, step * self.model.settings.dt, far)

    def _end_beyond(self, start: int, step: int, time: float, far: float) -> None:
        """End a run whose body is beyond the bound."""
        where = f"a body is {far:.4g} m from where it began, beyond the bound of"
        text = f"diverged in step {step} at time {time:.6f} s: {where} {self.bound:.4g} m."
        self.end(start, _failure(text, step, time, start))

    def end(self, start: int, error: SimulationError) -> None:
        if start not in self.failures:
            self.failures[start], self.steps_made[start] = error, error.step
            self.inner[start] = error.step
            for values in self.data.values():
                values[start, error.step // self.every + 1 :] = np.nan

    def run_all(self, threads: int) -> None:
        """Run all starts in one call of the engine."""
        key = (self.model.core, self.model.settings, len(self.starts), threads)
        kept = core, arrays, initial = _kept_batch(key)
        for name, values in initial.items():
            arrays[name][...] = values
        for world, start in enumerate(self.starts):
            start.write(arrays, world)
        inputs = {name: arrays[name].copy() for name in self.names if name in arrays}
        ends = {"bound": self.bound, "most": self.most}
        how = sample_request(self.names, self.steps, self.every, self.hold, first=True, **ends)
        samples, evaluations = core.follow(how, self.ctrl, lambda count: checkpoint())
        self.data = dict(zip(self.names, samples, strict=True))
        for name, values in inputs.items():
            # The given values, not rounded to single precision.
            self.data[name][:, 0] = values
            if name == "ctrl" and self.ctrl is None:
                self.data[name][:] = values[:, None]
        for error in core.failures([])[1]:
            world = error.world
            # The caller has starts, which are no worlds of a batch of its own.
            error.args = (str(error).replace(f" in world {world}", "", 1),)
            if "_start" in error.__dict__:
                attach(error, self.model, arrays["qpos"][world], arrays["qvel"][world])
            self.end(world, of_one_run(error))
        if self.model.settings.accuracy is not None:
            self.inner[:] = evaluations
        _keep_batch(key, kept)

    def together(self, threads: int) -> None:
        """Run all starts in a Batch, under a control function of many worlds."""
        # Imported here because batches use this module's parts.
        from stepcore.engine.batch import Batch

        count = len(self.starts)
        worlds: Any = Batch(self.model, count, threads=threads, on_failure="go on")
        worlds._core.unwatch()
        for world, start in enumerate(self.starts):
            start.put(worlds, world)
        control, done = new_control(self.control) if self.control else None, 0
        assert control is not None
        self.keep_all(0, worlds)
        while done < self.steps:
            checkpoint()
            if done % self.hold == 0:
                worlds.ctrl[:] = batch_controls(control, worlds)
            ends = (done // n * n + n for n in (self.hold, self.every))
            following = min(self.steps, *ends)
            worlds._call(worlds._core.step, following - done, None)
            done = following
            if done % self.every == 0:
                self.keep_all(done // self.every, worlds)
        for world, error in worlds.failures.items():
            self.end(world, of_one_run(error))
        for world, error in self.failures.items():
            # The other worlds went on, and with them the samples of runs that had ended.
            for values in self.data.values():
                values[world, error.step // self.every + 1 :] = np.nan

    def keep_all(self, sample: int, worlds: Any) -> None:
        """Record a sample of all runs, and end those with a body beyond the bound."""
        for name in self.names:
            value = np.asarray(getattr(worlds, name))
            if name not in self.data:
                shape = (len(value), self.steps // self.every + 1, *value.shape[1:])
                self.data[name] = np.full(shape, np.nan)
            self.data[name][:, sample] = value
        if np.isfinite(self.bound):
            home, step = self.home.setdefault(-1, worlds.xpos), sample * self.every
            far = np.linalg.norm(worlds.xpos - home, axis=-1).max(axis=1, initial=0.0)
            for start in np.flatnonzero(far > self.bound).tolist():
                self._end_beyond(start, step, step * self.model.settings.dt, float(far[start]))

    def alone(self, start: int) -> None:
        """Run one start in a Sim."""
        sim = unwatched(Sim(self.model))
        self.starts[start].put(sim)
        drive: Any = None if self.control is None else new_control(self.control)
        if self.ctrl is not None:
            drive = self.ctrl[start % len(self.ctrl)]
        try:
            for done in pieces(sim, self.steps, drive, self.hold, pauses=(self.every,)):
                checkpoint()
                if sim.settings.accuracy is not None and sim._core.evaluations > self.most:
                    self.end(start, _failure(DEAR, done, sim.time, start))
                    break
                if done % self.every == 0:
                    self.record(start, done // self.every, sim)
                if start in self.failures:
                    break
        except SimulationError as error:
            self.end(start, error)
        except ControlError:
            raise
        except ValueError as error:
            if sim.time == 0:
                raise
            step = round(sim.time / self.model.settings.dt)
            self.end(start, _failure(checks.one_line(error), step, sim.time, start))
        if self.model.settings.accuracy is not None:
            self.inner[start] = sim._core.evaluations

    def operations(self) -> Floats:
        """Estimate the operations of each start from a few of its steps."""
        operations = np.full(len(self.starts), np.nan)
        for start, completed in enumerate(self.steps_made.tolist() if self.control is None else ()):
            checkpoint()
            sim, counts, before = unwatched(Sim(self.model)), list[int](), 0
            self.starts[start].put(sim)
            table = None if self.ctrl is None else self.ctrl[start % len(self.ctrl)]
            middles = (np.arange(COUNTED) + 0.5) / COUNTED * completed
            for done in np.unique(middles.astype(int)).tolist() if completed else []:
                periods = np.arange(before, done + 1) // self.hold
                rows = None if table is None else table[np.minimum(periods, len(table) - 1)]
                samples(sim, (), done - before, None if rows is None else rows[None, :-1])
                if rows is not None:
                    sim.ctrl[:] = rows[-1]
                counts.append(sim.count_flops())
                before = done
            operations[start] = np.mean(counts) * completed if completed else 0.0
        return operations


def _failure(text: str, step: int, time: float, world: int) -> SimulationError:
    error = SimulationError(text)
    error.step, error.time, error.world, error.gained = step, time, world, False
    return error


# The key of a kept batch; and a core batch, its arrays, and their initial values.
_Key = tuple[_core.Model, Settings, int, int]
_Kept = tuple[_core.Batch, dict[str, Floats], dict[str, Floats]]
_batches: list[tuple[_Key, _Kept]] = []
_lock = threading.Lock()


def _kept_batch(key: _Key) -> _Kept:
    """Return a reset batch at time 0, for exclusive use until `_keep_batch`."""
    with _lock:
        for place, (other, kept) in enumerate(_batches):
            if other[0] is key[0] and other[1:] == key[1:]:
                del _batches[place]
                kept[0].restart(0.0)
                kept[0].forget(list(range(key[2])))
                return kept
    core = _core.Batch(*key[:2], key[2], key[3], None, True)
    core.unwatch()
    arrays = dict(core.arrays())
    return core, arrays, {name: array.copy() for name, array in arrays.items()}


def _keep_batch(key: _Key, kept: _Kept) -> None:
    with _lock:
        _batches.append((key, kept))
        del _batches[:-MOST_BATCHES]
