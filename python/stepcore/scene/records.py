"""Check a scene as a whole, and convert it to plain data for the engine by the engine's names."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore.scene import length_ranges
from stepcore.scene.elements import WHOLE as EVERYWHERE
from stepcore.scene.elements import Body, Element, Geom, Key, Site
from stepcore.scene.elements.actuator import check_inputs
from stepcore.scene.frames import IDENTITY, ORIGIN
from stepcore.scene.layout import DOFS, LISTS, SIZES, Layout
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
        "excludes": [[layout.needed("exclude", b) for b in pair] for pair in scene.excludes],
        "contact_override": override.record("enable") if override.enable else None,
        "mass_rules": scene.mass_rules.record(),
        "features": scene.features.record(),
    }


def _whole(scene: Scene) -> dict[str, Any]:
    values = {word: getattr(scene, word) for word in EVERYWHERE}
    return {w: list(value) if isinstance(value, tuple) else value for w, value in values.items()}


def _varied(layout: Layout) -> dict[str, Sequence[Element]]:
    tree = ("body", "joint", "geom", "site")
    kinds = (*tree, "tendon", "actuator", "equality", "key", "pair")
    return {LISTS[kind]: layout.elements(kind) for kind in kinds}


def _record(layout: Layout, element: Element) -> dict[str, Any]:
    record = element.plain(layout)
    if isinstance(element, Key) and element.qpos:
        record["qpos"] = layout.unit_quaternions(element.qpos)
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
        record = {"name": hfield.name, "nrow": nrow, "ncol": ncol, "size": list(hfield.size)}
        records.append(record | {"data": heights[key]})
    return records


class Variation:
    """A copy of a scene in which each call of `data` replaces some values.

    Only the records of elements that depend on these values are recomputed.

    scene: the scene to copy.
    paths: the paths of the values, as in `Model.with_values`.
    body_mass: as in `value_paths.changed_scene`.
    """

    def __init__(self, scene: Scene, paths: Iterable[str], body_mass: Mapping[str, float]) -> None:
        self.scene, self._body_mass = copy.deepcopy(scene), body_mass
        self._layout = Layout(self.scene)
        touched: list[list[Any]] = []
        for element, field in (find(self.scene, path) for path in paths if path not in WHOLE):
            # A mass that comes from geoms changes these. An input has the values of what it feeds.
            inferred = field == "mass" and isinstance(element, Body) and element.mass is None
            geoms = [geom for geom in self.scene.geoms if geom.body is element]
            inputs = [actuator for actuator in self.scene.actuators if actuator.feeds is element]
            touched.append(geoms if inferred else [element, *inputs])
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
        kinds = {places.get(id(element)) for element, _ in self._initial}
        # Values of elements in other lists, and length ranges found by simulation, need all records
        # to be recomputed.
        self._all_anew = None in kinds or bool(length_ranges.missing_ranges(self.scene))
        self._places = sorted(place for place in kinds if place is not None)
        self._data: dict[str, Any] | None = None

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
            check_scene(self._layout)
        if self._all_anew or self._data is None:
            self._data = plain(self._layout)
            length_ranges.fill_ranges(self.scene, self._data)
            return self._data
        lists = {kind: list(self._data[kind]) for kind, _ in self._places}
        for kind, index in self._places:
            lists[kind][index] = _record(self._layout, self._lists[kind][index])
        # The ends of an equality may be sites, which may have changed.
        lists["equalities"] = [tie.plain(self._layout) for tie in self.scene.equalities]
        rules = {"mass_rules": self.scene.mass_rules.record()}
        return self._data | _whole(self.scene) | rules | lists


SIZE_WORDS = {
    "sphere": "a radius > 0",
    "capsule": "a radius and a half length > 0",
    "cylinder": "a radius and a half length > 0",
    "ellipsoid": "3 radii > 0",
    "box": "3 half sizes > 0",
}


def check_scene(layout: Layout) -> None:
    """Raise ValueError, naming the element, if fields or elements contradict each other."""
    scene = layout.scene
    world = layout.bodies[0]
    if (world.pos, world.quat) != (ORIGIN, IDENTITY) or id(world) in layout.joints_of:
        raise ValueError("the world cannot move: it has no pos, no quat and no joint")
    for body in layout.bodies[1:]:
        _check_body(layout, body)
    for geom in layout.geoms:
        _check_geom(layout, geom)
    for pulling in (*scene.tendons, *scene.actuators):
        pulling.check(layout)
    check_inputs(scene.actuators)
    for element in (*scene.equalities, *scene.pairs, *scene.sensors):
        element.check(layout)
    for site in layout.sites:
        _check_size(site, SIZES[site.type])
    sizes = {"qpos": layout.nq, "qvel": layout.nv, "act": layout.na}
    sizes["ctrl"] = len(scene.actuators)
    mocaps = sum(body.mocap for body in scene.bodies)
    sizes |= {"mpos": 3 * mocaps, "mquat": 4 * mocaps}
    for key in scene.keys:
        for field, count in sizes.items():
            value = getattr(key, field)
            if value is not None and len(value) != count:
                raise checks.refuse(key, field, value, f"{count} numbers, not {len(value)}")
    for kind in ("body", "joint", "geom", "site", "tendon", *list(LISTS)[7:]):
        seen: set[str] = set()
        for element in getattr(scene, LISTS[kind]):
            name = element.name
            if name and name in seen:
                raise checks.ElementError(element, "the name is used twice")
            seen.add(name)


def _check_size(shape: Geom | Site, count: int) -> None:
    if any(size <= 0 for size in shape.size[:count]):
        limit = f"{SIZE_WORDS[shape.type]} for a {shape.type}"
        raise checks.refuse(shape, "size", shape.size, limit)


def _check_geom(layout: Layout, geom: Geom) -> None:
    """Raise unless a geom's mesh and height field are in the scene and fit the geom's type."""
    assets: tuple[tuple[str, Any, bool, bool], ...] = (
        ("mesh", geom.mesh, geom.type == "mesh", geom.type in ("plane", "hfield")),
        ("hfield", geom.hfield, geom.type == "hfield", geom.type != "hfield"),
    )
    for field, asset, needed, barred in assets:
        if needed and asset is None:
            raise checks.ElementError(geom, f"a geom of type {geom.type} needs a {field}")
        if asset is None:
            continue
        if barred:
            raise checks.ElementError(geom, f"a geom of type {geom.type} has no {field}")
        layout.needed(geom, asset)
    if geom.type == "mesh" and geom.shellinertia:
        limit = 'False for a mesh, whose own inertia can be "shell"'
        raise checks.refuse(geom, "shellinertia", True, limit)
    _check_size(geom, 0 if geom.mesh is not None else SIZES[geom.type])
    if geom.type == "plane" and layout.moving(geom.body):
        text = "a plane must be on the world or on a body that cannot move"
        raise checks.ElementError(geom, text)


def _check_body(layout: Layout, body: Body) -> None:
    """Raise if the fields of a body or its joints contradict each other."""
    body.check_mass()
    if body.mocap and (body.parent is not layout.bodies[0] or id(body) in layout.joints_of):
        limit = "a child of the world without joints"
        raise checks.refuse(body, "mocap", True, f"False, or {limit}")
    root = layout.moving(body) and not layout.moving(body.parent)
    if body.sleep != "auto" and not root:
        limit = '"auto": only the root of a tree, which has a joint, says how it sleeps'
        raise checks.refuse(body, "sleep", body.sleep, limit)
    joints = layout.joints_of.get(id(body), [])
    if sum(DOFS[joint.type] for joint in joints) > 6:
        raise checks.ElementError(body, "its joints have more than 6 dofs")
    turned_by_ball = False
    for joint in joints:
        if turned_by_ball and joint.type in ("ball", "hinge"):
            raise checks.ElementError(joint, "a ball joint must be a body's last joint that turns")
        turned_by_ball |= joint.type == "ball"
        if joint.type == "free" and body.parent is not layout.bodies[0]:
            raise checks.ElementError(joint, "a free joint needs a body whose parent is the world")
        if joint.range is not None:
            if joint.type == "free":
                raise checks.refuse(joint, "range", joint.range, "None for a free joint")
            if joint.type != "ball" and joint.range[0] == joint.range[1]:
                limit = "two finite numbers, the first smaller"
                raise checks.refuse(joint, "range", joint.range, limit)
            if joint.type == "ball" and joint.range[0] != 0:
                raise checks.refuse(joint, "range", joint.range, "(0, angle) for a ball joint")
