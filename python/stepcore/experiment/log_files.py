"""The sources of a log: CSV, npz, Parquet and MCAP files, DataFrames, dicts and arrays.

`content_of` returns the columns of a source; `stepcore.experiment.log` interprets them.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from stepcore import checks, files
from stepcore.engine.trajectory import KIND, Trajectory, from_instant
from stepcore.needs import need

ENDINGS = (".csv", ".npz", ".npy", ".parquet", ".mcap")
# A path, then after a colon the topic of an MCAP file and the quantity taken as controls:
# "log.csv:effort", "log.mcap:/joints.effort".
PATH = re.compile(
    rf"(?P<file>.+({'|'.join(map(re.escape, ENDINGS))}))(:(?P<part>[^:]+))?", re.DOTALL
)
TABLE = "a table"
# The endings of other recordings of ROS: SQLite of ROS 2, and ROS 1.
ROS = (".db3", ".bag")
# Cells without a number, and the beginnings of lines that are comments.
MISSING = ("", "nan", "null", "none", "na", "n/a", "-", "--")
COMMENTS = ("#", "%", "//")
# The factors of units to SI units; times are in seconds.
TIMES = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
UNITS = TIMES | dict.fromkeys(("", "-", "1", "rad", "rad/s", "m", "m/s"), 1.0)
UNITS |= dict.fromkeys(("deg", "degree", "degrees", "°"), math.pi / 180)
UNITS |= {f"{name}/s": UNITS[name] for name in ("deg", "degree", "degrees", "°")}
UNITS |= dict.fromkeys(("nm", "n·m", "n*m", "n.m", "n m", "n"), 1.0)
UNITS |= {"mm": 1e-3, "cm": 1e-2, "mm/s": 1e-3, "cm/s": 1e-2, "mnm": 1e-3, "kn": 1e3, "knm": 1e3}
UNITS |= {"rpm": math.pi / 30, "1/min": math.pi / 30}
# The topic of arrays in logs of stepcore.
OWN = "/recorded"
# The lists of names, and the lists of numbers in their order, in the messages of ROS.
NAMES, STATES = ("name", "names", "joint_names"), ("position", "velocity", "effort")


@dataclass
class Content:
    """Columns by name, each of shape (n,) or (n, m); rows without names have the key "".

    units: of columns, if the file gives them apart from the names. lines: the line of each row in
    a text file. texts: the first cell of each column that is not a number: its place and its text.
    """

    columns: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    lines: Sequence[int] | None = None
    texts: dict[str, tuple[int, str]] = field(default_factory=dict)


def parts_of(path: str) -> tuple[str, str | None, str]:
    """Return the file of a path, the topic of an MCAP file or None, and the quantity taken.

    >>> parts_of("log.csv:effort"), parts_of("a.mcap:/joints.effort"), parts_of("a.mcap:/joints")
    (('log.csv', None, 'effort'), ('a.mcap', '/joints', 'effort'), ('a.mcap', '/joints', ''))
    """
    match = PATH.fullmatch(_in_folder(path))
    if match is None:
        raise ValueError(f"{checks.cut(path, 200)}: must end in {endings_for(path)}")
    file, part = match["file"], match["part"] or ""
    if not file.endswith(".mcap") or part in STATES:
        return file, None, part
    topic, _, taken = part.partition(".")
    return file, topic or None, taken


def is_file(text: str) -> bool:
    """Return whether a text is the path of a log, by its ending, or of a rosbag2 folder."""
    return PATH.fullmatch(_in_folder(text)) is not None


def endings_for(path: str) -> str:
    """Return the endings of logs in words; for a recording of ROS in another format, how to convert
    it.
    """
    folder = path.partition(":")[0]
    inside = os.listdir(folder) if os.path.isdir(folder) else []
    endings = ", ".join(ENDINGS)
    if not any(name.endswith(ROS) for name in (folder, *inside)):
        return endings
    command = f"rosbags-convert --src {checks.cut(folder, 200)} --dst FOLDER --dst-storage mcap"
    return f"{endings}; `{command}` (pip install rosbags) writes a folder with a .mcap file"


def _in_folder(path: str) -> str:
    """Return a path in which the folder of a rosbag2 is replaced by its only .mcap file."""
    folder, colon, part = path.partition(":")
    if not os.path.isdir(folder):
        return path
    files = sorted(name for name in os.listdir(folder) if name.endswith(".mcap"))
    if len(files) > 1:
        raise ValueError(
            f"{checks.cut(folder, 200)}: has {len(files)} .mcap files: name one, such as "
            f"{os.path.join(folder, files[0])}"
        )
    return f"{os.path.join(folder, files[0])}{colon}{part}" if files else path


def content_of(source: Any, name: str) -> Content:
    """Return the content of a user's source.

    name: of the source in errors.

    Raises ValueError for anything that is no table, ImportError, and OSError for a file.
    """
    if isinstance(source, (str, os.PathLike)):
        return _of_file(os.fsdecode(source), name)
    if isinstance(source, Trajectory):
        arrays = {key: from_instant(key, a) for key, a in source.data.items() if a.ndim == 2}
        return Content({"time": source.time, **arrays}, {"time": "s"})
    if isinstance(source, Mapping):
        return _of_columns(name, source)
    if not (hasattr(source, "columns") and hasattr(source, "to_numpy")):
        names = getattr(getattr(source, "dtype", None), "names", None)
        return _of_columns(name, {key: source[key] for key in names or ()} or {"": source})
    # A DataFrame of pandas, polars or a similar library.
    titles = list(source.columns)
    if not any(isinstance(title, (str, tuple)) for title in titles):
        return _of_columns(name, {"": source.to_numpy()})
    called = [
        "/".join(map(str, title)) if isinstance(title, tuple) else str(title) for title in titles
    ]
    _check_once(name, called)
    columns = {key: source[title].to_numpy() for key, title in zip(called, titles, strict=True)}
    index = getattr(source, "index", None)
    dated = str(getattr(index, "dtype", "")).startswith(("datetime", "timedelta"))
    title = "time" if dated else getattr(index, "name", None)
    if title is not None:
        columns[str(title)] = np.asarray(index)
    return _of_columns(name, columns)


def _of_file(path: str, name: str) -> Content:
    file, topic, taken = parts_of(path)
    if file.endswith(".mcap"):
        return _of_messages(file, topic, taken)
    if file.endswith(".csv"):
        try:
            return _of_text(name, _decoded(files.contents(file, TABLE)))
        except csv.Error as error:
            raise ValueError(f"{name}: is not {TABLE}: {checks.one_line(error)}") from None
    if file.endswith(".parquet"):
        parquet = need("pyarrow.parquet", f"reading {checks.cut(file, 80)}", "data")
        data = files.contents(file, TABLE)
        try:
            columns = parquet.read_table(io.BytesIO(data)).to_pydict()
        except (ValueError, TypeError, OSError) as error:
            raise ValueError(f"{file}: {checks.one_line(error)}") from None
        # Without the unnamed index of a DataFrame of pandas.
        return _of_columns(name, {key: columns[key] for key in columns if "__index_" not in key})
    arrays = files.arrays(file, TABLE)
    if str(arrays.get("kind")) == KIND:
        return content_of(Trajectory.load(file), name)
    if file.endswith(".npy") and (fields := arrays[""].dtype.names):
        arrays = {key: arrays[""][key] for key in fields}
    return _of_columns(name, arrays)


# --- columns --------------------------------------------------------------------------------------


def _of_columns(name: str, columns: Mapping[Any, Any]) -> Content:
    """Return columns of the same length; a single number applies to all rows.

    Arrays "position", "velocity" and "effort" next to a list of names have a column for each name.
    """
    content = Content({})
    names = next((list(map(str, columns[key])) for key in NAMES if key in columns), None)
    for title, values in columns.items():
        array = _numbers(name, str(title), values, content)
        if str(title) in NAMES:
            continue
        if array.ndim > 2:
            raise ValueError(f"{name}, column {title}: must have a number a row, or one an element")
        if names is not None and title in STATES and array.shape[1:] == (len(names),):
            content.columns |= {f"{joint}.{title}": array[:, k] for k, joint in enumerate(names)}
        else:
            content.columns[str(title)] = array
    rows = max((len(array) for array in content.columns.values() if array.ndim), default=0)
    if names is None and [*content.columns] == [""]:
        content.columns[""] = content.columns[""].reshape(rows, -1 if rows else 0)
    for title, array in content.columns.items():
        if array.ndim == 0 or (array.ndim == 1 and len(array) == 1):
            content.columns[title] = np.broadcast_to(np.ravel(array), max(rows, 1))
        elif len(array) != rows:
            raise ValueError(f"{name}: column {checks.quoted(title)} has another length")
    return content


def _numbers(name: str, title: str, values: Any, content: Content) -> np.ndarray:
    """Return values as numbers, times in seconds; record the other texts in `content`."""
    array = values if isinstance(values, np.ndarray) else _array(name, title, values)
    if array.dtype.kind in "Mm":
        content.units[title] = "s"
        ticks = array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64)
        return np.where(np.isnat(array), np.nan, 1e-9 * ticks)
    if array.dtype.kind in "OUS" and array.ndim == 1:
        return np.array([*_cells(title, enumerate(array.tolist()), content)])
    if array.dtype.kind in "OUScV":
        limit = "numbers, one row a period"
        raise ValueError(f"{name} = {checks.shown(values)}: must be {limit}")
    return array.astype(float)


def _array(name: str, title: str, values: Any) -> np.ndarray:
    try:
        return np.asarray(values)
    except ValueError as error:
        called = f"{name}, column {title}" if title else name
        raise ValueError(f"{called}: must be numbers: {checks.one_line(error)}") from None


def _cells(title: str, cells: Iterable[tuple[int, Any]], content: Content) -> Iterator[float]:
    """Yield the numbers of cells; cells: pairs of place and cell."""
    for place, cell in cells:
        try:
            yield parse_number(cell)
        except ValueError:
            moment = _moment(cell)
            if moment is None:
                content.texts.setdefault(title, (place, str(cell)))
            else:
                content.units[title] = "s"
            yield math.nan if moment is None else moment


def parse_number(cell: Any) -> float:
    """Return the number of a cell, with a decimal point or comma; NaN for an empty one.

    Raises ValueError for other texts.

    >>> parse_number(" 1.5"), parse_number("2,5e3"), parse_number("n/a")
    (1.5, 2500.0, nan)
    """
    if cell is None:
        return math.nan
    try:
        return float(cell)
    except TypeError:
        raise ValueError(f"{checks.shown(cell)} is no number") from None
    except ValueError:
        text = cell.strip().lower()
        return math.nan if text in MISSING else float(text.replace(",", "."))


def _moment(cell: Any) -> float | None:
    """Return the seconds since 1970 of a date and time, in UTC if it has no zone; else None."""
    # pandas takes 0.4 s or more to import, and does not infer the unit of seconds since 1970:
    # `pandas.to_datetime` (3.1) reads integers as ns and refuses "1700000000.5".
    try:
        moment = cell if isinstance(cell, datetime) else datetime.fromisoformat(cell.strip())
    except (ValueError, AttributeError):
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _check_once(source: str, names: Iterable[Any]) -> None:
    twice = [name for name, count in Counter(map(str, names)).items() if name and count > 1]
    if twice:
        raise ValueError(f"{source}: several columns are named {checks.quoted(min(twice))}")


# --- text -----------------------------------------------------------------------------------------


def _decoded(data: bytes) -> str:
    """Return the text of a file in UTF-8, in UTF-16 with a byte order mark, or in Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _of_text(name: str, text: str) -> Content:
    """Parse separated values, with or without names, units and comments above them."""
    lines = [*enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1)]
    lines = [(k, line.strip(" ")) for k, line in lines if line.strip()]
    body = [(k, line) for k, line in lines if not line.startswith(COMMENTS)]
    # Decimal commas are in fewer lines than the separator of cells: not in the names.
    counts = {mark: sum(mark in line for _, line in body) for mark in "\t;,"}
    separator = max(counts, key=lambda mark: counts[mark]) if any(counts.values()) else " "
    rows = [(k, _split(line, separator)) for k, line in body]
    first = next((n for n, (_, cells) in enumerate(rows) if _is_data(cells)), len(rows))
    above, data = [cells for _, cells in rows[:first]], rows[first:]
    units = above.pop() if len(above) > 1 and _are_units(above[-1]) else []
    names = above[-1] if above else []
    if data and not names:
        heads = [line for k, line in lines if line.startswith(COMMENTS) and k < data[0][0]]
        last = _split(heads[-1].lstrip("#%/ "), separator) if heads else []
        names = last if len(last) == len(data[0][1]) and not _is_data(last) else []
    width = len(names or (data[0][1] if data else ()))
    for row, cells in data:
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if len(cells) != width:
            cure = "decimal commas need semicolons between cells"
            cure = cure if len(cells) > width else "remove this row, which is cut off"
            raise ValueError(f"{name}, row {row}: {len(cells)} columns, above {width}: {cure}")
    return _of_rows(name, names, units, data)


