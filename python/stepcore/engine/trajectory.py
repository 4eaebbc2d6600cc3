"""`Trajectory`: what `Sim.run` recorded, and the loop that records it."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine import trajectory_file
from stepcore.engine.arrays import numbers
from stepcore.engine.axes import Axis, axes_of
from stepcore.engine.control import controls
from stepcore.engine.snapshots import Snapshots, Taking
from stepcore.engine.unsolved import LOOKS, Residuals

if TYPE_CHECKING:
    from stepcore.engine.world import World
    from stepcore.viewing.frames import Replayed
    from stepcore.viewing.live import View

SomeWorld = TypeVar("SomeWorld", bound="World")
# Controls over a run: a function of (time, sim), or a table with a row for each control period.
Driven = Callable[[float, SomeWorld], ArrayLike] | ArrayLike | None

UNKEPT = "this trajectory has no snapshots to look at: only those that `Sim.run` returns have"
# Of more snapshots than this a notebook shows no page: 20 s.
INLINE = 1200

RECORDED = (
    *("qpos", "qvel", "act", "ctrl_history", "ctrl", "qfrc_applied", "xfrc_applied"),
    *("eq_active", "mocap_pos", "mocap_quat"),
    *("xpos", "xquat", "xmat", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat"),
    *("ten_length", "ten_velocity"),
    *("subtree_com", "cinert", "cvel", "cacc", "cfrc_ext", "cfrc_int"),
    *("energy", "momentum", "overlap", "bias", "passive", "qfrc_bias", "qfrc_passive"),
    *("actuator_length", "actuator_velocity"),
    "sensordata",
    *("qacc", "residual", "constraint_force", "qfrc_constraint", "actuator_force"),
    *("sweeps_done", "row_updates"),
    "unrecovered_overlap",
)


@dataclass(repr=False)
class Trajectory:
    """A recorded run: ``trajectory["qpos"]`` or ``trajectory.qpos``, with time as the first axis.

    time: [s], shape (steps + 1,).
    data: recorded arrays by name, shape (steps + 1, …); the first entry is the initial state.
    unsolved: the text of the `UnsolvedWarning` of this run, "" if there was none.
    snapshots: whole states of the run, at most 60 a second, from which it is looked at.

    >>> from stepcore import Sim, lesson
    >>> run = Sim(lesson.drop()).run(0.5)
    >>> run["qpos"].shape, [axis.entries for axis in run.axes("qpos")]
    ((251, 1), [('height0',)])
    """

    time: NDArray[np.float64]
    data: dict[str, NDArray[Any]] = field(default_factory=dict)
    unsolved: str = ""
    snapshots: Snapshots | None = None
    # Of a run that was read from a file, where no model names them.
    _axes: dict[str, tuple[Axis, ...]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A recorded array by its name, or "time".

        Raises KeyError, which names the nearest, for what was not recorded.
        """
        if name == "time":
            return self.time
        if name not in self.data:
            known = checks.nearest(name, self.data) if isinstance(name, str) else ""
            raise KeyError(f"{checks.shown(name)} was not recorded{known}")
        return self.data[name]

    def __contains__(self, name: object) -> bool:
        return name == "time" or name in self.data

    # A run has both instants and arrays: it is not gone through as a list of either.
    __iter__ = None

    def axes(self, name: str) -> tuple[Axis, ...]:
        """The axes of a recorded array after time, with their names in the model.

        The axes of "xpos" are "body", with the names of the bodies, and "xyz". Where nothing names
        an axis its entries are numbered.
        """
        if name in self._axes:
            return self._axes[name]
        model = None if self.snapshots is None else self.snapshots.model
        return axes_of(model, name, self[name].shape[1:])

    def _every_axis(self) -> dict[str, tuple[Axis, ...]]:
        return {name: self.axes(name) for name in self.data}

    def __getattr__(self, name: str) -> NDArray[Any]:
        # Looked up only when there is no such attribute; `data` is not there in a copy's making.
        data = self.__dict__.get("data", {})
        if name in data:
            return data[name]
        if name.startswith("__"):
            raise AttributeError(name)
        raise AttributeError(f'"{name}" was not recorded{checks.nearest(name, data)}')

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in self.data.items())
        end = f"{self.time[0]:g} to {self.time[-1]:g} s" if len(self.time) else "empty"
        return f"<Trajectory: {end}, {len(self.time)} instants; {shapes}>"

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Plots the run over time and returns the matplotlib figure.

        The plot shows energy and deepest overlap if they were recorded, else everything that was.
        path: a file to save the plot to. Needs matplotlib (the extra "plot").

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop())
        >>> sim.reset(key="start")
        >>> _ = sim.run(0.5, record=("energy", "overlap")).plot("drop.png")
        """
        from stepcore.report.plot import plot

        return plot("trajectory", self, path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the recorded arrays and the names of their axes to a file of numpy's (.npz).

        `Trajectory.load` reads it. It has no snapshots: what is to be looked at later is written
        by `save_html`, `save_video` or `save_mcap`. For other formats see `to_pandas`.

        Raises ValueError for a path that ends as another format does, such as .csv.

        >>> from stepcore import Sim, Trajectory, lesson
        >>> Sim(lesson.drop()).run(0.5).save("drop.npz")
        >>> Trajectory.load("drop.npz")["qpos"].shape
        (251, 1)
        """
        trajectory_file.write(path, self.time, self.data, self._every_axis(), self.unsolved)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Reads what `save` wrote.

        Raises ValueError for another file or a damaged one, FileNotFoundError, IsADirectoryError.
        """
        time, data, unsolved, axes = trajectory_file.read(path)
        return cls(time, data, unsolved, _axes=axes)

    def to_pandas(self) -> Any:
        """The run as a pandas DataFrame: a row for each instant, columns such as "qpos[knee]".

        Needs pandas (the extra "data").
        """
        return trajectory_file.to_pandas(self.time, self.data, self._every_axis())

    def to_xarray(self) -> Any:
        """The run as an xarray Dataset: ``dataset.xpos.sel(body="torso", xyz="z")``.

        Needs xarray (the extra "data").
        """
        return trajectory_file.to_xarray(self.time, self.data, self._every_axis())

    def save_mcap(self, path: str | os.PathLike[str]) -> None:
        """Writes the run as a log that Foxglove opens (MCAP, JSON with schemas).

        Topics: ``/tf``, where the bodies are (foxglove.FrameTransforms); ``/scene``, what they look
        like, and ``/contacts``, the forces as arrows (foxglove.SceneUpdate), both at the snapshots;
        ``/state``, energy, residual and contacts; ``/recorded``, the recorded arrays at every
        step. Times count from the beginning of simulated time. Needs the extra "mcap". See
        docs/view.md.

        Raises ValueError for a trajectory without snapshots, and OSError.
        """
        from stepcore.viewing.mcap_log import write

        write(self._replayed(), self.time, self.data, path)

    def view(self, *, host: str = "localhost", port: int = 8080, wait: bool | None = None) -> View:
        """Opens a page that replays the run, with a slider for time; see `stepcore.view`."""
        from stepcore.viewing.live import opened, view_runs

        return opened(view_runs([self._replayed()], host, port), wait)

    def save_html(
        self,
        path: str | os.PathLike[str],
        over: Sequence[Trajectory] = (),
        labels: Sequence[str] = (),
    ) -> None:
        """Writes a page that replays the run, which anybody opens without Python or a network.

        It can be paused, turned and moved through in time, at any speed; contacts are points,
        their forces arrows to scale; energy and the residual stand beside. The run is solved again
        from its snapshots, at most 60 for each second. Needs the extra "view". See docs/view.md.

        over: other runs of the same bodies, which are laid over this one, with their distance.
        labels: what this run and those are called.

        Raises ValueError for runs of other bodies, and OSError.

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop())
        >>> sim.reset(key="start")
        >>> sim.run(0.5).save_html("drop.html")
        """
        from stepcore.viewing.live import several
        from stepcore.viewing.page import save_page

        save_page(several([self, *over], labels), path)

    def save_video(
        self,
        path: str | os.PathLike[str],
        *,
        fps: float = 30.0,
        speed: float = 1.0,
        width: int = 640,
        height: int = 480,
        renderer: str | None = None,
    ) -> None:
        """Writes a video of the run, without a window or a graphics card.

        path: such as "run.mp4"; its ending says the format.
        fps: pictures per second of the video, 1 to 240. speed: how much faster than the motion.
        width, height: in points, even numbers.
        renderer: see `stepcore.picture`.

        The camera goes along with what moves. Needs the extra "video". Raises ValueError for
        values outside their limits.
        """
        from stepcore.viewing.picture import save_video

        save_video(self._replayed(), path, fps, speed, (width, height), renderer)

    def _replayed(self, label: str = "") -> Replayed:
        """The run for drawing, solved again from its snapshots.

        Raises ValueError for a trajectory without snapshots.
        """
        from stepcore.viewing.frames import replayed

        if self.snapshots is None or not self.snapshots.states:
            raise ValueError(UNKEPT)
        return replayed(self.snapshots, label)

    def _repr_html_(self) -> str | None:
        """The run as a notebook shows it: the page of `save_html`, if it is short."""
        if self.snapshots is None or len(self.snapshots.states) > INLINE:
            return None
        from stepcore.viewing.page import framed, page

        try:
            text = page([self._replayed()])
        except ImportError:
            return None
        return framed(text)


def record_run(
    sim: SomeWorld,
    duration: float,
    control: Driven[SomeWorld],
    control_dt: float | None,
    record: Sequence[str],
) -> Trajectory:
    """See `Sim.run`."""
    dt = sim.settings.dt
    steps = whole_steps("duration", duration, dt)
    period = 1 if control_dt is None else whole_steps("control_dt", control_dt, dt, least=1)
    ctrl_of = _ctrl_of(sim, control)
    names = recordable(record)
    data = {}
    try:
        time = np.empty(steps + 1)
        for name in names:
            value = np.asarray(getattr(sim, name))
            data[name] = np.empty((steps + 1, *value.shape), dtype=value.dtype)
    except MemoryError:
        what = f"duration = {duration:g}: {steps} steps of {', '.join(names)} exceed the memory"
        raise ValueError(f"{what}; run shorter pieces, or record less") from None
    residuals, stride = Residuals(sim), max(1, steps // LOOKS)
    snapshots = Taking(sim, steps)
    for step in range(steps + 1):
        time[step] = sim.time
        if step > 0 and step % stride == 0:
            residuals.look(sim)
        for name in names:
            data[name][step] = getattr(sim, name)
        if step < steps:
            if ctrl_of is not None and step % period == 0:
                sim.ctrl = ctrl_of(step // period)
            snapshots.look(step)
            sim.step()
    snapshots.look(steps)
    return Trajectory(time, data, residuals.sentence(sim.settings), snapshots.kept())


def whole_steps(name: str, value: float, dt: float, least: int = 0) -> int:
    """A time [s] in steps of `dt`; ValueError if it is not a whole number of steps."""
    number = checks.number(value)
    if number is None or number < 0:
        raise ValueError(f"{name} = {checks.shown(value)}: must be a finite number of seconds >= 0")
    if not number / dt <= checks.MOST_STEPS:
        limit = f"at most {checks.MOST_STEPS:g} steps of dt = {dt:g} s"
        raise ValueError(f"{name} = {number:g}: must be {limit}")
    steps = round(number / dt)
    if steps < least or not math.isclose(steps * dt, number, rel_tol=1e-6, abs_tol=1e-9 * dt):
        limit = f"a whole number of steps of dt = {dt:g} s"
        raise ValueError(f"{name} = {number:g}: must be {limit}")
    return steps


def _ctrl_of(sim: SomeWorld, control: Driven[SomeWorld]) -> Callable[[int], ArrayLike] | None:
    """A function from the index of a control period to its ctrl."""
    if control is None:
        return None
    if callable(control):
        checks.function("time", "sim")("run", "control", control)
        return lambda period: controls(control, sim)
    table = numbers("control", control)
    if table.ndim != 2 or table.shape[1] != sim.model.nu or not len(table):
        limit = f"of shape (n, {sim.model.nu}) with n > 0"
        raise ValueError(f"control has shape {table.shape}: must be {limit}")
    for row, ctrl in enumerate(table):
        _check_finite(sim, ctrl, f"in row {row} of control")
    return lambda period: table[min(period, len(table) - 1)]


def _check_finite(sim: World, table: NDArray[np.float64], where: str) -> None:
    """Checks controls before they are written, so that an error leaves ctrl as it was."""
    single = sim.settings.precision == "f32"
    with np.errstate(over="ignore"):
        finite = np.isfinite(table.astype(np.float32) if single else table)
    if not finite.all():
        k = np.argwhere(~finite)[0]
        index = ", ".join(str(i) for i in k)
        name = sim.model.actuator_names[k[-1]] if len(k) and k[-1] < sim.model.nu else ""
        of = f'actuator "{name}", ' if name else ""
        limit = "finite in single precision" if single else "finite"
        number = table[tuple(k)]
        value = f"ctrl{f'[{index}]' if index else ''} = {'NaN' if np.isnan(number) else number}"
        raise ValueError(f"{value}: must be {limit} ({of}{where}); the state was left as it is")


def recordable(record: Sequence[str], known: Sequence[str] = RECORDED) -> tuple[str, ...]:
    """The names, checked against those that can be recorded."""
    names = [record] if isinstance(record, str) else checks.listed(record)
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f'record = {checks.shown(record)}: must be names, such as ("qpos",)')
    for name in names:
        if name not in known:
            near = checks.nearest(name, known)
            raise ValueError(f"record: {checks.quoted(name)} cannot be recorded{near}")
    return tuple(names)
