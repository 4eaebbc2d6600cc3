"""Array attributes: writable, checked state arrays, and read-only readouts and constants."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks

Floats = NDArray[np.float64]
Array = TypeVar("Array", bound=NDArray[Any])
T = TypeVar("T")

# The state, and the inputs of a step in the order of `Replay.inputs`.
STATE = ("qpos", "qvel", "act")
INPUTS = ("ctrl", "qfrc_applied", "xfrc_applied", "eq_active", "mocap_pos", "mocap_quat")


def refuse_late(option: str, world: Any) -> None:
    """Raise ValueError for an option that steps the same motion in steps of another length."""
    if world._arrays["ctrl_history"].size:
        limit = "False in a scene with late controls, whose past depends on the time step"
        raise ValueError(f"{option} = True: must be {limit}")


class StateArray:
    """An array of a `Sim` or a `Batch` that can be written, in place or by assignment."""

    def __init__(self, doc: str, *, truths: bool = False) -> None:
        self.__doc__ = doc
        self.truths = truths

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, sim: Any, owner: type | None = None) -> Floats:
        if sim is None:
            return self  # type: ignore[return-value]
        array: Floats = sim._arrays[self.name]
        return array

    def __set__(self, sim: Any, value: ArrayLike) -> None:
        if self.truths and np.asarray(value).dtype.kind == "b":
            value = np.asarray(value, dtype=np.float64)
        fill(sim._arrays[self.name], self.name, value)


class ReadOnly(Generic[T]):
    """An attribute that can be read but not assigned.

    read: a function of the owner and the attribute's name that returns the value.
    """

    def __init__(self, doc: str, read: Callable[[Any, str], T]) -> None:
        self.__doc__, self.read = doc, read

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, owner: Any, kind: type | None = None) -> T:
        return self if owner is None else self.read(owner, self.name)  # type: ignore[return-value]

    def __set__(self, owner: Any, value: object) -> None:
        raise AttributeError(f"{self.name} of a {type(owner).__name__} is read-only")


def readout(doc: str, alias: str = "") -> ReadOnly[Floats]:
    """Return an attribute that the engine computes from the state, or kept from the last solve.

    alias: the readout that an alias with MuJoCo's name returns.
    """
    return ReadOnly(doc, lambda owner, name: owner._core.readout(alias or name))


def constant(doc: str) -> ReadOnly[NDArray[Any]]:
    """Return an attribute that is a constant array of a `Model`."""
    return ReadOnly(doc, lambda owner, name: owner._arrays[name])


def element_names(doc: str) -> ReadOnly[tuple[str, ...]]:
    """Return an attribute `<kind>_names` with the names of a model's elements of this kind."""
    return ReadOnly(doc, lambda owner, name: owner.names[name.removesuffix("_names")])


def number_of(kind: str, doc: str) -> ReadOnly[int]:
    """Return an attribute with the number of a model's elements of a kind."""
    return ReadOnly(doc, lambda owner, name: len(owner.names[kind]))


def fill(array: Floats, name: str, value: ArrayLike) -> None:
    """Overwrite an array in place; raise ValueError unless `value` is real numbers of its shape.

    A single number fills the whole array, and missing leading axes are broadcast. An axis of length
    1 is not broadcast, because a state of too few numbers would then be accepted, and values would
    vanish in an empty array.
    """
    table = numbers(name, value)
    if np.ndim(value) and table.shape != array.shape[array.ndim - table.ndim :]:
        raise ValueError(f"{name} has shape {table.shape}: must be of shape {array.shape}")
    array[...] = table


def indices_of(worlds: ArrayLike, n: int) -> NDArray[np.intp]:
    """Return the indices of some of n worlds, given as a mask or as indices."""
    array = np.asarray(worlds)
    if array.dtype == bool and array.shape == (n,):
        return np.flatnonzero(array)
    integers = array.ndim == 1 and (array.dtype.kind in "iu" or not array.size)
    if integers and np.all((array >= 0) & (array < n)) and len(set(array.tolist())) == len(array):
        return array.astype(np.intp)
    limit = f"a mask of shape ({n},), or different indices from 0 to {n - 1}"
    raise ValueError(f"worlds = {checks.shown(worlds)}: must be {limit}")


class State(bytes):
    """A snapshot of one world. Equal snapshots continue identically.

    last: input and result of the last solve, which the readouts of a solve need after `restore`.
    """

    last: bytes | None = None


def snapshot_with(state: bytes, last: bytes | None) -> State:
    """Return a snapshot with the data of the last solve."""
    copy = State(state)
    copy.last = last
    return copy


def snapshot(value: object, part: Any) -> tuple[bytes, bytes | None]:
    """Return `part` of the snapshot `value`, and its data of the last solve.

    Raises ValueError unless `part` is bytes.
    """
    try:
        return bytes(memoryview(part)), getattr(part, "last", None)
    except TypeError:
        text = "must be what state() returned"
        raise ValueError(f"state = {checks.shown(value)}: {text}") from None


def numbers(name: str, value: ArrayLike) -> Floats:
    """Return a contiguous float64 array; raise ValueError unless `value` is real numbers."""
    try:
        table = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} = {checks.shown(value)}: must be numbers ({error})") from None
    if table.dtype.kind not in "fiu":
        raise ValueError(
            f"{name} = {checks.shown(value)}: must be real numbers, not {table.dtype.name}"
        )
    return np.ascontiguousarray(table, dtype=np.float64)


def frozen(array: Array) -> Array:
    """Make an array read-only, and return it."""
    array.flags.writeable = False
    return array


def digest(qpos: Floats, qvel: Floats) -> str:
    """Return a hash of a state; states with equal hashes are bit-identical."""
    return hashlib.sha256(qpos.tobytes() + qvel.tobytes()).hexdigest()
