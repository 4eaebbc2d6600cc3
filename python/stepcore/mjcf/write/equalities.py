"""The section `<equality>`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.elements import Element, Equality

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


def referred(scene: Contents) -> list[Element]:
    """The bodies that equalities name."""
    return [body for e in scene.equalities for body in (e.body1, e.body2)]


def tags(scene: Contents, names: Names) -> list[Tag]:
    """The elements of the section."""
    return [_equality(element, names) for element in scene.equalities]


def _equality(equality: Equality, names: Names) -> Tag:
    given = changed(equality, "name", "type", "body1", "body2", "anchor")
    first = {"name": equality.name} if equality.name else {}
    ends = {"body1": names.of(equality.body1), "body2": names.of(equality.body2)}
    return Tag(equality.type, **first, **ends, anchor=equality.anchor, **given)
