"""The section `<worldbody>`."""

from __future__ import annotations

import itertools
import math

from stepcore.mjcf.nodes import DEPTH
from stepcore.mjcf.write.names import Names
from stepcore.mjcf.write.tags import Tag, changed
from stepcore.scene import frames
from stepcore.scene.elements import Body, Geom, Joint, Site
from stepcore.scene.elements.site import SITE_SIZE
from stepcore.scene.frames import Vec
from stepcore.scene.layout import SIZES, Layout

# MuJoCo's grey with opacity 0.
UNSEEN = (0.5, 0.5, 0.5, 0.0)


def add_tree(root: Tag, layout: Layout, names: Names) -> None:
    """Adds the bodies, each with its joints, geoms and sites before its children."""
    tags: dict[int, Tag] = {}
    depth: dict[int, int] = {}
    for body in layout.bodies:
        if body.parent is None:
            tag, level = root.add(Tag("worldbody")), 1
        else:
            tag = tags[id(body.parent)].add(_body(body, names))
            level = depth[id(body.parent)] + 1
        if level > DEPTH - 2:
            raise ValueError(f"{body}: an MJCF file nests bodies at most {DEPTH - 2} deep")
        tags[id(body)], depth[id(body)] = tag, level
        # Its child bodies follow in the order of the layout.
        for joint in layout.joints_of.get(id(body), []):
            tag.add(_joint(joint, names))
    for geom in layout.geoms:
        _before_bodies(tags[id(geom.body)], _geom(geom, names))
    for site in layout.sites:
        _before_bodies(tags[id(site.body)], _site(site, names))


def _before_bodies(tag: Tag, inner: Tag) -> None:
    at = next((i for i, one in enumerate(tag.inside) if one.kind == "body"), len(tag.inside))
    tag.inside.insert(at, inner)


def _body(body: Body, names: Names) -> Tag:
    placed = changed(body, "name", "parent", "mass", "ipos", "inertia", "iquat")
    tag = Tag("body", **names.attribute(body), **placed)
    if body.mass is not None:
        tag.add(Tag("inertial", pos=body.ipos, mass=body.mass, **_inertia(body)))
    return tag


def _inertia(body: Body) -> dict[str, Vec]:
    inertia = body.inertia
    if body.iquat is not None:
        turn = {} if body.iquat == frames.IDENTITY else {"quat": body.iquat}
        return {**turn, "diaginertia": _moments(body.iquat, inertia)}
    # Axes that are found put the largest moment first; three moments of a file are as they stand.
    falling = inertia[0] >= inertia[1] >= inertia[2]
    diagonal = not any(inertia[3:]) and (falling or min(inertia[:3]) == 0.0)
    return {"diaginertia": inertia[:3]} if diagonal else {"fullinertia": inertia}


def _moments(quat: Vec, inertia: Vec) -> Vec:
    """The moments about principal axes, by which a reader finds these very bits, if any do."""
    if quat == frames.IDENTITY:
        return inertia[:3]
    w, x, y, z = quat
    found: Vec = (0.0, 0.0, 0.0)
    # Twice: the quaternion has its length only to rounding.
    for _ in range(2):
        seen = frames.turned_inertia(quat, (*found, 0.0, 0.0, 0.0))
        missing = [one - two for one, two in zip(inertia, seen, strict=True)]
        more = frames.turned_inertia((w, -x, -y, -z), missing)
        found = tuple(one + two for one, two in zip(found, more[:3], strict=True))
    for moments in itertools.product(*map(_neighbours, found)):
        if frames.turned_inertia(quat, (*moments, 0.0, 0.0, 0.0)) == inertia:
            return moments
    return found


def _neighbours(x: float) -> list[float]:
    """The number and those within two roundings of it."""
    found = [x]
    for end in (math.inf, -math.inf):
        one = x
        for _ in range(2):
            one = math.nextafter(one, end)
            found.append(one)
    return found


def _joint(joint: Joint, names: Names) -> Tag:
    skip = ["name", "body"]
    if joint.type in ("ball", "free"):
        skip += ["axis", "ref", "springref"]
    if joint.type == "free":
        skip.append("pos")
    # A range of nothing but 0 means no limit, unless it is said to be one.
    limited = {"limited": "true"} if joint.range == (0.0, 0.0) else {}
    return Tag("joint", **names.attribute(joint), **limited, **changed(joint, *skip))


def _geom(geom: Geom, names: Names) -> Tag:
    given = changed(geom, "name", "body", "size", "mesh", "hfield")
    for field, asset in (("mesh", geom.mesh), ("hfield", geom.hfield)):
        if asset is not None:
            given[field] = names.of(asset)
    if given.pop("hidden", False):
        given["rgba"] = UNSEEN
    used = SIZES[geom.type]
    # MuJoCo wants a spacing for the grid of a plane, even where nothing is drawn.
    size = geom.size[:used] if used else (*geom.size[:2], geom.size[2] or 1.0)
    if "mesh" not in given and "hfield" not in given:
        given = {"size": size, **given}
    for mask in ("contype", "conaffinity"):
        if mask in given:
            given[mask] = (given[mask] + 2**31) % 2**32 - 2**31
    first = {"type": given.pop("type")} if "type" in given else {}
    return Tag("geom", **names.attribute(geom), **first, **given)


def _site(site: Site, names: Names) -> Tag:
    given = changed(site, "name", "body", "size")
    size = site.size[: SIZES[site.type]]
    if size != SITE_SIZE[: len(size)]:
        given["size"] = size
    return Tag("site", **names.attribute(site), **given)
