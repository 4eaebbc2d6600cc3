"""File and line of the elements that an error of the engine names.

The engine knows an element by its kind and index; a user has a file with lines.
"""

from __future__ import annotations

from stepcore.mjcf.nodes import MJCFError
from stepcore.scene.elements import Body
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
    mentioned = [layout.elements[kind][index] for _, _, kind, index in mentions]
    for at, (start, stop, _, _) in enumerate(mentions):
        element = mentioned[at]
        label = text[start:stop]
        body = getattr(element, "body", None)
        unnamed = not getattr(element, "name", "")
        # The engine may name the body itself, right after the element.
        told = at + 1 < len(mentioned) and mentioned[at + 1] is body
        if isinstance(body, Body) and unnamed and not told:
            label += f" of {layout.body_called(body)}"
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
