"""A scene as plain data: dicts, lists and numbers under the names of the engine's fields."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stepcore.scene import actuation, sensing, tying
from stepcore.scene.elements import Element
from stepcore.scene.elements.tendon import Around, Pulley, Share, Stop
from stepcore.scene.frames import ORIGIN
from stepcore.scene.layout import SIZES, Layout

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from stepcore.scene.elements import Actuator, Body, Geom, HField, Key, Pair, Tendon


def plain(layout: Layout) -> dict[str, Any]:
    """The whole scene as dicts, lists and numbers, with the names of the engine's fields."""
    scene, records = layout.scene, Records(layout)
    override = scene.contact_override
    lists = {
        kind: [record(element) for element in elements]
        for kind, (elements, record) in records.kinds().items()
    }
    return {
        "name": scene.name,
        **records.whole(),
        **lists,
        "meshes": [mesh.record() for mesh in scene.meshes],
        "hfields": _hfields(scene.hfields),
        "sensors": [sensing.plain(layout, sensor) for sensor in scene.sensors],
        "excludes": [[layout.body("exclude", b) for b in pair] for pair in scene.excludes],
        "contact_override": override.record("enable") if override.enable else None,
        "mass_rules": scene.mass_rules.record(),
        "features": scene.features.record(),
    }


class Records:
    """The plain data of single elements of a scene; references become indices."""

    def __init__(self, layout: Layout) -> None:
        self.layout, scene = layout, layout.scene
        self.body_of = {id(body): i for i, body in enumerate(layout.bodies)}
        self.geom_of = {id(geom): i for i, geom in enumerate(layout.geoms)}
        self.mesh_of = {id(mesh): i for i, mesh in enumerate(scene.meshes)}
        self.hfield_of = {id(hfield): i for i, hfield in enumerate(scene.hfields)}
        self.index = self.geom_of | {id(joint): i for i, joint in enumerate(layout.joints)}
        self.index |= {id(site): i for i, site in enumerate(layout.sites)}
        self.actuator_of = {id(actuator): i for i, actuator in enumerate(scene.actuators)}
        self.index |= {id(tendon): i for i, tendon in enumerate(scene.tendons)} | self.body_of

    def whole(self) -> dict[str, Any]:
        """The values of the whole scene."""
        scene = self.layout.scene
        return {
            "gravity": list(scene.gravity),
            "density": scene.density,
            "viscosity": scene.viscosity,
            "wind": list(scene.wind),
            "magnetic": list(scene.magnetic),
        }

    def kinds(self) -> dict[str, tuple[list[Any], Callable[[Any], dict[str, Any]]]]:
        """The lists of elements whose values can be varied, and what makes an element a record."""
        layout, scene = self.layout, self.layout.scene
        return {
            "bodies": (layout.bodies, lambda body: _body(body, self.body_of)),
            "joints": (layout.joints, self._attached),
            "geoms": (layout.geoms, self._geom),
            "sites": (layout.sites, self._attached),
            "tendons": (scene.tendons, self._tendon),
            "actuators": (scene.actuators, self._actuator),
            "equalities": (scene.equalities, lambda equality: tying.plain(layout, equality)),
            "keys": (scene.keys, self._key),
            "pairs": (scene.pairs, self._pair),
        }

    def _attached(self, element: Any, *skip: str) -> dict[str, Any]:
        return element.record("body", *skip) | {"body": self.body_of[id(element.body)]}

    def _geom(self, geom: Geom) -> dict[str, Any]:
        ends = {
            "mesh": self.mesh_of.get(id(geom.mesh)),
            "hfield": self.hfield_of.get(id(geom.hfield)),
        }
        return self._attached(geom, "mesh", "hfield") | ends

    def _tendon(self, tendon: Tendon) -> dict[str, Any]:
        return tendon.record("path") | {"path": [_stop(stop, self.index) for stop in tendon.path]}

    def _actuator(self, actuator: Actuator) -> dict[str, Any]:
        owner = actuator.feeds
        feeds = None if owner is None else self.actuator_of.get(id(owner), -1)
        return (
            actuator.record("type", *actuation.LAW, *actuation.TARGET)
            | {"target": actuation.target(actuator, self.index), "feeds": feeds}
            | actuation.plain(actuator)
        )

    def _key(self, key: Key) -> dict[str, Any]:
        return key.record() | {"qpos": key.qpos and self.layout.unit_quaternions(key.qpos)}

    def _pair(self, pair: Pair) -> dict[str, Any]:
        ends = {end: self.geom_of.get(id(getattr(pair, end)), -1) for end in ("geom1", "geom2")}
        return pair.record("geom1", "geom2") | ends


def essence(layout: Layout) -> dict[str, Any]:
    """`plain` without what has no effect: the axis of a ball, the third size of a capsule, the size
    at which a plane is drawn. Scenes with the same essence are equal.
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
        # Arrays are equal entry by entry, and these all at once.
        asset |= {k: (v.shape, v.tobytes()) for k, v in asset.items() if hasattr(v, "tobytes")}
    for key in scene["keys"]:
        # An empty list and none are the same: nothing is given.
        key |= {field: key[field] or None for field in ("qpos", "qvel", "act", "ctrl")}
    return scene


def _stop(stop: Stop, index: dict[int, int]) -> dict[str, Any]:
    """A stop of a tendon; -1 where what it refers to is not in the scene."""

    def at(element: Element) -> int:
        return index.get(id(element), -1)

    if isinstance(stop, Share):
        return {"joint": at(stop.joint), "coef": stop.coef}
    if isinstance(stop, Around):
        side = stop.sidesite
        return {"geom": at(stop.geom), "side": None if side is None else at(side)}
    if isinstance(stop, Pulley):
        return {"divisor": stop.divisor}
    return {"site": at(stop)}


def _hfields(hfields: Iterable[HField]) -> list[dict[str, Any]]:
    """Height fields with their rows from −y to y; those of one file share their heights."""
    heights: dict[int, NDArray[Any]] = {}
    records = []
    for hfield in hfields:
        (nrow, ncol), key = hfield.elevation.shape, id(hfield.elevation)
        if key not in heights:
            heights[key] = hfield.elevation[::-1].ravel()
        own = {"name": hfield.name, "nrow": nrow, "ncol": ncol, "size": list(hfield.size)}
        records.append(own | {"data": heights[key]})
    return records


def _body(body: Body, index: dict[int, int]) -> dict[str, Any]:
    inertial = None
    if body.mass is not None:
        inertial = {"mass": body.mass, "pos": list(body.ipos), "inertia": list(body.inertia)}
        inertial["axes"] = None if body.iquat is None else list(body.iquat)
    return {
        "name": body.name,
        "parent": 0 if body.parent is None else index[id(body.parent)],
        "pos": list(body.pos),
        "quat": list(body.quat),
        "inertial": inertial,
        "gravcomp": body.gravcomp,
        "mocap": body.mocap,
        "sleep": body.sleep,
    }
