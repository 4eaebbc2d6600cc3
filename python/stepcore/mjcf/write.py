"""Writes a `Scene` as MJCF, with exact numbers and without defaults."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from stepcore._core import Settings
from stepcore.mjcf import custom
from stepcore.mjcf.nodes import DEPTH
from stepcore.mjcf.option import said, shortest
from stepcore.scene.consistency import check
from stepcore.scene.elements import (
    GRAVITY,
    Actuator,
    Body,
    Element,
    Equality,
    Geom,
    HField,
    Joint,
    Key,
    MassRules,
    Mesh,
    Site,
)
from stepcore.scene.layout import SIZES, Layout

if TYPE_CHECKING:
    from stepcore.scene.contents import Contents

# Characters that XML 1.0 does not allow, even escaped.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_ESCAPES = {"&": "&amp;", "<": "&lt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
# What is written of a mesh in another way, or not at all.
ASSET_OWN = ("name", "vertices", "faces", "file")
INERTIA_FROM = {None: "auto", True: "true", False: "false"}


class Tag:
    """An element to write: its attributes in order, and its children."""

    def __init__(self, kind: str, /, **attributes: Any) -> None:
        self.kind = kind
        self.attributes = {key: text(value) for key, value in attributes.items()}
        self.inside: list[Tag] = []

    def add(self, tag: Tag) -> Tag:
        self.inside.append(tag)
        return tag

    def start(self) -> str:
        words = [self.kind, *(f'{key}="{value}"' for key, value in self.attributes.items())]
        return f"<{' '.join(words)}{'>' if self.inside else '/>'}"


def text(value: Any) -> str:
    """A value as the text of an attribute."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (tuple, list)):
        return " ".join(shortest(number) for number in value)
    return escaped(value) if isinstance(value, str) else shortest(value)


def escaped(value: str) -> str:
    """A text as it stands between quotes; ValueError for characters that XML does not allow."""
    if _FORBIDDEN.search(value):
        raise ValueError(f"{value!r}: XML does not allow this character in a name")
    return "".join(_ESCAPES.get(letter, letter) for letter in value)


def changed(element: Element, *skip: str) -> dict[str, Any]:
    """The fields of an element that differ from their defaults."""
    defaults = {spec.name: spec.default for spec in dataclasses.fields(element)}  # type: ignore[arg-type]
    values = {field: value for field, value in element.values().items() if field not in skip}
    return {field: value for field, value in values.items() if value != defaults[field]}


def written(scene: Contents) -> str:
    """The scene as an MJCF text; see `Scene.to_mjcf`."""
    layout = Layout(scene)
    check(layout)
    world = scene.world
    if world.name != "world" or world.mass is not None:
        raise ValueError(f"{world}: the world of an MJCF file is called world and has no mass")
    names = _Names(layout)
    root = Tag("mujoco", **({"model": scene.name} if scene.name else {}))
    _compiler(root, scene.mass_rules)
    words = _option(root, scene)
    assets = [_mesh(mesh, names) for mesh in scene.meshes]
    assets += [_hfield(hfield, names) for hfield in scene.hfields]
    if assets:
        root.add(Tag("asset")).inside = assets
    _tree(root, layout, names)
    sections = (
        ("contact", [_exclude(pair, names) for pair in scene.excludes] + _pairs(scene, names)),
        ("equality", [_equality(equality, names) for equality in scene.equalities]),
        ("actuator", [_actuator(actuator, names) for actuator in scene.actuators]),
        ("keyframe", [_key(key) for key in scene.keys]),
    )
    for name, tags in sections:
        if tags:
            root.add(Tag(name)).inside = tags
    data = custom.data(words, names.made)
    if data:
        root.add(Tag("custom")).add(Tag("text", name=custom.NAME, data=data))
    return _printed(root, _left_out(scene))


class _Names:
    """Names of elements in the file: their own, or new ones if other elements refer to them."""

    def __init__(self, layout: Layout) -> None:
        self.given: dict[int, str] = {}
        self.made: list[tuple[str, str]] = []
        scene = layout.scene
        bodies = [body for pair in scene.excludes for body in pair]
        bodies += [body for e in scene.equalities for body in (e.body1, e.body2)]
        ends = [geom for pair in scene.pairs for geom in (pair.geom1, pair.geom2)]
        self._name("geom", layout.geoms, ends)
        self._name("body", layout.bodies, bodies)
        self._name("joint", layout.joints, [actuator.joint for actuator in scene.actuators])
        # MJCF knows no asset without a name.
        self._name("mesh", scene.meshes, scene.meshes)
        self._name("hfield", scene.hfields, scene.hfields)

    def _name(self, kind: str, among: Iterable[Any], referred: Iterable[Any]) -> None:
        elements = list(among)
        taken = {element.name for element in elements}
        wanted = {id(element) for element in referred}
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
        return self.given[id(element)]

    def attribute(self, element: Element) -> dict[str, str]:
        """``name=…``, if the element has one."""
        return {"name": self.of(element)} if self.of(element) else {}


def _compiler(root: Tag, rules: MassRules) -> None:
    given = changed(rules)
    if "inertiafromgeom" in given:
        given["inertiafromgeom"] = INERTIA_FROM[given["inertiafromgeom"]]
    root.add(Tag("compiler", angle="radian", **given))


