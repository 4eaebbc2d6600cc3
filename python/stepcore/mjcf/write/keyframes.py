"""The section `<keyframe>`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.elements import Key

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


def tags(scene: Contents, _: Names) -> list[Tag]:
    """The keyframes."""
    return [_key(key) for key in scene.keys]


def _key(key: Key) -> Tag:
    given = changed(key)
    # An empty list cannot be written as an attribute.
    return Tag("key", **{name: value for name, value in given.items() if value != ()})
