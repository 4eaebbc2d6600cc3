"""Controls in files that need other packages: tables of Parquet, and messages of MCAP logs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.viewing.needs import need

# The path of an MCAP log, with a topic, and a field of its messages: "log.mcap:/joints.effort".
MCAP = re.compile(r"(?P<file>.+\.mcap)(:(?P<topic>[^:.]+)(\.(?P<field>\w+))?)?")
# The topic of arrays in logs of stepcore. An instant has these of the step before it.
OWN = "/recorded"
LATE = ("ctrl", "sensordata")
# Fields with the names of joints, in the messages of ROS; and their lists that are arrays of ours,
# where these are not the positions.
NAMES = ("name", "joint_names")
FIELDS = {"qvel": "velocity"}


def parquet_columns(path: str) -> dict[str, Any]:
    """Return the columns of a Parquet file by name.

    Raises ImportError without pyarrow, ValueError for another file, and OSError.
    """
    parquet = need("pyarrow.parquet", f"reading {checks.cut(path, 80)}", "data")
    try:
        columns: dict[str, Any] = parquet.read_table(path).to_pydict()
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {checks.one_line(error)}") from None
    # The unnamed index of a DataFrame of pandas.
    return {name: values for name, values in columns.items() if "__index_level_" not in name}


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
    topic, field = parts["topic"], parts["field"]
    reader = need("mcap.reader", f"reading {checks.cut(path, 80)}", "mcap")
    found: dict[str, list[tuple[int, dict[str, float]]]] = {}
    unread, begin = set(), 0
    try:
        with open(parts["file"], "rb") as file:
            for _, _, message in reader.make_reader(file).iter_messages():
                begin = message.log_time
                break
            file.seek(0)
            for schema, channel, message in reader.make_reader(file).iter_messages(topics=topic):
                decode = _decoder(channel.message_encoding, schema)
                if decode is None:
                    unread.add(f"{channel.topic} ({channel.message_encoding})")
                elif row := _numbers(decode(message.data), field, array):
                    found.setdefault(channel.topic, []).append((message.log_time, row))
    except OSError:
        raise
    except Exception as error:  # mcap raises errors of its own, and those of struct and json
        raise ValueError(f"{path}: {checks.one_line(error)}") from None
    if len(found) > 1:
        found = {OWN: found[OWN]} if OWN in found else found
    if len(found) != 1:
        raise ValueError(f"{path}: {_refused(found, sorted(unread))}")
    ((name, messages),) = found.items()
    columns = tuple(messages[0][1])
    if any(tuple(row) != columns for _, row in messages):
        raise ValueError(f"{path}: not all messages of {name} have the numbers of the first")
    times = 1e-9 * np.array([at - begin for at, _ in messages])
    rows = np.array([list(row.values()) for _, row in messages], float)
    if name == OWN and array in LATE:
        times, rows = times[:-1], rows[1:]
    return times, rows, None if columns[0].isdecimal() else columns


def _refused(found: Mapping[str, Any], unread: list[str]) -> str:
    if found:
        return f"has numbers in {', '.join(sorted(found))}: choose one, as in log.mcap:/TOPIC"
    other = f"; not read: {', '.join(unread)}" if unread else ""
    return f"has no messages with numbers by name, or lists of numbers{other}"


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
