"""Compilation of scenes: once per edited state, and once per process for models sent to it."""

from __future__ import annotations

import copy
import hashlib
import pickle
import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, Any

from stepcore import _core, checks
from stepcore.mjcf.nodes import MJCFError
from stepcore.scene.elements import Body
from stepcore.scene.layout import Layout, called, named

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

# The number of compiled scenes that a process caches for the models sent to it.
KEPT = 16


def bare(scene: Scene) -> bytes:
    """Return a pickle of the scene without the text of its file, which no step needs."""
    scene = copy.copy(scene)
    scene._source = None
    return pickle.dumps(scene)


def compiled_once(scene: Scene, copied: Scene) -> _core.Model:
    """Return the engine's model of a scene, cached on the scene until the scene is edited.

    `stepcore.load` compiles most scenes first, in order to warn of their time step.
    """
    try:
        key = hashlib.blake2b(bare(scene), digest_size=16).digest()
    except Exception:  # pickling a user's own data can raise any error
        return compiled(copied)
    if scene._compiled is None or scene._compiled[0] != key:
        scene._compiled = key, compiled(copied)
    model: _core.Model = scene._compiled[1]
    return model


def compiled(scene: Scene) -> _core.Model:
    """Return the engine's model of a scene."""
    try:
        data: dict[str, Any] | ValueError = scene.to_dict()
    except ValueError as error:
        data = error
    return compile_data(scene, data)


def compile_data(scene: Scene, data: dict[str, Any] | ValueError) -> _core.Model:
    """Return the engine's model; add file and line to an error about an element of a file."""
    try:
        if isinstance(data, ValueError):
            raise data
        return _core.compile(data)
    except checks.ElementError as error:
        place = getattr(error.owner, "place", "")
        if not place:
            raise named(scene, error) from None
        raise checks.ElementError(f"{place}: {called(scene, error.owner)}", error.text) from None
    except ValueError as error:
        raise _with_file_lines(error, Layout(scene)) from None


class CompiledScenes:
    """A cache of the scenes that this process compiled last, by their pickle.

    Compilation is deterministic and takes longer than unpickling. A worker that receives a model
    repeatedly, with any settings, compiles the model once.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._models: OrderedDict[bytes, _core.Model] = OrderedDict()

    def get(self, pickled: bytes, scene: Scene) -> _core.Model:
        """Return the compiled model of a scene, whose pickle is the key."""
        key = hashlib.blake2b(pickled, digest_size=16).digest()
        with self._lock:
            if key in self._models:
                self._models.move_to_end(key)
                return self._models[key]
        model = compiled(scene)
        with self._lock:
            self._models[key] = model
            while len(self._models) > KEPT:
                self._models.popitem(last=False)
        return model


compiled_scenes = CompiledScenes()


def _with_file_lines(error: ValueError, layout: Layout) -> ValueError:
    """Add file and line to the elements that an error names, where they come from a file.

    The engine knows an element by its kind and index, but a user needs its line in the file. The
    error begins with the place of the first element. An element without a name is described by its
    body.
    """
    text = str(error)
    first = ""
    parts: list[str] = []
    end = 0
    mentions: list[tuple[int, int, str, int]] = getattr(error, "mentions", [])
    mentioned = [layout.elements(kind)[index] for _, _, kind, index in mentions]
    for at, (start, stop, _, _) in enumerate(mentions):
        element = mentioned[at]
        label = text[start:stop]
        body = getattr(element, "body", None)
        unnamed = not getattr(element, "name", "")
        # The engine may already name the body, right after the element.
        told = at + 1 < len(mentioned) and mentioned[at + 1] is body
        if isinstance(body, Body) and unnamed and not told:
            label += f" of {layout.body_called(body)}"
        place = str(element.place)
        first = first or place
        if place and place != first:
            label += f" ({place})"
        parts += [text[end:start], label]
        end = stop
    text = "".join([*parts, text[end:]])
    if not first:
        return ValueError(text)
    file, _, line = first.rpartition(":")
    return MJCFError(file, int(line), text)
