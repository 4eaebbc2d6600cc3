"""Check conditions that involve several fields or elements of a scene."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from stepcore import checks
from stepcore.scene.elements import Body, Element, Geom, Site, Tendon
from stepcore.scene.elements.actuator import check_inputs
from stepcore.scene.elements.tendon import Around, Pulley, Share, Stop
from stepcore.scene.frames import IDENTITY, ORIGIN
from stepcore.scene.layout import DOFS, SIZES, Layout

SIZE_WORDS = {
    "sphere": "a radius > 0",
    "capsule": "a radius and a half length > 0",
    "cylinder": "a radius and a half length > 0",
    "ellipsoid": "3 radii > 0",
    "box": "3 half sizes > 0",
}


def _is_root(layout: Layout, body: Body) -> bool:
    return layout.moving(body) and not layout.moving(body.parent)


def check(layout: Layout) -> None:
    """Raise ValueError, naming the element, if fields or elements contradict each other."""
    scene = layout.scene
    world = layout.bodies[0]
    if (world.pos, world.quat) != (ORIGIN, IDENTITY) or id(world) in layout.joints_of:
        raise ValueError("the world cannot move: it has no pos, no quat and no joint")
    for body in layout.bodies[1:]:
        if body.mass is None and (any((*body.inertia, *body.ipos)) or body.iquat is not None):
            raise checks.refuse(body, "mass", None, "given where ipos, inertia or iquat is")
        if body.mocap and (body.parent is not world or id(body) in layout.joints_of):
            limit = "a child of the world without joints"
            raise checks.refuse(body, "mocap", True, f"False, or {limit}")
        if body.sleep != "auto" and not _is_root(layout, body):
            limit = '"auto": only the root of a tree, which has a joint, says how it sleeps'
            raise checks.refuse(body, "sleep", body.sleep, limit)
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
    _check_tendons(layout)
    for actuator in scene.actuators:
        actuator.check(layout)
    check_inputs(scene.actuators)
    for equality in scene.equalities:
        equality.check(layout)
    _check_pairs(layout)
    for sensor in scene.sensors:
        sensor.check(layout)
    for site in layout.sites:
        if any(size <= 0 for size in site.size[: SIZES[site.type]]):
            raise checks.refuse(
                site, "size", site.size, f"{SIZE_WORDS[site.type]} for a {site.type}"
            )
    sizes = {"qpos": layout.nq, "qvel": layout.nv, "act": layout.na}
    sizes["ctrl"] = len(scene.actuators)
    mocaps = sum(body.mocap for body in scene.bodies)
    sizes |= {"mpos": 3 * mocaps, "mquat": 4 * mocaps}
    for key in scene.keys:
        for field, count in sizes.items():
            value = getattr(key, field)
            if value is not None and len(value) != count:
                raise checks.refuse(key, field, value, f"{count} numbers, not {len(value)}")
    kinds: tuple[Sequence[Element], ...] = (
        *(scene.bodies, scene.joints, scene.geoms, scene.sites),
        *(scene.tendons, scene.actuators, scene.equalities, scene.sensors, scene.pairs, scene.keys),
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


def _check_tendons(layout: Layout) -> None:
    inside = {id(e) for elements in (layout.joints, layout.sites, layout.geoms) for e in elements}
    for tendon in layout.scene.tendons:
        for element in tendon.elements():
            if id(element) not in inside:
                what = f"refers to {element}, which is not in this scene"
                raise checks.ElementError(tendon, what)
        if tendon.fixed:
            _check_fixed(tendon)
        else:
            _check_spatial(tendon)


def _check_fixed(tendon: Tendon) -> None:
    seen: set[int] = set()
    for stop in tendon.path:
        if not isinstance(stop, Share):
            raise checks.ElementError(tendon, "passes a joint, so it passes nothing but joints")
        joint = stop.joint
        if joint.type not in ("hinge", "slide"):
            raise checks.ElementError(tendon, f"passes {joint}, which is no hinge or slide")
        if id(joint) in seen:
            raise checks.ElementError(tendon, f"passes {joint} twice")
        seen.add(id(joint))


def _check_spatial(tendon: Tendon) -> None:
    """Raise unless every branch begins and ends with a site and has sites between geoms."""
    branches: list[list[Stop]] = [[]]
    for at, stop in enumerate(tendon.path):
        if isinstance(stop, Share):
            raise checks.ElementError(tendon, f"passes {stop.joint}, and other things than joints")
        if not isinstance(stop, Pulley):
            branches[-1].append(stop)
        elif at:
            branches.append([])
    for branch in branches:
        if sum(isinstance(stop, Site) for stop in branch) < 2:
            raise checks.ElementError(tendon, "a branch of its path needs at least two sites")
        if not (isinstance(branch[0], Site) and isinstance(branch[-1], Site)):
            raise checks.ElementError(tendon, "a branch of its path must begin and end with a site")
        for stop, following in itertools.pairwise(branch):
            if isinstance(stop, Around) and isinstance(following, Around):
                raise checks.ElementError(tendon, "two geoms of its path need a site between them")
            if isinstance(stop, Around) and stop.geom.type not in ("sphere", "cylinder"):
                raise checks.ElementError(
                    tendon,
                    f"goes round {stop.geom}, which is a {stop.geom.type}: a sphere or a "
                    "cylinder can be gone round",
                )


def _check_asset(layout: Layout, geom: Geom) -> None:
    """Raise unless a geom's mesh and height field are in the scene and fit the geom's type."""
    listed: tuple[tuple[str, Any, bool, bool], ...] = (
        ("mesh", geom.mesh, geom.type == "mesh", geom.type in ("plane", "hfield")),
        ("hfield", geom.hfield, geom.type == "hfield", geom.type != "hfield"),
    )
    for field, asset, needed, barred in listed:
        if needed and asset is None:
            raise checks.ElementError(geom, f"a geom of type {geom.type} needs a {field}")
        if asset is None:
            continue
        if barred:
            raise checks.ElementError(geom, f"a geom of type {geom.type} has no {field}")
        if layout.place(asset) is None:
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
            if joint.type != "ball" and joint.range[0] == joint.range[1]:
                limit = "two finite numbers, the first smaller"
                raise checks.refuse(joint, "range", joint.range, limit)
            if joint.type == "ball" and joint.range[0] != 0:
                raise checks.refuse(joint, "range", joint.range, "(0, angle) for a ball joint")
