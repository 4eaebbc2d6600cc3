"""A scene as plain data, many times with other values: only what they touch is made anew."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from stepcore.scene import length_ranges
from stepcore.scene.consistency import check
from stepcore.scene.elements import Body, Element
from stepcore.scene.layout import Layout
from stepcore.scene.plain import Records, plain
from stepcore.scene.value_paths import WHOLE, assign, find

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents


class Variation:
    """A copy of a scene, some of whose values are given anew for each `data`.

    paths: the values that are given, as in `Model.with_values`; body_mass: as in
        `value_paths.changed`.
    """

    def __init__(
        self, scene: Contents, paths: Iterable[str], body_mass: Mapping[str, float]
    ) -> None:
        self.scene, self._body_mass = copy.deepcopy(scene), body_mass
        self._layout = Layout(self.scene)
        touched = [self._touched(path) for path in paths if path not in WHOLE]
        self._initial = [(element, dict(element.__dict__)) for one in touched for element in one]
        self._whole = {word: getattr(self.scene, word) for word in WHOLE}
        self._records = Records(self._layout)
        self._lists = self._records.kinds()
        places = {
            id(element): (kind, index)
            for kind, (elements, _) in self._lists.items()
            for index, element in enumerate(elements)
        }
        known = {places.get(id(element)) for element, _ in self._initial}
        # What stands in no list of records, and what is found by simulation, needs all of it.
        self._all_anew = None in known or bool(length_ranges.asked(self.scene))
        self._places = sorted(place for place in known if place is not None)
        self._data: dict[str, Any] | None = None

    def _touched(self, path: str) -> list[Element]:
        """The elements that a value changes: a body's mass may be that of its geoms."""
        element, field = find(self.scene, path)
        if field == "mass" and isinstance(element, Body) and element.mass is None:
            return [geom for geom in self.scene.geoms if geom.body is element]
        return [element]

    def data(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """What `Scene.to_dict` returns of the scene with these values; raises what that raises."""
        for element, initial in self._initial:
            element.__dict__.update(initial)
        for word, value in self._whole.items():
            setattr(self.scene, word, value)
        assign(self.scene, values, self._body_mass)
        check(self._layout)
        if self._all_anew or self._data is None:
            self._data = plain(self._layout)
            length_ranges.fill(self.scene, self._data)
            return self._data
        lists = {kind: list(self._data[kind]) for kind, _ in self._places}
        for kind, index in self._places:
            elements, record = self._lists[kind]
            lists[kind][index] = record(elements[index])
        # The ends of an equality may be those of a site.
        elements, record = self._lists["equalities"]
        lists["equalities"] = [record(element) for element in elements]
        return self._data | self._records.whole() | lists
