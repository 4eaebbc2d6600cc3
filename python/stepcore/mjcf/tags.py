"""Elements to write: exact numbers as text, and names for all referenced elements."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from stepcore.mjcf.custom import KINDS
from stepcore.mjcf.option import shortest
from stepcore.scene.elements import Element

if TYPE_CHECKING:
    from stepcore.scene.layout import Layout

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
    """Return a value as the text of an attribute."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (tuple, list)):
        return " ".join(shortest(number) for number in value)
    return escaped(value) if isinstance(value, str) else shortest(value)


def escaped(value: str) -> str:
    """Escape a text for quotes; raise ValueError for characters that XML does not allow."""
    if _FORBIDDEN.search(value):
        raise ValueError(f"{value!r}: XML does not allow this character in a name")
    return "".join(_ESCAPES.get(letter, letter) for letter in value)


def printed(root: Tag, comment: str) -> str:
    """Return the text of a whole file."""
    lines: list[str] = []
    # (indentation, tag to write or end tag) in reverse order.
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


class Names:
    """The names of elements in the written file.

    referred: elements of any kind that others refer to, and that therefore need a name.
    made: (kind, name) of elements that have a name only for that reason.
    """

    def __init__(self, layout: Layout, referred: Iterable[Element]) -> None:
        self.given: dict[int, str] = {}
        self.made: list[tuple[str, str]] = []
        scene = layout.scene
        wanted = {id(element) for element in referred}
        # In MJCF every asset needs a name.
        wanted |= {id(asset) for asset in (*scene.meshes, *scene.hfields)}
        for kind in KINDS:
            # Elements inside bodies are numbered in document order.
            self._name(kind, layout.elements(kind), wanted)

    def _name(self, kind: str, elements: Iterable[Any], wanted: set[int]) -> None:
        elements = list(elements)
        taken = {element.name for element in elements}
        for index, element in enumerate(elements):
            name = element.name
            if not name and id(element) in wanted:
                name = f"{kind}_{index}"
                while name in taken:
                    name += "_"
                taken.add(name)
                self.made.append((kind, name))
            self.given[id(element)] = name

    def of(self, element: Element) -> str:
        """Return the name of an element in the file."""
        return self.given[id(element)]

    def attribute(self, element: Element) -> dict[str, str]:
        """Return the attribute ``name``, if the element has a name in the file."""
        name = self.given.get(id(element), getattr(element, "name", ""))
        return {"name": name} if name else {}
