"""`EnvCore`: steps the worlds of an environment by one action and reads them for its task."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.sim import Sim, unwatched
from stepcore.gymnasium.draws import Streams
from stepcore.gymnasium.mujoco_late_arrays import go_to_last_stage
from stepcore.gymnasium.snapshot import Moment, Readings, TaskState
from stepcore.gymnasium.task import Task

# What tells of the last solve; the other arrays are of the present state.
OF_THE_SOLVE = frozenset(
    {
        *("qacc", "constraint_force", "qfrc_constraint", "cacc", "cfrc_ext", "cfrc_int"),
        *("actuator_force", "sensordata"),
    }
)
# What mj_forward does not compute: zero in MuJoCo from a reset to the first step.
NOT_OF_FORWARD = frozenset({"cacc", "cfrc_ext", "cfrc_int"})


class EnvCore:
    """A `Sim`, or a `Batch` of n worlds, with what its task reads.

    settings: a `Settings` or some fields of one, instead of the model's own.
    n: the number of worlds, None for a Sim. how: further arguments of the Batch.
    """

    def __init__(
        self,
        task: Task,
        settings: Settings | Mapping[str, Any] | None,
        n: int | None = None,
        **how: Any,
    ) -> None:
        self.task = task
        self.skip = checks.count("frame_skip", task.frame_skip)
        fields = settings if isinstance(settings, Mapping) else {"settings": settings}
        self.model = task.model().with_settings(**fields)
        self.action_space = task.action_space(self.model)
        self.world = self._made(n, how)
        # All worlds: their indices, and as an index of arrays; a Sim's have no axis of worlds.
        self._all: Any = 0 if n is None else np.arange(n)
        self._rows: Any = 0 if n is None else slice(None)
        # What the task remembers, by name, with an axis of worlds.
        self.state: dict[str, NDArray[Any]] = {}
        self._n = 1 if n is None else n
        self.streams = Streams(self._n)
        self._events = task.has("before_step")
        self._random: set[str] = set()
        self._on_all = len(inspect.signature(task.start).parameters) > 2
        self.dt = self.model.settings.dt * self.skip
        rk4 = self.model.settings.integrator == "rk4"
        solved = not OF_THE_SOLVE.isdisjoint(task.late)
        # A copy, for late arrays that this world does not have where they are asked for.
        self._stage = self._made(n, how) if task.late and (rk4 or solved) else None
        if rk4 and task.late and self.model.na:
            raise ValueError(
                f"{type(task).__name__}: reads what MuJoCo has after rk4's last stage, which is "
                "not known for actuators with activations"
            )
        # Resets are read in a world of their own, one after another.
        self._first = unwatched(Sim(self.model))
        self._asked: set[str] = set()
        self._asked_before: set[str] = set(task.late)
        self._before: dict[str, Any] = {}

    def _made(self, n: int | None, how: dict[str, Any]) -> Sim | Batch:
        if n is None:
            return unwatched(Sim(self.model))
        return Batch(self.model, n, on_failure="go on", **how)

    # Moments.

    @contextmanager
    def trial(self) -> Iterator[Moment]:
        """Give the present worlds for a trial of the functions; record which arrays they read."""
        action = self._no_action(self.world.qpos.shape[:-1])

        def read(name: str) -> Any:
            return np.array(getattr(self.world, name))

        before = Readings(read, self._asked_before, {"action": action})
        now = self._moment(read, {}, action, before)
        self.task.begin(now)
        yield now
        # What the trial drew and remembered is no part of an episode.
        self.state.clear()
        self.streams = Streams(self._n)

    def moment(self, action: NDArray[Any], late: dict[str, Any]) -> Moment:
        """Return the worlds after an action."""
        before = Readings(_unknown, self._asked_before, self._before)
        return self._moment(lambda name: getattr(self.world, name), late, action, before)

    def ahead(self, action: NDArray[Any]) -> Moment:
        """Return the worlds before an action or a step, of which nothing is kept."""
        before = Readings(_not_before, set())
        return self._moment(lambda name: getattr(self.world, name), {}, action, before, set())

    def _moment(
        self,
        read: Any,
        kept: dict[str, Any],
        action: NDArray[Any],
        before: Readings,
        asked: set[str] | None = None,
        worlds: Any = None,
    ) -> Moment:
        whole = worlds is None
        here, rows = (self._all, self._rows) if whole else (worlds, worlds)
        return Moment(
            read,
            self._asked if asked is None else asked,
            kept,
            action=action,
            before=before,
            dt=self.dt,
            model=self.model,
            worlds=here,
            state=TaskState(self.state, self._n, rows),
            rng=self.streams.of(here),
            world=self.world,
        )

    def _no_action(self, shape: tuple[int, ...]) -> NDArray[Any]:
        return np.zeros((*shape, *(self.action_space.shape or ())), dtype=np.float32)

    def keep(self, now: Moment) -> None:
        """Keep the arrays that the functions will read as `now.before` after the next action."""
        self._before = {name: np.array(getattr(now, name)) for name in self._asked_before}

    # Actions.

    def act(self, action: NDArray[Any]) -> tuple[Moment, dict[int, SimulationError]]:
        """Take an action; return the moment after it, and the errors of worlds that failed.

        A world that fails stands in its last finite state.
        """
        self.world.ctrl = np.asarray(self.task.control(self.ahead(action)))
        late: dict[str, Any] = {}
        if not self.task.late:
            errors = self._steps(action, 0, self.skip)
        else:
            errors = self._steps(action, 0, self.skip - 1)
            late = self._late()
            if not (errors and isinstance(self.world, Sim)):
                errors |= self._steps(action, self.skip - 1, self.skip)
        for name, array in late.items():
            for world in errors:
                own = world if isinstance(self.world, Batch) else ...
                array[own] = self._before[name][own]
        now = self.moment(action, late)
        self.task.after_action(now)
        return now, errors

    def _steps(self, action: NDArray[Any], first: int, end: int) -> dict[int, SimulationError]:
        """Take some of the steps of an action; return the errors of worlds that failed."""
        if not self._events:
            return self._stepped(end - first)
        errors: dict[int, SimulationError] = {}
        for step in range(first, end):
            self.task.before_step(self.ahead(action), step)
            errors |= self._stepped(1)
            if errors and isinstance(self.world, Sim):
                break
        return errors

    def _stepped(self, n: int) -> dict[int, SimulationError]:
        if n:
            try:
                self.world.step(n)
            except SimulationError as error:
                return {0: error}
        return self.world.failures if isinstance(self.world, Batch) else {}

    def _late(self) -> dict[str, Any]:
        """Before the last step, read the arrays at the place where it last evaluates forces."""
        source: Sim | Batch = self.world
        if self._stage is not None:
            source = self._stage
            source.reset()
            source.ctrl = self.world.ctrl
            source.qfrc_applied, source.xfrc_applied = (
                self.world.qfrc_applied,
                self.world.xfrc_applied,
            )
            try:
                go_to_last_stage(source, self.world.qpos, self.world.qvel)
            except SimulationError:
                _stand([0], source)
            if isinstance(source, Batch) and source.failures:
                _stand(list(source.failures), source)
        return {name: np.array(getattr(source, name)) for name in self.task.late}

    # Resets.

    def begin(self, worlds: NDArray[np.intp], rngs: Sequence[np.random.Generator]) -> Moment:
        """Begin episodes in k worlds, whose generators these are; return their first moment.

        Its arrays have an axis of k worlds, for a Sim too.
        """
        self.streams.seed(worlds.tolist(), rngs)
        self._randomize(worlds)
        qpos, qvel = self._starts(worlds, rngs)
        if isinstance(self.world, Batch):
            self.world.reset(worlds=worlds, qpos=qpos, qvel=qvel)
        else:
            self.world.reset()
            self.world.qpos, self.world.qvel = qpos[0], qvel[0]
        first = self._first_moment(worlds, qpos, qvel)
        self.task.begin(first)
        return first

    def _randomize(self, worlds: NDArray[np.intp]) -> None:
        if not self.task.has("randomize"):
            return
        values = self.task.randomize(self.model, self.streams.of(worlds), worlds)
        given = {path: np.asarray(value, dtype=np.float64) for path, value in values.items()}
        self._random |= given.keys()
        if isinstance(self.world, Sim):
            own = {path: value[0].tolist() for path, value in given.items()}
            self.world = unwatched(Sim(self.model.with_values(own)))
            return
        columns = {}
        for path, value in given.items():
            column = np.array(self.world.param[path])
            first = column.ndim > value.ndim
            column[(worlds, 0) if first else worlds] = value
            columns[path] = column
        self.world.param.update(columns)

    def _starts(
        self, worlds: NDArray[np.intp], rngs: Sequence[np.random.Generator]
    ) -> tuple[Floats, Floats]:
        """Draw first states of k worlds: qpos (k, nq) and qvel (k, nv)."""
        if self._on_all:
            start: Any = self.task.start
            drawn = start(self.model, self.streams.of(worlds), worlds)
            own = [np.atleast_2d(np.asarray(part, dtype=np.float64)) for part in drawn]
            tables = [np.broadcast_to(part, (len(worlds), part.shape[-1])) for part in own]
        else:
            each = [self.task.start(self.model, rng) for rng in rngs]
            tables = [np.array(values, dtype=np.float64) for values in zip(*each, strict=True)]
        qpos, qvel = tables
        for name, table, size in (("qpos", qpos, self.model.nq), ("qvel", qvel, self.model.nv)):
            if table.shape[1:] != (size,):
                raise ValueError(f"reset gave {name} of shape {table.shape[1:]}: must be ({size},)")
        return qpos, qvel

    def _first_moment(self, worlds: NDArray[np.intp], qpos: Floats, qvel: Floats) -> Moment:
        """Return the moment of worlds that were just reset to these states, in their order."""
        action = self._no_action((len(qpos),))
        names = (self._asked | self._asked_before) - {"qpos", "qvel", "action"}
        kept: dict[str, Any] = {"qpos": qpos, "qvel": qvel}
        if names and self._random:
            kept |= {name: self._read_own(name, worlds) for name in names}
        elif names:
            rows = [self._read_first(names, *state) for state in zip(qpos, qvel, strict=True)]
            kept |= {name: np.array([row[name] for row in rows]) for name in names}
        before = Readings(_unknown, set(), {**kept, "action": action})
        return self._moment(_unknown, kept, action, before, worlds=worlds)

    def _read_first(self, names: Iterable[str], qpos: Floats, qvel: Floats) -> dict[str, Any]:
        sim = self._first
        sim.reset()
        sim.qpos, sim.qvel = qpos, qvel
        zero = NOT_OF_FORWARD if self.task.late else frozenset()
        if any(name in OF_THE_SOLVE - zero for name in names):
            sim.forward()
        values = {name: np.array(getattr(sim, name)) for name in names}
        return {name: value * 0 if name in zero else value for name, value in values.items()}

    def _read_own(self, name: str, worlds: NDArray[np.intp]) -> Any:
        """Read an array of worlds that were just reset, whose models have values of their own."""
        if name not in OF_THE_SOLVE:
            array = np.array(getattr(self.world, name))
            return array[worlds] if isinstance(self.world, Batch) else array[None]
        rows = []
        for world in worlds.tolist():
            own = self.world.model_of(world) if isinstance(self.world, Batch) else self.world.model
            sim = unwatched(Sim(own))
            at = world if isinstance(self.world, Batch) else ...
            sim.qpos, sim.qvel = self.world.qpos[at], self.world.qvel[at]
            sim.forward()
            rows.append(np.array(getattr(sim, name)))
        return np.array(rows)

    def keep_first(self, worlds: Any, first: Moment) -> None:
        """Keep a first moment as `before` for these worlds."""
        for name in self._asked_before:
            value = getattr(first, name)
            if name not in self._before:
                shape = (self._n, *value.shape[1:])
                self._before[name] = np.zeros(shape, dtype=value.dtype)
            self._before[name][worlds] = value

    def keep_only(self, first: Moment) -> None:
        """Keep the first moment of a Sim, whose arrays have no axis of worlds."""
        self._before = {name: np.array(getattr(first, name)[0]) for name in self._asked_before}


def _stand(worlds: list[int], source: Sim | Batch) -> None:
    """Allow failed worlds to be read, without reporting the failure again."""
    if isinstance(source, Batch):
        source.reset(worlds=worlds)
    else:
        source.reset()
    source.forward()


def _unknown(name: str) -> NoReturn:
    """Explain that no function read this array when the environment was made."""
    raise AttributeError(
        f"{name} was not read when the environment was created: observe, reward and the others "
        "must read the same arrays in every call, because the moment before a step is kept for them"
    )


def _not_before(name: str) -> NoReturn:
    """Explain that what was before an action is not known ahead of it."""
    raise AttributeError(
        f"before.{name} is not known in control and before_step: keep it in now.state, in begin "
        "and after_action"
    )
