"""A recorded run as a numpy file (.npz) or a table (.csv), and as pandas and xarray frames."""

from __future__ import annotations

import csv
import importlib
import os
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks, files
from stepcore.engine.axes import UNITS, Axis

Data = Mapping[str, NDArray[Any]]
Axes = Mapping[str, tuple[Axis, ...]]

# Increases when the layout of the file changes.
KIND, VERSION = "stepcore trajectory", 1
# The extension of a table, and the name of its column of times.
TABLE, TIME = ".csv", "time [s]"
# Extensions of other formats. Such a file name would be misleading, so it is rejected.
OTHERS = (".tsv", ".txt", ".json", ".xlsx", ".parquet", ".html", ".mcap", ".mp4", ".gif")


def write(
    path: str | os.PathLike[str], time: NDArray[Any], data: Data, axes: Axes, unsolved: str
) -> None:
    """Write a trajectory file; see `Trajectory.save`."""
    target = files.path("path", path)
    if target.lower().endswith(OTHERS):
        limit = "must end in .npz or .csv"
        frame = "to_pandas() has the frame that pandas writes in other formats"
        raise ValueError(f"path = {checks.shown(target)}: {limit}; {frame}")
    if target.lower().endswith(TABLE):
        _write_table(target, time, data, axes)
        return
    arrays = {"kind": np.array(KIND), "version": np.array(VERSION), "time": time}
    arrays["unsolved"] = np.array(unsolved)
    for name, values in data.items():
        arrays[f"data/{name}"] = values
        for k, axis in enumerate(axes[name]):
            arrays[f"axis/{name}/{k}/{axis.name}"] = np.array(axis.entries, dtype=np.str_)
    # Imported here so that the engine alone does not load the reports.
    from stepcore.report.outputs import MARK

    with open(target, "wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    with zipfile.ZipFile(target, "a") as archive:
        archive.comment = MARK.encode()


def _write_table(path: str, time: NDArray[Any], data: Data, axes: Axes) -> None:
    """Write a row for each instant, with time from the beginning of the run, and all digits."""
    columns = {TIME: time - time[:1]} | _columns(data, axes)
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerow(columns)
        np.savetxt(file, np.column_stack(list(columns.values())), fmt="%.17g", delimiter=",")


def read(
    path: str | os.PathLike[str],
) -> tuple[NDArray[Any], dict[str, NDArray[Any]], str, dict[str, tuple[Axis, ...]]]:
    """Return time, data, the text of the `UnsolvedWarning`, and axes; see `Trajectory.load`."""
    source = files.path("path", path)
    shown = checks.cut(source, 300)
    if os.path.isdir(source):
        raise IsADirectoryError(f"{shown}: is a folder, not a trajectory")
    try:
        with open(source, "rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays: Mapping[str, NDArray[Any]] = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise FileNotFoundError(f"{shown}: no such file") from None
    except (ValueError, TypeError, EOFError, OSError, zipfile.BadZipFile):
        raise ValueError(f"{shown}: is no trajectory, or was damaged") from None
    if "kind" not in arrays or str(arrays["kind"]) != KIND:
        raise ValueError(f"{shown}: is no trajectory; `Trajectory.save` writes them")
    if str(arrays.get("version")) != str(VERSION):
        what = f"version {checks.cut(str(arrays.get('version')), 80)} of a trajectory"
        raise ValueError(f"{shown}: {what}; this stepcore reads version {VERSION}")
    try:
        return _parts(arrays)
    except (ValueError, TypeError, KeyError, OverflowError):
        raise ValueError(f"{shown}: is no whole trajectory: it was edited or damaged") from None


def _parts(
    arrays: Mapping[str, NDArray[Any]],
) -> tuple[NDArray[Any], dict[str, NDArray[Any]], str, dict[str, tuple[Axis, ...]]]:
    """Return the values of `read`; raise ValueError or KeyError for inconsistent arrays."""
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
    return time, data, str(arrays["unsolved"]), axes


def to_pandas(time: NDArray[Any], data: Data, axes: Axes) -> Any:
    """Return a DataFrame; see `Trajectory.to_pandas`."""
    pandas = _needed("pandas", "Trajectory.to_pandas")
    return pandas.DataFrame(_columns(data, axes), index=pandas.Index(time, name=TIME))


def _columns(data: Data, axes: Axes) -> dict[str, NDArray[Any]]:
    """Return the values over time by names such as "qpos[knee]", each of shape (n,)."""
    columns: dict[str, NDArray[Any]] = {}
    for name, values in data.items():
        entries = [axis.entries for axis in axes[name]]
        for index in np.ndindex(*values.shape[1:]):
            of = ", ".join(names[k] for names, k in zip(entries, index, strict=True))
            columns[f"{name}[{of}]" if of else name] = values[(slice(None), *index)]
    return columns


def to_xarray(time: NDArray[Any], data: Data, axes: Axes) -> Any:
    """Return a Dataset; see `Trajectory.to_xarray`."""
    xarray = _needed("xarray", "Trajectory.to_xarray")
    coordinates: dict[str, Any] = {"time": ("time", time, {"units": UNITS["time"]})}
    variables = {}
    for name, values in data.items():
        own = axes[name]
        units = {"units": UNITS[name]} if name in UNITS else {}
        variables[name] = (("time", *(axis.name for axis in own)), values, units)
        coordinates |= {a.name: (a.name, np.array(a.entries, dtype=np.str_)) for a in own}
    return xarray.Dataset(variables, coordinates)


def _needed(package: str, what: str) -> Any:
    try:
        return importlib.import_module(package)
    except ImportError:
        raise ImportError(f"{what} needs {package}: pip install 'stepcore[data]'") from None
