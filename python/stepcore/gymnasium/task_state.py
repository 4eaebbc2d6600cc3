"""`TaskState`: what a task remembers of each world, such as a command or the last action."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks


class TaskState:
    """Arrays of a task's own by name, each with an entry for every world.

    An assignment makes an array that is not there yet: zero in the worlds that it does not reach.
    Whoever reads many worlds gets the array itself, and may write into it.
    """

    def __init__(self, arrays: dict[str, NDArray[Any]], n: int, rows: Any) -> None:
        # rows: those at hand, as an index of the first axis; a number for a world without an axis.
        self.__dict__.update(_arrays=arrays, _n=n, _rows=rows)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._arrays:
            known = checks.nearest(name, self._arrays)
            raise AttributeError(f"state has no {checks.quoted(name)}: set it in `begin`{known}")
        return self._arrays[name][self._rows]

    def __setattr__(self, name: str, value: Any) -> None:
        given = np.asarray(value)
        if name not in self._arrays:
            axes = 0 if isinstance(self._rows, int) else 1
            own = given.shape[axes:] if given.ndim else ()
            self._arrays[name] = np.zeros((self._n, *own), dtype=given.dtype)
        array = self._arrays[name]
        if not np.can_cast(given.dtype, array.dtype, "same_kind"):
            text = f"holds {array.dtype.name} and was given {given.dtype.name}"
            raise ValueError(f"state.{name} {text}: begin with numbers of that type")
        array[self._rows] = given

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {array.shape}" for name, array in self._arrays.items())
        return f"<TaskState of {self._n} worlds: {shown or 'nothing'}>"
