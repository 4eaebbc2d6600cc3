"""File and line of the elements that an error of the engine names.

The engine knows an element by its kind and index; a user has a file with lines.
"""

from __future__ import annotations

from collections.abc import Sequence

from stepcore.mjcf.nodes import MJCFError
from stepcore.scene.elements import Body, Element
from stepcore.scene.layout import Layout


def with_file_lines(error: ValueError, layout: Layout) -> ValueError:
    """The same error with the places of its elements, where a file has them.

    The first element's place comes in front; an element without a name gets that of its body.
    """
    text = str(error)
    first = ""
    parts: list[str] = []
    end = 0
    mentions: list[tuple[int, int, str, int]] = getattr(error, "mentions", [])
    mentioned = [_elements(layout, kind)[index] for _, _, kind, index in mentions]
    for at, (start, stop, _, _) in enumerate(mentions):
        element = mentioned[at]
        label = text[start:stop]
        body = getattr(element, "body", None)
        unnamed = not getattr(element, "name", "")
        # The engine may name the body itself, right after the element.
        told = at + 1 < len(mentioned) and mentioned[at + 1] is body
        if isinstance(body, Body) and unnamed and not told:
            label += f" of {_body(layout, body)}"
        place = str(element.place)
        first = first or place
        if place and place != first:
            label += f" ({place})"
        parts += [text[end:start], label]
        end = stop
    text = "".join([*parts, text[end:]])
    if not first:
        return ValueError(text)
    file, _, line = first.rpartition(":")
    return MJCFError(file, int(line), text)


def _elements(layout: Layout, kind: str) -> Sequence[Element]:
    """The elements of a kind, in the order of the compiled model."""
    elements: dict[str, Sequence[Element]] = {
        "body": layout.bodies,
        "joint": layout.joints,
        "geom": layout.geoms,
        "site": layout.sites,
        "tendon": layout.scene.tendons,
        "actuator": layout.scene.actuators,
        "equality": layout.scene.equalities,
        "pair": layout.scene.pairs,
        "key": layout.scene.keys,
    }
    return elements[kind]


def _body(layout: Layout, body: Body) -> str:
    if body is layout.bodies[0]:
        return "the world"
    return f"body '{body.name}'" if body.name else f"body {layout.body(body, body)}"
