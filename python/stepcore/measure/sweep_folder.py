"""`SweepFolder`: the results of a sweep, kept in a folder as they come.

``sweep.json`` says what is measured, and ``points.jsonl`` has a line for each point that is done.
Numbers are written so that they are read with the same bits.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from stepcore import checks, files
from stepcore.engine.model import Model

Point = dict[str, Any]
SWEEP, POINTS = "sweep.json", "points.jsonl"


class SweepFolder:
    """Results that are kept in a folder.

    path: of the folder, which is made. source: the model, or the function that makes it.

    Raises ValueError for a folder of another sweep: of another model, measurement or version.
    """

    def __init__(self, path: Any, source: Model | Callable[..., Any], measure: Any) -> None:
        self.path = Path(files.path("folder", path))
        self.path.mkdir(parents=True, exist_ok=True)
        own = {"stepcore": _version(), "model": _named(source), "measure": _named(measure)}
        kept = self.path / SWEEP
        if kept.exists():
            self._compare(json.loads(files.read(kept, "a sweep")), own)
        else:
            kept.write_text(json.dumps(own, indent=1) + "\n", encoding="utf-8")
        self._done: dict[str, Point] = {}
        self._read()

    def _compare(self, kept: Any, own: Mapping[str, str]) -> None:
        for name, value in own.items():
            theirs = kept.get(name) if isinstance(kept, dict) else None
            if theirs != value:
                text = f"folder = {checks.shown(str(self.path))}: holds a sweep of another {name}"
                raise ValueError(f"{text} ({theirs}, not {value}): choose another folder")

    def _read(self) -> None:
        """Read the points that are done; the last line may be cut off."""
        file = self.path / POINTS
        if not file.exists():
            return
        lines = file.read_bytes().split(b"\n")
        for line in lines[:-1]:
            try:
                point, result = json.loads(line)
                self._done[point] = {name: _read(value) for name, value in result.items()}
            except (ValueError, TypeError, AttributeError):
                raise ValueError(f"{file}: is damaged: {checks.shown(line[:80])}") from None
        if lines[-1]:
            with file.open("rb+") as cut:
                cut.truncate(file.stat().st_size - len(lines[-1]))

    def result(self, point: Point) -> Point | None:
        """Return the kept result of a point; None for a point that is not done."""
        kept = self._done.get(_key(point))
        return None if kept is None else dict(kept)

    def keep(self, points: list[Point], results: list[Point]) -> None:
        """Write results to the folder.

        Raises ValueError for results that are neither numbers, texts, arrays nor lists of these.
        """
        text = "".join(
            json.dumps([_key(point), {name: _written(name, v) for name, v in result.items()}])
            + "\n"
            for point, result in zip(points, results, strict=True)
        )
        with (self.path / POINTS).open("ab") as file:
            file.write(text.encode())


def _key(point: Point) -> str:
    return json.dumps({name: _written(name, value) for name, value in sorted(point.items())})


def _written(name: str, value: Any) -> Any:
    """Return a value as JSON has it; numpy's types are marked."""
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "fiub":
        array = np.asarray(value)
        return {"dtype": array.dtype.name, "shape": array.shape, "values": array.ravel().tolist()}
    if isinstance(value, list | tuple):
        return [_written(name, entry) for entry in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    limit = "numbers, texts, arrays or lists of these, to be kept in a folder"
    raise ValueError(f"{checks.quoted(name)} = {checks.shown(value)}: must be {limit}")


def _read(value: Any) -> Any:
    if isinstance(value, dict):
        array = np.array(value["values"], dtype=value["dtype"]).reshape(value["shape"])
        return array[()] if not array.shape else array
    if isinstance(value, list):
        return [_read(entry) for entry in value]
    return value


def _named(thing: Any) -> str:
    """Return what tells a model or a function from others."""
    if isinstance(thing, Model):
        data = [thing.scene.to_dict(), thing.settings.as_dict()]
        text = json.dumps(data, default=_plain, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]
    if isinstance(thing, partial):
        arguments = [*thing.args, *sorted(thing.keywords.items())]
        return f"{_named(thing.func)}({', '.join(map(repr, arguments))})"
    name = getattr(thing, "__qualname__", type(thing).__qualname__)
    return f"{getattr(thing, '__module__', None)}.{name}"


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else repr(value)


def _version() -> str:
    try:
        return version("stepcore")
    except PackageNotFoundError:
        return "unknown"
