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
        if isinstance(name, Element):
            at = self._by_id.get(id(name), -1)
        else:
            at = self._by_name.get(name, -1) if name and isinstance(name, str) else -1
        if at >= 0:
            element = elements[at]
            if element is name or element.name == name:
                return element
        # An entry of the list may have been replaced after the index was built.
        for element in elements:
            if element is name or (name and element.name == name):
                return element
        return None

    def taken(self, elements: Sequence[Any], name: str) -> bool:
        """Return whether an element has this name.

        The index may miss an element that replaced another in place; compiling then detects a
        repeated name.
        """
        self._read(elements)
        return name in self._by_name and self.find(elements, name) is not None

    def added(self, elements: Sequence[Any], element: Any) -> None:
        """Add the last element of the list to the index."""
        if self._elements is elements and self._count == len(elements) - 1:
            self._note(element)

    def _note(self, element: Any) -> None:
        self._by_name.setdefault(element.name, self._count)
        self._by_id[id(element)] = self._count
        self._count += 1
        self._last = element

    def _read(self, elements: Sequence[Any]) -> None:
        now = renamed()
        if self._elements is elements and (self._count, self._renamed) == (len(elements), now):
            return
        # The index of the other elements stays valid when elements are appended.
        grown = self._elements is elements and self._renamed == now
        grown = (
            grown and 0 < self._count < len(elements) and elements[self._count - 1] is self._last
        )
        if not grown:
            self._elements, self._count, self._renamed = elements, 0, now
            self._by_name, self._by_id = {}, {}
        for at in range(self._count, len(elements)):
            self._note(elements[at])

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy of the scene has other elements, so it starts with an empty index.
        return Names, ()
