"""`Log`: measurements of a robot over time, with the place of each column in a model."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.actuator import MOTOR, actuators
from stepcore.engine.axes import axes_of
from stepcore.engine.element import name_list
from stepcore.engine.model import Model
from stepcore.engine.start import Start
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.change import with_motors
from stepcore.experiment.log_files import TIMES, UNITS, content_of, parts_of, plain_unit
from stepcore.report.units import counted, seconds

# The quantities that a log can have: their names in sentences, and their names in columns.
SAID = {"qpos": "position", "qvel": "velocity", "effort": "torque", "ctrl": "control"}
SAID |= {"sensordata": "reading"}
SPELT = {
    "qpos": "qpos position pos angle q",
    "qvel": "qvel velocity vel speed qd dq",
    "effort": "effort torque force tau",
    "ctrl": "ctrl control command cmd",
    "sensordata": "sensordata sensor",
}
WORDS = {word: array for array, words in SPELT.items() for word in words.split()}
# "position[knee]"; "knee.position", "knee/position", "knee_position"; "knee [deg]", "knee_deg".
INDEXED = re.compile(r"(?P<word>\w+)\[(?P<name>.+)\]")
SUFFIXED = re.compile(r"(?P<name>.+)[./_](?P<word>[A-Za-z]+)")
UNIT = re.compile(r"(?P<name>.+?)(?:\s*\[([^][]*)\]|\s*\(([^()]*)\)|_([a-zµ]+))")
CLOCK = re.compile(r"[%_]*(time|t|stamp|time_?stamp|seconds|elapsed)_*", re.IGNORECASE)
# This many rows this far apart [s] have times in another unit: 2 Hz does not resolve the motion of
# a robot, and slower schedules that a person writes have fewer rows.
SLOW, MANY = 0.5, 20
# Positions of a hinge without limits beyond this many radians, nearly two turns, may be degrees.
TURNS = 10.0


class Names:
    """The names that columns of a log may have: the index of each name in each array of a model.

    own: names of coordinates, dofs, actuators and readings. also: the actuators of each joint, and
    the joint of each actuator.
    """

    def __init__(self, model: Any) -> None:
        is_model = isinstance(model, Model)
        sizes = {"ctrl": model.nu}
        if is_model:
            sizes |= {"qpos": model.nq, "qvel": model.nv, "effort": model.nv}
            sizes["sensordata"] = int(np.sum(model.sensor_dim))
        self.own: dict[str, dict[str, int]] = {array: {} for array in SAID}
        self.also: dict[str, dict[str, list[int]]] = {array: {} for array in SAID}
        for array, size in sizes.items():
            entries = entries_of(model, array, size) if is_model else model.called("actuator")
            self.own[array] = {name: k for k, name in enumerate(entries)}
        drives = model.called("actuator")
        for k, joint in enumerate(model.actuator_joint.tolist()):
            if joint >= 0 and (name := model.joint_names[joint]):
                self.also["ctrl"].setdefault(name, []).append(k)
                for array in ("qpos", "qvel", "effort"):
                    if name in self.own[array]:
                        self.also[array][drives[k]] = [self.own[array][name]]

        every = {name.lower(): name for indices in self.own.values() for name in indices}
        self._cased = every if len(every) == len({n for o in self.own.values() for n in o}) else {}
        some = "|".join(map(re.escape, sorted(self._cased, key=len, reverse=True)))
        self._any = re.compile(rf"(?<![^\W_])({some})(?![^\W_])", re.IGNORECASE)

    def spellings(self, title: str) -> Iterator[tuple[str, str]]:
        """Yield readings of a column's title, with names in the model's upper and lower case."""
        for text, unit in spellings(title):
            if self._cased and not self.knows(text):
                text = self._any.sub(lambda match: self._cased[match[0].lower()], text)
            yield text, unit

    def find(self, array: str, name: str) -> list[int]:
        """Return the entries of an array that a name denotes."""
        index = self.own[array].get(name)
        return self.also[array].get(name, []) if index is None else [index]

    def knows(self, name: str) -> bool:
        """Return whether an entry of the model has this name."""
        return any(name in indices for indices in self.own.values())

    def called(self, array: str, index: int) -> str:
        return list(self.own[array])[index]


def entries_of(model: Model, array: str, size: int) -> tuple[str, ...]:
    """Return the names of an array's entries, such as "knee" or "root.x"."""
    array = "qvel" if array == "effort" else array
    return axes_of(model, array, (size,))[0].entries if size else ()


