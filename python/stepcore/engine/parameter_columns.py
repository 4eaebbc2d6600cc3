"""Parameters by which a step is differentiated, and the models around their values."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stepcore import checks
from stepcore.engine.variations import ModelVariation, own_value
from stepcore.scene.value_paths import WHOLE

if TYPE_CHECKING:
    from stepcore import _core
    from stepcore.engine.model import Model

# Where the model is compiled around a value: these multiples of a share of it. Of a number that
# goes with 1/p³ the derivative is then off by 2e-12 of itself, and by 1e-12 for rounding.
AROUND = (-2, -1, 1, 2)
SHARE = 2.0**-11
# Impedances are clamped at 0.0001 and 0.9999: the models around one are within.
CLAMPED = 0.00011
ENTRY = re.compile(r"(.*)\[(\d+)\]")


@dataclass(frozen=True)
class Column:
    """A number of a model by which a step is differentiated.

    path: of the value, as in `Model.with_values`. entry: of a vector; None for a number.
    value: the number in the model.
    """

    path: str
    entry: int | None
    value: float

    @property
    def label(self) -> str:
        """The path, with the entry of a vector: "geom/floor/friction[0]"."""
        return self.path if self.entry is None else f"{self.path}[{self.entry}]"

    @property
    def clamped(self) -> bool:
        """Whether it is an impedance or its midpoint, which steps clamp to 0.0001 … 0.9999."""
        return _is_impedance(self.path) and self.entry in (0, 1, 3)

    @property
    def apart(self) -> float:
        """The distance between the values around that of the model."""
        near = min(self.value, 1.0 - self.value) if self.clamped else abs(self.value)
        return near * SHARE

    def check(self) -> None:
        """Refuse a number by which no step is differentiated."""
        limit = None
        if self.value == 0 or not np.isfinite(self.value):
            limit = "finite and not zero: what is zero is left out of a step"
        elif self.clamped and not CLAMPED < self.value < 1 - CLAMPED:
            limit = f"between {CLAMPED} and {1 - CLAMPED}: steps clamp it"
        if limit:
            raise ValueError(f"parameters: {self.label} = {self.value:g}: must be {limit}")


def columns(model: Model, parameters: Sequence[str]) -> list[Column]:
    """Return the columns of parameters; raise ValueError for a value that is zero, too.

    See `named_columns`.
    """
    found = named_columns(model, parameters)
    for column in found:
        column.check()
    return found


def named_columns(model: Model, parameters: Sequence[str]) -> list[Column]:
    """Return the columns of parameters: of a vector, those of its entries that are not zero.

    The power of an impedance that is 1 or 2, which steps compute in another way, is left out too.

    Raises ValueError for an unknown path.
    """
    names = checks.listed(parameters) if not isinstance(parameters, str) else [parameters]
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f"parameters = {checks.shown(parameters)}: must be paths of values")
    found: dict[str, Column] = {}
    for name in names:
        for path in _expanded(model, name):
            found |= {column.label: column for column in _columns(model, path)}
    return list(found.values())


def split_entry(name: str) -> tuple[str, int | None]:
    """Return the path and the entry of "path[3]"; None for a path alone."""
    match = ENTRY.fullmatch(name)
    return (name, None) if match is None else (match[1], int(match[2]))


def _expanded(model: Model, name: str) -> Iterator[str]:
    """Yield the paths that a pattern such as "actuator/*/gain" stands for."""
    parts = name.split("/")
    if "*" not in name or name in WHOLE or len(parts) < 3:
        yield name
        return
    kind, pattern, field = parts[0], "/".join(parts[1:-1]), parts[-1]
    known = fnmatch.filter(filter(None, model.names.get(kind, ())), pattern)
    if not known:
        raise ValueError(f"parameters: no {kind} is named {checks.quoted(pattern)}")
    for one in known:
        yield f"{kind}/{one}/{field}"


def _is_impedance(path: str) -> bool:
    return path.rpartition("/")[2].startswith("solimp")


def _columns(model: Model, path: str) -> Iterator[Column]:
    path, wanted = split_entry(path)
    value = own_value(model, path)
    if not value.ndim:
        if wanted is not None:
            raise ValueError(f"parameters: {path} is a number and has no entry [{wanted}]")
        entries: list[int | None] = [None]
    elif wanted is None:
        entries = [int(k) for k in np.flatnonzero(value)] or list(range(len(value)))
        if _is_impedance(path) and value[-1] in (1.0, 2.0):
            entries.remove(len(value) - 1)
    elif wanted < len(value):
        entries = [wanted]
    else:
        raise ValueError(f"parameters: {path} has {len(value)} entries, and no [{wanted}]")
    for entry in entries:
        yield Column(path, entry, float(value if entry is None else value[entry]))


def models_around(model: Model, by: Sequence[Column]) -> list[list[_core.Model]]:
    """Return the compiled models around the value of each parameter, which the model keeps."""
    kept: dict[str, list[_core.Model]] = model.__dict__.setdefault("_around", {})
    new = [column for column in by if column.label not in kept]
    if new:
        kept |= _compiled_around(model, new)
    return [kept[column.label] for column in by]


def _compiled_around(model: Model, by: Sequence[Column]) -> dict[str, list[_core.Model]]:
    variation = ModelVariation(model, dict.fromkeys(column.path for column in by))
    made: dict[str, list[_core.Model]] = {}
    for column in by:
        around = made[column.label] = []
        for k in AROUND:
            value = own_value(model, column.path)
            value[() if column.entry is None else column.entry] = column.value + k * column.apart
            # What lies between two values that are allowed is allowed, and nearer to zero too.
            checked = k == max(AROUND)
            try:
                data = variation.data({column.path: value.tolist()}, checked=checked)
                around.append(variation.compiled(data))
            except ValueError as error:
                raise ValueError(f"parameters: {column.label}: {error}") from None
    return made
