"""The order of a scene's elements in the compiled model, and the plain data that the engine reads.

Bodies stand depth first, and joints, geoms and sites body by body: MuJoCo's order. References
become indices. Errors that one element alone does not show (a plane on a moving body, a key of
the wrong length) are found here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore.scene import actuation, assets
from stepcore.scene.elements import Body, ContactOverride, Element, Geom, Joint, Pair
from stepcore.scene.frames import IDENTITY, ORIGIN

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

QPOS = {"free": 7, "ball": 4, "slide": 1, "hinge": 1}
DOFS = {"free": 6, "ball": 3, "slide": 1, "hinge": 1}
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3, "plane": 0}
# The sizes of these are those of their assets.
SIZES |= {"mesh": 0, "hfield": 0}
SIZE_WORDS = {
    "sphere": "a radius > 0",
    "capsule": "a radius and a half length > 0",
    "cylinder": "a radius and a half length > 0",
    "ellipsoid": "3 radii > 0",
    "box": "3 half sizes > 0",
}


class Layout:
    """The elements of a scene in the order of the compiled model."""

    def __init__(self, scene: Contents) -> None:
        self.scene = scene
        self.bodies = _depth_first(scene.bodies)
        self.index = {id(body): i for i, body in enumerate(self.bodies)}
        self.joints: list[Joint] = self._by_body(scene.joints)
        self.geoms: list[Geom] = self._by_body(scene.geoms)
        self.sites = self._by_body(scene.sites)
        self.joints_of: dict[int, list[Joint]] = {}
        for joint in self.joints:
            self.joints_of.setdefault(id(joint.body), []).append(joint)

    def _by_body(self, elements: Iterable[Any]) -> list[Any]:
        return sorted(elements, key=lambda e: self.body(e, e.body))

    def body(self, owner: Element | str, body: Body) -> int:
        """The index of a body; an error about `owner`, which refers to it, if it has none."""
        index = self.index.get(id(body))
        if index is None:
            raise checks.ElementError(owner, f"refers to {body}, which is not in this scene")
        return index

    @property
    def nq(self) -> int:
        return sum(QPOS[joint.type] for joint in self.joints)

    @property
    def nv(self) -> int:
        return sum(DOFS[joint.type] for joint in self.joints)

    def moving(self, body: Body | None) -> bool:
        """Whether there is a joint between this body and the world."""
        while body is not None:
            if id(body) in self.joints_of:
                return True
            body = body.parent
        return False

    def qpos0(self) -> list[float]:
        """The positions in the pose in which the scene is described, length nq."""
        qpos: list[float] = []
        for joint in self.joints:
            if joint.type == "free":
                qpos += [*joint.body.pos, *joint.body.quat]
            elif joint.type == "ball":
                qpos += [1.0, 0.0, 0.0, 0.0]
            else:
                qpos.append(joint.ref)
        return qpos

    def unit_quaternions(self, qpos: Iterable[float]) -> list[float]:
        """`qpos` with its quaternions at unit length; a zero quaternion becomes the identity."""
        result = list(qpos)
        at = 0
        for joint in self.joints:
            if joint.type in ("free", "ball"):
                start = at + (3 if joint.type == "free" else 0)
                quat = result[start : start + 4]
                norm = math.hypot(*quat)
                if norm < checks.TINY:
                    quat = [1.0, 0.0, 0.0, 0.0]
                elif abs(norm - 1) > 1e-15:
                    quat = [x / norm for x in quat]
                result[start : start + 4] = quat
            at += QPOS[joint.type]
        return result


def _depth_first(bodies: list[Body]) -> list[Body]:
    children: dict[int, list[Body]] = {}
    for body in bodies[1:]:
        if body.parent is None:
            raise checks.ElementError(body, "parent = None: only the world has no parent")
        children.setdefault(id(body.parent), []).append(body)
    order: list[Body] = []
    stack = [bodies[0]]
    while stack:
        body = stack.pop()
        order.append(body)
        stack.extend(reversed(children.get(id(body), [])))
    if len(order) != len(bodies):
        seen = {id(body) for body in order}
        lost = next(body for body in bodies if id(body) not in seen)
        raise checks.ElementError(lost, "is not connected to the world through its parents")
    return order


def check(layout: Layout) -> None:
    """Checks what concerns several fields or elements; a ValueError names the element."""
    scene = layout.scene
    world = layout.bodies[0]
    if (world.pos, world.quat) != (ORIGIN, IDENTITY) or id(world) in layout.joints_of:
        raise ValueError("the world cannot move: it has no pos, no quat and no joint")
    for body in layout.bodies[1:]:
        if body.mass is None and any((*body.inertia, *body.ipos)):
            raise checks.refuse(body, "mass", None, "given where ipos or inertia is")
        _check_joints(layout, body)
    for geom in layout.geoms:
        need = 0 if geom.mesh is not None else SIZES[geom.type]
        _check_asset(layout, geom)
        if any(size <= 0 for size in geom.size[:need]):
            raise checks.refuse(
                geom, "size", geom.size, f"{SIZE_WORDS[geom.type]} for a {geom.type}"
            )
        if geom.type == "plane" and layout.moving(geom.body):
            raise checks.ElementError(
                geom, "a plane must be on the world or on a body that cannot move"
            )
    inside = {id(joint) for joint in layout.joints}
    for actuator in scene.actuators:
        if id(actuator.joint) not in inside:
            raise checks.ElementError(
                actuator, f"refers to {actuator.joint}, which is not in this scene"
            )
        actuation.check(actuator)
    for equality in scene.equalities:
        if equality.body1 is equality.body2:
            raise checks.ElementError(equality, f"connects {equality.body1} to itself")
    _check_pairs(layout)
    sizes = {"qpos": layout.nq, "qvel": layout.nv, "ctrl": len(scene.actuators)}
    for key in scene.keys:
        for field, count in sizes.items():
            value = getattr(key, field)
            if value is not None and len(value) != count:
                raise checks.refuse(key, field, value, f"{count} numbers, not {len(value)}")
    kinds: tuple[Sequence[Element], ...] = (
        *(scene.bodies, scene.joints, scene.geoms, scene.sites),
        *(scene.actuators, scene.equalities, scene.pairs, scene.keys),
    )
    for elements in kinds:
        seen: set[str] = set()
        for element in elements:
            name = getattr(element, "name", "")
            if name and name in seen:
                raise checks.ElementError(element, "the name is used twice")
            seen.add(name)


def _check_pairs(layout: Layout) -> None:
    inside = {id(geom) for geom in layout.geoms}
    for pair in layout.scene.pairs:
        for geom in (pair.geom1, pair.geom2):
            if id(geom) not in inside:
                raise checks.ElementError(pair, f"refers to {geom}, which is not in this scene")
        if pair.geom1 is pair.geom2:
            raise checks.ElementError(pair, f"pairs {pair.geom1} with itself")


def _check_asset(layout: Layout, geom: Geom) -> None:
    """What a geom refers to is in the scene and fits its type."""
    scene = layout.scene
    listed: tuple[tuple[str, Any, Sequence[Any], bool, bool], ...] = (
        ("mesh", geom.mesh, scene.meshes, geom.type == "mesh", geom.type in ("plane", "hfield")),
        ("hfield", geom.hfield, scene.hfields, geom.type == "hfield", geom.type != "hfield"),
    )
    for field, asset, known, needed, barred in listed:
        if needed and asset is None:
            raise checks.ElementError(geom, f"a geom of type {geom.type} needs a {field}")
        if asset is None:
            continue
        if barred:
            raise checks.ElementError(geom, f"a geom of type {geom.type} has no {field}")
        if not any(asset is each for each in known):
            raise checks.ElementError(geom, f"refers to {asset}, which is not in this scene")
    if geom.type == "mesh" and geom.shellinertia:
        limit = 'False for a mesh, whose own inertia can be "shell"'
        raise checks.refuse(geom, "shellinertia", True, limit)


def _check_joints(layout: Layout, body: Body) -> None:
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
            if joint.type == "ball" and joint.range[0] != 0:
                raise checks.refuse(joint, "range", joint.range, "(0, angle) for a ball joint")


# Fields whose name in the engine is not MuJoCo's word.
RENAMED = {"type": "kind", "ref": "reference", "shellinertia": "shell_inertia"}
# Fields of an actuator that reach the engine as gain, bias and dampratio.
SERVO = ("kp", "kv", "dampratio", "gainprm", "biasprm")
SOFTNESS = {
    Joint: {
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

    def attached(element: Any, *skip: str) -> dict[str, Any]:
        return _record(element, "body", *skip) | {"body": body_of[id(element.body)]}

    return {
        "name": scene.name,
        "gravity": list(scene.gravity),
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
        "actuators": [
            _record(actuator, "joint", "type", *SERVO)
            | {"joint": joint_of.get(id(actuator.joint), -1)}
            | actuation.plain(actuator)
            for actuator in scene.actuators
        ],
        "equalities": [
            {
                "name": equality.name,
                "body1": layout.body(equality, equality.body1),
                "body2": layout.body(equality, equality.body2),
                "anchor": list(equality.anchor),
                "active": equality.active,
                "soft": {"solref": list(equality.solref), "solimp": list(equality.solimp)},
            }
            for equality in scene.equalities
        ],
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
    for joint in scene["joints"]:
        if joint["kind"] not in ("hinge", "slide"):
            joint |= {"axis": [0.0, 0.0, 1.0], "reference": 0.0, "springref": 0.0}
        if joint["kind"] == "free":
            joint["pos"] = list(ORIGIN)
    for geom in scene["geoms"]:
        used = 0 if geom["mesh"] is not None else SIZES[geom["kind"]]
        geom["size"] = geom["size"][:used] + [0.0] * (3 - used)
    for asset in scene["meshes"] + scene["hfields"]:
        # Arrays are equal entry by entry, and these all at once.
        asset |= {k: (v.shape, v.tobytes()) for k, v in asset.items() if hasattr(v, "tobytes")}
    for key in scene["keys"]:
        # An empty list and none are the same: nothing is given.
        key |= {field: key[field] or None for field in ("qpos", "qvel", "ctrl")}
    return scene


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
    }