def _of_rows(
    name: str, names: list[str], units: list[str], data: list[tuple[int, list[str]]]
) -> Content:
    """Return the columns of rows of cells; data: pairs of line number and cells."""
    content = Content({}, lines=[k for k, _ in data])
    titles = names or [str(k + 1) for k in range(len(data[0][1]) if data else 0)]
    _check_once(name, titles)
    for n, title in enumerate(titles):
        cells = ((k, row[n]) for k, row in data)
        content.columns[title] = np.array([*_cells(title, cells, content)])
    if not names:
        for column, (row, cell) in content.texts.items():
            where = f"{name}, row {row}, column {column}"
            raise ValueError(f"{where}: {checks.shown(cell)}: must be a number")
        content.columns = {"": np.array([*content.columns.values()]).T}
    else:
        # The index that pandas writes has no name.
        content.columns.pop("", None)
    pairs = zip(titles, units, strict=False)
    content.units |= {title: unit for title, unit in pairs if plain_unit(unit)}
    return content


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in cells]


def _is_data(cells: Sequence[str]) -> bool:
    """Return whether half of the cells or more are numbers, dates or empty, and not all empty."""
    there = [cell for cell in cells if cell.lower() not in MISSING]
    count = sum(_is_number(cell) or _moment(cell) is not None for cell in there)
    return count > 0 and 2 * (count + len(cells) - len(there)) >= len(cells)


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(parse_number(cell))
    except ValueError:
        return False


