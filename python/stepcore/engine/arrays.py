"""What a `Sim` and a `Batch` share: a model, and state arrays that are checked when written."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks

if TYPE_CHECKING:
    from stepcore import _core
    from stepcore._core import Settings
    from stepcore.engine.model import Model

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


def fill(array: Floats, name: str, value: ArrayLike) -> None:
    """Overwrites an array; a ValueError for what is not real numbers of its shape."""
    table = numbers(name, value)
    try:
        array[...] = table
    except ValueError:
        limit = f"of shape {array.shape}"
        raise ValueError(f"{name} has shape {table.shape}: must be {limit}") from None


class Stepped(checks.KnownNames, ABC):
    """A model with its state arrays; the number of worlds is the subclass's affair."""

    _model: Model

    def _own(self, core: _core.Sim | _core.Batch) -> None:
        """Takes the arrays of the engine, which its own memory stands behind."""
        self._arrays = {
            "qpos": core.qpos,
            "qvel": core.qvel,
            "act": np.zeros((*core.qpos.shape[:-1], 0)),
            "ctrl": core.ctrl,
            "qfrc_applied": core.qfrc_applied,
            "xfrc_applied": core.xfrc_applied,
        }

    @abstractmethod
    def _restart(self, time: float) -> None:
        """Sets the time and forgets the impulses of the last step."""

    @property
    def model(self) -> Model:
        """The model, with the settings that are used here."""
        return self._model

    @property
    def settings(self) -> Settings:
        """How it is computed."""
        return self._model.settings

    def reset(self, key: str | int | None = None) -> None:
        """Back to the scene's own pose at rest at time 0, or to a keyframe by name or index.

        Controls are the keyframe's or 0; applied forces and warm-start impulses are forgotten.
        Raises ValueError, with the nearest names, for a keyframe that there is not.
        """
        state = None if key is None else self._model.keys[self._model.index("key", key)]
        for array in self._arrays.values():
            array[...] = 0.0
        self._arrays["qpos"][...] = self._model.qpos0 if state is None else state.qpos
        if state is not None:
            self._arrays["qvel"][...] = state.qvel
            self._arrays["ctrl"][...] = state.ctrl
        self._restart(0.0 if state is None else state.time)


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
