"""Convert a scene to plain data for the engine: dicts, lists and numbers by the engine's names."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from stepcore.scene import length_ranges
from stepcore.scene.consistency import check
from stepcore.scene.elements import Body, Element
from stepcore.scene.frames import ORIGIN
from stepcore.scene.layout import LISTS, SIZES, Layout
from stepcore.scene.value_paths import WHOLE, assign, find

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from stepcore.scene.elements import HField
    from stepcore.scene.scene import Scene


def plain(layout: Layout) -> dict[str, Any]:
    """Return the whole scene as plain data, with indices for references."""
    scene = layout.scene
    override = scene.contact_override
    return {
        "name": scene.name,
        **_whole(scene),
        **{
            kind: [_record(layout, element) for element in elements]
            for kind, elements in _varied(layout).items()
        },
        "meshes": [mesh.record() for mesh in scene.meshes],
        "hfields": _hfields(scene.hfields),
        "sensors": [sensor.plain(layout) for sensor in scene.sensors],
        "excludes": [[layout.body("exclude", b) for b in pair] for pair in scene.excludes],
        "contact_override": override.record("enable") if override.enable else None,
        "mass_rules": scene.mass_rules.record(),
        "features": scene.features.record(),
    }


def _whole(scene: Scene) -> dict[str, Any]:
    values = {word: getattr(scene, word) for word in (*WHOLE, "magnetic")}
    return {w: list(value) if isinstance(value, tuple) else value for w, value in values.items()}


def _varied(layout: Layout) -> dict[str, Sequence[Element]]:
    tree = ("body", "joint", "geom", "site")
    kinds = (*tree, "tendon", "actuator", "equality", "key", "pair")
    return {LISTS[kind]: layout.elements(kind) for kind in kinds}


def _record(layout: Layout, element: Any) -> dict[str, Any]:
    record: dict[str, Any] = element.plain(layout)
    if record.get("qpos"):
        # The element is a keyframe.
        record["qpos"] = layout.unit_quaternions(record["qpos"])
    return record


def essence(layout: Layout) -> dict[str, Any]:
    """Return `plain` without values that have no effect. Scenes of the same essence are equal.

    Examples are the axis of a ball, the third size of a capsule and the drawn size of a plane.
    """
    scene = plain(layout)
    scene["lengthrange"] = layout.scene.lengthrange.record()
    for joint in scene["joints"]:
        if joint["kind"] not in ("hinge", "slide"):
            joint |= {"axis": [0.0, 0.0, 1.0], "reference": 0.0, "springref": 0.0}
        if joint["kind"] == "free":
            joint["pos"] = list(ORIGIN)
    for geom in scene["geoms"]:
        used = 0 if geom["mesh"] is not None else SIZES[geom["kind"]]
        geom["size"] = geom["size"][:used] + [0.0] * (3 - used)
    for site in scene["sites"]:
        site["size"] = site["size"][: SIZES[site["kind"]]]
    for asset in scene["meshes"] + scene["hfields"]:
        # Bytes compare with one ==; arrays compare entry by entry.
        asset |= {k: (v.shape, v.tobytes()) for k, v in asset.items() if hasattr(v, "tobytes")}
    for key in scene["keys"]:
        # An empty list and None both mean that the field is not given.
        key |= {field: key[field] or None for field in ("qpos", "qvel", "act", "ctrl")}
    return scene


def _hfields(hfields: Iterable[HField]) -> list[dict[str, Any]]:
    """Return height fields with rows from −y to y; fields with one elevation share the array."""
    heights: dict[int, NDArray[Any]] = {}
    records = []
    for hfield in hfields:
        (nrow, ncol), key = hfield.elevation.shape, id(hfield.elevation)
        if key not in heights:
            heights[key] = hfield.elevation[::-1].ravel()
        own = {"name": hfield.name, "nrow": nrow, "ncol": ncol, "size": list(hfield.size)}
        records.append(own | {"data": heights[key]})
    return records


class Variation:
    """A copy of a scene in which each call of `data` replaces some values.

    Only the records of elements that depend on these values are recomputed.

    scene: the scene to copy.
    paths: the paths of the values, as in `Model.with_values`.
    body_mass: as in `value_paths.changed`.
    """

    def __init__(self, scene: Scene, paths: Iterable[str], body_mass: Mapping[str, float]) -> None:
        self.scene, self._body_mass = copy.deepcopy(scene), body_mass
        self._layout = Layout(self.scene)
        touched = [self._touched(path) for path in paths if path not in WHOLE]
        self._initial = [
            (element, dict(element.__dict__)) for elements in touched for element in elements
        ]
        self._whole = {word: getattr(self.scene, word) for word in WHOLE}
        self._rules = dict(self.scene.mass_rules.__dict__)
        self._lists = _varied(self._layout)
        places = {
            id(element): (kind, index)
            for kind, elements in self._lists.items()
            for index, element in enumerate(elements)
        }
        known = {places.get(id(element)) for element, _ in self._initial}
        # Values of elements in other lists, and length ranges found by simulation, need all records
        # to be recomputed.
        self._all_anew = None in known or bool(length_ranges.asked(self.scene))
        self._places = sorted(place for place in known if place is not None)
        self._data: dict[str, Any] | None = None

    def _touched(self, path: str) -> list[Element]:
        """Return the elements that a value changes: the geoms for a mass that comes from geoms."""
        element, field = find(self.scene, path)
        if field == "mass" and isinstance(element, Body) and element.mass is None:
            return [geom for geom in self.scene.geoms if geom.body is element]
        return [element]

    def data(self, values: Mapping[str, Any], checked: bool = True) -> dict[str, Any]:
        """Return `Scene.to_dict` of the scene with these values.

        checked: raise the same errors.
        """
        for element, initial in self._initial:
            element.__dict__.update(initial)
        for word, value in self._whole.items():
            setattr(self.scene, word, value)
        self.scene.mass_rules.__dict__.update(self._rules)
        assign(self.scene, values, self._body_mass)
        if checked:
            check(self._layout)
        if self._all_anew or self._data is None:
            self._data = plain(self._layout)
            length_ranges.fill(self.scene, self._data)
            return self._data
        lists = {kind: list(self._data[kind]) for kind, _ in self._places}
        for kind, index in self._places:
            lists[kind][index] = _record(self._layout, self._lists[kind][index])
        # The ends of an equality may be sites, which may have changed.
        lists["equalities"] = [tie.plain(self._layout) for tie in self.scene.equalities]
        rules = {"mass_rules": self.scene.mass_rules.record()}
        return self._data | _whole(self.scene) | rules | lists