def _are_units(cells: Sequence[str]) -> bool:
    return 2 * sum(plain_unit(cell) in UNITS for cell in cells) >= len(cells)


def plain_unit(unit: str) -> str:
    """Return a unit in the form of the keys of `UNITS`."""
    return unit.strip("[]() ").lower()


# --- logs of messages -----------------------------------------------------------------------------


def _of_messages(path: str, topic: str | None, taken: str) -> Content:
    """Return the numbers of the messages of one topic, in JSON or in the CDR of ROS 2.

    A message has numbers by name; a list of names with lists of numbers, as JointState has; or
    lists of numbers alone. taken: the list to read, if one was chosen.
    """
    reader = need("mcap.reader", f"reading {checks.cut(path, 80)}", "mcap")
    topics: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    unread, begin, decoders = set(), 0, dict[int, Any]()
    try:
        with files.open_regular(path, "a log", sys.maxsize) as (file, _):
            for _, _, message in reader.make_reader(file).iter_messages():
                begin = message.log_time
                break
            file.seek(0)
            for schema, channel, message in reader.make_reader(file).iter_messages(topics=topic):
                if channel.id not in decoders:
                    encoding = channel.message_encoding
                    decoders[channel.id] = _decoder(path, schema, encoding, topic)
                decode = decoders[channel.id]
                if decode is None:
                    unread.add(f"{channel.topic} ({channel.message_encoding})")
                elif row := _message(decode(message.data), taken):
                    topics.setdefault(channel.topic, []).append((message.log_time, row))
    except (OSError, ImportError):
        raise
    except Exception as error:  # mcap raises its errors, and errors of struct and json
        raise ValueError(f"{path}: {checks.one_line(error)}") from None
    chosen = OWN if OWN in topics else min(topics, default="")
    if len(topics) > 1 and chosen != OWN:
        raise ValueError(
            f"{path}: has numbers in {', '.join(sorted(topics))}: choose one, as in log.mcap:/TOPIC"
        )
    if not topics:
        other = f"; not read: {', '.join(sorted(unread))}" if unread else ""
        raise ValueError(
            f"{path}: has no messages with numbers by name, or lists of numbers{other}"
        )
    rows = [row for _, row in topics[chosen]]
    if any(row.keys() != rows[0].keys() for row in rows):
        raise ValueError(f"{path}: not all messages of {chosen} have the numbers of the first")
    content = _of_columns(path, {key: [row[key] for row in rows] for key in rows[0]})
    # Times count from the file's first message, so that topics can be compared.
    content.columns["time"] = 1e-9 * np.array([at - begin for at, _ in topics[chosen]], float)
    content.units["time"] = "s"
    if chosen == OWN:
        content.columns |= {key: from_instant(key, content.columns[key]) for key in rows[0]}
    return content


