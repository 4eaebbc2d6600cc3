"""The section `<equality>`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.elements import Element, Equality

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


def referred(scene: Contents) -> list[Element]:
    """The bodies, sites and joints that equalities name."""
    values = [value for e in scene.equalities for value in e.given().values()]
    return [value for value in values if isinstance(value, Element)]


def tags(scene: Contents, names: Names) -> list[Tag]:
    """The elements of the section."""
    return [_equality(element, names) for element in scene.equalities]


def _equality(equality: Equality, names: Names) -> Tag:
    own = equality.given()
    if equality.body1 is not None and equality.type == "connect":
        # Without it MuJoCo does not know what is connected.
        own["anchor"] = equality.anchor
    own = {k: names.of(v) if isinstance(v, Element) else v for k, v in own.items()}
    first = {"name": equality.name} if equality.name else {}
    return Tag(equality.type, **first, **own, **changed(equality, "name", "type", *own))
