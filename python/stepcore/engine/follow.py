"""`follow`: the motions of a model from several starts, whole, under controls over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import process_time, thread_time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepcore import checks
from stepcore._core import SimulationError
from stepcore.engine.arrays import Floats, numbers
from stepcore.engine.batch import Batch
from stepcore.engine.batch import unwatched as unwatched_batch
from stepcore.engine.control import Control, ControlError, controls, finite_controls, fresh
from stepcore.engine.model import Model
from stepcore.engine.rollout import NAMES
from stepcore.engine.sim import Sim, unwatched
from stepcore.engine.start import Start
from stepcore.engine.trajectory import recordable
from stepcore.executors import checkpoint


@dataclass(frozen=True, eq=False)
class Followed:
    """Motions from several starts.

    times: of the samples [s], (n + 1,); the first is 0, the start.
    data: what was recorded, by name, (starts, n + 1, …); NaN after a run has ended.
    failures: why runs ended early, by the index of the start.
    made: steps that each start made, (starts,).
    inner: steps that these were made of, (starts,): more under a setting `accuracy`.
    operations: floating-point operations of each start, (starts,); NaN where they were not counted.
    seconds: processor time of the call [s].
    """

    times: Floats
    data: dict[str, Floats]
    failures: dict[int, SimulationError]
    made: np.ndarray
    inner: np.ndarray
    operations: Floats
    seconds: float

    def __getitem__(self, name: str) -> Floats:
        """Return what was recorded under a name; KeyError, with the nearest, if it was not."""
        if name not in self.data:
            raise KeyError(
                f"{checks.shown(name)} was not recorded{checks.nearest(name, self.data)}"
            )
        return self.data[name]


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
    bound: float = np.inf,
    threads: int = 1,
) -> Followed:
    """Run a model from several starts, and record the motions.

    The motions are those of `Sim.step` bit for bit, at any number of starts and threads. A run that
    fails ends, and the others go on. Energies are looked at only with the setting ``ledger``.

    model: with the settings of the runs.
    steps: how many, a multiple of `every`.
    every: steps from one sample to the next.
    ctrl: controls, of shape (starts, rows, nu), or (1, rows, nu) for all starts alike. Each row is
        held for `hold` steps, the last one to the end. None leaves the initial controls.
    control: a function of (time, sim) that returns the controls, called every `hold` steps with the
        Sim of each start. A callable object is copied for each start.
    record: names as in `Sim.run`, read at the start and at each sample.
    bound: a run ends where a body is further than this from its place at the start [m]; looked at
        at the samples.
    threads: threads that share the starts.

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
    run = _Run(model, starts, steps, every, ctrl, hold, control, record, bound)
    clock = thread_time if threads == 1 else process_time
    begun = clock()
    if control is not None or model.settings.accuracy is not None:
        for start in range(len(starts)):
            run.alone(start)
    else:
        run.together(checks.threads(threads))
    return run.followed(clock() - begun)


