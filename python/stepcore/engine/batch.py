"""`Batch`: many worlds of one model, stepped together in vector lanes and threads."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import _core, checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats, indices_of, numbers, snapshot
from stepcore.engine.parameters import Parameters
from stepcore.engine.rollout import NAMES, Rollout, recorded_rollout
from stepcore.engine.sim import Momentum
from stepcore.engine.tables import contact_table, contacts_of_body, row_table
from stepcore.engine.trajectory import recordable
from stepcore.engine.unsolved import BatchResiduals, UnsolvedWarning
from stepcore.engine.world import World, compiled
from stepcore.signatures import refuse_unknown, takes_settings

if TYPE_CHECKING:
    import os
    from typing import Unpack

    from stepcore.engine.model import Model
    from stepcore.report.progress import Choice
    from stepcore.scene.scene import Scene
    from stepcore.signatures import SettingsFields


# A batch of fewer worlds × dofs than this is stepped faster by one thread than by several, because
# waking a thread takes some 20 µs a step (measured: 64 worlds of a half cheetah lose 25 %, 512 gain
# 40 % on two cores).
WORTH_THREADS = 2000

# What happens to the other worlds when one fails.
ON_FAILURE = ("stop", "go on")


class Batch(World):
    """Simulates many worlds of a model. Its arrays are those of a `Sim` with a leading world axis.

    An array whose documentation says shape (nq,) has shape (n, nq) here, and so on.

    model: a `Model`, a `Scene`, which is compiled, or what `stepcore.load` takes, such as the path
        of an MJCF file.
    n: the number of worlds.
    settings: a `Settings` that replaces the model's own.
    threads: how many threads step them; by default one a core, or one in all for a batch so small
        that waking threads costs more than it gains.
    lanes: True steps eight worlds at a time in the processor's vector registers, sixteen in
        single precision, False one by one. "auto" does what takes less time: now and then, and
        ever more rarely, it takes a step the other way and times it. Where worlds touch different
        things, a register does the work of all of them, so walkers in contact may be quicker one by
        one.
    on_failure: what happens if a world fails as in `Sim.step`. With "stop", SimulationError names
        it and all worlds are left before the first step in which one failed. With "go on", the
        others continue with the same bits; the failed world stays in its last finite state, its
        error is in `failures`, and it moves again once its qpos or qvel is written, or after
        `reset` or `restore`.
    fields: single fields of `Settings` to change, such as ``dt=0.005``.

    The results are the same bits with any number of threads, with and without lanes, and in a
    `Sim`. All worlds share one `time`, and one model but for what `param` gives each. Of the last
    solve a batch keeps only `qacc`: reading `contacts`, `rows`, `residual`, `constraint_force` or
    `actuator_force` computes it again, over the batch's threads.

    >>> from stepcore import Batch, Scene
    >>> scene = Scene()
    >>> ball = scene.add_body("ball")
    >>> _ = scene.add_joint(ball, "slide")
    >>> _ = scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    >>> batch = Batch(scene, 3, dt=0.01)
    >>> batch.qvel[:, 0] = [0.0, 1.0, 2.0]
    >>> batch.step(10)
    >>> batch.qvel[:, 0].round(3).tolist()
    [-0.981, 0.019, 1.019]
    """

    @takes_settings
    def __init__(
        self,
        model: Model | Scene | str | os.PathLike[str],
        n: int,
        settings: Settings | None = None,
        *,
        threads: int | None = None,
        lanes: bool | Literal["auto"] = "auto",
        on_failure: str = "stop",
        **fields: Unpack[SettingsFields],
    ) -> None:
        refuse_unknown(Batch, fields)
        self._model = compiled(model).with_settings(settings, **fields)
        self._lanes = checks.one_of(True, False, "auto")("Batch", "lanes", lanes)
        self._threads = _threads(threads, n, self._model.nv)
        self._on_failure: str = checks.one_of(*ON_FAILURE)("Batch", "on_failure", on_failure)
        self._failures: dict[int, SimulationError] = {}
        self._residuals = BatchResiduals()
        own, goes_on = self._model.settings, self._on_failure == "go on"
        how = (self._threads, None if self._lanes == "auto" else self._lanes, goes_on)
        self._own(_core.Batch(self._model.core, own, n, *how))
        self._param = Parameters(self._model, self._core, len(self))
        # Of worlds that were reset by themselves: the batch's time then, and their own.
        self._reset_at, self._reset_to = np.full((2, len(self)), np.nan)

    def __len__(self) -> int:
        """The number of worlds."""
        return len(self.qpos)

    @property
    def param(self) -> Parameters:
        """Values of the model that differ from world to world, by path: masses, friction, gains.

        >>> from stepcore import Batch, lesson
        >>> batch = Batch(lesson.spring(), 2)
        >>> batch.param["joint/spring/stiffness"] = [10.0, 20.0]
        >>> batch.model_of(1).scene.joint("spring").stiffness
        20.0
        """
        return self._param

    def model_of(self, world: int) -> Model:
        """Returns the model of a world: `model` with the values of `param` there."""
        index = checks.count("world", world, 0)
        if index >= len(self):
            raise ValueError(f"world = {checks.shown(world)}: must be below {len(self)}")
        return self._model_of(index)

    def _model_of(self, world: int) -> Model:
        return self._param.model_of(world)

    def step(self, n: int = 1, *, progress: Choice = None) -> None:
        """Takes n steps in every world, with the GIL released; raises what `Sim.step` raises.

        progress: a function of (label, done, total), called some fifty times a second and at the
            end; False for no bar. None is a bar where somebody watches, once the call has taken
            two seconds.

        Ctrl-C is noticed between steps, as is what `progress` raises; the steps until then count.
        Warns (`UnsolvedWarning`) once if a world's residual is more than gravity gives in a step at
        three looks in a row; it looks after 64, 128, 256, … steps. Warns (`EnergyWarning`) once if
        one of about 32 worlds, evenly spread, has far more energy than it can have gained.
        """
        with self._long(n, progress) as told:
            self._core.step(n, told)
        self._told(n)

    def forward(self) -> None:
        """Computes poses, contacts and forces at the present states, without taking a step."""
        with self._explained():
            self._core.forward()

    def rollout(
        self, ctrl: ArrayLike, record: Sequence[str] = (), *, progress: Choice = None
    ) -> Rollout:
        """Steps with given controls and returns every state.

        ctrl: shape (n, steps, nu), one row for each step; the last row stays in `ctrl`.
        record: names of what else is kept of each state, such as "sensordata" or "energy": the
            attributes that `Sim.run` records, but for counts of one world's solve and momentum.
            Each is read after each step, which may solve that state's forces once more.
        progress: as in `step`.

        Raises ValueError for controls of another shape, numbers that are not finite and names that
        cannot be recorded, all before the first step; and what `step` raises.

        >>> from stepcore import Batch
        >>> import numpy as np
        >>> swings = Batch("gymnasium:inverted_pendulum", 2)
        >>> run = swings.rollout(np.zeros((2, 5, 1)), record="energy")
        >>> run.qpos.shape, run.recorded["energy"].shape
        ((2, 5, 2), (2, 5, 2))
        """
        table, names = numbers("ctrl", ctrl), recordable(record, NAMES)
        if table.ndim != 3 or table.shape[::2] != (len(self), self._model.nu):
            limit = f"({len(self)}, steps, {self._model.nu})"
            raise ValueError(f"ctrl has shape {table.shape}: must be {limit}")
        steps = table.shape[1]
        with self._long(steps, progress) as told:
            if names:
                roll = partial(self._core.rollout, told=None)
                states = recorded_rollout(self, roll, table, names, told)
            else:
                states = Rollout(*self._core.rollout(table, told)[:3])
        self._told(steps)
        return states

    def _told(self, steps: int) -> None:
        """Warns of rows that stay unsolved; skipped while another thread uses the batch."""
        try:
            text = self._residuals.step(self, steps)
        except RuntimeError as error:
            # The steps are made and count.
            if "busy in another thread" not in str(error):
                raise
            return
        if text:
            warnings.warn(UnsolvedWarning(text), stacklevel=3)

    @contextmanager
    def _long(self, steps: int, progress: Choice) -> Iterator[Callable[[int], None] | None]:
        """Shows the progress of a long call; errors within get their replay."""
        checks.progress("Batch", progress)
        with self._explained():
            # What is no number of steps, the engine refuses.
            total = steps if isinstance(steps, (int, np.integer)) else 0
            if total <= (1 if progress is None else 0):
                yield None
                return
            # Only long calls need the bar.
            from stepcore.report.progress import BEGUN, Progress

            with Progress("steps", total, progress, after=BEGUN) as bar:
                yield bar.advance

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Adds its `replay` to an error that is raised within."""
        try:
            yield
        except SimulationError as error:
            self._explain(error)
            raise

    @property
    def time(self) -> float:
        """Time [s] that all worlds share; see `Sim.time`, and `times` for that of each."""
        time: float = self._core.time
        return time

    @time.setter
    def time(self, value: float) -> None:
        self._core.time = value
        self._reset_at[:] = np.nan

    @property
    def times(self) -> Floats:
        """Time of each world [s], shape (n,): that of a `Sim` which was reset when the world was.

        It differs from `time` where `reset` was called with `worlds`; `restore` sets both alike.
        """
        dt = self.settings.dt
        own = self._reset_to + np.rint((self.time - self._reset_at) / dt) * dt
        return np.where(np.isnan(own), self.time, own)

    @property
    def nbytes(self) -> int:
        """Memory of all worlds, their arrays and the threads' working space [bytes].

        The model, which they share, is not in it.
        """
        size: int = self._core.nbytes
        return size + self._reset_at.nbytes + self._reset_to.nbytes

    @property
    def in_lanes(self) -> bool:
        """Whether worlds are stepped side by side in vector registers now; "auto" may change it."""
        stepped: bool = self._core.in_lanes
        return stepped

    @property
    def failures(self) -> dict[int, SimulationError]:
        """Errors of the worlds that failed under on_failure="go on", by index of the world."""
        known = self._failures
        failed, new = self._core.failures(list(known))
        for error in new:
            self._explain(error)
        errors = {error.world: error for error in new}
        self._failures = {world: known.get(world) or errors[world] for world in failed}
        return dict(self._failures)

    def _restart(self, time: float) -> None:
        self._core.restart(time)
        self._reset_at[:] = np.nan

    def reset(
        self,
        key: str | int | None = None,
        *,
        worlds: ArrayLike | None = None,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
    ) -> None:
        """Resets all worlds, or some of them; see `Sim.reset`.

        worlds: which are reset, as a mask of shape (n,) or as indices; None for all. Reset worlds
            go on with the bits of a new `Sim`, the others with theirs. `time` is that of all
            worlds and goes on unless all are reset by None; `times` has each world's own. Worlds
            that failed and are not reset try again from where they stand.
        qpos, qvel: what the reset worlds have instead of the initial or the keyframe's, shape (nq,)
            or (k, nq) and (nv,) or (k, nv) for k worlds.

        Raises ValueError for an unknown keyframe, for worlds that do not exist or are named twice
        and for arrays of another shape; nothing changes then.

        >>> from stepcore import Batch, lesson
        >>> batch = Batch(lesson.drop(), 3, dt=0.01)
        >>> batch.step(10)
        >>> batch.reset(worlds=[1], qvel=[2.0])
        >>> batch.qvel[:, 0].round(3).tolist()
        [-0.007, 2.0, -0.007]
        """
        chosen = np.arange(len(self)) if worlds is None else indices_of(worlds, len(self))
        values, time = self._initial(key)
        for name, given in (("qpos", qpos), ("qvel", qvel)):
            if given is not None:
                values[name] = self._rows(name, given, len(chosen))
        if worlds is None:
            self._restart(time)
        else:
            self._core.forget(chosen.tolist())
            self._reset_at[chosen], self._reset_to[chosen] = self.time, time
        own = {name: values.pop(name) for name in ("qpos", "qvel") if np.ndim(values[name]) > 1}
        # A slice is written much sooner than indices.
        where: Any = slice(None) if worlds is None else chosen
        self._write(values, where)
        if key is None:
            self._write_own_initial(chosen)
        for name, rows in own.items():
            self._arrays[name][where] = rows

    def _write_own_initial(self, chosen: NDArray[np.intp]) -> None:
        """Writes the initial arrays that parameters change, in the chosen worlds."""
        for worlds, values in self._param.initial():
            self._write(values, np.intersect1d(worlds, chosen))

    def _rows(self, name: str, given: ArrayLike, k: int) -> Floats:
        """One row for each of k worlds, finite and of the array's width."""
        table, width = numbers(name, given), self._arrays[name].shape[1]
        if table.shape not in ((width,), (k, width)):
            limit = f"({width},) or ({k}, {width})"
            raise ValueError(f"{name} has shape {table.shape}: must be {limit}")
        if not np.isfinite(table).all():
            raise ValueError(f"{name}: must be finite")
        return np.broadcast_to(table, (k, width))

    def state(self) -> tuple[bytes, ...]:
        """Returns a complete snapshot of every world; each is also one of a `Sim`."""
        return tuple(self._core.state())

    def restore(self, state: tuple[bytes, ...]) -> None:
        """Restores a snapshot from `state`; continuing from it gives the same bits.

        Raises ValueError for anything else, and changes nothing then.
        """
        try:
            worlds = list(state)
        except TypeError:
            worlds = [state]  # type: ignore[list-item]
        self._core.restore([snapshot(state, world) for world in worlds])
        self._reset_at[:] = np.nan

    def copy(self) -> Batch:
        """Returns another batch of the same worlds: both go on with the same bits."""
        return copy.deepcopy(self)

    # The present states.

    @property
    def momentum(self) -> Momentum:
        """Linear [kg·m/s] and angular [kg·m²/s] momentum of each world, shape (n, 3) each."""
        both = self._core.readout("momentum")
        return Momentum(both[:, 0], both[:, 1])

    # The last step or forward().

    @property
    def contacts(self) -> list[NDArray[Any]]:
        """Contacts of each world, a list of n structured arrays; see `Sim.contacts`."""
        names = self._model.called("geom")
        return [contact_table(names, *table) for table in self._core.contacts()]

    def contacts_of(self, body: str | int) -> list[NDArray[Any]]:
        """Contacts of a body in each world, a list of n; see `Sim.contacts_of`."""
        return [contacts_of_body(table, self._model, body) for table in self.contacts]

    @property
    def rows(self) -> list[NDArray[Any]]:
        """Constraint rows of each world, a list of n structured arrays; see `Sim.rows`."""
        return [row_table(self.settings.dt, *table) for table in self._core.rows()]

    @property
    def asleep(self) -> NDArray[np.bool_]:
        """Whether each body of each world sleeps, shape (n, nbody); see `Settings.sleep`."""
        shape = (len(self), self.model.nbody)
        return np.array(self._core.asleep, dtype=bool).reshape(shape)

    @property
    def residual(self) -> Floats:
        """Residual of each world's last solve [m/s], shape (n,); see `Sim.residual`."""
        return self._core.residual

    @property
    def unrecovered_overlap(self) -> Floats:
        """Overlap that the recovery limit left [m], shape (n,); see `Sim.unrecovered_overlap`."""
        return self._core.unrecovered

    @property
    def energy(self) -> Floats:
        """Kinetic and potential energy [J], shape (n, 2); see `Sim.energy`."""
        return self._core.readout("energy")

    @property
    def overlap(self) -> Floats:
        """The deepest overlap of two geoms that can collide [m], shape (n,)."""
        return self._core.readout("overlap")

    def __reduce__(self) -> tuple[Any, ...]:
        how = (self._threads, self._lanes, self._on_failure)
        own = (self._param.columns(), self.state(), self._reset_at, self._reset_to)
        return _restored, (self._model, len(self), *how, *own)

    def __repr__(self) -> str:
        scene = self._model.scene.name
        name = f" of {checks.quoted(scene)}" if scene else ""
        return f"<Batch{name}: {len(self)} worlds, time {self.time:g} s; {self.settings!r}>"


def unwatched(batch: Batch) -> Batch:
    """The batch without warnings, for measurements that judge its motion themselves."""
    batch._residuals.told = True
    batch._core.unwatch()
    return batch


def _threads(threads: int | None, n: int, nv: int) -> int:
    """The number of threads; None: one a core, or a single one where waking more costs too much."""
    if threads is None and checks.number(n) is not None and n * nv < WORTH_THREADS:
        return 1
    return checks.threads(threads)


def _restored(
    model: Model,
    n: int,
    threads: int,
    lanes: Any,
    on_failure: str,
    param: dict[str, Floats],
    state: tuple[bytes, ...],
    reset_at: Floats,
    reset_to: Floats,
) -> Batch:
    batch = Batch(model, n, threads=threads, lanes=lanes, on_failure=on_failure)
    if param:
        batch.param.update(param)
    batch.restore(state)
    batch._reset_at[:], batch._reset_to[:] = reset_at, reset_to
    return batch
