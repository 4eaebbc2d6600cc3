"""Tables of a user: columns by name, or rows, from an array, a file, a DataFrame or a dict."""

from __future__ import annotations

import csv
import os
import re
import warnings
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.trajectory import Trajectory
from stepcore.experiment.control_files import MCAP, parquet_columns

ENDINGS = (".csv", ".npz", ".npy", ".parquet", ".mcap")
# Names of a column of times: "time", "t", "Time [s]", "t_s".
TIME = re.compile(r"(time|t)([\s_]*[\[(]?s[\])]?)?", re.IGNORECASE)
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
    if hasattr(table, "columns") and hasattr(table, "to_numpy"):
        return name, _of_frame(table, name)
    names = getattr(getattr(table, "dtype", None), "names", None)
    return name, {key: table[key] for key in names} if names else numbers(name, table)


def _of_file(path: str, name: str) -> Content:
    source = os.path.basename(path)
    if not is_file(path):
        raise ValueError(f"{name} = '{path}': must end in {', '.join(ENDINGS)}")
    if path.endswith(".parquet"):
        return parquet_columns(path)
    if path.endswith(".csv"):
        with open(path, encoding="utf-8-sig", newline="") as file:
            return _of_text(source, file.read().splitlines())
    try:
        loaded = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise ValueError(f"{path}: {checks.one_line(error)}") from None
    if path.endswith(".npy"):
        names = loaded.dtype.names
        return {key: loaded[key] for key in names} if names else numbers(source, loaded)
    with loaded:
        arrays = {key: loaded[key] for key in loaded.files}
    return Trajectory.load(path) if "kind" in arrays else arrays


def _of_text(source: str, lines: list[str]) -> Content:
    """Parse comma-, semicolon- or tab-separated values, with or without a line of names.

    An empty cell is NaN.
    """
    head = next((line for line in lines if line.strip()), "")
    delimiter = max(",;\t", key=head.count)
    (names,) = csv.reader([head.lstrip("# ")], delimiter=delimiter) if head else ([],)
    names = [name.strip() for name in names]
    named = bool(names) and not any(checks.number(_float(name)) is not None for name in names)
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
        text = f"{len(names)} names stand above {rows.shape[1]} columns"
        raise ValueError(f"{source}: {text}")
    _check_once(source, names)
    return dict(zip(names, rows.T if rows.size else np.empty((len(names), 0)), strict=True))


def _cell(text: str) -> float:
    return float(text.strip() or "nan")


def _of_frame(frame: Any, source: str) -> Content:
    """Return the columns of a DataFrame of pandas, polars or a similar library."""
    names = list(frame.columns)
    if not any(isinstance(name, str) for name in names):
        return numbers(source, frame.to_numpy())
    _check_once(source, names)
    columns = {str(name): frame[name].to_numpy() for name in names}
    index = getattr(frame, "index", None)
    if TIME.fullmatch(str(getattr(index, "name", None) or "")):
        columns |= {"time": np.asarray(index)}
    return columns


def _check_once(source: str, names: Iterable[Any]) -> None:
    listed = [str(name) for name in names]
    twice = {name for name in listed if listed.count(name) > 1}
    if twice:
        raise ValueError(f"{source}: several columns are named {checks.quoted(min(twice))}")


def numbers(source: str, value: Any) -> np.ndarray:
    """Return an array of numbers; raise ValueError for anything else."""
    try:
        table = np.asarray(value, float)
    except (TypeError, ValueError):
        limit = "numbers, one row a period"
        raise ValueError(f"{source} = {checks.shown(value)}: must be {limit}") from None
    return table


def times_of(source: str, times: Any, count: int) -> np.ndarray | None:
    """Return a column of times [s] for `count` rows; raise ValueError for another length."""
    if times is None:
        return None
    values = np.ravel(numbers(f"{source}, time", times))
    if len(values) != count:
        raise ValueError(f"{source}: {len(values)} times for {count} rows")
    return values


def _float(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
