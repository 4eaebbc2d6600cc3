"""`Names`: an index of a list of elements, so that large scenes are built quickly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stepcore.scene.element import Element, renamed


class Names:
    """An index of a list of elements by name and by identity.

    The list belongs to the scene, and any code may change the list. The index is rebuilt after the
    length of the list or the name of an element has changed. Each result is verified in the list.
    """

    def __init__(self) -> None:
        self._elements: Sequence[Any] | None = None
        self._count = self._renamed = 0
        self._by_name: dict[str, int] = {}
        self._by_id: dict[int, int] = {}
        self._last: Any = None

    def find(self, elements: Sequence[Any], name: object) -> Any:
        """Return the element with this name, or the given element if listed; None otherwise."""
        self._read(elements)
        text = name if isinstance(name, str) else ""
        if isinstance(name, Element):
            at = self._by_id.get(id(name), -1)
        else:
            at = self._by_name.get(text, -1) if text else -1
        if at >= 0:
            element = elements[at]
            if element is name or (text and element.name == text):
                return element
        # An entry of the list may have been replaced after the index was built.
        for element in elements:
            if element is name or (text and element.name == text):
                return element
        return None

    def taken(self, elements: Sequence[Any], name: str) -> bool:
        """Return whether an element has this name.

        The index may miss an element that replaced another in place; compiling then detects a
        repeated name.
        """
        self._read(elements)
        return name in self._by_name and self.find(elements, name) is not None

    def _read(self, elements: Sequence[Any]) -> None:
        now = renamed()
        if self._elements is elements and (self._count, self._renamed) == (len(elements), now):
            return
        # The index of the other elements stays valid when elements are appended.
        same = self._elements is elements and self._renamed == now
        longer = 0 < self._count < len(elements)
        if not (same and longer and elements[self._count - 1] is self._last):
            self._elements, self._count, self._renamed = elements, 0, now
            self._by_name, self._by_id = {}, {}
        for at in range(self._count, len(elements)):
            self._last = elements[at]
            self._by_name.setdefault(self._last.name, at)
            self._by_id[id(self._last)] = at
        self._count = len(elements)

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy of the scene has other elements, so it starts with an empty index.
        return Names, ()
