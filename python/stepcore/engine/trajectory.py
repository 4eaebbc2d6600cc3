"""`Trajectory` and `Rollout`: recorded runs, and the loop in which worlds are stepped."""

from __future__ import annotations

import csv
import math
import os
import zipfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks, files
from stepcore._core import Settings
from stepcore.engine.arrays import STATE, Floats, numbers
from stepcore.engine.axes import UNITS, Axis, axes_of
from stepcore.engine.control import evaluate_control, not_finite
from stepcore.engine.error_bar import driven_finer, recorded_names
from stepcore.engine.snapshots import RATE, Snapshots, Taking
from stepcore.engine.unsolved import LOOKS, Residuals
from stepcore.engine.world import READINGS, World
from stepcore.needs import need

if TYPE_CHECKING:
    from stepcore import _core
    from stepcore.viewing.frames import Replayed
    from stepcore.viewing.live import View

SomeWorld = TypeVar("SomeWorld", bound=World)
# Controls over a run: a function of (time, sim), or a table with a row for each control period.
Driven = Callable[[float, SomeWorld], ArrayLike] | ArrayLike | None

# Arrays whose values at an instant of a run belong to the step before it.
LATE = ("ctrl", "sensordata")
UNKEPT = "this trajectory has no snapshots to look at: only those that `Sim.run` returns have"

# Files: the version increases when the layout changes; the name of the column of times of a table;
# and extensions of other formats, with which a file name would be misleading.
KIND, VERSION, TIME = "stepcore trajectory", 1, "time [s]"
OTHERS = (".tsv", ".txt", ".json", ".xlsx", ".parquet", ".html", ".mcap", ".mp4", ".gif")

# Arrays that the engine samples within a run, see `sampled`; others are read between its calls.
SAMPLED = {
    *("time", "qpos", "qvel", "act", "ctrl_history", "ctrl", "xpos", "xquat", "energy"),
    *("qacc", "actuator_force"),
}
# Quantities recorded in a `Sim` only: counts of its solve, its error bar, and a pair of arrays.
OF_ONE_WORLD = ("sweeps_done", "row_updates", "momentum", "error", "body_error")
OF_WORLDS = (*READINGS, "energy", "overlap", "sensordata", "residual", "unrecovered_overlap")
RECORDED = (*OF_WORLDS, *OF_ONE_WORLD)


