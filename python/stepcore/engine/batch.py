"""`Batch`: many worlds of one model, stepped together in vector lanes and threads."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import _core, checks
from stepcore._core import Settings, SimulationError
from stepcore.engine import gradients
from stepcore.engine.arrays import (
    INPUTS,
    STATE,
    Floats,
    indices_of,
    numbers,
    snapshot,
    snapshot_with,
)
from stepcore.engine.gradients import Gradients, X
from stepcore.engine.linearization import Linearizations, LinearWorlds
from stepcore.engine.parameters import Parameters, columns
from stepcore.engine.pitfalls import warn_of_pitfalls
from stepcore.engine.tables import Momentum, contact_table, contacts_of_body, row_table
from stepcore.engine.trajectory import OF_WORLDS, Rollout, recordable, samples
from stepcore.engine.unsolved import BatchResiduals, UnsolvedWarning
from stepcore.engine.world import World, compiled
from stepcore.signatures import refuse_unknown_settings, takes_settings

if TYPE_CHECKING:
    import os
    from typing import Unpack

    from stepcore.engine.model import Model
    from stepcore.report.progress import Choice, Progress
    from stepcore.scene.scene import Scene
    from stepcore.signatures import SettingsFields


# Treatment of the other worlds when one world fails.
ON_FAILURE = ("stop", "go on")


class Batch(World):
    """A simulation of many worlds of a model.

    The arrays of a `Sim` have a leading world axis here: an array documented with shape (nq,) has
    shape (n, nq), and so on.

    model: a `Model`, a `Scene`, which is compiled, or any argument of `stepcore.load`, such as the
        path of an MJCF file.
    n: the number of worlds.
    settings: a `Settings` that replaces the settings of the model.
    threads: the number of threads. The default is one per core, or a single thread for a batch that
        is too small to repay the cost of waking threads.
    lanes: True steps eight worlds (sixteen in single precision) at a time in the processor's vector
        registers; False steps them one by one. "auto" chooses the faster way: at increasing
        intervals, a step is taken the other way and timed. If worlds have different contacts, a
        register does the work of all its worlds, so walkers in contact may be faster one by one.
    on_failure: the treatment of a world that fails as in `Sim.step`. With "stop", SimulationError
        names the world, and all worlds keep the state before the first step in which a world
        failed. `rows`, `contacts`, `qacc` and the like are then those of these states. With "go
        on", the other worlds continue bit-identically. The failed world keeps its last finite
        state, and its error is in `failures`; it moves again once its qpos or qvel is written, or
        after `reset` or `restore`.
    fields: single fields of `Settings` to change, such as ``dt=0.005``.

    The results are bit-identical with any number of threads, with and without lanes, and in a
    `Sim`. All worlds share one `time`, and one model except for the values in `param`. A batch
    keeps only `qacc` and `actuator_force` from the last solve: reading `contacts`, `rows`,
    `residual` or `constraint_force` solves again, on the batch's threads.

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

    _lead = (slice(None),)

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
        refuse_unknown_settings(Batch, fields)
        self._model = compiled(model).with_settings(settings, **fields)
        self._lanes = checks.one_of(True, False, "auto")("Batch", "lanes", lanes)
        self._threads = _threads(threads, n, self._model.nv)
        self._on_failure: str = checks.one_of(*ON_FAILURE)("Batch", "on_failure", on_failure)
        self._failures: dict[int, SimulationError] = {}
        self._residuals = BatchResiduals()
        warn_of_pitfalls(self._model, stacklevel=4)
        initial, goes_on = self._model.settings, self._on_failure == "go on"
        how = (self._threads, None if self._lanes == "auto" else self._lanes, goes_on)
        self._own(_core.Batch(self._model.core, initial, n, *how))
        self._param = Parameters(self._model, self._core, len(self))
        self._linear_worlds: LinearWorlds | None = None
        # Worlds that were reset individually: the batch's time at the reset, and the world's time.
        self._reset_at, self._reset_to = np.full((2, len(self)), np.nan)

    def __len__(self) -> int:
        """Return the number of worlds."""
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
        """Return the model of a world: `model` with this world's values of `param`."""
        index = checks.count("world", world, 0)
        if index >= len(self):
            raise ValueError(f"world = {checks.shown(world)}: must be below {len(self)}")
        return self._model_of(index)

    def _model_of(self, world: int) -> Model:
        return self._param._variants.model(world)

    def step(self, n: int = 1, *, progress: Choice = None) -> None:
        """Take n steps in every world, with the GIL released; raise the same errors as `Sim.step`.

        progress: a function of (label, done, total), called about fifty times a second and at the
            end; False for no bar. None shows a bar in a terminal or a notebook, once the call has
            taken two seconds.

        An error raised by `progress` interrupts between steps, and Ctrl-C also within a long step,
        which is then discarded; steps already taken are kept. The residuals are checked after 64,
        128, 256, … steps. The batch warns once (`UnsolvedWarning`) if a world's residual exceeds
        the speed that gravity adds in one step at three consecutive checks. The batch warns once
        (`EnergyWarning`) if one of about 32 evenly spread worlds has far more energy than it can
        have gained.
        """
        with self._long(n, progress) as bar:
            self._call(self._core.step, n, bar.advance if bar else None)
        self._warn_of_residuals(n)

    def rollout(
        self, ctrl: ArrayLike, record: Sequence[str] = (), *, progress: Choice = None
    ) -> Rollout:
        """Step with given controls and return every state.

        ctrl: shape (n, steps, nu), one row for each step; the last row stays in `ctrl`.
        record: names of further quantities to record, such as "sensordata" or "energy": all that
            `Sim.run` records, except momentum and the counts of one world's solve. Each quantity is
            read after each step, which may require one more solve.
        progress: as in `step`.

        Raises ValueError for controls of another shape, numbers that are not finite and names that
        cannot be recorded, all before the first step; and the same errors as `step`.

        >>> from stepcore import Batch
        >>> import numpy as np
        >>> swings = Batch("gymnasium:inverted_pendulum", 2)
        >>> run = swings.rollout(np.zeros((2, 5, 1)), record="energy")
        >>> run.qpos.shape, run.recorded["energy"].shape
        ((2, 5, 2), (2, 5, 2))
        """
        table, names = numbers("ctrl", ctrl), recordable(record, OF_WORLDS)
        if table.ndim != 3 or table.shape[::2] != (len(self), self._model.nu):
            limit = f"({len(self)}, steps, {self._model.nu})"
            raise ValueError(f"ctrl has shape {table.shape}: must be {limit}")
        steps = table.shape[1]
        with self._long(steps, progress) as bar:
            recorded = samples(self, (*STATE, *names), steps, table, bar.advance if bar else None)
        self._warn_of_residuals(steps)
        qpos, qvel, act, *more = recorded
        return Rollout(qpos, qvel, act, dict(zip(names, more, strict=True)))

    def linearize(self, parameters: Sequence[str] = ()) -> Linearizations:
        """Linearise the next step of every world about its state, without taking the step.

        parameters: paths as in `Sim.linearize`, whose errors it raises.

        Worlds share the batch's threads. The states of a trajectory, one to a world, are linearised
        in one call. The solver starts from no impulses, as after a reset; one that converges
        forgets its start.

        >>> from stepcore import Batch, lesson
        >>> batch = Batch(lesson.spring(), 3, dt=0.01, integrator="semi-implicit")
        >>> batch.linearize().A.shape
        (3, 2, 2)
        """
        by = columns(self._model, parameters)
        states = {name: np.array(getattr(self, name))[:, None] for name in (*X, *INPUTS)}
        return Linearizations(self._model, self._linearised_worlds().linear(states, by), by)

    def _linearised_worlds(self) -> LinearWorlds:
        """Return the worlds for linearisation, which are kept until a parameter is set."""
        models = self._param.models()
        if self._linear_worlds is None or self._linear_worlds.models is not models:
            self._linear_worlds = LinearWorlds(models, self._threads)
        return self._linear_worlds

    def vjp(
        self,
        ctrl: ArrayLike,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
        act: ArrayLike | None = None,
        parameters: Sequence[str] = (),
        error_bar: bool = False,
    ) -> Gradients:
        """Step with given controls, and return the gradient of a sum of the states, backward.

        ctrl: shape (n, steps, nu), as in `rollout`.
        qpos, qvel, act: the gradient of a scalar with respect to the states after each step, shapes
            (n, steps, nq), …; None for zero.
        parameters: paths as in `Sim.linearize`.
        error_bar: compute the gradient with half the step as well, at three times the cost; `error`
            is the distance of the two gradients. Must be False in a scene with late controls.

        Each step is differentiated exactly at the state where it starts, with rows solved to
        rounding; see `Sim.linearize`. The states and the gradient with respect to each are kept.
        Worlds share the batch's threads, and the batch ends in the last state of the rollout. Warns
        (`GradientWarning`) if a gradient grows without bound or its error exceeds half of it.

        >>> import numpy as np
        >>> from stepcore import Batch, lesson
        >>> batch = Batch(lesson.spring(), 1, dt=0.01, integrator="semi-implicit")
        >>> batch.reset("start")
        >>> ends = np.zeros((1, 50, 1))
        >>> ends[0, -1] = 1.0
        >>> found = batch.vjp(np.zeros((1, 50, 0)), ends, parameters=["joint/spring/stiffness"])
        >>> list(found.parameters), found.qvel.shape
        (['joint/spring/stiffness'], (1, 1))
        """
        cotangents = {"qpos": qpos, "qvel": qvel, "act": act}
        return gradients.vjp(self, ctrl, cotangents, parameters, error_bar)

    def jvp(
        self,
        ctrl: ArrayLike,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
        act: ArrayLike | None = None,
        ctrl_change: ArrayLike | None = None,
        parameters: Mapping[str, ArrayLike] = MappingProxyType({}),
    ) -> tuple[Rollout, Rollout]:
        """Step with given controls; return the states and their directional derivative.

        ctrl: shape (n, steps, nu), as in `rollout`.
        qpos, qvel, act: changes of the initial state, shapes (n, nq), (n, nv), (n, na).
        ctrl_change: changes of the controls, shape (n, steps, nu).
        parameters: changes of parameters by label, numbers or of shape (n,); see `vjp`.
        """
        tangents = {"qpos": qpos, "qvel": qvel, "act": act}
        return gradients.jvp(self, ctrl, tangents, ctrl_change, parameters)

    def _warn_of_residuals(self, steps: int) -> None:
        """Warn of rows that stay unsolved, unless another thread is using the batch."""
        try:
            text = self._residuals.step(self, steps)
        except RuntimeError as error:
            # The steps were taken; only the check of the residuals is skipped.
            if "busy in another thread" not in str(error):
                raise
            return
        if text:
            warnings.warn(UnsolvedWarning(text), stacklevel=3)

    def _long(self, steps: int, progress: Choice) -> AbstractContextManager[Progress | None]:
        """Return the progress bar of a long call."""
        checks.progress("Batch", progress)
        # The engine rejects an invalid number of steps.
        total = steps if isinstance(steps, (int, np.integer)) else 0
        if total <= (1 if progress is None else 0):
            return nullcontext()
        # Imported here because only long calls need the bar.
        from stepcore.report.progress import BEGUN, Progress

        return Progress("steps", total, progress, after=BEGUN)

    @property
    def time(self) -> float:
        """Time [s] that all worlds share; see `Sim.time`. `times` has the time of each world."""
        time: float = self._core.time
        return time

    @time.setter
    def time(self, value: float) -> None:
        self._core.time = value
        self._reset_at[:] = np.nan

    @property
    def times(self) -> Floats:
        """Time of each world [s], shape (n,), counted from the last reset of this world.

        The times differ from `time` after a `reset` with `worlds`.
        """
        times = self._reset_to + self._steps_since_reset() * self.settings.dt
        return np.where(np.isnan(times), self.time, times)

    def _steps_since_reset(self) -> Floats:
        """Return the steps of each world since its individual reset; NaN without one."""
        steps: Floats = np.rint((self.time - self._reset_at) / self.settings.dt)
        return steps

    @property
    def nbytes(self) -> int:
        """Memory of all worlds, their arrays and the threads' workspace [bytes].

        The workspace of `linearize` is included after its first call; the shared model is not.
        """
        size: int = self._core.nbytes
        linear: int = self._linear_worlds.core.nbytes if self._linear_worlds else 0
        return size + linear + self._reset_at.nbytes + self._reset_to.nbytes

    @property
    def in_lanes(self) -> bool:
        """Whether worlds are stepped in vector lanes at present; "auto" may change this."""
        stepped: bool = self._core.in_lanes
        return stepped

    @property
    def failures(self) -> dict[int, SimulationError]:
        """Errors of the worlds that failed under on_failure="go on", by index of the world."""
        failures = self._failures
        failed, new = self._core.failures(list(failures))
        for error in new:
            self._explain(error)
        errors = {error.world: error for error in new}
        self._failures = {world: failures.get(world) or errors[world] for world in failed}
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
        """Reset all worlds, or some of them; see `Sim.reset`.

        worlds: the worlds to reset, as a mask of shape (n,) or as indices; None means all. Reset
            worlds continue bit-identically to a new `Sim`, and the other worlds are unaffected.
            `time` is reset only with None, else it continues; `times` has the time of each world.
            Failed worlds that are not reset continue from their present state.
        qpos, qvel: values for the reset worlds instead of the initial state or the keyframe, shape
            (nq,) or (k, nq) and (nv,) or (k, nv) for k worlds.

        Raises ValueError for an unknown keyframe, for worlds that do not exist or occur twice, and
        for arrays of another shape; nothing changes then.

        >>> from stepcore import Batch, lesson
        >>> batch = Batch(lesson.drop(), 3, dt=0.01)
        >>> batch.step(10)
        >>> batch.reset(worlds=[1], qvel=[2.0])
        >>> batch.qvel[:, 0].round(3).tolist()
        [-0.007, 2.0, -0.007]
        """
        chosen = np.arange(len(self)) if worlds is None else indices_of(worlds, len(self))
        values, time = self._initial(key)
        arrays: dict[str, Floats] = {}
        for name, value in (("qpos", qpos), ("qvel", qvel)):
            if value is not None:
                width = self._arrays[name].shape[1]
                arrays[name] = self._table(name, value, (width,), (len(chosen), width))
        if worlds is None:
            self._restart(time)
        else:
            self._core.forget(chosen.tolist())
            self._reset_at[chosen], self._reset_to[chosen] = self.time, time
        # Writing a slice is much faster than writing indices.
        where: Any = slice(None) if worlds is None else chosen
        self._write(values, where)
        if key is None:
            # Initial arrays that parameters change.
            for worlds_of, values in self._param._variants.initial():
                self._write(values, np.intersect1d(worlds_of, chosen))
        for name, rows in arrays.items():
            self._arrays[name][where] = rows

    def state(self) -> tuple[bytes, ...]:
        """Return a complete snapshot of every world; each is also a snapshot of a `Sim`.

        A snapshot has the time of its world; see `Sim.state`.
        """
        steps = self._steps_since_reset()
        clocks = {
            int(world): (float(self._reset_to[world]), int(steps[world]))
            for world in np.flatnonzero(~np.isnan(steps))
        }
        return tuple(map(snapshot_with, self._core.state(clocks), self._core.last()))

    def restore(self, state: tuple[bytes, ...]) -> None:
        """Restore a snapshot from `state`; the motion then continues bit-identically.

        `time` becomes the time of the batch at the snapshot, and `times` the time of each world.

        Raises ValueError for any other argument; nothing changes then.
        """
        try:
            worlds = list(state)
        except TypeError:
            worlds = [state]  # type: ignore[list-item]
        parts = [snapshot(state, world) for world in worlds]
        resets = self._core.restore([state for state, _ in parts], [last for _, last in parts])
        self._reset_at[:] = np.nan
        for world, (start, steps) in resets.items():
            self._reset_at[world] = self.time - steps * self.settings.dt
            self._reset_to[world] = start

    def copy(self) -> Batch:
        """Return another batch of the same worlds; both continue bit-identically."""
        return _restored(*self.__reduce__()[1])

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
        """Return the contacts of a body in each world, a list of n; see `Sim.contacts_of`."""
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
        """Overlap left by the recovery limit [m], shape (n,); see `Sim.unrecovered_overlap`."""
        return self._core.unrecovered

    @property
    def energy(self) -> Floats:
        """Kinetic and potential energy [J], shape (n, 2); see `Sim.energy`."""
        return self._core.readout("energy")

    @property
    def overlap(self) -> Floats:
        """The deepest overlap of two collidable geoms [m], shape (n,)."""
        return self._core.readout("overlap")

    def __reduce__(self) -> tuple[Any, ...]:
        how = (self._threads, self._lanes, self._on_failure)
        content = (self._param.columns(), self.state())
        return _restored, (self._model, len(self), *how, *content)

    def __repr__(self) -> str:
        scene = self._model.scene.name
        name = f" of {checks.quoted(scene)}" if scene else ""
        return f"<Batch{name}: {len(self)} worlds, time {self.time:g} s; {self.settings!r}>"


def unwatched(batch: Batch) -> Batch:
    """Disable the warnings of a batch whose motion the caller judges, and return the batch."""
    batch._residuals.warned = True
    batch._core.unwatch()
    return batch


def _threads(threads: int | None, n: int, nv: int) -> int:
    """Return the number of threads; None means one per core, or one for a small batch."""
    # For fewer worlds × dofs one thread is faster than several: waking a thread costs about 20 µs a
    # step (measured on two cores: 64 worlds of a half cheetah lose 25 %, 512 gain 40 %).
    if threads is None and checks.number(n) is not None and n * nv < 2000:
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
) -> Batch:
    batch = Batch(model, n, threads=threads, lanes=lanes, on_failure=on_failure)
    if param:
        batch.param.update(param)
    batch.restore(state)
    return batch
