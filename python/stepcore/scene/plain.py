"""A scene as plain data: dicts, lists and numbers under the names of the engine's fields."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stepcore.scene import actuation, assets, sensing, tying
from stepcore.scene.elements import Body, ContactOverride, Element, Geom, Joint, Pair, Tendon
from stepcore.scene.elements.tendon import Around, Pulley, Share, Stop
from stepcore.scene.frames import ORIGIN
from stepcore.scene.layout import SIZES, Layout

if TYPE_CHECKING:
    pass

# Fields whose name in the engine is not MuJoCo's word.
RENAMED = {"type": "kind", "ref": "reference", "shellinertia": "shell_inertia"}
SOFTNESS = {
    Joint: {
        "limit": ("solreflimit", "solimplimit"),
        "friction": ("solreffriction", "solimpfriction"),
    },
    Tendon: {
        "limit": ("solreflimit", "solimplimit"),
        "friction": ("solreffriction", "solimpfriction"),
    },
    Geom: {"soft": ("solref", "solimp")},
    Pair: {"soft": ("solref", "solimp")},
    ContactOverride: {"soft": ("solref", "solimp")},
}
MASS_RULES = {
    "inertiafromgeom": "from_geoms",
    "inertiagrouprange": "group_range",
    "boundmass": "bound_mass",
    "boundinertia": "bound_inertia",
    "balanceinertia": "balance_inertia",
    "settotalmass": "total_mass",
    "fitaabb": "fit_aabb",
}


def plain(layout: Layout) -> dict[str, Any]:
    """The whole scene as dicts, lists and numbers, with the names of the engine's fields."""
    scene = layout.scene
    body_of = {id(body): i for i, body in enumerate(layout.bodies)}
    geom_of = {id(geom): i for i, geom in enumerate(layout.geoms)}
    override = scene.contact_override
    joint_of = {id(joint): i for i, joint in enumerate(layout.joints)}

    mesh_of = {id(mesh): i for i, mesh in enumerate(scene.meshes)}
    hfield_of = {id(hfield): i for i, hfield in enumerate(scene.hfields)}

    index = geom_of | joint_of | {id(site): i for i, site in enumerate(layout.sites)}
    index |= {id(tendon): i for i, tendon in enumerate(scene.tendons)} | body_of

    def attached(element: Any, *skip: str) -> dict[str, Any]:
        return _record(element, "body", *skip) | {"body": body_of[id(element.body)]}

    return {
        "name": scene.name,
        "gravity": list(scene.gravity),
        "density": scene.density,
        "viscosity": scene.viscosity,
        "wind": list(scene.wind),
        "magnetic": list(scene.magnetic),
        "bodies": [_body(body, body_of) for body in layout.bodies],
        "joints": [attached(joint) for joint in layout.joints],
        "geoms": [
            attached(geom, "mesh", "hfield")
            | {"mesh": mesh_of.get(id(geom.mesh)), "hfield": hfield_of.get(id(geom.hfield))}
            for geom in layout.geoms
        ],
        "meshes": [assets.plain_mesh(mesh) for mesh in scene.meshes],
        "hfields": [assets.plain_hfield(hfield) for hfield in scene.hfields],
        "sites": [attached(site) for site in layout.sites],
        "tendons": [
            _record(tendon, "path") | {"path": [_stop(stop, index) for stop in tendon.path]}
            for tendon in scene.tendons
        ],
        "sensors": [sensing.plain(layout, sensor) for sensor in scene.sensors],
        "actuators": [
            _record(actuator, "type", "dampingpoly", *actuation.LAW, *actuation.TARGET)
            | {"target": actuation.target(actuator, index)}
            | actuation.plain(actuator)
            for actuator in scene.actuators
        ],
        "equalities": [tying.plain(layout, equality) for equality in scene.equalities],
        "keys": [
            _record(key) | {"qpos": key.qpos and layout.unit_quaternions(key.qpos)}
            for key in scene.keys
        ],
        "excludes": [[layout.body("exclude", b) for b in pair] for pair in scene.excludes],
        "pairs": [
            _record(pair, "geom1", "geom2")
            | {end: geom_of.get(id(getattr(pair, end)), -1) for end in ("geom1", "geom2")}
            for pair in scene.pairs
        ],
        "contact_override": _record(override, "enable") if override.enable else None,
        "mass_rules": {MASS_RULES[f]: value for f, value in scene.mass_rules.record().items()},
        "features": _record(scene.features),
    }


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


def _record(element: Element, *skip: str) -> dict[str, Any]:
    record = element.record()
    groups = SOFTNESS.get(type(element), {})
    grouped = {field for pair in groups.values() for field in pair}
    result = {
        RENAMED.get(field, field): value
        for field, value in record.items()
        if field not in grouped and field not in skip
    }
    for group, (solref, solimp) in groups.items():
        result[group] = {"solref": record[solref], "solimp": record[solimp]}
    return result


def _body(body: Body, index: dict[int, int]) -> dict[str, Any]:
    inertial = None
    if body.mass is not None:
        inertial = {"mass": body.mass, "pos": list(body.ipos), "inertia": list(body.inertia)}
    return {
        "name": body.name,
        "parent": 0 if body.parent is None else index[id(body.parent)],
        "pos": list(body.pos),
        "quat": list(body.quat),
        "inertial": inertial,
        "gravcomp": body.gravcomp,
        "mocap": body.mocap,
    }
