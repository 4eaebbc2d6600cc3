"""Checks of the fields of a replay file, because anyone can write such a file."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from stepcore import checks

# The engine keeps a state only some hundred steps before a failure.
MOST_STEPS = 100_000
# Array types in a scene: numbers, and indices of vertices.
ARRAYS = ("<f8", "<i8", "<u8", "<i4", "<u4")
# The length of an input: the step, then the input arrays of a step.
INPUT = 7

whole = checks.whole(0, 2**63 - 1)


def _maybe(check: checks.Check) -> checks.Check:
    return lambda owner, name, value: None if value is None else check(owner, name, value)


def _float(owner: Any, name: str, value: object) -> float:
    """Check a JSON number, which may be non-finite."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise checks.refuse(owner, name, value, "a number")
    try:
        return float(value)
    except OverflowError:
        raise checks.refuse(owner, name, value, "a number below 1e308") from None


def _list(owner: Any, name: str, value: object) -> list[Any]:
    if not isinstance(value, list):
        raise checks.refuse(owner, name, value, "a list")
    return value


def _dict(owner: Any, name: str, value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise checks.refuse(owner, name, value, "an object")
    return value


def _id(owner: Any, name: str, value: object) -> tuple[str, int, int]:
    """Check the kind, index and part of an element."""
    entries = _list(owner, name, value)
    if len(entries) != 3 or not isinstance(entries[0], str):
        raise checks.refuse(owner, name, value, "(kind, index, part)")
    return entries[0], *(checks.whole(-1, 2**63 - 1)(owner, name, entry) for entry in entries[1:])


def _ids(owner: Any, name: str, value: object) -> list[tuple[str, int, int]]:
    return [_id(owner, f"{name}[{k}]", entry) for k, entry in enumerate(_list(owner, name, value))]


def _shares(owner: Any, name: str, value: object) -> dict[str, float]:
    shares = _dict(owner, name, value)
    return {key: _float(owner, f"{name}.{checks.cut(key, 80)}", shares[key]) for key in shares}


def _state(owner: Any, name: str, value: object) -> bytes:
    text = checks.text(owner, name, value)
    try:
        return base64.b64decode(text, validate=True)
    except ValueError:
        raise checks.refuse(owner, name, value, "base64") from None


def _input(owner: Any, name: str, value: object) -> tuple[Any, ...]:
    entries = _list(owner, name, value)
    if len(entries) != INPUT:
        raise checks.refuse(owner, name, value, f"a list of {INPUT} entries")
    arrays = [
        list(checks.numbers(owner, f"{name}[{k + 1}]", array))
        for k, array in enumerate(entries[1:])
    ]
    return whole(owner, f"{name}[0]", entries[0]), *arrays


def _inputs(owner: Any, name: str, value: object) -> list[tuple[Any, ...]]:
    entries = _list(owner, name, value)
    return [_input(owner, f"{name}[{k}]", entry) for k, entry in enumerate(entries)]


def _event(owner: Any, name: str, value: object) -> dict[str, Any]:
    event = _record(owner, f"{name}.", _dict(owner, name, value), EVENT)
    if len(event["share_ids"]) != len(event["shares"]):
        raise checks.refuse(owner, f"{name}.share_ids", event["share_ids"], "one for each share")
    return event


# Attributes of the error in a replay; `EVENT` adds the error's text and the last state.
ATTRIBUTES: dict[str, checks.Check] = {
    "step": whole,
    "time": _float,
    "world": whole,
    "gained": checks.flag,
    "growth": _maybe(_float),
    "stable_dt": _maybe(_float),
    "element": checks.text,
    "element_id": _maybe(_id),
    "shares": _shares,
    "share_ids": _ids,
}
EVENT = {**ATTRIBUTES, "text": checks.text, "state": checks.text}
BODY = {
    "name": checks.text,
    "scene": _dict,
    "settings": _dict,
    "state": _state,
    "inputs": _inputs,
    "steps": checks.whole(0, MOST_STEPS),
    "happened": _event,
}


def checked(data: dict[str, Any]) -> dict[str, Any]:
    """Return the checked fields of a file; raise ValueError naming the first bad field."""
    return _record("replay", "", data, BODY)


def unpacked(data: Any) -> Any:
    """Return plain data with packed arrays converted back to arrays."""
    if isinstance(data, list):
        return [unpacked(entry) for entry in data]
    if not isinstance(data, dict):
        return data
    if set(data) == {"array"}:
        return _array(data["array"])
    return {key: unpacked(value) for key, value in data.items()}


def _array(packed: object) -> Any:
    entries = packed if isinstance(packed, list) and len(packed) == 3 else ["", "", ""]
    if entries[0] not in ARRAYS:
        limit = f"(type, shape, base64), of a type {', '.join(ARRAYS)}"
        raise ValueError(f"array = {checks.shown(packed)}: must be {limit}")
    try:
        shape = [whole("array", "shape", count) for count in _list("array", "shape", entries[1])]
        numbers = np.frombuffer(_state("array", "bytes", entries[2]), entries[0]).reshape(shape)
        return numbers.astype(numbers.dtype.newbyteorder("="))
    except (ValueError, TypeError) as error:
        raise ValueError(f"array = {checks.shown(packed)}: {checks.one_line(error)}") from None


def _record(
    owner: Any, prefix: str, data: dict[str, Any], fields: dict[str, checks.Check]
) -> dict[str, Any]:
    for name in data:
        if name not in fields:
            raise ValueError(f"{prefix}{checks.cut(name, 80)}: no such field")
    for name in fields:
        if name not in data:
            raise ValueError(f"{prefix}{name}: missing")
    return {name: check(owner, prefix + name, data[name]) for name, check in fields.items()}
