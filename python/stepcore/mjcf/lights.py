"""The lights of a file. MuJoCo documentation, XML reference, body/light and visual/headlight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from stepcore.mjcf.compiler import Compiler
from stepcore.mjcf.defaults import Defaults
from stepcore.mjcf.models import inside, sections
from stepcore.mjcf.nodes import MJCFError, Node
from stepcore.mjcf.validation import seen_values
from stepcore.scene import frames
from stepcore.scene.frames import Vec

DOWN = (0.0, 0.0, -1.0)


@dataclass(frozen=True)
class Light:
    """A light that a body carries.

    pos: [m], and dir: where it shines, in the body's frame. diffuse: its colour.
    kind: "directional" shines everywhere along dir, "spot" from pos within `cutoff` of dir
    [degrees], and "point" from pos to all sides.
    """

    body: int
    pos: Vec
    dir: Vec
    diffuse: Vec
    kind: str
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
    root: Node,
    compiler: Compiler,
    defaults: Defaults,
    bodies: Mapping[int, int],
    notes: list[str],
) -> list[Light]:
    """The lights that are on.

    bodies: the index of a body by the id of its node. notes: gets a line for each light that cannot
    be read. One that follows or looks at a body (`mode`) stands in the body that holds it.
    """
    found = []
    pending = [(node, _Place()) for node in sections(root, "worldbody")]
    while pending:
        node, place = pending.pop()
        for child in node.children:
            if child.tag == "light":
                try:
                    values = seen_values(child, defaults.of(child, place.childclass))
                    if values.get("type") == "image":
                        notes.append(child.listed("of type image, which is not drawn"))
                    elif values.get("active", True):
                        found.append(_light(child, values, place))
                except MJCFError as error:
                    notes.append(str(error))
            elif child.tag == "frame" or id(child) in bodies:
                held = _Place(bodies.get(id(child), place.body))
                if child.tag == "frame":
                    orientation = (child.compiler or compiler).orientation(child, child.values)
                    pos = child.values.get("pos", frames.ORIGIN)
                    held = replace(held, pose=frames.composed(place.pose, pos, orientation))
                childclass = defaults.known(child, "childclass") or place.childclass
                pending.append((child, replace(held, childclass=childclass)))
    return found


def _light(node: Node, values: dict[str, Any], place: _Place) -> Light:
    kind = values.get("type", "directional" if values.get("directional") else "spot")
    try:
        direction = frames.normalised(values.get("dir", DOWN), "dir")
    except ValueError as error:
        raise node.error(f"<light>: {error}") from None
    return Light(
        place.body,
        frames.composed(place.pose, values.get("pos", frames.ORIGIN), frames.IDENTITY)[0],
        frames.rotated(place.pose[1], direction),
        values.get("diffuse", (0.7, 0.7, 0.7)),
        kind,
        values.get("cutoff", 45.0),
    )


def headlight_of(root: Node, notes: list[str]) -> Headlight:
    """The light at the camera. notes: gets a line for each that cannot be read."""
    own = Headlight()
    for node in inside(root, "visual"):
        if node.tag == "headlight":
            try:
                values = seen_values(node)
            except MJCFError as error:
                notes.append(str(error))
                continue
            if values.get("active") in ("0", "false"):
                return Headlight((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            given = {name: values[name] for name in ("ambient", "diffuse") if name in values}
            own = replace(own, **given)
    return own