@dataclass
class Placed:
    """A log as arrays of a model.

    arrays: numbers by array, shape (n, size), NaN where there are none. titles: the column of each
    entry that has one, by array and index; names: of the entries. unread: columns that match
    nothing in the model. notes: changes of the numbers.
    """

    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    titles: dict[tuple[str, int], str] = field(default_factory=dict)
    names: dict[str, list[str]] = field(default_factory=dict)
    unread: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def words(self) -> str:
        """The quantities read, in words: "position and torque of joint_1 … joint_7"."""
        alike: dict[str, list[str]] = {}
        for array in (array for array in SAID if array in self.names):
            names = self.names[array]
            few = ", ".join(names) if len(names) < 4 else f"{names[0]} … {names[-1]}"
            alike.setdefault(few, []).append(SAID[array])
        return "; ".join(f"{_and(words)} of {names}" for names, words in alike.items())

    def of(self, array: str) -> list[int]:
        """Return the entries of an array that have a column."""
        return [index for key, index in self.titles if key == array]


class Log:
    """A log of a robot: columns by joint, actuator or sensor over time.

    Every command and measurement takes the same logs: `ctrl` and `follow` of a `Motion`, and
    `identify`. See docs/your_robot.md.

    A column's title names a joint, an actuator or a sensor, and a quantity: "knee.position" [rad
    or m], "knee.velocity", "knee.effort" or "knee.torque" [N·m or N], "knee.control". "/" and "_"
    may replace the point; "position[knee]" means the same; topics may come first
    ("/joint_states/knee/position"). A unit may follow ("knee [deg]"), or the row below the names
    has the units. The name of a sensor alone means its reading, of an actuator its control, and of
    a joint its position; in controls without such words, a joint's name means its actuator.
    Each row holds from its time on. An empty cell is not measured.

    Times are a column "time", "t", "timestamp" or "stamp": in seconds, in the given unit
    ("t [ms]"), since 1970 in s, ms, µs or ns, or as dates of ISO 8601.

    source: a .csv, .npz, .npy, .parquet or .mcap file (one topic of MCAP, in JSON or a
        message of ROS 2); a DataFrame; a dict or a structured array of columns; rows without
        names; or a recorded run. "log.csv:effort" takes torques as controls, for which motors
        replace the model's servos; "log.mcap:/TOPIC" and "log.mcap:/TOPIC.effort" choose a topic.
    name: of the log in errors; a file's name replaces it.
    controls: the quantity taken as controls, as after the colon of a path, such as "effort".

    Attributes: `times` [s] from the first row on, (n,), None without; `columns`, numbers by name,
    (n,), or (n, m) for arrays; `source`, in words; `path`, or None.

    Raises ValueError for anything that is no log (with row, column and fix), ImportError without
    the package that a format needs, and OSError for a file that cannot be read.

    >>> log = Log({"t [ms]": [0, 8, 16], "knee [deg]": [0.0, 90.0, 180.0]})
    >>> log
    <Log: 16 ms at 125 Hz, knee [deg]>
    >>> log.times.tolist()
    [0.0, 0.008, 0.016]
    """

    # The meaning of a joint's name alone: "ctrl" or "qpos"; with "", two meanings are an error.
    expected = ""
    # Whether servos follow its positions; and whether the user could request that by `follow`.
    follows = can_follow = False
    # The time of the first row in the source [s].
    begin = 0.0

    def __init__(self, source: Any, name: str = "log", controls: str = "") -> None:
        if isinstance(source, Log):
            self.__dict__.update(source.__getstate__())
            return
        self.path = os.fsdecode(source) if isinstance(source, (str, os.PathLike)) else None
        self.source = name
        if self.path is not None:
            file, _, taken = parts_of(self.path)
            self.source, controls = os.path.basename(file), controls or taken
            if taken and taken not in WORDS and not file.endswith(".mcap"):
                limit = checks.nearest(taken, WORDS)
                raise ValueError(f"{self.path}: no quantity is named {checks.quoted(taken)}{limit}")
        elif isinstance(source, Trajectory):
            self.source = "a recorded run"
        self.taken = WORDS.get(controls, "")
        self._content = content_of(source, self.source)
        self.columns = dict(self._content.columns)
        if not any(array.size for array in self.columns.values()):
            raise ValueError(f"{self.source}: is empty; must hold a row of numbers")
        self.times = self._clocked()

    def __repr__(self) -> str:
        return f"<Log: {', '.join(filter(None, [self.pace, *self.columns]))}>"

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in vars(self).items() if key != "_last"}

    # --- times ------------------------------------------------------------------------------------

    @property
    def duration(self) -> float:
        """The time from the first row to the last [s]; 0 without times."""
        return 0.0 if self.times is None else float(self.times[-1])

    @property
    def gap(self) -> float | None:
        """The time between two rows [s]; None without times, or if it varies by more than 0.1 %."""
        if self.times is None or len(self.times) < 2:
            return None
        gap = self.duration / (len(self.times) - 1)
        # Loggers jitter, and seconds since 1970 are rounded to 0.2 µs.
        return gap if np.allclose(np.diff(self.times), gap, rtol=1e-3, atol=1e-6) else None

    @property
    def pace(self) -> str:
        """The length and the rate of the log in words; "" without times."""
        if self.times is None or len(self.times) < 2:
            return ""
        rate = (len(self.times) - 1) / self.duration
        return f"{seconds(self.duration)} at {'' if self.gap else 'about '}{rate:.4g} Hz"

    def _clocked(self) -> np.ndarray | None:
        """Take the times out of the columns [s], from the first row on; None without times."""
        for title, values in self.columns.items():
            clock = [u for text, u in spellings(title) if CLOCK.fullmatch(text.split("/")[-1])]
            if clock and values.ndim != 1:
                raise ValueError(f"{self.source}, column {title}: must have one time a row")
            if clock:
                del self.columns[title]
                self._check_text(title)
                unit = self._content.units.get(title, clock[-1])
                times = self._in_order(title, self._seconds(title, unit, values))
                self.begin = float(times[0])
                return times - times[0]
        return None

    def _seconds(self, title: str, unit: str, values: np.ndarray) -> np.ndarray:
        """Return times in seconds; a missing unit is inferred."""
        scale = TIMES.get(plain_unit(unit))
        if scale is not None:
            return values * scale
        if unit:
            limit = f"must be one of {', '.join(TIMES)}"
            raise ValueError(f"{self.source}, column {title}: unit {checks.quoted(unit)}: {limit}")
        apart = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
        # Since 1970: from 2001 on, until 2286.
        since = [s for s in TIMES.values() if 1e9 <= values[0] * s < 1e10 and apart * s < SLOW]
        if not since and apart >= SLOW and len(values) >= MANY:
            raise ValueError(
                f"{self.source}, column {title}: rows are {apart:g} s apart, which looks like "
                f'milliseconds or nanoseconds: tell the unit, as in "t [ms]" or "t [s]"'
            )
        return values * since[0] if since else values

    def _in_order(self, title: str, times: np.ndarray) -> np.ndarray:
        """Return times; raise ValueError for one that is not finite, or does not increase."""
        bad = np.flatnonzero(~np.isfinite(times))
        if len(bad):
            raise ValueError(f"{self.at(bad[0], title)} = {times[bad[0]]}: must be a time")
        late = np.flatnonzero(np.diff(times) <= 0)
        if len(late):
            k = int(late[0]) + 1
            problem, cure = "is before", "sort the rows by time"
            if times[k] == times[k - 1]:
                problem, cure = "repeats", "keep one of them"
            raise ValueError(
                f"{self.at(k, title)}: {times[k]:.10g} s {problem} row {self._row(k - 1)}, "
                f"{times[k - 1]:.10g} s: times must be finite and increase: {cure}"
            )
        return times

    def _row(self, k: int) -> int:
        return int(k) if self._content.lines is None else self._content.lines[k]

    def at(self, row: int, title: str) -> str:
        """Return the place of a number in words; row: its index."""
        return f"{self.source}, row {self._row(row)}{f', column {title}' if title else ''}"

    def _check_text(self, title: str) -> None:
        if title in self._content.texts:
            row, cell = self._content.texts[title]
            where = f"{self.source}, row {row}, column {title}"
            raise ValueError(f"{where}: {checks.shown(cell)}: must be a number or empty")

    # --- columns ----------------------------------------------------------------------------------

    def placed(self, model: Any) -> Placed:
        """Return the log as arrays of a Model, or of an object that names parts as a Model does.

        Raises ValueError for a column with two meanings, for two columns of one meaning, for one
        that is nearly the name of an entry without a column, and for cells that are no numbers.
        """
        last = self.__dict__.get("_last")
        if last is None or last[0] is not model:
            last = self.__dict__["_last"] = (model, self._placed(model))
        placed: Placed = last[1]
        return placed

    def _placed(self, model: Any) -> Placed:
        names, placed, bare = Names(model), Placed(), list[str]()
        for title, values in self.columns.items():
            if values.ndim == 2:
                self._put_array(names, placed, title, values)
            elif (place := self._worded(names, title)) is not None:
                self._put(names, placed, title, self.columns[title], place)
            else:
                bare.append(title)
        has_arrays = bool(placed.arrays)
        drives = set(placed.of("ctrl"))
        for title in bare:
            named = {text for text, _ in names.spellings(title)} - names.own["qpos"].keys()
            drives |= {names.own["ctrl"][text] for text in named & names.own["ctrl"].keys()}
        for title in bare:
            place = self._bare(names, title, has_arrays, drives)
            if place is None:
                placed.unread.append(title)
            else:
                self._put(names, placed, title, self.columns[title], place)
        self._check_unread(names, placed)
        if self.times is None and {"qvel", "effort"} & placed.arrays.keys() and len(values) > 1:
            cure = 'name a column "time", or "t [ms]"'
            raise ValueError(f"{self.source}: has {placed.words}, and no times: {cure}")
        if "effort" in placed.names and "ctrl" not in placed.names:
            without = [
                name for name in placed.names.get("qpos", ()) if name not in placed.names["effort"]
            ]
            placed.notes += [f"no torque of {name_list(without)}"] if without else []
        if isinstance(model, Model):
            self._check_degrees(model, placed)
            self._unwrap(model, placed)
        placed.notes += self._gaps()
        return placed

    def _gaps(self) -> list[str]:
        """Return a note on rows that are missing between others, if most rows are regular."""
        if self.times is None or len(self.times) < MANY:
            return []
        apart = np.diff(self.times)
        usual = float(np.median(apart))
        missing = np.round(apart / usual) - 1
        rows, longest = int(missing.sum()), int(apart.argmax())
        if not rows or np.mean(missing > 0) > 0.25:
            return []
        at = seconds(float(self.times[longest]))
        gap = f"the longest gap is {seconds(float(apart[longest]))}, at {at}"
        return [f"{counted(rows, 'row')} of {len(apart) + 1 + rows} are missing ({gap})"]

    def _worded(self, names: Names, title: str) -> tuple[str, int, str] | None:
        """Return array, entry and unit of a column such as "knee.position"; None for another."""
        for text, unit in names.spellings(title):
            match = INDEXED.fullmatch(text) or SUFFIXED.fullmatch(text)
            if match is None or names.knows(text):
                continue
            array = WORDS.get(match["word"].lower(), "")
            if self.expected == "ctrl" and self.taken == array != "effort":
                array = "ctrl"
            if array and (index := self._entry(names, array, match["name"])) is not None:
                return array, index, unit
        return None

    def _bare(
        self, names: Names, title: str, has_arrays: bool, drives: Collection[int]
    ) -> tuple[str, int, str] | None:
        """Return array, entry and unit of a column whose title is just a name of the model.

        has_arrays: whether other columns name their quantity. drives: actuators that have a column.
        """
        for text, unit in names.spellings(title):
            keys = [key for key in ("ctrl", "qpos", "sensordata") if text in names.own[key]]
            joint = text in names.own["qpos"] or text in names.also["ctrl"]
            if joint and self.expected == "ctrl" and not has_arrays:
                moved = self._entry(names, "ctrl", text)
                if moved is not None and moved not in drives:
                    return "ctrl", moved, unit
            if not keys:
                continue
            if joint and len(keys) > 1:
                taken = self._entry(names, "ctrl", text) in drives
                if not (self.expected or taken or keys == ["qpos"]):
                    words = " or ".join(f"{text}.{SAID[key]}" for key in sorted(keys, reverse=True))
                    where = f"{self.source}: column {checks.quoted(text)}"
                    raise ValueError(f"{where}: must be {words}")
                keys = ["qpos"]
            return keys[0], names.own[keys[0]][text], unit
        return None

    def _entry(self, names: Names, array: str, name: str) -> int | None:
        """Return the entry of an array that a name denotes; None without one."""
        entries = names.find(array, name)
        if len(entries) > 1:
            several = ", ".join(names.called(array, k) for k in entries)
            raise ValueError(f"{self.source}: several actuators drive joint {name}: {several}")
        return entries[0] if entries else None

    def _put_array(self, names: Names, placed: Placed, title: str, values: np.ndarray) -> None:
        """Put rows of all entries of an array: of a title such as "qpos", or without a title."""
        array = WORDS.get(title, "") if title else self.expected
        if not array:
            placed.unread.append(title)
            return
        width = len(names.own[array])
        if values.shape[1] != width:
            limit = "one row a period" if array == "ctrl" else "or have columns by joint"
            called = f"{self.source}: {title}" if title else self.source
            raise ValueError(f"{called} has shape {values.shape}: must be (n, {width}), {limit}")
        for k, name in enumerate(names.own[array]):
            column = f"{title}[{name}]" if title else name
            self._put(names, placed, column, values[:, k], (array, k, ""))

    def _put(
        self,
        names: Names,
        placed: Placed,
        title: str,
        values: np.ndarray,
        place: tuple[str, int, str],
    ) -> None:
        """Put the numbers of a column at its place: array, entry, and the unit in its title."""
        array, k, title_unit = place
        self._check_text(title)
        unit = self._content.units.get(title, title_unit)
        scale, name = UNITS.get(plain_unit(unit)), names.called(array, k)
        where = f"{self.source}, column {title}"
        if scale is None:
            limit = "must be rad, deg, m, mm, N·m or N, or these per second"
            raise ValueError(f"{where}: unit {checks.quoted(unit)}: {limit}")
        if (array, k) in placed.titles:
            problem = "is controlled" if array == "ctrl" else f"has its {SAID[array]} told"
            other = f"leave out this one or {placed.titles[array, k]}"
            raise ValueError(f"{where}: {checks.quoted(name)} {problem} by two columns: {other}")
        bad = np.flatnonzero(np.isinf(values))
        if len(bad):
            raise ValueError(f"{self.at(bad[0], title)} = {values[bad[0]]}: must be finite")
        empty = np.full((len(values), len(names.own[array])), np.nan)
        placed.arrays.setdefault(array, empty)[:, k] = scale * values
        placed.titles[array, k] = title
        placed.names.setdefault(array, []).append(name)

    def _check_unread(self, names: Names, placed: Placed) -> None:
        """Refuse titles that nearly name an entry without a column, and controls of nothing."""
        free = {
            array: [name for name, k in index.items() if (array, k) not in placed.titles]
            for array, index in names.own.items()
        }
        joints = [name for name, k in names.also["ctrl"].items() if not {*k} & {*placed.of("ctrl")}]
        free["ctrl"] += joints
        for title in placed.unread:
            text = title.strip("/ ").rpartition("/")[2]
            match = INDEXED.fullmatch(text) or SUFFIXED.fullmatch(text)
            array = WORDS.get(match["word"].lower(), "") if match else ""
            name = match["name"] if match and array else text
            choices = free[array] if array else [*free["ctrl"], *free["qpos"]]
            if name in choices and self.columns[title].ndim == 2:
                raise ValueError(f"{self.source}, column {title}: must have one number a row")
            # Other quantities of a joint, such as its temperature, have a point or brackets.
            plain_name = array or not re.search(r"[.[]", text)
            near = plain_name and difflib.get_close_matches(name, choices, 1, 0.7)
            nothing = self.expected and not {self.expected, "effort"} & placed.arrays.keys()
            if near or nothing or array == "ctrl":
                kind = {"ctrl": "actuator", "qpos": "joint"}.get(
                    array or self.expected, "joint or actuator"
                )
                nearest = checks.nearest(name, dict.fromkeys(choices))
                raise ValueError(
                    f"{self.source}: no {kind} is named {checks.quoted(title)}{nearest}"
                )

    def _unwrap(self, model: Model, placed: Placed) -> None:
        """Unwrap angles that jump by a turn, unless the result leaves the joint's range."""
        for joint, title, values in self._hinges(model, placed):
            measured, turn = np.isfinite(values), 2 * np.pi
            jumps = np.abs(np.diff(values[measured])) > 0.75 * turn
            if not jumps.any() or np.ptp(values[measured]) > turn:
                continue
            unwrapped = np.unwrap(values[measured], 0.75 * turn)
            limits = model.jnt_range[joint]
            outside = [np.abs(each - each.clip(*limits)) for each in (unwrapped, values)]
            if outside[0].max() <= np.nanmax(outside[1]):
                values[measured] = unwrapped
                count = counted(int(jumps.sum()), "jump")
                placed.notes.append(f"{title} is unwrapped at {count} by a turn")

    def _hinges(self, model: Model, placed: Placed) -> Iterator[tuple[int, str, np.ndarray]]:
        """Yield the hinges with a measured position, its column, and its values."""
        for joint, kind in enumerate(model.jnt_type):
            q = int(model.jnt_qposadr[joint])
            if kind == "hinge" and ("qpos", q) in placed.titles:
                yield joint, placed.titles["qpos", q], placed.arrays["qpos"][:, q]

    def _check_degrees(self, model: Model, placed: Placed) -> None:
        """Refuse positions that are far beyond the range, or in another unit than velocities."""
        for joint, title, values in self._hinges(model, placed):
            v, units = int(model.jnt_dofadr[joint]), {plain_unit(u) for _, u in spellings(title)}
            if (units - {""}) & UNITS.keys() or self._content.units.get(title):
                continue
            most = float(np.nanmax(np.abs(values), initial=0.0))
            limit = float(np.abs(model.jnt_range[joint]).max())
            why = f"reaches {most:.3g} rad, and the range of its joint {limit:.3g} rad"
            rate = 0.0
            if ("qvel", v) in placed.titles and self.times is not None and len(values) > 2:
                speed, moved = placed.arrays["qvel"][:, v], np.gradient(values, self.times)
                rate = float(np.nansum(speed * moved) / (np.nansum(speed**2) or 1.0))
            if np.degrees(0.8) < rate < np.degrees(1.2):
                why = f"changes {rate:.3g} times as fast as its velocity"
            elif limit == np.inf and most > TURNS and not self._turns(values):
                placed.notes.append(
                    f"{title} reaches {most:.3g} rad: if these are degrees, name the column "
                    f'"{title} [deg]"'
                )
                continue
            # A column within a radian would be within a degree.
            elif not max(3 * limit, 1.0) < most < np.degrees(3 * limit):
                continue
            cure = f'it looks like degrees: name the column "{title} [deg]"'
            raise ValueError(f"{self.source}, column {title}: {why}: {cure}")

    @staticmethod
    def _turns(values: np.ndarray) -> bool:
        """Return whether a joint goes on turning, as a wheel does: it does not come back."""
        measured = values[np.isfinite(values)]
        return abs(measured[-1] - measured[0]) > 0.5 * float(np.ptp(measured))

    # --- controls ---------------------------------------------------------------------------------

    def told(self, model: Any) -> str:
        """Describe the log in a line: "10 s at 125 Hz: position and torque of knee"."""
        placed = self.placed(model)
        return "; ".join([": ".join(filter(None, [self.pace, placed.words])), *placed.notes])

    def driven(self, model: Model) -> Model:
        """Return the model with motors for torques, or followed positions, that nothing drives.

        Joints without actuators get motors if the log has torques and no controls. If the log takes
        torques as controls, motors also replace other actuators.

        Raises ValueError for torques of joints whose actuators are no motors.
        """
        placed = self.placed(model)
        follows = self.follows
        if placed.of("ctrl") and not follows and self.taken != "effort":
            return model
        played = placed.of("qpos" if follows else "effort")
        drives = [] if follows else actuators(model)
        others = [d for d in drives if d.dof in placed.of("effort") and d.kind != MOTOR]
        if others and self.taken != "effort":
            names = name_list(model.called("actuator")[drive.index] for drive in others)
            path = self.path or "log.csv"
            follow = f"; to follow the positions, --follow {path} (follow=)" * self.can_follow
            raise ValueError(
                f"{self.source}: has torques and no controls, and {names} are no motors. To play "
                f"the torques, by motors in place of these, write {path}:effort (in Python "
                f'Log(…, controls="effort")){follow}'
            )
        # Followed joints get motors only if a model has no actuators at all; and if tendons are
        # driven, the torques of joints may come from them.
        driven = {drive.dof for drive in drives}
        free = not model.nu if follows else -1 not in driven
        places = model.jnt_qposadr if follows else model.jnt_dofadr
        joints = [
            joint
            for joint, kind in enumerate(model.jnt_type)
            if kind in ("hinge", "slide") and free and int(places[joint]) in {*played} - driven
        ]
        driven_model = with_motors(model, joints, [drive.index for drive in others])
        if driven_model is not model:
            called = [model.called("joint")[joint] for joint in joints]
            called += [model.called("actuator")[drive.index] for drive in others]
            quantity = "positions" if follows else "torques"
            driven_model.scene.notes.append(
                f"motors were made for the {quantity} of {self.source}: {name_list(called)}"
            )
        return driven_model

    def controls(self, model: Any, key_ctrl: np.ndarray) -> np.ndarray:
        """Return the controls of all actuators, (n, nu): as logged, or for the logged torques.

        key_ctrl: the controls of actuators without a column, (nu,).

        Raises ValueError for a log that drives nothing, and for a missing control.
        """
        placed = self.placed(model)
        played = {}
        if self.taken != "effort":
            played = {
                k: (placed.titles["ctrl", k], placed.arrays["ctrl"][:, k])
                for k in placed.of("ctrl")
            }
        for drive in actuators(model) if placed.of("effort") else ():
            if drive.kind == MOTOR and drive.dof in placed.of("effort"):
                force = placed.arrays["effort"][:, drive.dof] / drive.gear
                column = placed.titles["effort", drive.dof], (force - drive.offset) / drive.gain
                played.setdefault(drive.index, column)
        if not played:
            had = f"it has {placed.words}" if placed.words else "no column is of the model"
            cure = "name columns such as joint.control or joint.effort"
            if placed.of("qpos") and self.can_follow:
                cure += f", or follow the positions: --follow {self.path or 'FILE'} (follow=)"
            raise ValueError(f"{self.source}: has no controls: {had}: {cure}")
        count = next(len(array) for array in placed.arrays.values())
        rows = np.tile(key_ctrl, (count, 1))
        for k, (title, values) in played.items():
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                limit = "must be finite: a control that is not known cannot be played"
                raise ValueError(f"{self.at(bad[0], title)} is empty or nan: {limit}")
            rows[:, k] = values
        return rows

    def start(self, model: Model, home: Start) -> Start:
        """Return the start with the positions and velocities of the first row, if it has these."""
        arrays = self.placed(model).arrays
        rows = {key: arrays[key][0] for key in ("qpos", "qvel") if key in arrays}
        state = {key: np.where(np.isfinite(r), r, getattr(home, key)) for key, r in rows.items()}
        return replace(home, **state)


def spellings(title: str) -> Iterator[tuple[str, str]]:
    """Yield readings of a title and their unit or "": with topics before the name, then without.

    >>> [*spellings("/joints/knee [deg]")]
    [('joints/knee [deg]', ''), ('joints/knee', 'deg'), ('knee [deg]', ''), ('knee', 'deg')]
    """
    text = title.strip("/ ")
    while text:
        yield text, ""
        match = UNIT.fullmatch(text)
        unit = next(filter(None, match.groups()[1:]), "") if match else ""
        if match and (plain_unit(unit) in UNITS or text.endswith(("]", ")"))):
            yield match["name"], unit
        text = text.partition("/")[2]


def _and(words: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))
