"""Compilation of scenes: once per edited state, and once per process for models sent to it."""

from __future__ import annotations

import copy
import functools
import hashlib
import pickle
import zlib
from typing import TYPE_CHECKING, Any

from stepcore import _core, checks
from stepcore.mjcf.nodes import with_file_lines
from stepcore.scene.layout import Layout, label_of, relabelled

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
    except Exception:  # pickling user-defined data can raise any error
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
            raise relabelled(scene, error) from None
        raise checks.ElementError(f"{place}: {label_of(scene, error.owner)}", error.text) from None
    except ValueError as error:
        raise with_file_lines(error, Layout(scene)) from None


@functools.lru_cache(maxsize=16)
def compiled_pickle(pickled: bytes) -> _core.Model:
    """Return the engine's model of a scene, sent as `zlib.compress(bare(scene))`.

    A worker that receives a model repeatedly, with any settings, compiles it once.
    """
    scene: Scene = pickle.loads(zlib.decompress(pickled))
    return compiled(scene)
