"""An element to write, and its values as text that reads back as exactly these values."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

from stepcore.mjcf.option import shortest
from stepcore.scene.elements import Element

# Characters that XML 1.0 does not allow, even escaped.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_ESCAPES = {"&": "&amp;", "<": "&lt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}


class Tag:
    """An element to write: its attributes in order, and its children."""

    def __init__(self, kind: str, /, **attributes: Any) -> None:
        self.kind = kind
        self.attributes = {key: text(value) for key, value in attributes.items()}
        self.inside: list[Tag] = []

    def add(self, tag: Tag) -> Tag:
        self.inside.append(tag)
        return tag

    def start(self) -> str:
        words = [self.kind, *(f'{key}="{value}"' for key, value in self.attributes.items())]
        return f"<{' '.join(words)}{'>' if self.inside else '/>'}"


def text(value: Any) -> str:
    """A value as the text of an attribute."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (tuple, list)):
        return " ".join(shortest(number) for number in value)
    return escaped(value) if isinstance(value, str) else shortest(value)


def escaped(value: str) -> str:
    """A text as it stands between quotes; ValueError for characters that XML does not allow."""
    if _FORBIDDEN.search(value):
        raise ValueError(f"{value!r}: XML does not allow this character in a name")
    return "".join(_ESCAPES.get(letter, letter) for letter in value)


def changed(element: Element, *skip: str) -> dict[str, Any]:
    """The fields of an element that differ from their defaults."""
    defaults = {spec.name: spec.default for spec in dataclasses.fields(element)}  # type: ignore[arg-type]
    values = {field: value for field, value in element.values().items() if field not in skip}
    return {field: value for field, value in values.items() if value != defaults[field]}


def printed(root: Tag, comment: str) -> str:
    """The text of a whole file."""
    lines: list[str] = []
    # Tags to open, and the ends of those that are open.
    pending: list[tuple[int, Tag | str]] = [(0, root)]
    while pending:
        indent, item = pending.pop()
        if isinstance(item, str):
            lines.append("  " * indent + item)
            continue
        lines.append("  " * indent + item.start())
        if item.inside:
            pending.append((indent, f"</{item.kind}>"))
            pending += [(indent + 1, tag) for tag in reversed(item.inside)]
    return comment + "\n".join(lines) + "\n"
