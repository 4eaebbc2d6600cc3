"""State arrays of a `Sim` or a `Batch`: numpy's memory, checked when written."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks

Floats = NDArray[np.float64]


class StateArray:
    """An array that belongs to a `Sim` or a `Batch`: write into it, or assign to fill it."""

    def __init__(self, doc: str) -> None:
        self.__doc__ = doc

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, sim: Any, owner: type | None = None) -> Floats:
        if sim is None:
            return self  # type: ignore[return-value]
        array: Floats = sim._arrays[self.name]
        return array

    def __set__(self, sim: Any, value: ArrayLike) -> None:
        fill(sim._arrays[self.name], self.name, value)


class ModelArray:
    """A read-only array of a `Model`, known to the engine by the attribute's name."""

    def __init__(self, doc: str) -> None:
        self.__doc__ = doc

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, model: Any, owner: type | None = None) -> NDArray[Any]:
        if model is None:
            return self  # type: ignore[return-value]
        array: NDArray[Any] = model._arrays[self.name]
        return array

    def __set__(self, model: Any, value: object) -> None:
        raise AttributeError(f"{self.name} of a Model cannot be set; see Model.with_values")


def fill(array: Floats, name: str, value: ArrayLike) -> None:
    """Overwrites an array; a ValueError for what is not real numbers of its shape."""
    table = numbers(name, value)
    try:
        array[...] = table
    except ValueError:
        limit = f"of shape {array.shape}"
        raise ValueError(f"{name} has shape {table.shape}: must be {limit}") from None


def snapshot(value: object, part: Any) -> bytes:
    """`part` of the snapshot `value` as bytes; ValueError if it cannot be one."""
    try:
        return bytes(memoryview(part))
    except TypeError:
        text = "must be what state() returned"
        raise ValueError(f"state = {checks.shown(value)}: {text}") from None


def numbers(name: str, value: ArrayLike) -> Floats:
    """`value` as a contiguous array of float64; a ValueError for what is not real numbers."""
    try:
        table = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} = {checks.shown(value)}: must be numbers ({error})") from None
    if table.dtype.kind not in "fiu":
        raise ValueError(
            f"{name} = {checks.shown(value)}: must be real numbers, not {table.dtype.name}"
        )
    return np.ascontiguousarray(table, dtype=np.float64)


def digest(qpos: Floats, qvel: Floats) -> str:
    """A hash of a state: equal for the same bits and no others."""
    return hashlib.sha256(qpos.tobytes() + qvel.tobytes()).hexdigest()
