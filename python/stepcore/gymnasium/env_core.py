"""`EnvCore`: steps the worlds of an environment by one action and reads them for its task."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats
from stepcore.engine.batch import Batch
from stepcore.engine.model import Model
from stepcore.engine.sim import Sim, unwatched
from stepcore.gymnasium.mujoco_late_arrays import go_to_last_stage
from stepcore.gymnasium.snapshot import Moment, Readings
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
        self.model = _with_settings(task.model(), settings)
        self.world = self._made(n, how)
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

    def trial(self) -> Moment:
        """Return the present worlds for a trial of the functions; record which arrays they read."""
        nu = len(self.model.names["actuator"])
        action = np.zeros((*self.world.qpos.shape[:-1], nu), dtype=np.float32)

        def read(name: str) -> Any:
            return np.array(getattr(self.world, name))

        return self._moment(read, {}, action, Readings(read, self._asked_before))

    def moment(self, action: NDArray[Any], late: dict[str, Any]) -> Moment:
        """Return the worlds after an action."""
        before = Readings(_unknown, self._asked_before, self._before)
        return self._moment(lambda name: getattr(self.world, name), late, action, before)

    def _moment(
        self, read: Any, kept: dict[str, Any], action: NDArray[Any], before: Readings
    ) -> Moment:
        return Moment(
            read, self._asked, kept, action=action, before=before, dt=self.dt, model=self.model
        )

    def keep(self, now: Moment) -> None:
        """Keep the arrays that the functions will read as `now.before` after the next action."""
        self._before = {name: np.array(getattr(now, name)) for name in self._asked_before}

    # Actions.

    def act(self, action: NDArray[Any]) -> tuple[Moment, dict[int, SimulationError]]:
        """Take an action; return the moment after it, and the errors of worlds that failed.

        A world that fails stands in its last finite state.
        """
        self.world.ctrl = action
        if not self.task.late:
            errors = self._stepped(self.skip)
            return self.moment(action, {}), errors
        errors = self._stepped(self.skip - 1)
        late = self._late(action)
        if not (errors and isinstance(self.world, Sim)):
            errors |= self._stepped(1)
        for name, array in late.items():
            for world in errors:
                own = world if isinstance(self.world, Batch) else ...
                array[own] = self._before[name][own]
        return self.moment(action, late), errors

    def _stepped(self, n: int) -> dict[int, SimulationError]:
        """Take n steps; return the errors of worlds that failed."""
        if n:
            try:
                self.world.step(n)
            except SimulationError as error:
                return {0: error}
        return self.world.failures if isinstance(self.world, Batch) else {}

    def _late(self, action: NDArray[Any]) -> dict[str, Any]:
        """Before the last step, read the arrays at the place where it last evaluates forces."""
        source: Sim | Batch = self.world
        if self._stage is not None:
            source = self._stage
            source.reset()
            source.ctrl = action
            try:
                go_to_last_stage(source, self.world.qpos, self.world.qvel)
            except SimulationError:
                _stand([0], source)
            if isinstance(source, Batch) and source.failures:
                _stand(list(source.failures), source)
        return {name: np.array(getattr(source, name)) for name in self.task.late}

    # Resets.

    def starts(self, rngs: Iterable[np.random.Generator]) -> tuple[Floats, Floats]:
        """Draw first states, one for each generator: qpos (k, nq) and qvel (k, nv)."""
        drawn = [self.task.start(self.model, rng) for rng in rngs]
        qpos, qvel = (np.array(values, dtype=np.float64) for values in zip(*drawn, strict=True))
        for name, table, size in (("qpos", qpos, self.model.nq), ("qvel", qvel, self.model.nv)):
            if table.shape[1:] != (size,):
                raise ValueError(f"reset gave {name} of shape {table.shape[1:]}: must be ({size},)")
        return qpos, qvel

    def first(self, qpos: Floats, qvel: Floats) -> Moment:
        """Return the moment of worlds that were just reset to these states, in their order."""
        names = (self._asked | self._asked_before) - {"qpos", "qvel"}
        kept: dict[str, Any] = {"qpos": qpos, "qvel": qvel}
        if names:
            rows = [self._read_first(names, *state) for state in zip(qpos, qvel, strict=True)]
            kept |= {name: np.array([row[name] for row in rows]) for name in names}
        action = np.zeros((len(qpos), len(self.model.names["actuator"])), dtype=np.float32)
        return self._moment(_unknown, kept, action, Readings(_unknown, set(), kept))

    def _read_first(self, names: Iterable[str], qpos: Floats, qvel: Floats) -> dict[str, Any]:
        sim = self._first
        sim.reset()
        sim.qpos, sim.qvel = qpos, qvel
        zero = NOT_OF_FORWARD if self.task.late else frozenset()
        if any(name in OF_THE_SOLVE - zero for name in names):
            sim.forward()
        values = {name: np.array(getattr(sim, name)) for name in names}
        return {name: value * 0 if name in zero else value for name, value in values.items()}

    def keep_first(self, worlds: Any, first: Moment) -> None:
        """Keep a first moment as `before` for these worlds."""
        for name in self._asked_before:
            value = getattr(first, name)
            if name not in self._before:
                self._before[name] = np.array(getattr(self.world, name))
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


def _with_settings(model: Model, given: Settings | Mapping[str, Any] | None) -> Model:
    if isinstance(given, Mapping):
        return model.with_settings(**given)
    return model.with_settings(given)
