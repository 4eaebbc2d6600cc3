"""The lights of a file. MuJoCo documentation, XML reference, body/light and visual/headlight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.models import inside, sections
from stepcore.mjcf.nodes import Node
from stepcore.scene import frames
from stepcore.scene.frames import Vec

DOWN = (0.0, 0.0, -1.0)


@dataclass(frozen=True)
class Light:
    """A light that a body carries.

    pos: [m], and dir: where it shines, in the body's frame. diffuse: its colour.
    directional: it shines everywhere along dir; else within `cutoff` of dir from pos [degrees].
    """

    body: int
    pos: Vec
    dir: Vec
    diffuse: Vec
    directional: bool
    cutoff: float


@dataclass(frozen=True)
class Headlight:
    """The light at the camera. ambient, diffuse: its colours."""

    ambient: Vec = (0.1, 0.1, 0.1)
    diffuse: Vec = (0.4, 0.4, 0.4)


@dataclass(frozen=True)
class _Place:
    """The body that holds an element, the pose of its frame there, and its childclass."""

    body: int = 0
    pose: tuple[Vec, Vec] = (frames.ORIGIN, frames.IDENTITY)
    childclass: str | None = None


def lights_of(
    root: Node, compiler: Compiler, defaults: Defaults, bodies: Mapping[int, int]
) -> list[Light]:
    """The lights that are on. bodies: the index of a body by the id of its node.

    One that follows or looks at a body (`mode`) stands in the body that holds it.
    """
    found = []
    pending = [(node, _Place()) for node in sections(root, "worldbody")]
    while pending:
        node, place = pending.pop()
        for child in node.children:
            if child.tag == "light":
                known = defaults.of(child, place.childclass, kind="light")
                values: dict[str, Any] = {**known, **child.attrs}
                if values.get("active", "true") in ("true", True):
                    found.append(_light(values, place))
            elif child.tag == "frame" or id(child) in bodies:
                held = _Place(bodies.get(id(child), place.body))
                if child.tag == "frame":
                    orientation = (child.compiler or compiler).orientation(child, child.values)
                    pos = child.values.get("pos", frames.ORIGIN)
                    held = replace(held, pose=frames.composed(place.pose, pos, orientation))
                childclass = defaults.known(child, "childclass") or place.childclass
                pending.append((child, replace(held, childclass=childclass)))
    return found


def _light(values: Mapping[str, Any], place: _Place) -> Light:
    kind = values.get("type", "directional" if _true(values.get("directional")) else "spot")
    pos = _numbers(values.get("pos"), frames.ORIGIN)
    direction = _numbers(values.get("dir"), DOWN)
    return Light(
        place.body,
        frames.composed(place.pose, pos, frames.IDENTITY)[0],
        frames.normalised(frames.rotated(place.pose[1], direction), "dir"),
        _numbers(values.get("diffuse"), (0.7, 0.7, 0.7)),
        kind == "directional",
        _numbers(values.get("cutoff"), (45.0,))[0],
    )


def headlight_of(root: Node) -> Headlight:
    """The light at the camera."""
    own = Headlight()
    for node in inside(root, "visual"):
        if node.tag == "headlight":
            if node.attrs.get("active", "1") == "0":
                return Headlight((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            ambient = _numbers(node.attrs.get("ambient"), own.ambient)
            own = Headlight(ambient, _numbers(node.attrs.get("diffuse"), own.diffuse))
    return own


def _true(value: Any) -> bool:
    return value in ("true", True)


def _numbers(value: Any, default: Vec) -> Vec:
    if value is None:
        return default
    words = value.split() if isinstance(value, str) else value
    return tuple(float(word) for word in words)
