"""Compilation of scenes: once per edited state, and once per process for models sent to it."""

from __future__ import annotations

import copy
import functools
import hashlib
import pickle
import zlib
from typing import TYPE_CHECKING, Any

from stepcore import _core, checks
from stepcore.mjcf.nodes import MJCFError
from stepcore.scene.elements import Body
from stepcore.scene.layout import Layout, called, named

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene


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


@functools.lru_cache(maxsize=16)
def compiled_pickle(pickled: bytes) -> _core.Model:
    """Return the engine's model of a scene, sent as `zlib.compress(bare(scene))`.

    A worker that receives a model repeatedly, with any settings, compiles it once.
    """
    scene: Scene = pickle.loads(zlib.decompress(pickled))
    return compiled(scene)


def _with_file_lines(error: ValueError, layout: Layout) -> ValueError:
    """Add file and line to the elements that an error names, where they come from a file.

    The engine knows an element by its kind and index, but a user needs its line in the file. The
    error begins with the place of the first element. An element without a name is described by its
    body.
    """
    text, first, end = str(error), "", 0
    parts: list[str] = []
    mentions: list[tuple[int, int, str, int]] = getattr(error, "mentions", [])
    mentioned = [layout.elements(kind)[index] for _, _, kind, index in mentions]
    for at, ((start, stop, _, _), element) in enumerate(zip(mentions, mentioned, strict=True)):
        label, body = text[start:stop], getattr(element, "body", None)
        # The engine may already name the body, right after the element.
        told = getattr(element, "name", "") or mentioned[at + 1 : at + 2] == [body]
        if isinstance(body, Body) and not told:
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