class Rollout(NamedTuple):
    """The states of a batch after every step.

    qpos: shape (n, steps, nq).
    qvel: shape (n, steps, nv).
    act: shape (n, steps, na).
    recorded: further recorded quantities by name, each of shape (n, steps, …).
    """

    qpos: Floats
    qvel: Floats
    act: Floats
    recorded: Mapping[str, NDArray[Any]] = {}


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
            nearest = checks.nearest(name, self.data) if isinstance(name, str) else ""
            raise KeyError(f"{checks.shown(name)} was not recorded{nearest}")
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

        The plot shows positions of joints, energy and deepest overlap if energy or overlap were
        recorded, else all recorded arrays.

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
        such as "qpos[knee]"; controls and sensor readings apply from the time of their row on, as
        in a `Log`. As the controls of a motion (``ctrl="run.csv"``), either file plays the recorded
        controls again.

        path: the file to write.

        Raises ValueError for a path with the extension of another format, such as .xlsx.

        >>> from stepcore import Sim, Trajectory, lesson
        >>> Sim(lesson.drop()).run(0.5).save("drop.npz")
        >>> Trajectory.load("drop.npz")["qpos"].shape
        (251, 1)
        """
        target = files.as_path("path", path)
        if target.lower().endswith(OTHERS):
            limit = "must end in .npz or .csv"
            frame = "to_pandas() has the frame that pandas writes in other formats"
            raise ValueError(f"path = {checks.shown(target)}: {limit}; {frame}")
        if target.lower().endswith(".csv"):
            # All digits, and time from the beginning of the run.
            columns = {TIME: self.time - self.time[:1]} | self._columns()
            with open(target, "w", encoding="utf-8", newline="") as file:
                csv.writer(file).writerow(columns)
                np.savetxt(file, np.column_stack(list(columns.values())), "%.17g", ",")
            return
        arrays = {"kind": np.array(KIND), "version": np.array(VERSION), "time": self.time}
        arrays["unsolved"] = np.array(self.unsolved)
        for name, values in self.data.items():
            arrays[f"data/{name}"] = values
            for k, axis in enumerate(self.axes(name)):
                arrays[f"axis/{name}/{k}/{axis.name}"] = np.array(axis.entries, dtype=np.str_)
        # Imported here so that the engine alone does not load the reports.
        from stepcore.report.outputs import MARK

        with open(target, "wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        with zipfile.ZipFile(target, "a") as archive:
            archive.comment = MARK.encode()

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a file written by `save`.

        path: the file to read.

        Raises ValueError for another or a damaged file, FileNotFoundError for a missing file and
        IsADirectoryError for a folder.
        """
        shown = checks.cut(source := files.as_path("path", path), 300)
        arrays = files.arrays(source, "a trajectory")
        if str(arrays.get("kind")) != KIND:
            raise ValueError(f"{shown}: is not a trajectory; `Trajectory.save` writes them")
        if str(arrays.get("version")) != str(VERSION):
            other = f"version {checks.cut(str(arrays.get('version')), 80)} of a trajectory"
            raise ValueError(f"{shown}: {other}; this stepcore reads version {VERSION}")
        try:
            return cls._of(arrays)
        except (ValueError, TypeError, KeyError, OverflowError):
            raise ValueError(f"{shown}: is no whole trajectory: it was edited or damaged") from None

    @classmethod
    def _of(cls, arrays: Mapping[str, NDArray[Any]]) -> Trajectory:
        """Return the run of a file's arrays; raise ValueError or KeyError if inconsistent."""
        time = arrays["time"]
        data = {n.removeprefix("data/"): arrays[n] for n in arrays if n.startswith("data/")}
        if time.ndim != 1 or time.dtype.kind != "f":
            raise ValueError("time")
        axes: dict[str, tuple[Axis, ...]] = dict.fromkeys(data, ())
        for name, entries in arrays.items():
            if name.startswith("axis/"):
                _, array, _, axis = name.split("/")
                axes[array] += (Axis(axis, tuple(map(str, entries))),)
        for name, values in data.items():
            if values.shape != (len(time), *(len(axis.entries) for axis in axes[name])):
                raise ValueError(name)
        return cls(time, data, str(arrays["unsolved"]), _axes=axes)

    def _columns(self) -> dict[str, NDArray[Any]]:
        """Return the values over time by names such as "qpos[knee]", each of shape (n,)."""
        columns: dict[str, NDArray[Any]] = {}
        for name, recorded in self.data.items():
            values = from_instant(name, recorded)
            entries = [axis.entries for axis in self.axes(name)]
            for index in np.ndindex(*values.shape[1:]):
                entry = ", ".join(names[k] for names, k in zip(entries, index, strict=True))
                columns[f"{name}[{entry}]" if entry else name] = values[(slice(None), *index)]
        return columns

    def to_pandas(self) -> Any:
        """Return the run as a pandas DataFrame.

        The frame has the columns of a .csv file; see `save`. Needs pandas (the extra "data").
        """
        pandas = need("pandas", "Trajectory.to_pandas", "data")
        return pandas.DataFrame(self._columns(), index=pandas.Index(self.time, name=TIME))

    def to_xarray(self) -> Any:
        """Return the run as an xarray Dataset: ``dataset.xpos.sel(body="torso", xyz="z")``.

        Needs xarray (the extra "data").
        """
        xarray = need("xarray", "Trajectory.to_xarray", "data")
        coordinates: dict[str, Any] = {"time": ("time", self.time, {"units": UNITS["time"]})}
        variables = {}
        for name, values in self.data.items():
            axes = self.axes(name)
            units = {"units": UNITS[name]} if name in UNITS else {}
            variables[name] = (("time", *(axis.name for axis in axes)), values, units)
            coordinates |= {a.name: (a.name, np.array(a.entries, dtype=np.str_)) for a in axes}
        return xarray.Dataset(variables, coordinates)

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
        from stepcore.viewing.mcap_log import write_mcap

        write_mcap(self._replayed(), self.time, self.data, path)

    def view(self, *, host: str = "localhost", port: int = 8080, wait: bool | None = None) -> View:
        """Open a page that replays the run, with a slider for time; see `stepcore.view`."""
        from stepcore.viewing.live import announced, view_runs

        return announced(view_runs([self._replayed()], host, port), wait)

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
        from stepcore.viewing.live import labelled_runs
        from stepcore.viewing.page import save_page

        save_page(labelled_runs([self, *over], labels), path)

    def save_video(
        self,
        path: str | os.PathLike[str],
        *,
        fps: float = 30.0,
        speed: float = 1.0,
        width: int = 640,
        height: int = 480,
    ) -> None:
        """Write a video of the run, without a window or a graphics card.

        path: such as "run.mp4"; the extension selects the format.
        fps: pictures per second of the video, 1 to 240.
        speed: playback speed relative to simulated time.
        width, height: size of a picture [pixels], even numbers.

        The camera follows the moving bodies. Needs the extra "video". Raises ValueError for values
        outside their limits.
        """
        from stepcore.viewing.picture import save_video

        save_video(self._replayed(), path, fps, speed, (width, height))

    def _replayed(self, label: str = "") -> Replayed:
        """Solve the run again from its snapshots, for drawing.

        Raises ValueError for a trajectory without snapshots.
        """
        from stepcore.viewing.frames import replayed

        if self.snapshots is None or not self.snapshots.states:
            raise ValueError(UNKEPT)
        return replayed(self.snapshots, label)

    def _repr_html_(self) -> str | None:
        """Return the page of `save_html` for a notebook, if the run has at most 20 s."""
        if self.snapshots is None or len(self.snapshots.states) > 20 * RATE:
            return None
        from stepcore.viewing.page import framed, replay_page

        try:
            text = replay_page([self._replayed()])
        except ImportError:
            return None
        return framed(text)