def _option(root: Tag, scene: Contents) -> dict[str, Any]:
    """Adds the option section; returns the settings that it cannot hold."""
    default, settings = Settings().as_dict(), scene.settings.as_dict()
    own = {name: value for name, value in settings.items() if value != default[name]}
    attributes, flags, rest = said(own)
    if scene.gravity != GRAVITY:
        attributes["gravity"] = text(scene.gravity)
    features = changed(scene.features)
    for name, on in features.items():
        if name in custom.OWN_FEATURES:
            rest[name] = on
        else:
            flags[name] = "enable" if on else "disable"
    override = changed(scene.contact_override)
    if override.pop("enable", False):
        flags["override"] = "enable"
    attributes |= {f"o_{name}": text(value) for name, value in override.items()}
    if attributes or flags:
        option = root.add(Tag("option", **attributes))
        if flags:
            option.add(Tag("flag", **flags))
    return rest


def _tree(root: Tag, layout: Layout, names: _Names) -> None:
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
        _before_bodies(tags[id(site.body)], _site(site))


def _before_bodies(tag: Tag, inner: Tag) -> None:
    at = next((i for i, one in enumerate(tag.inside) if one.kind == "body"), len(tag.inside))
    tag.inside.insert(at, inner)


def _body(body: Body, names: _Names) -> Tag:
    placed = changed(body, "name", "parent", "mass", "ipos", "inertia")
    tag = Tag("body", **names.attribute(body), **placed)
    if body.mass is not None:
        inertia = body.inertia
        about = {"fullinertia": inertia} if any(inertia[3:]) else {"diaginertia": inertia[:3]}
        tag.add(Tag("inertial", pos=body.ipos, mass=body.mass, **about))
    return tag


def _joint(joint: Joint, names: _Names) -> Tag:
    skip = ["name", "body"]
    if joint.type in ("ball", "free"):
        skip += ["axis", "ref", "springref"]
    if joint.type == "free":
        skip.append("pos")
    return Tag("joint", **names.attribute(joint), **changed(joint, *skip))


def _mesh(mesh: Mesh, names: _Names) -> Tag:
    arrays = {"vertex": mesh.vertices.ravel().tolist()}
    if mesh.faces is not None:
        arrays["face"] = mesh.faces.ravel().tolist()
    return Tag("mesh", **names.attribute(mesh), **changed(mesh, *ASSET_OWN), **arrays)


def _hfield(hfield: HField, names: _Names) -> Tag:
    nrow, ncol = hfield.elevation.shape
    heights = hfield.elevation.ravel().tolist()
    own = {"size": hfield.size, "nrow": nrow, "ncol": ncol, "elevation": heights}
    return Tag("hfield", **names.attribute(hfield), **own)


def _geom(geom: Geom, names: _Names) -> Tag:
    given = changed(geom, "name", "body", "size", "mesh", "hfield")
    for field, asset in (("mesh", geom.mesh), ("hfield", geom.hfield)):
        if asset is not None:
            given[field] = names.of(asset)
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


def _site(site: Site) -> Tag:
    return Tag("site", **changed(site, "body"))


def _exclude(pair: tuple[Body, Body], names: _Names) -> Tag:
    return Tag("exclude", body1=names.of(pair[0]), body2=names.of(pair[1]))


def _pairs(scene: Contents, names: _Names) -> list[Tag]:
    tags = []
    for pair in scene.pairs:
        first = {"name": pair.name} if pair.name else {}
        ends = {"geom1": names.of(pair.geom1), "geom2": names.of(pair.geom2)}
        tags.append(Tag("pair", **first, **ends, **changed(pair, "name", "geom1", "geom2")))
    return tags


def _equality(equality: Equality, names: _Names) -> Tag:
    given = changed(equality, "name", "type", "body1", "body2", "anchor")
    first = {"name": equality.name} if equality.name else {}
    ends = {"body1": names.of(equality.body1), "body2": names.of(equality.body2)}
    return Tag(equality.type, **first, **ends, anchor=equality.anchor, **given)


def _actuator(actuator: Actuator, names: _Names) -> Tag:
    given = changed(actuator, "name", "joint", "type")
    first = {"name": actuator.name} if actuator.name else {}
    if actuator.biasprm is not None:
        first["biastype"] = "affine"
    return Tag(actuator.type, **first, joint=names.of(actuator.joint), **given)


def _key(key: Key) -> Tag:
    given = changed(key)
    # An empty list cannot be written as an attribute.
    return Tag("key", **{name: value for name, value in given.items() if value != ()})


def _left_out(scene: Contents) -> str:
    """The comment about elements of the scene's file that this text leaves out."""
    count = len(scene.ignored)
    if not count:
        return ""
    what = "1 element" if count == 1 else f"{count} elements"
    return f"<!-- Left out: {what} of the scene's file that cannot change the motion. -->\n"


def _printed(root: Tag, comment: str) -> str:
    lines: list[str] = []
    # Tags to open, and the ends of those that are open.
    pending: list[tuple[int, Tag | str]] = [(0, root)]
    while pending:
        indent, item = pending.pop()
        if isinstance(item, str):
            lines.append("  " * indent + item)
            continue
        lines.append("  " * indent + item.start())
        if item.inside:
            pending.append((indent, f"</{item.kind}>"))
            pending += [(indent + 1, tag) for tag in reversed(item.inside)]
    return comment + "\n".join(lines) + "\n"
