"""Names of elements in the file: their own, or new ones where another element refers to them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from stepcore.mjcf.custom import KINDS
from stepcore.scene.elements import Element

if TYPE_CHECKING:
    from stepcore.scene.layout import Layout


class Names:
    """What each element is called.

    referred: elements that others refer to, of any kind, so that they need a name.
    made: (kind, name) of those that got one for that only.
    """

    def __init__(self, layout: Layout, referred: Iterable[Element]) -> None:
        self.given: dict[int, str] = {}
        self.made: list[tuple[str, str]] = []
        scene = layout.scene
        wanted = {id(element) for element in referred}
        # MJCF knows no asset without a name.
        wanted |= {id(asset) for asset in (*scene.meshes, *scene.hfields)}
        for kind, where in KINDS.items():
            # Elements that stand in bodies are counted in the order of the file.
            self._name(kind, getattr(layout, where, None) or getattr(scene, where), wanted)

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
        """The name of an element in the file."""
        return self.given[id(element)]

    def attribute(self, element: Element) -> dict[str, str]:
        """``name=…``, if the element has one."""
        return {"name": self.of(element)} if self.of(element) else {}
