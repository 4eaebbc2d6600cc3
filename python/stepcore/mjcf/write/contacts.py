"""The section `<contact>`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene.elements import Body, Element, Pair

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


def referred(scene: Contents) -> list[Element]:
    """The bodies and geoms that pairs name."""
    bodies: list[Element] = [body for pair in scene.excludes for body in pair]
    return bodies + [geom for pair in scene.pairs for geom in (pair.geom1, pair.geom2)]


def tags(scene: Contents, names: Names) -> list[Tag]:
    """Excluded pairs of bodies, then explicit pairs of geoms."""
    excluded = [_exclude(pair, names) for pair in scene.excludes]
    return excluded + [_pair(pair, names) for pair in scene.pairs]


def _exclude(pair: tuple[Body, Body], names: Names) -> Tag:
    return Tag("exclude", body1=names.of(pair[0]), body2=names.of(pair[1]))


def _pair(pair: Pair, names: Names) -> Tag:
    first = {"name": pair.name} if pair.name else {}
    ends = {"geom1": names.of(pair.geom1), "geom2": names.of(pair.geom2)}
    return Tag("pair", **first, **ends, **changed(pair, "name", "geom1", "geom2"))
