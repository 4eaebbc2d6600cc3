"""Tables of a user: columns by name, or rows, from an array, a file, a DataFrame or a dict.

Parquet and logs of messages (MCAP) need packages of their own.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from stepcore import checks, files
from stepcore.engine.trajectory import Trajectory
from stepcore.viewing.needs import need

ENDINGS = (".csv", ".npz", ".npy", ".parquet", ".mcap")
# Names of a column of times: "time", "t", "Time [s]", "t_s".
TIME = re.compile(r"(time|t)([\s_]*[\[(]?s[\])]?)?", re.IGNORECASE)
# The path of an MCAP log, with a topic, and a field of its messages: "log.mcap:/joints.effort".
MCAP = re.compile(r"(?P<file>.+\.mcap)(:(?P<topic>[^:.]+)(\.(?P<field>\w+))?)?")
# The topic of arrays in logs of stepcore. An instant has these of the step before it.
OWN = "/recorded"
LATE = ("ctrl", "sensordata")
# Fields with the names of joints, in the messages of ROS; and their lists that are arrays of ours,
# where these are not the positions.
NAMES = ("name", "joint_names")
FIELDS = {"qvel": "velocity"}
TABLE = "a table"
# A recorded run, columns by name, or rows.
Content = Trajectory | dict[str, Any] | np.ndarray


def is_file(text: str) -> bool:
    """Return whether a text is the path of a file of a table, by its ending."""
    return text.endswith(ENDINGS) or MCAP.fullmatch(text) is not None


def read_table(table: Any, name: str) -> tuple[str, Content]:
    """Return the source of a user's table in words, and what it holds.

    table: an array; a dict, a DataFrame or a structured array of columns; a recorded run; or a file
        of one of these, but for logs of messages (.mcap).
    name: of the argument.

    Raises ValueError for what is no table, and OSError for a file that cannot be read.
    """
    if isinstance(table, (str, os.PathLike)):
        path = os.fsdecode(table)
        return os.path.basename(path), _of_file(path, name)
    if isinstance(table, Trajectory):
        return "a recorded run", table
    if isinstance(table, Mapping):
        return name, dict(table)
    if not (hasattr(table, "columns") and hasattr(table, "to_numpy")):
        return name, _of_array(name, table)
    # A DataFrame of pandas, polars or a similar library.
    names = list(table.columns)
    if not any(isinstance(column, str) for column in names):
        return name, numbers(name, table.to_numpy())
    _check_once(name, names)
    columns = {str(column): table[column].to_numpy() for column in names}
    index = getattr(table, "index", None)
    if TIME.fullmatch(str(getattr(index, "name", None) or "")):
        columns |= {"time": np.asarray(index)}
    return name, columns


def _of_array(source: str, array: Any) -> Content:
    """Return the columns of a structured array, or the rows of another one."""
    names = getattr(getattr(array, "dtype", None), "names", None)
    return {name: array[name] for name in names} if names else numbers(source, array)


def _of_file(path: str, name: str) -> Content:
    source = os.path.basename(path)
    if not is_file(path):
        raise ValueError(f"{name} = '{path}': must end in {', '.join(ENDINGS)}")
    if path.endswith(".csv"):
        try:
            return _of_text(source, files.read(path, TABLE).decode("utf-8-sig").splitlines())
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f"{source}: is not {TABLE}: {checks.one_line(error)}") from None
    if path.endswith(".parquet"):
        parquet = need("pyarrow.parquet", f"reading {checks.cut(path, 80)}", "data")
        data = files.read(path, TABLE)
        try:
            columns = parquet.read_table(io.BytesIO(data)).to_pydict()
        except (ValueError, TypeError, OSError) as error:
            raise ValueError(f"{path}: {checks.one_line(error)}") from None
        # Without the unnamed index of a DataFrame of pandas.
        return {key: columns[key] for key in columns if "__index_level_" not in key}
    arrays = files.arrays(path, TABLE)
    if path.endswith(".npy"):
        return _of_array(source, arrays[""])
    return Trajectory.load(path) if "kind" in arrays else arrays


def _of_text(source: str, lines: list[str]) -> Content:
    """Parse comma-, semicolon- or tab-separated values, with or without a line of names.

    An empty cell is NaN.
    """
    head = next((line for line in lines if line.strip()), "")
    delimiter = max(",;\t", key=head.count)
    (names,) = csv.reader([head.lstrip("# ")], delimiter=delimiter) if head else ([],)
    names = [name.strip() for name in names]
    named = bool(names) and not any(_is_number(name) for name in names)
    if named and not head.startswith("#"):
        lines = lines[lines.index(head) + 1 :]
    try:
        with warnings.catch_warnings():
            # numpy warns of an empty file, for which its user raises an error.
            warnings.simplefilter("ignore")
            rows = np.loadtxt(lines, delimiter=delimiter, ndmin=2, converters=_cell)
    except ValueError as error:
        raise ValueError(f"{source}: {checks.one_line(error)}") from None
    if not named or (head.startswith("#") and rows.size and len(names) != rows.shape[1]):
        return rows if rows.size else np.empty((0, 0))
    if rows.size and rows.shape[1] != len(names):
        raise ValueError(f"{source}: {len(names)} names stand above {rows.shape[1]} columns")
    _check_once(source, names)
    return dict(zip(names, rows.T if rows.size else np.empty((len(names), 0)), strict=True))


def _cell(text: str) -> float:
    return float(text.strip() or "nan")


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _check_once(source: str, names: Iterable[Any]) -> None:
    twice = [name for name, count in Counter(map(str, names)).items() if count > 1]
    if twice:
        raise ValueError(f"{source}: several columns are named {checks.quoted(min(twice))}")


def numbers(source: str, value: Any) -> np.ndarray:
    """Return an array of numbers; raise ValueError for anything else."""
    try:
        return np.asarray(value, float)
    except (TypeError, ValueError):
        limit = "numbers, one row a period"
        raise ValueError(f"{source} = {checks.shown(value)}: must be {limit}") from None


def times_of(source: str, times: Any, count: int) -> np.ndarray | None:
    """Return a column of times [s] for `count` rows; raise ValueError for another length."""
    if times is None:
        return None
    values = np.ravel(numbers(f"{source}, time", times))
    if len(values) != count:
        raise ValueError(f"{source}: {len(values)} times for {count} rows")
    return values


# --- logs of messages -----------------------------------------------------------------------------


def mcap_rows(path: str, array: str) -> tuple[np.ndarray, np.ndarray, tuple[str, ...] | None]:
    """Return times [s], rows, and the names of the columns, or None for rows of arrays.

    Times count from the file's first message, so that topics can be compared.
    The messages of one topic are read, in JSON or (with the package mcap-ros2-support) of ROS 2. A
    message has numbers by the names of actuators or joints; or a list of names with lists of
    numbers, as sensor_msgs/JointState has (by default "position"); or a list of numbers alone.

    path: the file, or with topic and field: "log.mcap:/joint_states.effort".
    array: the list that a message has alone, such as "ctrl" or "qpos"; of "qvel" a message with
        names has the list "velocity".

    Raises ImportError without mcap, ValueError for other files and messages, and OSError.
    """
    parts = MCAP.fullmatch(path)
    if parts is None:
        raise ValueError(f"{path}: must end in .mcap, or in .mcap:/TOPIC or .mcap:/TOPIC.FIELD")
    reader = need("mcap.reader", f"reading {checks.cut(path, 80)}", "mcap")
    found: dict[str, list[tuple[int, dict[str, float]]]] = {}
    unread, begin = set(), 0
    try:
        with files.opened(parts["file"], "a log", sys.maxsize) as (file, _):
            for _, _, message in reader.make_reader(file).iter_messages():
                begin = message.log_time
                break
            file.seek(0)
            messages = reader.make_reader(file).iter_messages(topics=parts["topic"])
            for schema, channel, message in messages:
                decode = _decoder(channel.message_encoding, schema)
                if decode is None:
                    unread.add(f"{channel.topic} ({channel.message_encoding})")
                elif row := _numbers(decode(message.data), parts["field"], array):
                    found.setdefault(channel.topic, []).append((message.log_time, row))
    except OSError:
        raise
    except Exception as error:  # mcap raises errors of its own, and those of struct and json
        raise ValueError(f"{path}: {checks.one_line(error)}") from None
    name = OWN if OWN in found else min(found, default="")
    if len(found) > 1 and name != OWN:
        raise ValueError(
            f"{path}: has numbers in {', '.join(sorted(found))}: choose one, as in log.mcap:/TOPIC"
        )
    if not found:
        other = f"; not read: {', '.join(sorted(unread))}" if unread else ""
        raise ValueError(
            f"{path}: has no messages with numbers by name, or lists of numbers{other}"
        )
    columns = tuple(found[name][0][1])
    if any(tuple(row) != columns for _, row in found[name]):
        raise ValueError(f"{path}: not all messages of {name} have the numbers of the first")
    times = 1e-9 * np.array([at - begin for at, _ in found[name]])
    rows = np.array([list(row.values()) for _, row in found[name]], float)
    if name == OWN and array in LATE:
        times, rows = times[:-1], rows[1:]
    return times, rows, None if columns[0].isdecimal() else columns


def _decoder(encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
    """Return the function that decodes a message, or None for a format that is not read."""
    if encoding == "json":
        return json.loads
    try:
        ros = need("mcap_ros2.decoder", "", "mcap")
    except ImportError:
        return None
    decode: Callable[[bytes], Any] | None = ros.DecoderFactory().decoder_for(encoding, schema)
    return decode


def _numbers(message: Any, field: str | None, array: str) -> dict[str, float]:
    """Return the numbers of a message by name; those of a list by their index."""
    names = next((names for word in NAMES if (names := _list(message, word))), None)
    if names is not None:
        values = _list(message, field or FIELDS.get(array, "position"))
        same = len(values) == len(names)
        return dict(zip(map(str, names), values, strict=True)) if same else {}
    values = _list(message, field or array)
    if values or field is not None:
        return {str(k): value for k, value in enumerate(values)}
    if not isinstance(message, dict):
        return {}
    return {
        name: value
        for name, value in message.items()
        if isinstance(value, (int, float)) and not isinstance(value, bool)
    }


def _list(message: Any, field: str) -> list[Any]:
    """Return a list in a message, [] for anything else."""
    value = message.get(field) if isinstance(message, dict) else getattr(message, field, None)
    if value is None or isinstance(value, (str, bytes, dict)) or np.ndim(value) != 1:
        return []
    return list(value)
