"""`Trajectory`: the record of a run by `Sim.run`, and the loop that records the run."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore._core import Settings, SimulationError
from stepcore.engine import trajectory_file
from stepcore.engine.arrays import Floats, numbers
from stepcore.engine.axes import Axis, axes_of
from stepcore.engine.control import controls, finite_controls
from stepcore.engine.error_bar import driven, judged
from stepcore.engine.snapshots import Snapshots, Taking
from stepcore.engine.unsolved import LOOKS, Residuals

if TYPE_CHECKING:
    from stepcore import _core
    from stepcore.engine.world import World
    from stepcore.viewing.frames import Replayed
    from stepcore.viewing.live import View

SomeWorld = TypeVar("SomeWorld", bound="World")
# Controls over a run: a function of (time, sim), or a table with a row for each control period.
Driven = Callable[[float, SomeWorld], ArrayLike] | ArrayLike | None

UNKEPT = "this trajectory has no snapshots to look at: only those that `Sim.run` returns have"
# With more snapshots than this (20 s of motion) a notebook shows no page.
INLINE = 1200

# What the engine samples within a run, see `sampled`; the rest is read between its calls.
SAMPLED = {
    *("time", "qpos", "qvel", "act", "ctrl_history", "ctrl", "xpos", "xquat", "energy"),
    *("qacc", "actuator_force"),
}
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
    *("error", "body_error"),
)


@dataclass(repr=False)
class Trajectory:
    """A recorded run: ``trajectory["qpos"]`` or ``trajectory.qpos``, with time as the first axis.

    time: [s], shape (steps + 1,).
    data: recorded arrays by name, shape (steps + 1, …); the first entry is the initial state.
    unsolved: the text of the `UnsolvedWarning` of this run, "" if there was none.
    snapshots: complete states of the run, at most 60 a second, from which the run is drawn.

    >>> from stepcore import Sim, lesson
    >>> run = Sim(lesson.drop()).run(0.5)
    >>> run["qpos"].shape, [axis.entries for axis in run.axes("qpos")]
    ((251, 1), [('height0',)])
    """

    time: NDArray[np.float64]
    data: dict[str, NDArray[Any]] = field(default_factory=dict)
    unsolved: str = ""
    snapshots: Snapshots | None = None
    # Set for a run that was read from a file, because there is no model to name the axes.
    _axes: dict[str, tuple[Axis, ...]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a recorded array by its name, or "time".

        Raises KeyError, which suggests the nearest name, for an array that was not recorded.
        """
        if name == "time":
            return self.time
        if name not in self.data:
            known = checks.nearest(name, self.data) if isinstance(name, str) else ""
            raise KeyError(f"{checks.shown(name)} was not recorded{known}")
        return self.data[name]

    def __contains__(self, name: object) -> bool:
        return name == "time" or name in self.data

    # Iteration would be ambiguous, over instants or over arrays.
    __iter__ = None

    def axes(self, name: str) -> tuple[Axis, ...]:
        """Return the axes of a recorded array after time, with the model's names of their entries.

        For example, the axes of "xpos" are "body", with the names of the bodies, and "xyz". The
        entries of an axis without names are numbered.

        name: the name of the recorded array.
        """
        if name in self._axes:
            return self._axes[name]
        model = None if self.snapshots is None else self.snapshots.model
        return axes_of(model, name, self[name].shape[1:])

    def _every_axis(self) -> dict[str, tuple[Axis, ...]]:
        return {name: self.axes(name) for name in self.data}

    def __getattr__(self, name: str) -> NDArray[Any]:
        # Called only for missing attributes. `data` is missing too while a copy is constructed.
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
        """Plot the run over time and return the matplotlib figure.

        The plot shows energy and deepest overlap if they were recorded, else all recorded arrays.

        path: a file to save the plot to.

        Needs matplotlib (the extra "plot").

        >>> from stepcore import Sim, lesson
        >>> sim = Sim(lesson.drop())
        >>> sim.reset(key="start")
        >>> _ = sim.run(0.5, record=("energy", "overlap")).plot("drop.png")
        """
        from stepcore.report.plot import plot

        return plot("trajectory", self, path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the recorded arrays and the names of their axes to a file, .npz or .csv.

        `Trajectory.load` reads an .npz file. It has no snapshots, so that a loaded run cannot be
        drawn: use `save_html`, `save_video` or `save_mcap` for this purpose. For other formats see
        `to_pandas`.

        A .csv file has a row for each instant, a column "time [s]" that begins at 0, and columns
        such as "qpos[knee]". As the controls of a motion (``ctrl="run.csv"``), either file plays
        the recorded controls again.

        path: the file to write.

        Raises ValueError for a path with the extension of another format, such as .xlsx.

        >>> from stepcore import Sim, Trajectory, lesson
        >>> Sim(lesson.drop()).run(0.5).save("drop.npz")
        >>> Trajectory.load("drop.npz")["qpos"].shape
        (251, 1)
        """
        trajectory_file.write(path, self.time, self.data, self._every_axis(), self.unsolved)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a file written by `save`.

        path: the file to read.

        Raises ValueError for another or a damaged file, FileNotFoundError for a missing file and
        IsADirectoryError for a folder.
        """
        time, data, unsolved, axes = trajectory_file.read(path)
        return cls(time, data, unsolved, _axes=axes)

    def to_pandas(self) -> Any:
        """Return the run as a pandas DataFrame.

        The frame has a row for each instant and columns such as "qpos[knee]". Needs pandas (the
        extra "data").
        """
        return trajectory_file.to_pandas(self.time, self.data, self._every_axis())

    def to_xarray(self) -> Any:
        """Return the run as an xarray Dataset: ``dataset.xpos.sel(body="torso", xyz="z")``.

        Needs xarray (the extra "data").
        """
        return trajectory_file.to_xarray(self.time, self.data, self._every_axis())

    def save_mcap(self, path: str | os.PathLike[str]) -> None:
        """Write the run as a log for Foxglove (MCAP, JSON with schemas).

        Topics: ``/tf``, the poses of the bodies (foxglove.FrameTransforms); ``/scene``, the shapes
        of the bodies, and ``/contacts``, the contact forces as arrows (foxglove.SceneUpdate), both
        at the snapshots; ``/state``, energy, residual and contacts; ``/recorded``, the recorded
        arrays at every step. Time stamps are simulated time, counted from its beginning. Needs the
        extra "mcap". See docs/view.md.

        path: the file to write.

        Raises ValueError for a trajectory without snapshots, and OSError.
        """
        from stepcore.viewing.mcap_log import write

        write(self._replayed(), self.time, self.data, path)

    def view(self, *, host: str = "localhost", port: int = 8080, wait: bool | None = None) -> View:
        """Open a page that replays the run, with a slider for time; see `stepcore.view`."""
        from stepcore.viewing.live import opened, view_runs

        return opened(view_runs([self._replayed()], host, port), wait)

    def save_html(
        self,
        path: str | os.PathLike[str],
        over: Sequence[Trajectory] = (),
        labels: Sequence[str] = (),
    ) -> None:
        """Write a page that replays the run; the page needs neither Python nor a network.

        The page has controls for pause, camera, time and speed. Contacts are points, and contact
        forces are arrows to scale. Energy and the residual are shown next to the picture. The run
        is solved again from its snapshots, at most 60 a second. Needs the extra "view". See
        docs/view.md.

        path: the file to write.
        over: other runs of the same bodies, drawn over this run, with the distance between them.
        labels: names of this run and of the other runs.

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
        """Write a video of the run, without a window or a graphics card.

        path: such as "run.mp4"; the extension selects the format.
        fps: pictures per second of the video, 1 to 240.
        speed: playback speed relative to simulated time.
        width, height: size of a picture [pixels], even numbers.
        renderer: see `stepcore.picture`.

        The camera follows the moving bodies. Needs the extra "video". Raises ValueError for values
        outside their limits.
        """
        from stepcore.viewing.picture import save_video

        save_video(self._replayed(), path, fps, speed, (width, height), renderer)

    def _replayed(self, label: str = "") -> Replayed:
        """Solve the run again from its snapshots, for drawing.

        Raises ValueError for a trajectory without snapshots.
        """
        from stepcore.viewing.frames import replayed

        if self.snapshots is None or not self.snapshots.states:
            raise ValueError(UNKEPT)
        return replayed(self.snapshots, label)

    def _repr_html_(self) -> str | None:
        """Return the page of `save_html` for a notebook, if the run is short."""
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
    """Simulate and record a run; see `Sim.run`."""
    dt = sim.settings.dt
    steps = whole_steps("duration", duration, dt)
    period = 1 if control_dt is None else whole_steps("control_dt", control_dt, dt, least=1)
    function = control if callable(control) else None
    if function is not None:
        checks.function("time", "sim")("run", "control", function)
    table = None if callable(control) or control is None else _table(sim, control)
    names = judged(sim, recordable(record))
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
    snapshots, finer = Taking(sim, steps), getattr(sim, "_finer", None)
    whole = finer is None and sampled(names, sim.settings)
    arrays, done = {"time": time, **data}, 0
    for name, values in arrays.items():
        values[0] = getattr(sim, name)
    # Until somebody looks at the Sim it runs in one call.
    looks = (stride, snapshots.stride, steps if function is None else period) if whole else (1,)
    with driven(sim, control) as beside:
        while done < steps:
            if function is not None and done % period == 0:
                beside()
                sim.ctrl = controls(function, sim)
            snapshots.look(done)
            count = min(steps - done, *(each - done % each for each in looks))
            rows = None
            if table is not None:
                periods = np.arange(done, done + count) // period
                rows = table[np.minimum(periods, len(table) - 1)]
            if whole:
                sampled_steps(sim, count, rows, arrays, done + 1)
            else:
                if rows is not None:
                    sim.ctrl = rows[0]
                sim.step()
                for name, values in arrays.items():
                    values[done + 1] = getattr(sim, name)
            done += count
            if done % stride == 0:
                residuals.look(sim)
    snapshots.look(steps)
    return Trajectory(time, data, residuals.sentence(sim.settings), snapshots.kept())


def whole_steps(name: str, value: float, dt: float, least: int = 0) -> int:
    """Convert a time [s] to steps of `dt`; raise ValueError unless the number is whole."""
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


def _table(sim: SomeWorld, control: ArrayLike) -> Floats:
    """Return a table of controls, with a row for each period."""
    table = numbers("control", control)
    if table.ndim != 2 or table.shape[1] != sim.model.nu or not len(table):
        limit = f"of shape (n, {sim.model.nu}) with n > 0"
        raise ValueError(f"control has shape {table.shape}: must be {limit}")
    _check_finite(sim, table)
    return table


def sampled(names: Collection[str], settings: Settings) -> bool:
    """Return whether the engine samples all of these quantities within a run."""
    # What was solved last within an accuracy belongs to a part of a step.
    solved = {"qacc", "actuator_force"} if settings.accuracy is not None else set()
    return set(names) <= SAMPLED - solved


def every_step(names: list[str], steps: int) -> _core._Asked:
    """Return what the engine is asked for by who wants a sample of each step, and gives its row."""
    return {
        "names": names,
        "steps": steps,
        "every": 1,
        "hold": 1,
        "first": False,
        "bound": np.inf,
    }


def sampled_steps(
    sim: World,
    count: int,
    rows: Floats | None,
    arrays: Mapping[str, Floats] = {},
    place: int = 0,
) -> None:
    """Take steps of a Sim, each with its row of controls, and write what comes of them.

    arrays: by name; the first step is written at `place`.
    """
    own = None if rows is None else rows[None]
    try:
        samples, _ = sim._core.follow(every_step(list(arrays), count), own)
    except SimulationError as error:
        sim._explain(error)
        raise
    for (name, values), sample in zip(arrays.items(), samples, strict=True):
        values[place : place + count] = sim.ctrl if name == "ctrl" and rows is None else sample[0]


def _check_finite(sim: World, table: NDArray[np.float64]) -> None:
    """Check rows of controls before the run, so that an error leaves the Sim unchanged."""
    finite = finite_controls(sim, table)
    if not finite.all():
        row, k = np.argwhere(~finite)[0]
        name = sim.model.actuator_names[k]
        of = f'actuator "{name}", ' if name else ""
        limit = "finite in single precision" if sim.settings.precision == "f32" else "finite"
        value = f"ctrl[{k}] = {'NaN' if np.isnan(table[row, k]) else table[row, k]}"
        where = f"{of}in row {row} of control"
        raise ValueError(f"{value}: must be {limit} ({where}); the state was left as it is")


def recordable(record: Sequence[str], known: Sequence[str] = RECORDED) -> tuple[str, ...]:
    """Return the names as a tuple, after checking that each can be recorded."""
    names = [record] if isinstance(record, str) else checks.listed(record)
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f'record = {checks.shown(record)}: must be names, such as ("qpos",)')
    for name in names:
        if name not in known:
            near = checks.nearest(name, known)
            raise ValueError(f"record: {checks.quoted(name)} cannot be recorded{near}")
    return tuple(names)
