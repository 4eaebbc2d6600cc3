"""A model as bytes: what crosses to another process, and what a worker keeps of it.

The bytes hold the scene, every number as it is, and the settings; no code, so that reading them
runs none. Compiling is deterministic: the same bytes give the same model everywhere. It is also
the dearer part, so a process keeps the engine's models by the content of their scene, and a
model that comes again and again is compiled once.
"""

from __future__ import annotations

import json
import threading
import zlib
from collections import OrderedDict
from collections.abc import Callable
from hashlib import blake2b
from typing import Any

from stepcore import _core
from stepcore._core import Settings
from stepcore.scene import elements
from stepcore.scene.elements import Element, fields_of
from stepcore.scene.scene import Scene

# The last byte counts versions: raise it when old bytes can no longer be read.
MAGIC = b"stepcore model\x00\x01"
DIGEST = 16
# Compiled models that a process keeps.
KEPT = 16


def packed(scene: Scene) -> bytes:
    """A scene as compressed JSON; elements refer to each other by list and index."""
    lists = {name: value for name, value in _attributes(scene) if isinstance(value, list)}
    places = {
        id(element): (name, i)
        for name, entries in lists.items()
        for i, element in enumerate(entries)
        if isinstance(element, Element)
    }
    data: dict[str, Any] = {}
    for name, value in _attributes(scene):
        if name in lists:
            data[name] = [_entry(value, places) for value in lists[name]]
        else:
            data[name] = _entry(value, places)
    text = json.dumps(data, separators=(",", ":"), default=_number)
    return zlib.compress(text.encode(), 6)


def unpacked(data: bytes) -> Scene:
    """The scene of `packed`, with the same numbers to the last bit."""
    found = json.loads(zlib.decompress(data))
    scene = Scene()
    lists = {name: value for name, value in found.items() if isinstance(value, list)}
    made = {name: [_bare(entry) for entry in entries] for name, entries in lists.items()}
    for name, value in found.items():
        if name == "gravity":
            scene.gravity = value
        elif name in made:
            for element, entry in zip(made[name], lists[name], strict=True):
                _fill(element, entry, made)
            setattr(scene, name, [_value(entry, made) for entry in made[name]])
        elif isinstance(value, dict) and "element" in value:
            element = _bare(value)
            _fill(element, value, made)
            setattr(scene, name, element)
        else:
            setattr(scene, name, value)
    return scene


def to_bytes(scene: bytes, settings: Settings) -> bytes:
    """A packed scene and settings, with a digest of both in front."""
    own = json.dumps(settings.as_dict()).encode()
    body = len(own).to_bytes(4, "little") + own + scene
    return MAGIC + _digest(body) + body


def from_bytes(data: bytes) -> tuple[bytes, Settings]:
    """The packed scene and the settings; ValueError for what is no model's bytes."""
    if not isinstance(data, (bytes, bytearray, memoryview)):
        raise ValueError(f"data of type {type(data).__name__}: must be the bytes of a model")
    data = bytes(data)
    head, digest, body = (
        data[: len(MAGIC)],
        data[len(MAGIC) : len(MAGIC) + DIGEST],
        data[len(MAGIC) + DIGEST :],
    )
    if head[:-1] != MAGIC[:-1]:
        raise ValueError("data: must be the bytes of a model, as Model.to_bytes gives them")
    if head != MAGIC:
        raise ValueError(
            f"data of version {head[-1]}: this stepcore reads version {MAGIC[-1]} of the bytes"
        )
    if digest != _digest(body):
        raise ValueError("data: the bytes of a model are damaged or cut short")
    end = 4 + int.from_bytes(body[:4], "little")
    return body[end:], Settings(**json.loads(body[4:end]))


class _Engines:
    """The engine's models of this process, the last used ones, by what they were made from."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[bytes, _core.Model] = OrderedDict()

    def get(self, scene: bytes, compile: Callable[[], _core.Model]) -> _core.Model:
        """The kept model of a packed scene, compiled if there is none."""
        key = _digest(scene)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = compile()
        with self._lock:
            self._kept[key] = made
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return made


engines = _Engines()


def _digest(data: bytes) -> bytes:
    return blake2b(data, digest_size=DIGEST).digest()


def _attributes(scene: Scene) -> list[tuple[str, Any]]:
    return [(name, getattr(scene, name)) for name in ("gravity", *scene._attributes)]


def _entry(value: Any, places: dict[int, tuple[str, int]]) -> Any:
    """A value, or a whole element as its fields."""
    if not isinstance(value, Element):
        return _plain(value, places)
    fields = {name: _plain(getattr(value, name), places) for name in fields_of(type(value))}
    entry = {"element": type(value).__name__, "fields": fields}
    if value.place:
        entry["place"] = value.place
    return entry


def _plain(value: Any, places: dict[int, tuple[str, int]]) -> Any:
    if isinstance(value, Element):
        return {"at": places[id(value)]}
    if isinstance(value, (tuple, list)):
        return [_plain(part, places) for part in value]
    return value


def _number(value: Any) -> Any:
    """numpy's numbers in options."""
    return value.tolist()


def _bare(entry: Any) -> Any:
    """A new element without its fields, so that others can refer to it; or what is none."""
    if not isinstance(entry, dict) or "element" not in entry:
        return entry
    kind = getattr(elements, entry["element"], None)
    if not (isinstance(kind, type) and issubclass(kind, Element)):
        raise ValueError(f"data: no element is a {entry['element']!r}")
    return object.__new__(kind)


def _fill(element: Any, entry: Any, made: dict[str, list[Any]]) -> None:
    """Past the checks, which the values have been through: a unit vector stays as it is."""
    if isinstance(element, Element):
        values = {name: _value(value, made) for name, value in entry["fields"].items()}
        if list(values) != fields_of(type(element)):
            raise ValueError("data: written by a stepcore whose elements have other fields")
        element.__dict__.update(values)
        if "place" in entry:
            element.__dict__["place"] = entry["place"]


def _value(value: Any, made: dict[str, list[Any]]) -> Any:
    if isinstance(value, dict) and set(value) == {"at"}:
        name, index = value["at"]
        return made[name][index]
    if isinstance(value, list):
        return tuple(_value(part, made) for part in value)
    return value