def from_instant(array: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return the values of a recorded array that apply from each instant on.

    An instant has the controls and the readings of the step before it. At the end the last controls
    continue, and the readings are unknown (NaN).
    """
    if array not in LATE:
        return values
    last = values[-1:] if array == "ctrl" else np.full_like(values[-1:], np.nan)
    return np.concatenate([values[1:], last])


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
    if callable(control):
        checks.function("time", "sim")("run", "control", control)
    elif control is not None:
        control = _table(sim, control)
    names = recorded_names(sim, recordable(record))
    try:
        values = {name: np.asarray(getattr(sim, name)) for name in ("time", *names)}
        arrays = {n: np.empty((steps + 1, *v.shape), dtype=v.dtype) for n, v in values.items()}
    except MemoryError:
        request = f"duration = {duration:g}: {steps} steps of {', '.join(names)} exceed the memory"
        raise ValueError(f"{request}; run shorter pieces, or record less") from None
    for name, value in values.items():
        arrays[name][0] = value
    residuals, stride, snapshots = Residuals(sim), max(1, steps // LOOKS), Taking(sim, steps)
    for done in pieces(sim, steps, control, period, arrays, (stride,), snapshots):
        if done and done % stride == 0:
            residuals.look(sim)
    time = arrays.pop("time")
    return Trajectory(time, arrays, residuals.sentence(sim.settings), snapshots.kept())


def pieces(
    sim: SomeWorld,
    steps: int,
    control: Driven[SomeWorld] = None,
    hold: int = 1,
    arrays: Mapping[str, NDArray[Any]] = MappingProxyType({}),
    pauses: Sequence[int] = (),
    snapshots: Taking | None = None,
) -> Iterator[int]:
    """Run a Sim under controls, and yield the number of completed steps at each pause.

    This is the only loop over control periods; between two pauses the engine runs uninterrupted.

    control: a function of (time, sim), or a table of controls; each applies for `hold` steps.
    arrays: arrays by name; the result of a step is written after the entry that it starts from.
    pauses: numbers of steps; the loop pauses at each multiple of each, and at both ends.
    snapshots: a recorder, which gets the controls of the following step.
    """
    function = control if callable(control) else None
    table = None if function is not None or control is None else np.asarray(control)
    looks = [*pauses, *([] if function is None else [hold])]
    looks += [] if snapshots is None else [snapshots.stride]
    done, names = 0, tuple(arrays)
    with driven_finer(sim, function) as beside:
        while done < steps:
            yield done
            count, rows = min([steps - done, *(each - done % each for each in looks)]), None
            if function is not None and done % hold == 0:
                beside()
                sim.ctrl = evaluate_control(function, sim)
            elif table is not None:
                periods = np.arange(done, done + count) // hold
                rows = table[np.minimum(periods, len(table) - 1)]
                sim.ctrl = rows[0]
            if snapshots is not None:
                snapshots.look(done)
            rooms = [array[None, done + 1 : done + 1 + count] for array in arrays.values()]
            samples(sim, names, count, None if rows is None else rows[None], rooms=rooms)
            done += count
    if snapshots is not None:
        snapshots.look(steps)
    yield steps


def samples(
    world: World,
    names: Sequence[str],
    steps: int,
    ctrl: Floats | None = None,
    callback: Callable[[int], object] | None = None,
    rooms: list[NDArray[Any]] | None = None,
) -> list[NDArray[Any]]:
    """Take steps, and return quantities after each of them, (worlds, steps, …).

    The engine takes all steps in one call if it samples all of these quantities; otherwise they are
    read between its calls.

    ctrl: a row for each step, (worlds, steps, nu); None leaves the present controls.
    callback: for a `Batch`, a function that is called with the number of new steps.
    rooms: arrays to write into, and to return.
    """
    extra = () if callback is None else (callback,)
    if _sampled(world, names):
        arrays, _ = world._call(world._core.follow, sample_request(names, steps), ctrl, *extra)
        if ctrl is None and "ctrl" in names:
            # The given values, not rounded to single precision.
            arrays[names.index("ctrl")][:] = world._arrays["ctrl"].reshape(len(arrays[0]), 1, -1)
        for room, values in zip(rooms or (), arrays, strict=rooms is not None):
            room[...] = values
        return list(arrays)
    if ctrl is not None and (bad := not_finite(world, ctrl)):
        raise ValueError(f"ctrl{list(bad)} = {ctrl[bad]}: must be finite; nothing was stepped")
    qpos = world._arrays["qpos"]
    batch, n = qpos.ndim > 1, len(qpos) if qpos.ndim > 1 else 1
    for step in range(steps):
        if ctrl is not None:
            world._arrays["ctrl"][...] = ctrl[:, step] if batch else ctrl[0, step]
        if batch:
            world._call(world._core.step, 1)
        else:
            world.step()
        values = [getattr(world, name) for name in names]
        rooms = [_room(value, n, steps, batch) for value in values] if rooms is None else rooms
        for room, value in zip(rooms, values, strict=True):
            room[:, step] = value
        if callback is not None:
            callback(1)
    return rooms or [_room(getattr(world, name), n, 0, batch) for name in names]


def _room(value: Any, n: int, steps: int, batch: bool) -> NDArray[Any]:
    """Return an array for a quantity of n worlds in this number of steps."""
    array = np.asarray(value)
    return np.empty((n, steps, *array.shape[batch:]), dtype=array.dtype)


def _sampled(world: World, names: Sequence[str]) -> bool:
    """Return whether the engine samples all of these quantities within its steps."""
    if getattr(world, "_finer", None) is not None:
        return False
    # With on_failure="go on", the last state of a failed world is read between calls.
    stands = getattr(world, "_on_failure", "stop") == "go on" and not set(names) <= set(STATE)
    return not stands and sampled(names, world.settings)


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
    table = numbers("control", control)
    if table.ndim != 2 or table.shape[1] != sim.model.nu or not len(table):
        limit = f"of shape (n, {sim.model.nu}) with n > 0"
        raise ValueError(f"control has shape {table.shape}: must be {limit}")
    if bad := not_finite(sim, table):
        (row, k), value, name = bad, table[bad], sim.model.actuator_names[bad[1]]
        where = f'actuator "{name}", ' * bool(name) + f"in row {row} of control"
        limit = "finite" + " in single precision" * (sim.settings.precision == "f32")
        reason = f"ctrl[{k}] = {'NaN' if np.isnan(value) else value}: must be {limit} ({where})"
        raise ValueError(f"{reason}; the state was left as it is")
    return table


def sampled(names: Collection[str], settings: Settings) -> bool:
    """Return whether the engine samples all of these quantities within a run."""
    # The last solve of an adaptive step belongs to a part of the step.
    solved = {"qacc", "actuator_force"} if settings.accuracy is not None else set()
    return set(names) <= SAMPLED - solved


def sample_request(
    names: Sequence[str],
    steps: int,
    every: int = 1,
    hold: int = 1,
    first: bool = False,
    bound: float = np.inf,
    most: float = np.inf,
) -> _core._Asked:
    """Return the engine's request for samples of a run; `first`: whether to sample the start."""
    return {
        "names": list(names),
        "steps": steps,
        "every": every,
        "hold": hold,
        "first": first,
        "bound": bound,
        "most": int(min(most, 2.0**63)),
    }


def recordable(record: Sequence[str], allowed: Sequence[str] = RECORDED) -> tuple[str, ...]:
    """Return the names as a tuple, after checking that each can be recorded."""
    names = [record] if isinstance(record, str) else checks.as_list(record)
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f'record = {checks.shown(record)}: must be names, such as ("qpos",)')
    for name in names:
        if name not in allowed:
            near = checks.nearest(name, allowed)
            raise ValueError(f"record: {checks.quoted(name)} cannot be recorded{near}")
    return tuple(names)
