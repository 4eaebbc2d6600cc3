"""Where the elements in an error of the engine stand in their file.

The engine knows an element by its name, or by its index where it has none. What a user has is
a file with lines: here the one becomes the other.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from stepcore.scene.elements import Body, Element

if TYPE_CHECKING:
    from stepcore.scene.layout import Layout

# "geom 'floor'", or "geom 3" where it has no name, as the engine writes it.
_LABEL = re.compile(r"\b(body|joint|geom|site|actuator|equality|key) (?:'([^']*)'|(\d+)\b)")


def located(error: ValueError, layout: Layout) -> ValueError:
    """The same error with the places of its elements, where a file has them.

    The first element's place comes in front; an element without a name gets that of its body.
    """
    text = str(error)
    first = ""
    parts: list[str] = []
    end = 0
    for match in _LABEL.finditer(text):
        element = _element(layout, *match.groups())
        if element is None:
            continue
        words = match.group()
        body = getattr(element, "body", None)
        follows = text[match.end() :].startswith(" of body ")
        if isinstance(body, Body) and match.group(3) and not follows:
            words += f" of {_body(layout, body)}"
        place = str(element.place)
        if place and not first:
            first = place
        elif place and place != first:
            words += f" ({place})"
        parts += [text[end : match.start()], words]
        end = match.end()
    text = "".join([*parts, text[end:]])
    if not first:
        return ValueError(text)
    from stepcore.mjcf.nodes import MJCFError

    file, _, line = first.rpartition(":")
    return MJCFError(file, int(line), text)


def _element(layout: Layout, kind: str, name: str | None, index: str | None) -> Element | None:
    elements: dict[str, Sequence[Element]] = {
        "body": layout.bodies,
        "joint": layout.joints,
        "geom": layout.geoms,
        "site": layout.sites,
        "actuator": layout.scene.actuators,
        "equality": layout.scene.equalities,
        "key": layout.scene.keys,
    }
    among = elements[kind]
    if index is not None:
        return among[int(index)] if int(index) < len(among) else None
    return next((element for element in among if getattr(element, "name", "") == name), None)


def _body(layout: Layout, body: Body) -> str:
    if body is layout.bodies[0]:
        return "the world"
    return f"body '{body.name}'" if body.name else f"body {layout.body(body, body)}"
