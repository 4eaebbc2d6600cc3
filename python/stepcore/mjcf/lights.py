"""The lights of a file. MuJoCo documentation, XML reference, body/light and visual/headlight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

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


def lights_of(root: Node, defaults: Defaults, bodies: Mapping[int, int]) -> list[Light]:
    """The lights that are on. bodies: the index of a body by the id of its node.

    A light within a frame is left out, as is one whose pose follows something.
    """
    found = []
    pending = [(node, 0) for node in sections(root, "worldbody")]
    while pending:
        node, body = pending.pop()
        for child in node.children:
            if child.tag == "body" and id(child) in bodies:
                pending.append((child, bodies[id(child)]))
            elif child.tag == "light":
                values: dict[str, Any] = {**defaults.of(child, kind="light"), **child.attrs}
                if values.get("active", "true") in ("true", True):
                    found.append(_light(values, body))
    return found


def _light(values: Mapping[str, Any], body: int) -> Light:
    kind = values.get("type", "directional" if _true(values.get("directional")) else "spot")
    return Light(
        body,
        _numbers(values.get("pos"), (0.0, 0.0, 0.0)),
        frames.normalised(_numbers(values.get("dir"), DOWN), "dir"),
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