@dataclass
class _Run:
    """The arguments of `follow`, checked, and its result as it grows."""

    model: Model
    starts: Sequence[Start]
    steps: int
    every: int
    ctrl: Any
    hold: int
    control: Control | None
    record: Sequence[str]
    bound: float
    data: dict[str, Floats] = field(default_factory=dict)
    failures: dict[int, SimulationError] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not len(self.starts):
            raise ValueError("starts: must be at least one")
        self.steps = checks.count("steps", self.steps, 0)
        self.every, self.hold = checks.count("every", self.every), checks.count("hold", self.hold)
        if self.steps % self.every:
            raise ValueError(f"steps = {self.steps}: must be a multiple of every = {self.every}")
        if not self.bound > 0:
            raise ValueError(f"bound = {checks.shown(self.bound)}: must be a distance [m] > 0")
        if self.ctrl is not None and self.control is not None:
            raise ValueError("control: must be None where ctrl is given")
        self.names = recordable(self.record, NAMES)
        self.ctrl = None if self.ctrl is None else self.table()
        self.made = np.full(len(self.starts), self.steps)
        self.inner = self.made.copy()
        self.home: dict[int, Floats] = {}

    def table(self) -> Floats:
        table, n, nu = numbers("ctrl", self.ctrl), len(self.starts), self.model.nu
        if (
            table.ndim != 3
            or len(table) not in (1, n)
            or table.shape[2] != nu
            or not table.shape[1]
        ):
            limit = f"({n} or 1, rows, {nu}) with at least one row"
            raise ValueError(f"ctrl has shape {table.shape}: must be {limit}")
        finite = finite_controls(self.model, table)
        if not finite.all():
            where = tuple(int(k) for k in np.argwhere(~finite)[0])
            raise ValueError(f"ctrl{list(where)} = {table[where]}: must be finite")
        return table

    def rows(self, first: int, count: int) -> Floats:
        """Return the controls of some steps, (starts, count, nu)."""
        rows = np.minimum(np.arange(first, first + count) // self.hold, self.ctrl.shape[1] - 1)
        table = self.ctrl[:, rows]
        return np.broadcast_to(table, (len(self.starts), *table.shape[1:]))

    def keep(self, starts: Sequence[int], sample: int, sim: Any, axis: Any) -> None:
        """Record a sample of runs that go on, and end those that are beyond the bound."""
        for name in self.names:
            value = np.asarray(getattr(sim, name))[axis]
            if name not in self.data:
                shape = (len(self.starts), self.steps // self.every + 1, *value.shape[1:])
                self.data[name] = np.full(shape, np.nan)
            going = [k for k, start in enumerate(starts) if start not in self.failures]
            self.data[name][[starts[k] for k in going], sample] = value[going]
        if not np.isfinite(self.bound):
            return
        xpos = np.asarray(sim.xpos)[axis]
        for k, start in enumerate(starts):
            home = self.home.setdefault(start, xpos[k])
            far = float(np.linalg.norm(xpos[k] - home, axis=-1).max(initial=0.0))
            if far > self.bound:
                self.end(start, self.beyond(start, sample, far))

    def beyond(self, start: int, sample: int, far: float) -> SimulationError:
        step = sample * self.every
        time = step * self.model.settings.dt
        text = f"a body is {far:.3g} m from its place at the start at {time:.4g} s"
        error = SimulationError(f"{text}, which is beyond {self.bound:.3g} m")
        error.step, error.time, error.world, error.gained = step, time, start, False
        return error

    def end(self, start: int, error: SimulationError) -> None:
        if start not in self.failures:
            self.failures[start], self.made[start] = error, error.step
            self.inner[start] = error.step
            for values in self.data.values():
                values[start, error.step // self.every + 1 :] = np.nan

    def together(self, threads: int) -> None:
        """Run all starts as the worlds of a batch."""
        n = len(self.starts)
        batch = unwatched_batch(Batch(self.model, n, threads=threads, on_failure="go on"))
        for world, start in enumerate(self.starts):
            start.put(batch, world)
        everyone = range(n)
        self.keep(everyone, 0, batch, ...)
        for done in range(0, self.steps, self.every):
            checkpoint()
            if self.ctrl is None:
                batch.step(self.every, progress=False)
            else:
                batch.rollout(self.rows(done, self.every), progress=False)
            for world, error in batch.failures.items():
                self.end(world, error)
            if len(self.failures) == n:
                return
            self.keep(everyone, done // self.every + 1, batch, ...)

    def alone(self, start: int) -> None:
        """Run one start as a Sim."""
        sim = unwatched(Sim(self.model))
        self.starts[start].put(sim)
        self.keep([start], 0, sim, None)
        function = None if self.control is None else fresh(self.control)
        try:
            for done in range(self.steps):
                if done % self.every == 0:
                    checkpoint()
                if done % self.hold == 0:
                    if function is not None:
                        sim.ctrl = controls(function, sim)
                    elif self.ctrl is not None:
                        sim.ctrl[:] = self.rows(done, 1)[start, 0]
                sim.step()
                if (done + 1) % self.every == 0:
                    self.keep([start], (done + 1) // self.every, sim, None)
                if start in self.failures:
                    break
        except SimulationError as error:
            self.end(start, error)
        except ControlError:
            raise
        except ValueError as error:
            if sim.time == 0:
                raise
            said = SimulationError(checks.one_line(error))
            said.step, said.time = round(sim.time / self.model.settings.dt), sim.time
            said.world, said.gained = start, False
            self.end(start, said)
        if self.model.settings.accuracy is not None:
            self.inner[start] = sim._core.evaluations

    def followed(self, seconds: float) -> Followed:
        made = np.arange(0, self.steps + 1, self.every, dtype=np.float64)
        times = made * self.model.settings.dt
        operations = np.full(len(self.starts), np.nan)
        data = self.data
        return Followed(times, data, self.failures, self.made, self.inner, operations, seconds)
