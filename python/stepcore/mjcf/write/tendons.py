"""The section `<tendon>`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.elements import Element, Tendon
from stepcore.scene.elements.tendon import Around, Pulley, Share, Stop

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


def referred(scene: Contents) -> list[Element]:
    """The joints, sites and geoms that tendons pass."""
    return [element for tendon in scene.tendons for element in tendon.elements()]


def tags(scene: Contents, names: Names) -> list[Tag]:
    """The elements of the section."""
    return [_tendon(tendon, names) for tendon in scene.tendons]


def _tendon(tendon: Tendon, names: Names) -> Tag:
    kind = "fixed" if tendon.fixed else "spatial"
    tag = Tag(kind, **names.attribute(tendon), **changed(tendon, "name", "path"))
    tag.inside = [_stop(stop, names) for stop in tendon.path]
    return tag


def _stop(stop: Stop, names: Names) -> Tag:
    if isinstance(stop, Share):
        return Tag("joint", joint=names.of(stop.joint), coef=stop.coef)
    if isinstance(stop, Around):
        side = {} if stop.sidesite is None else {"sidesite": names.of(stop.sidesite)}
        return Tag("geom", geom=names.of(stop.geom), **side)
    if isinstance(stop, Pulley):
        return Tag("pulley", divisor=stop.divisor)
    return Tag("site", site=names.of(stop))
