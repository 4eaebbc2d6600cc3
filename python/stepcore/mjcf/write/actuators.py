"""The section `<actuator>`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.elements import Actuator, Element

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


def referred(scene: Contents) -> list[Element]:
    """The joints that actuators name."""
    return [actuator.joint for actuator in scene.actuators]


def tags(scene: Contents, names: Names) -> list[Tag]:
    """The elements of the section."""
    return [_actuator(element, names) for element in scene.actuators]


def _actuator(actuator: Actuator, names: Names) -> Tag:
    given = changed(actuator, "name", "joint", "type")
    first = {"name": actuator.name} if actuator.name else {}
    if actuator.biasprm is not None:
        first["biastype"] = "affine"
    return Tag(actuator.type, **first, joint=names.of(actuator.joint), **given)