def _decoder(path: str, schema: Any, encoding: str, topic: str | None) -> Any:
    """Return the function that decodes messages, or None for a format that is not read."""
    if encoding == "json":
        return json.loads
    joints = schema is not None and schema.name.replace("/msg/", "/") == "sensor_msgs/JointState"
    # Many topics of ROS 2 have numbers: without a chosen topic only joint states are read.
    if encoding != "cdr" or not (topic or joints):
        return None
    package = need(
        "mcap_ros2.decoder", f"reading messages of ROS 2 in {checks.cut(path, 80)}", "mcap"
    )
    decode = package.DecoderFactory().decoder_for(encoding, schema)
    return decode and (lambda data: _fields(decode(data)))


def _fields(message: Any) -> dict[str, Any]:
    """Return the fields of a decoded message of ROS 2."""
    return {name: getattr(message, name) for name in message.__slots__}


def _message(message: Any, taken: str) -> dict[str, Any]:
    """Return the numbers of a message by name, and its lists of numbers."""
    if not isinstance(message, dict):
        return {}
    names = next((message[key] for key in NAMES if isinstance(message.get(key), list)), None)
    if names is not None:
        lists = dict.fromkeys([*STATES, taken])
        return {
            f"{joint}.{state}": value
            for state in lists
            if isinstance(message.get(state), list) and len(message[state]) == len(names)
            for joint, value in zip(names, message[state], strict=True)
        }
    if taken and taken in message:
        return {"": message[taken]} if isinstance(message[taken], list) else {}
    plain = {key: value for key, value in message.items() if not isinstance(value, bool)}
    return {key: value for key, value in plain.items() if _is_numeric(value)}


def _is_numeric(value: Any) -> bool:
    if isinstance(value, list):
        return bool(value) and all(isinstance(entry, (int, float)) for entry in value)
    return isinstance(value, (int, float))
