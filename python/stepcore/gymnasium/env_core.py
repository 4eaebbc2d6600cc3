"""`EnvCore`: the common base of `Env` and `VectorEnv`: steps, readings and pictures."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from stepcore import checks
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats, fill
from stepcore.engine.batch import Batch
from stepcore.engine.sim import Sim, unwatched
from stepcore.gymnasium.moment import Draws, Moment, Readings, Streams, TaskState
from stepcore.gymnasium.task import Task

# Arrays of the last solve; the other arrays describe the present state.
OF_THE_SOLVE = frozenset(
    {
        *("qacc", "constraint_force", "qfrc_constraint", "cacc", "cfrc_ext", "cfrc_int"),
        *("actuator_force", "sensordata"),
    }
)
# Arrays that mj_forward does not compute: zero in MuJoCo from a reset to the first step.
NOT_OF_FORWARD = frozenset({"cacc", "cfrc_ext", "cfrc_int"})


# The values of `render_mode`, besides None.
MODES = ["rgb_array"]
Picture = NDArray[np.uint8]


class EnvCore:
    """A `Sim`, or a `Batch` of n worlds, with the readings of its task, its spaces and its camera.

    owner: the class of the environment, for errors. settings: a `Settings` or some of its fields,
    which replace the model's settings. dtype: number type of observations; None for the space's.
    n: the number of worlds, None for a Sim. how: further arguments of the Batch.
    """

    def __init__(
        self,
        owner: str,
        task: Task,
        settings: Settings | Mapping[str, Any] | None,
        dtype: Any,
        render_mode: Any,
        width: int,
        height: int,
        n: int | None = None,
        how: Mapping[str, Any] | None = None,
    ) -> None:
        checks.one_of(None, *MODES)(owner, "render_mode", render_mode)
        self._camera = None if render_mode is None else WorldCamera(owner, width, height)
        self.task = task
        self.skip = checks.count("frame_skip", task.frame_skip)
        fields = settings if isinstance(settings, Mapping) else {"settings": settings}
        self.model = task.model().with_settings(**fields)
        self.dt = self.model.settings.dt * self.skip
        render_fps = max(1, round(1 / self.dt))
        self.metadata: dict[str, Any] = {"render_modes": MODES, "render_fps": render_fps}
        rk4 = self.model.settings.integrator == "rk4"
        if rk4 and task.late and self.model.na:
            raise ValueError(
                f"{type(task).__name__}: reads what MuJoCo has after rk4's last stage, which is "
                "not known for actuators with activations"
            )

        def made() -> Sim | Batch:
            if n is None:
                return unwatched(Sim(self.model))
            return Batch(self.model, n, on_failure="go on", **(how or {}))

        self.world = made()
        # A copy that evaluates late arrays at states where this world does not have them.
        self._solved = not OF_THE_SOLVE.isdisjoint(task.late)
        self._stage = made() if task.late and (rk4 or self._solved) else None
        # The arrays after a reset are read in this separate world, one reset after another.
        self._first = unwatched(Sim(self.model))
        self._n = 1 if n is None else n
        # The arrays of `Moment.state` by name, with an axis of worlds.
        self.state: dict[str, NDArray[Any]] = {}
        self.streams = Streams(self._n)
        # All worlds: their indices, and as an index of arrays; a Sim's have no axis of worlds.
        self._all = self._part(0, 0) if n is None else self._part(np.arange(n), slice(None))
        self._differs = False
        self._controls, self._each = task.has("control"), task.has("before_step")
        self._on_all = len(inspect.signature(task.start).parameters) > 2
        # The arrays that the functions read after and before the action.
        self._asked: set[str] = set()
        self._asked_before: set[str] = set(task.late)
        self._before: dict[str, Any] = {}
        self.action_space = task.action_space(self.model)
        self._action_shape = (*self.world.qpos.shape[:-1], *(self.action_space.shape or ()))
        space = self._observation_space()
        self.observation_space = space if dtype is None else _of_type(space, dtype)

    def _observation_space(self) -> Box:
        """Try the functions: find the arrays that they read, and the space of observations.

        Raises ValueError if a function of the task returns something of another shape.
        """
        task, action = self.task, self._no_action(self.world.qpos.shape[:-1])
        shape, nu, drawn = action.shape[:-1], self.model.nu, self.streams.counts()

        def read(name: str) -> Any:
            return np.array(getattr(self.world, name))

        now = self._moment(read, {}, action, Readings(read, self._asked_before, {"action": action}))
        task.begin(now)
        controls = task.control(self._ahead(action))
        if not task.has("control") and self.action_space.shape != (nu,):
            raise ValueError(f"action_space has shape {self.action_space.shape}: must be ({nu},)")
        _checked("control", controls, (*shape, nu))
        task.after_action(now)
        observation = _checked("observe", task.observe(now), (*shape, "k"))
        reward, terminated, info = task.outcome(now)
        _checked("reward", reward, shape)
        _checked("terminated", terminated, shape)
        for label, infos in (("info", info), ("info after a reset", task.reset_info(now))):
            for key, value in infos.items():
                if np.shape(value)[: len(shape)] != shape:
                    raise _shaped(f'{label}["{key}"]', value, f"{shape} first")
        space: Box = task.observation_space(observation.shape[-1])
        if space.shape != observation.shape[-1:]:
            limit = str(observation.shape[-1:])
            raise ValueError(f"observation_space has shape {space.shape}: must be {limit}")
        # Discard the random numbers and the state of this trial.
        self.state.clear()
        self.streams.rewind(np.ones(self._n, dtype=bool), drawn)
        return space

    # Moments.

    def _ahead(self, action: NDArray[Any]) -> Moment:
        """Return a moment before an action or a step, whose arrays are not kept."""
        before = Readings(_not_before, set())
        return self._moment(lambda name: getattr(self.world, name), {}, action, before, set())

    def _moment(
        self,
        read: Callable[[str], Any],
        kept: dict[str, Any],
        action: NDArray[Any],
        before: Readings,
        asked: set[str] | None = None,
        worlds: Any = None,
    ) -> Moment:
        here, state, rng = self._all if worlds is None else self._part(worlds, worlds)
        return Moment(
            read,
            self._asked if asked is None else asked,
            kept,
            action=action,
            before=before,
            dt=self.dt,
            model=self.model,
            worlds=here,
            state=state,
            rng=rng,
            world=self.world,
        )

    def _part(self, worlds: Any, rows: Any) -> tuple[Any, TaskState, Draws]:
        """Return some worlds, their state and their random numbers."""
        return worlds, TaskState(self.state, self._n, rows), self.streams.of(worlds)

    def _no_action(self, shape: tuple[int, ...]) -> NDArray[Any]:
        return np.zeros((*shape, *(self.action_space.shape or ())), dtype=np.float32)

    def keep(self, now: Moment, worlds: NDArray[np.intp] | None = None) -> None:
        """Keep the arrays that the functions will read as `now.before` after the next action.

        worlds: the worlds of a first moment; by default the moment has all worlds.
        """
        for name in self._asked_before:
            value = np.array(getattr(now, name))
            if worlds is None:
                self._before[name] = value
            elif isinstance(self.world, Sim):
                self._before[name] = value[0]
            else:
                empty = np.zeros((self._n, *value.shape[1:]), value.dtype)
                self._before.setdefault(name, empty)[worlds] = value

    # Actions.

    def act(self, action: Any) -> tuple[Moment, dict[int, SimulationError]]:
        """Take an action; return the moment after it, and the errors of worlds that failed.

        A failed world keeps its last finite state. Raises ValueError if the shape of the action is
        not the shape of the space.
        """
        action = np.asarray(action)
        if action.shape != self._action_shape:
            raise ValueError(f"action has shape {action.shape}: must be {self._action_shape}")
        if self._controls or action.dtype.kind not in "fiu":
            fill(self.world._arrays["ctrl"], "ctrl", self.task.control(self._ahead(action)))
        else:
            self.world._arrays["ctrl"][...] = action
        late: dict[str, Any] = {}
        single = isinstance(self.world, Sim)
        first = self.skip - 1 if self.task.late else self.skip
        errors = self._steps(action, 0, first)
        if self.task.late:
            late = self._late()
            if not (errors and single):
                errors |= self._steps(action, first, self.skip)
            for name, array in late.items():
                for world in errors:
                    chosen = ... if single else world
                    array[chosen] = self._before[name][chosen]
        before = Readings(_unknown, self._asked_before, self._before)
        now = self._moment(lambda name: getattr(self.world, name), late, action, before)
        self.task.after_action(now)
        return now, errors

    def _steps(self, action: NDArray[Any], first: int, end: int) -> dict[int, SimulationError]:
        """Take some of the steps of an action; return the errors of worlds that failed."""
        errors: dict[int, SimulationError] = {}
        for step in range(first, end, 1 if self._each else max(1, end - first)):
            if self._each:
                self.task.before_step(self._ahead(action), step)
            try:
                self.world.step(1 if self._each else end - first)
            except SimulationError as error:
                return {0: error}
            if isinstance(self.world, Batch):
                errors |= self.world.failures
        return errors

    def _late(self) -> dict[str, Any]:
        """Before the last step, read the arrays at the state of its last force evaluation."""
        world, source = self.world, self._stage
        if source is None:
            return {name: np.array(getattr(world, name)) for name in self.task.late}
        # As after a reset: the other arrays keep their initial values.
        source._restart(0.0)
        for name in ("ctrl", "qfrc_applied", "xfrc_applied", "qpos", "qvel"):
            source._arrays[name][...] = world._arrays[name]
        failed = False
        try:
            source._core.go_to_last_stage()
            if self._solved:
                source.forward()
        except SimulationError:
            failed = True
        # After a reset, a failed world can be read and does not fail again.
        if isinstance(source, Batch) and source.failures:
            failed = True
            source.reset(worlds=list(source.failures))
        elif failed:
            source.reset()
        if failed:
            source.forward()
        return {name: np.array(getattr(source, name)) for name in self.task.late}

    # Resets.

    def begin(self, worlds: NDArray[np.intp], rngs: Sequence[np.random.Generator]) -> Moment:
        """Begin episodes in k worlds with these generators; return their first moment.

        The arrays of the moment have an axis of k worlds, also for a Sim.
        """
        self.streams.seed(worlds.tolist(), rngs)
        self._randomize(worlds)
        qpos, qvel = self._starts(worlds, rngs)
        if isinstance(self.world, Batch):
            self.world.reset(worlds=worlds, qpos=qpos, qvel=qvel)
        else:
            self.world.reset()
            _place(self.world, qpos[0], qvel[0])
        action = self._no_action((len(qpos),))
        kept: dict[str, Any] = {"qpos": qpos, "qvel": qvel}
        names = (self._asked | self._asked_before) - {*kept, "action"}
        kept |= self._first_arrays(names, worlds, qpos, qvel)
        before = Readings(_unknown, set(), {**kept, "action": action})
        first = self._moment(_unknown, kept, action, before, worlds=worlds)
        self.task.begin(first)
        self.keep(first, worlds)
        return first

    def _randomize(self, worlds: NDArray[np.intp]) -> None:
        if not self.task.has("randomize"):
            return
        values = self.task.randomize(self.model, self.streams.of(worlds), worlds)
        arrays = {path: np.asarray(value, dtype=np.float64) for path, value in values.items()}
        self._differs = self._differs or bool(arrays)
        if isinstance(self.world, Sim):
            values_of_world = {path: value[0].tolist() for path, value in arrays.items()}
            self.world = unwatched(Sim(self.model.with_values(values_of_world)))
            return
        columns = {}
        for path, value in arrays.items():
            column = np.array(self.world.param[path])
            first = column.ndim > value.ndim
            column[(worlds, 0) if first else worlds] = value
            columns[path] = column
        self.world.param.update(columns)

    def _starts(
        self, worlds: NDArray[np.intp], rngs: Sequence[np.random.Generator]
    ) -> tuple[Floats, Floats]:
        """Draw first states of k worlds: qpos (k, nq) and qvel (k, nv)."""
        start: Any = self.task.start
        if self._on_all:
            drawn = start(self.model, self.streams.of(worlds), worlds)
            arrays = [np.atleast_2d(np.asarray(part, dtype=np.float64)) for part in drawn]
            tables = [np.broadcast_to(part, (len(worlds), part.shape[-1])) for part in arrays]
        else:
            each = [start(self.model, rng) for rng in rngs]
            tables = [np.array(values, dtype=np.float64) for values in zip(*each, strict=True)]
        qpos, qvel = tables
        for name, table, size in (("qpos", qpos, self.model.nq), ("qvel", qvel, self.model.nv)):
            if table.shape[1:] != (size,):
                raise ValueError(f"reset gave {name} of shape {table.shape[1:]}: must be ({size},)")
        return qpos, qvel

    def _first_arrays(
        self, names: set[str], worlds: NDArray[np.intp], qpos: Floats, qvel: Floats
    ) -> dict[str, Any]:
        """Read arrays of worlds that were just reset to these states, in their order."""
        zero = NOT_OF_FORWARD if self.task.late else frozenset()
        solved = OF_THE_SOLVE.intersection(names)
        if self._differs and not solved:
            # Read all worlds at once: a separate model for each world is slow.
            rows = worlds if isinstance(self.world, Batch) else None
            return {name: np.array(getattr(self.world, name))[rows] for name in names}
        collected: dict[str, list[Any]] = {name: [] for name in names}
        for world, place, speed in zip(worlds.tolist() if names else (), qpos, qvel, strict=False):
            sim = self._first
            if self._differs:
                many = self.world if isinstance(self.world, Batch) else None
                sim = unwatched(Sim(self.world.model if many is None else many.model_of(world)))
            # As after a reset: the other arrays keep their initial values.
            sim._restart(0.0)
            _place(sim, place, speed)
            if solved - zero:
                sim.forward()
            for name in names:
                collected[name].append(np.array(getattr(sim, name)) * (name not in zero))
        return {name: np.array(rows) for name, rows in collected.items()}

    # Pictures.

    def draw(self, index: int | None = None) -> Picture | None:
        """Draw a Sim, or one world of a Batch, (height, width, 3); None without a render mode."""
        return None if self._camera is None else self._camera.draw(self.world, index)

    def close(self) -> None:
        """Free the renderer."""
        if self._camera is not None:
            self._camera.close()


class WorldCamera:
    """A camera that draws worlds of a model and follows the moving bodies.

    width, height: size of a picture, in pixels.
    """

    def __init__(self, owner: str, width: int, height: int) -> None:
        # Imported here because the import takes as long as drawing, and few environments draw.
        from stepcore.viewing.camera import LARGEST_SIDE

        for name, size in (("width", width), ("height", height)):
            checks.whole(2, LARGEST_SIDE)(owner, name, size)
        self.width, self.height = width, height
        self._sim: Sim | None = None
        self._renderer: Any = None
        self._drawing: Any = None
        self._follows: Any = None

    def draw(self, world: Any, index: int | None) -> Picture:
        from stepcore.viewing.camera import following_camera, ropes
        from stepcore.viewing.drawing import drawing_of
        from stepcore.viewing.frames import poses_of
        from stepcore.viewing.renderers import Renderer

        if self._sim is None:
            self._sim = Sim(world.model)
            self._drawing = drawing_of(world.model, self._sim)
            self._renderer = Renderer(self._drawing, self.width, self.height)
        for name in self._sim._arrays:
            values = world._arrays[name]
            self._sim._arrays[name][...] = values if index is None else values[index]
        instant = poses_of(self._sim)
        self._follows = self._follows or following_camera(self._drawing, instant)
        marks = ropes(self._drawing, instant)
        picture: Picture = self._renderer.draw(instant, self._follows(instant), marks)
        return picture

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._sim = None


def _place(sim: Sim, qpos: Floats, qvel: Floats) -> None:
    """Write a state whose shape was checked, in less time than an assignment to the Sim."""
    sim._arrays["qpos"][...], sim._arrays["qvel"][...] = qpos, qvel


def _of_type(space: Box, dtype: Any) -> Box:
    """Return a space in another number type."""
    try:
        target = np.dtype(dtype)
    except TypeError:
        target = np.dtype(object)
    if target.kind != "f":
        limit = "numpy.float32, numpy.float64 or another type of real numbers"
        raise ValueError(f"dtype = {checks.shown(dtype)}: must be {limit}")
    return Box(space.low.astype(target), space.high.astype(target), space.shape, target)


def _checked(name: str, value: Any, shape: tuple[int | str, ...]) -> Any:
    """Convert a function's result to an array of a shape, in which a letter means any size."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} returned {checks.shown(value)}: must be numbers")
    wanted = zip(array.shape, shape, strict=False)
    if array.ndim != len(shape) or any(length != size for length, size in wanted if size != "k"):
        raise _shaped(name, array, str(shape).replace("'", ""))
    return array


def _shaped(name: str, value: Any, limit: str) -> ValueError:
    hint = "; write now.qpos[..., i] and axis=-1, which serve one world and many"
    return ValueError(f"{name} returned shape {np.shape(value)}: must be {limit}{hint}")


def _unknown(name: str) -> NoReturn:
    """Raise the error for an array that no function read when the environment was created."""
    raise AttributeError(
        f"{name} was not read when the environment was created: observe, reward and the others "
        "must read the same arrays in every call, because the moment before a step is kept for them"
    )


def _not_before(name: str) -> NoReturn:
    """Raise the error for `before`, which is unavailable ahead of an action."""
    raise AttributeError(
        f"before.{name} is not known in control and before_step: keep it in now.state, in begin "
        "and after_action"
    )
