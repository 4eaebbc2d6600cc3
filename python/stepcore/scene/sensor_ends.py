"""The elements that sensors look at, found by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from stepcore import checks
from stepcore.scene.elements import Element

if TYPE_CHECKING:
    from stepcore.scene.holdings import Holdings

LISTS = {
    "site": "sites",
    "body": "bodies",
    "geom": "geoms",
    "joint": "joints",
    "tendon": "tendons",
    "actuator": "actuators",
}

ADHERES = "the speed along the contacts of an adhesion is not computed"


def find(scene: Holdings, kinds: Sequence[str], what: str, name: object) -> Element | None:
    """The element of one of these kinds that has this name, or is the one given.

    Raises ValueError for an unknown name, with the nearest, and for one that several kinds have.
    """
    if name is None or isinstance(name, Element):
        return name
    if not kinds:
        raise ValueError(f"{what} = {checks.shown(name)}: a sensor of this type has none")
    lists = {kind: getattr(scene, LISTS[kind]) for kind in kinds}
    every = [element for each in lists.values() for element in each]
    found = [element for element in every if name and element.name == name]
    if len(found) == 1:
        only: Element = found[0]
        return only
    words = " or ".join(kinds)
    if found:
        what = " and ".join(type(element).__name__.lower() for element in found)
        raise ValueError(f"{checks.shown(name)} is the name of a {what}: give the object itself")
    if not isinstance(name, str):
        raise ValueError(f"{what} = {checks.shown(name)}: must be the name of a {words}, or one")
    raise ValueError(scene._no_such(words, name, [element.name for element in every]))
