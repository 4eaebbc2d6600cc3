"""Write a `Scene` as MJCF, with exact numbers and without defaults, or in the text of its own file.

If only settings have changed, `<option>`, `<flag>` and `<custom>` are edited in place, or new
sections at the end override the earlier ones. An edited text is used only if it reads back as the
scene.
"""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stepcore import checks, files
from stepcore._core import Settings
from stepcore.mjcf.nodes import DEPTH, OWN_TEXT
from stepcore.mjcf.option import NAMED_KINDS, as_option, implied, own_data, shortest, to_say
from stepcore.mjcf.reader import read_text
from stepcore.mjcf.schema import OWN_FEATURES, changed_attributes
from stepcore.scene import frames
from stepcore.scene.element import field_rows
from stepcore.scene.elements import (
    WHOLE,
    Actuator,
    Body,
    Element,
    Equality,
    Geom,
    HField,
    Joint,
    Mesh,
    Sensor,
    Site,
    Tendon,
)
from stepcore.scene.elements.actuator import TARGET_FIELDS
from stepcore.scene.elements.actuator_laws import ALL_LAW_FIELDS, FED
from stepcore.scene.elements.body import SITE_SIZE
from stepcore.scene.elements.sensor import ENDS, OF_GAP, TYPED
from stepcore.scene.elements.tendon import STOPS, stop_parts
from stepcore.scene.frames import Vec
from stepcore.scene.layout import SIZES, Layout
from stepcore.scene.records import check_scene

if TYPE_CHECKING:
    from stepcore.mjcf.nodes import Source
    from stepcore.scene.layout import Layout
    from stepcore.scene.scene import Scene

# Characters that XML 1.0 does not allow, even escaped.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_ESCAPES = {"&": "&amp;", "<": "&lt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}


class Tag:
    """An element to write: its attributes in order, and its children."""

    def __init__(self, kind: str, /, **attributes: Any) -> None:
        self.kind = kind
        self.attributes: dict[str, str] = {}
        self.inside: list[Tag] = []
        self.set(**attributes)

    def set(self, **attributes: Any) -> Tag:
        self.attributes |= {key: text(value) for key, value in attributes.items()}
        return self

    def add(self, tag: Tag) -> Tag:
        self.inside.append(tag)
        return tag

    def start(self) -> str:
        words = [self.kind, *(f'{key}="{value}"' for key, value in self.attributes.items())]
        return f"<{' '.join(words)}{'>' if self.inside else '/>'}"


def text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (tuple, list)):
        return " ".join(shortest(number) for number in value)
    return quotable(value) if isinstance(value, str) else shortest(value)


def quotable(value: str) -> str:
    """Escape a text for quotes; raise ValueError for characters that XML does not allow."""
    if _FORBIDDEN.search(value):
        raise ValueError(f"{value!r}: XML does not allow this character in a name")
    return "".join(_ESCAPES.get(letter, letter) for letter in value)


def printed(root: Tag, comment: str) -> str:
    """Return the text of a whole file."""
    lines: list[str] = []
    # (indentation, tag to write or end tag) in reverse order.
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


class Names:
    """The names of elements in the written file.

    referred: elements of any kind that others refer to, and that therefore need a name.
    made: (kind, name) of elements that have a name only for that reason.
    """

    def __init__(self, layout: Layout, referred: Iterable[Element]) -> None:
        self.given: dict[int, str] = {}
        self.made: list[tuple[str, str]] = []
        scene = layout.scene
        wanted = {id(element) for element in referred}
        # In MJCF every asset needs a name.
        wanted |= {id(asset) for asset in (*scene.meshes, *scene.hfields)}
        for kind in NAMED_KINDS:
            # Elements inside bodies are numbered in document order.
            elements = layout.elements(kind)
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
        return self.given[id(element)]

    def in_place(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        """Return the given fields, with names in place of elements."""
        return {
            field: self.of(value) if isinstance(value, Element) else value
            for field, value in fields.items()
            if value is not None
        }

    def attribute(self, element: Element) -> dict[str, str]:
        """Return the attribute ``name``, if the element has a name in the file."""
        name = self.given.get(id(element), getattr(element, "name", ""))
        return {"name": name} if name else {}


# The group of disabled actuators.
DISABLED = 30
# Attributes of `<general>`, and the shortcuts that also have them.
GENERAL = {"actearly": (), "actrange": ("intvelocity",)}


def written(scene: Scene) -> str:
    """Return the scene as an MJCF text; see `Scene.to_mjcf`."""
    layout = Layout(scene)
    check_scene(layout)
    world = scene.world
    if world.name != "world" or world.mass is not None:
        raise ValueError(f"{world}: the world of an MJCF file is called world and has no mass")
    names = Names(layout, _referred(scene))
    root = Tag("mujoco", **({"model": scene.name} if scene.name else {}))
    compiler = root.add(Tag("compiler", angle="radian", **changed_attributes(scene.mass_rules)))
    if ranges := changed_attributes(scene.lengthrange):
        compiler.add(Tag("lengthrange", **ranges))
    words = _add_option(root, scene)
    meshes = [_mesh(mesh, names) for mesh in scene.meshes]
    _add_section(root, "asset", meshes + [_hfield(hfield, names) for hfield in scene.hfields])
    _add_tree(root, layout, names)
    bodies = [map(names.of, pair) for pair in scene.excludes]
    excluded = [Tag("exclude", body1=first, body2=second) for first, second in bodies]
    _add_section(root, "contact", excluded + [_tag("pair", pair, names) for pair in scene.pairs])
    _add_section(root, "tendon", [_tendon(tendon, names) for tendon in scene.tendons])
    _add_section(root, "equality", [_equality(tie, names) for tie in scene.equalities])
    actuators = [
        _actuator(actuator, scene.actuators[at + 1 : at + len(actuator.inputs)], names)
        for at, actuator in enumerate(scene.actuators)
        if actuator.type != "input"
    ]
    _add_section(root, "actuator", actuators)
    _add_section(root, "sensor", [_sensor(sensor, names) for sensor in scene.sensors])
    keys = [_tag("key", key, names) for key in scene.keys]
    for key in keys:
        # An empty list cannot be written as an attribute.
        key.attributes = {name: value for name, value in key.attributes.items() if value}
    _add_section(root, "keyframe", keys)
    data = own_data(words, names.made)
    if data:
        root.add(Tag("custom")).add(Tag("text", name=OWN_TEXT, data=data))
    count = len(scene.ignored)
    elements = "1 element" if count == 1 else f"{count} elements"
    comment = f"<!-- Left out: {elements} of the scene's file that cannot change the motion. -->\n"
    return printed(root, comment if count else "")


def _referred(scene: Scene) -> list[Element]:
    holders = [*scene.pairs, *scene.equalities, *scene.actuators, *scene.sensors]
    fields = [(e, f) for e in holders for f, row in field_rows(type(e)).items() if row.type.refers]
    ends = [getattr(element, field) for element, field in fields if field != "feeds"]
    ends += [body for pair in scene.excludes for body in pair]
    ends += [element for tendon in scene.tendons for element in tendon.elements()]
    return [end for end in ends if isinstance(end, Element)]


def _add_section(root: Tag, name: str, tags: list[Tag]) -> None:
    if tags:
        root.add(Tag(name)).inside = tags


def _add_option(root: Tag, scene: Scene) -> dict[str, Any]:
    """Add the option section; return the settings that MJCF lacks."""
    attributes, flags, rest = as_option(to_say(scene.settings))
    for name, usual in WHOLE.items():
        if getattr(scene, name) != usual:
            attributes[name] = text(getattr(scene, name))
    features = changed_attributes(scene.features)
    for name, on in features.items():
        if name in OWN_FEATURES:
            rest[name] = on
        else:
            flags[name] = "enable" if on else "disable"
    override = changed_attributes(scene.contact_override)
    if override.pop("enable", False):
        flags["override"] = "enable"
    attributes |= {f"o_{name}": text(value) for name, value in override.items()}
    if any(not actuator.enabled for actuator in scene.actuators):
        attributes["actuatorgroupdisable"] = str(DISABLED)
    if attributes or flags:
        root.add(_option(attributes, flags))
    return rest


def _option(attributes: dict[str, str], flags: dict[str, str]) -> Tag:
    option = Tag("option", **attributes)
    option.inside = [Tag("flag", **flags)] if flags else []
    return option


def _tag(kind: str, element: Element, names: Names, *skip: str, **first: Any) -> Tag:
    """Return a tag with the element's name, `first`, and the fields that are no defaults."""
    attributes = changed_attributes(element, "name", *skip, *first)
    return Tag(kind, **names.attribute(element), **names.in_place(first | attributes))


def _mesh(mesh: Mesh, names: Names) -> Tag:
    tag = _tag("mesh", mesh, names, "vertices", "faces", "file")
    tag.set(vertex=mesh.vertices.ravel().tolist())
    if mesh.faces is not None:
        tag.set(face=mesh.faces.ravel().tolist())
    return tag


def _hfield(hfield: HField, names: Names) -> Tag:
    (nrow, ncol), heights = hfield.elevation.shape, hfield.elevation.ravel().tolist()
    tag = _tag("hfield", hfield, names, "elevation", "file")
    return tag.set(nrow=nrow, ncol=ncol, elevation=heights)


def _add_tree(root: Tag, layout: Layout, names: Names) -> None:
    """Add the bodies, each with its joints, geoms and sites before its children."""
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
        # Child bodies follow in the order of the layout.
        for joint in layout.joints_of.get(id(body), []):
            tag.add(_joint(joint, names))
    for geom in layout.geoms:
        _before_bodies(tags[id(geom.body)], _geom(geom, names))
    for site in layout.sites:
        _before_bodies(tags[id(site.body)], _site(site, names))


def _before_bodies(tag: Tag, inner: Tag) -> None:
    at = next((i for i, child in enumerate(tag.inside) if child.kind == "body"), len(tag.inside))
    tag.inside.insert(at, inner)


def _body(body: Body, names: Names) -> Tag:
    tag = _tag("body", body, names, "parent", "mass", "ipos", "inertia", "iquat")
    if body.mass is not None:
        tag.add(Tag("inertial", pos=body.ipos, mass=body.mass, **_inertia(body)))
    return tag


def _inertia(body: Body) -> dict[str, Vec]:
    inertia = body.inertia
    if body.iquat is not None:
        turn = {} if body.iquat == frames.IDENTITY else {"quat": body.iquat}
        return {**turn, "diaginertia": _moments(body.iquat, inertia)}
    # The engine sorts principal moments that it computes; moments given as diaginertia keep their
    # order.
    falling = inertia[0] >= inertia[1] >= inertia[2]
    diagonal = not any(inertia[3:]) and (falling or min(inertia[:3]) == 0.0)
    return {"diaginertia": inertia[:3]} if diagonal else {"fullinertia": inertia}


def _moments(quat: Vec, inertia: Vec) -> Vec:
    """Return the principal moments from which a reader computes exactly this inertia."""
    if quat == frames.IDENTITY:
        return inertia[:3]
    w, x, y, z = quat
    best: Vec = (0.0, 0.0, 0.0)
    # Iterate twice, because the quaternion has unit length only up to rounding.
    for _ in range(2):
        turned = frames.turned_inertia(quat, (*best, 0.0, 0.0, 0.0))
        missing = [a - b for a, b in zip(inertia, turned, strict=True)]
        more = frames.turned_inertia((w, -x, -y, -z), missing)
        best = tuple(a + b for a, b in zip(best, more[:3], strict=True))
    for moments in itertools.product(*map(_neighbours, best)):
        if frames.turned_inertia(quat, (*moments, 0.0, 0.0, 0.0)) == inertia:
            return moments
    return best


def _neighbours(x: float) -> list[float]:
    above, below = math.nextafter(x, math.inf), math.nextafter(x, -math.inf)
    further = math.nextafter(above, math.inf), math.nextafter(below, -math.inf)
    # Somebody wrote a short number.
    return [float(f"{x:.12g}"), x, above, further[0], below, further[1]]


def _joint(joint: Joint, names: Names) -> Tag:
    skip = ["body"]
    if joint.type in ("ball", "free"):
        skip += ["axis", "ref", "springref"]
    if joint.type == "free":
        skip.append("pos")
    # Without limited="true", a range of 0 0 means no limit.
    limited = {"limited": "true"} if joint.range == (0.0, 0.0) else {}
    return _tag("joint", joint, names, *skip, **limited)


def _geom(geom: Geom, names: Names) -> Tag:
    attributes = changed_attributes(geom, "name", "body", "size", "mesh", "hfield")
    attributes |= names.in_place({"mesh": geom.mesh, "hfield": geom.hfield})
    if attributes.pop("hidden", False):
        # MuJoCo's grey with opacity 0.
        attributes["rgba"] = (0.5, 0.5, 0.5, 0.0)
    used = SIZES[geom.type]
    # MuJoCo requires a grid spacing > 0 for a plane.
    size = geom.size[:used] if used else (*geom.size[:2], geom.size[2] or 1.0)
    if "mesh" not in attributes and "hfield" not in attributes:
        attributes = {"size": size, **attributes}
    first = {"type": attributes.pop("type")} if "type" in attributes else {}
    return Tag("geom", **names.attribute(geom), **first, **attributes)


def _site(site: Site, names: Names) -> Tag:
    tag, size = _tag("site", site, names, "body", "size"), site.size[: SIZES[site.type]]
    return tag if size == SITE_SIZE[: len(size)] else tag.set(size=size)


def _tendon(tendon: Tendon, names: Names) -> Tag:
    tag = _tag("fixed" if tendon.fixed else "spatial", tendon, names, "path")
    kinds = {stop: kind for kind, stop in STOPS.items()}
    for stop in tendon.path:
        tag.add(Tag(kinds.get(type(stop), "site"), **names.in_place(stop_parts(stop))))
    return tag


def _equality(equality: Equality, names: Names) -> Tag:
    ends = equality.given()
    if equality.body1 is not None and equality.type == "connect":
        # MuJoCo requires an anchor with body1.
        ends["anchor"] = equality.anchor
    return _tag(equality.type, equality, names, "type", **ends)


def _actuator(actuator: Actuator, behind: list[Actuator], names: Names) -> Tag:
    """Return the tag of an actuator. behind: the following actuators, one per further input."""
    attributes = changed_attributes(actuator, "name", "type", "enabled")
    target = {field: attributes.pop(field, None) for field in TARGET_FIELDS}
    first: dict[str, Any] = names.attribute(actuator) | names.in_place(target)
    if not actuator.enabled:
        first["group"] = DISABLED
    kind = actuator.type
    if any(field in attributes and kind not in also for field, also in GENERAL.items()):
        kind = "general"
    low, high = actuator.forcerange or (-1.0, 1.0)
    if kind == "dcmotor" and low != -high:
        if actuator.law.controller is not None:
            limit = "alike both ways, to be written as MJCF"
            raise checks.refuse(actuator, "forcerange", actuator.forcerange, limit)
        kind = "general"
    if kind != actuator.type:
        attributes = {
            field: value for field, value in attributes.items() if field not in ALL_LAW_FIELDS
        }
        return Tag(kind, **first, **actuator.law.general(), **attributes)
    if kind in FED:
        first |= _of_inputs(actuator, behind, attributes)
    if kind == "dcmotor":
        attributes |= _motor(attributes)
    if actuator.biasprm is not None and actuator.biastype is None:
        first["biastype"] = "affine"
    return Tag(kind, **first, **attributes)


def _of_inputs(
    actuator: Actuator, behind: list[Actuator], attributes: dict[str, Any]
) -> dict[str, Any]:
    """Return the control ranges of a controller, each of which is an actuator in stepcore."""
    words = actuator.inputs
    for word, other in zip(words[1:], behind, strict=False):
        name = f"{actuator.name}/{word}" if actuator.name else ""
        late = ("delay", "nsample", "interp")
        same = all(getattr(other, field) == getattr(actuator, field) for field in late)
        stands = other.feeds is actuator and other.input == word and other.name == name
        bounded = actuator.type == "pid" or other.ctrlrange == actuator.ctrlrange
        if not (stands and same and bounded):
            limit = "inputs right behind it, named by it and late like it, to be written as MJCF"
            raise checks.refuse(actuator, "input", actuator.input, limit)
    if actuator.type != "pid":
        return {}
    ctrlrange = attributes.pop("ctrlrange", None)
    bounds = [ctrlrange, *(other.ctrlrange for other in behind)]
    return {f"{word}range": b for word, b in zip(words, bounds, strict=False) if b is not None}


def _motor(attributes: dict[str, Any]) -> dict[str, Any]:
    """Remove the motor fields that MJCF combines from `given`; return the combined attributes."""
    fields = [
        attributes.pop(name, None) or 0.0 for name in ("kp", "ki", "kv", "slewmax", "imax", "vmax")
    ]
    bounds, rate = attributes.pop("forcerange", None), attributes.pop("current_rate", None) or 0.0
    words: dict[str, Any] = {"controller": tuple(fields)} if any(fields) else {}
    if thermal := attributes.pop("thermal", None):
        words["thermal"] = (*thermal[:2], 0.0, *thermal[2:])
    if bounds or rate:
        words["saturation"] = (bounds[1] if bounds else 0.0, 0.0, rate)
    return words


def _sensor(sensor: Sensor, names: Names) -> Tag:
    attributes = _end(sensor, names, sensor.object, sensor.objtype, "1")
    attributes |= _end(sensor, names, sensor.reference, sensor.reftype, "2")
    if sensor.data:
        attributes["data"] = " ".join(sensor.data)
    skip = ["type", "object", "reference", "objtype", "reftype", "data"]
    if sensor.type == "user":
        attributes["dim"] = sensor.num
        skip.append("num")
    return _tag(sensor.type, sensor, names, *skip, **attributes)


def _end(
    sensor: Sensor, names: Names, element: Element | None, word: str, number: str
) -> dict[str, Any]:
    """Return the attributes that name the object or the reference of a sensor.

    number: "1" for the object, "2" for the reference.
    """
    if element is None:
        return {}
    kind, name = type(element).__name__.lower(), names.of(element)
    if sensor.type in TYPED and not (sensor.type == "insidesite" and number == "2"):
        prefix = "obj" if number == "1" else "ref"
        typed = (word or "xbody") if kind == "body" else kind
        return {f"{prefix}type": typed, f"{prefix}name": name}
    numbered = f"{'subtree' if word == 'subtree' else kind}{number}"
    return {numbered if sensor.type in (*OF_GAP, "contact") and numbered in ENDS else kind: name}


# A start tag, a tag of stepcore's own text, and an attribute that names a file.
_START = rb"""<%s\b(?:[^"'>]|"[^"]*"|'[^']*')*>"""
_OWN_START = re.compile(rb"""<text\s[^>]*\bname\s*=\s*["']%s["'][^>]*>""" % OWN_TEXT.encode())
_NAMES_FILE = re.compile(rb"\sfile\w*\s*=")


def save(scene: Scene, path: str | os.PathLike[str]) -> None:
    target = Path(files.as_path("path", path))
    data = current_text(scene, os.path.abspath(target.parent))
    target.write_bytes(written(scene).encode() if data is None else data)


def current_text(scene: Scene, directory: str) -> bytes | None:
    """Return the text of the scene's file with the current settings; None if not possible.

    directory: the folder in which the text will be saved.
    """
    source = scene._source
    original = None if source is None else _read(type(scene)(), source.data, source)
    if source is None or original is None:
        return None
    same = original.with_settings(scene.settings)
    same.name = scene.name
    if same != scene:
        return None
    if _NAMES_FILE.search(source.data) and directory != source.directory:
        return None
    if original == scene:
        return source.data
    for in_place in (True, False):
        data = _edited(source.data, in_place, original, scene)
        if _read(type(scene)(), data, source) == scene:
            return data
    return None


def _read(scene: Scene, data: bytes, source: Source) -> Scene | None:
    """Fill an empty scene from a text and return it; None if the text cannot be read."""
    try:
        read_text(scene, data, base=source.directory)
    except (ValueError, OSError):
        return None
    return scene


def _edited(data: bytes, in_place: bool, original: Scene, scene: Scene) -> bytes:
    """Return the text with the settings of `scene`, which only reading it can prove.

    in_place: whether to edit the last <option>; otherwise a new one is added at the end.
    """
    before, after = original.settings.as_dict(), scene.settings.as_dict()
    implications = implied(before).keys() ^ implied(after).keys()
    changed = {
        name: value
        for name, value in after.items()
        if value != before[name] or name in implications
    }
    attributes, flags, _ = as_option(changed)
    if scene.name != original.name:
        data = _with(data, _last_start(data, "mujoco"), {"model": scene.name})
    for tag, values in (("option", attributes), ("flag", flags)):
        start = _last_start(data, tag) if in_place else None
        if start:
            data = _with(data, start, values)
            values.clear()
    added = [_option(attributes, flags)] if attributes or flags else []
    rest = as_option(to_say(scene.settings))[2]
    opening = _OWN_START.search(data)
    if opening:
        data = _with_words(data, opening, rest)
    elif rest:
        added.append(Tag("custom"))
        added[-1].add(Tag("text", name=OWN_TEXT, data=own_data(rest)))
    lines = "".join(f"  {_on_one_line(tag)}\n" for tag in added)
    end = max(data.rfind(b"</"), 0)
    return data[:end] + lines.encode() + data[end:]


def _last_start(data: bytes, tag: str) -> re.Match[bytes] | None:
    return max(re.finditer(_START % tag.encode(), data), key=re.Match.start, default=None)


def _with_words(data: bytes, opening: re.Match[bytes], rest: dict[str, Any]) -> bytes:
    """Return the text with these settings in stepcore's own text, which keeps its other words."""
    match = re.search(r"""\bdata\s*=\s*["']([^"']*)["']""", opening[0].decode("utf-8", "replace"))
    settings = Settings().as_dict()
    words = (match[1] if match else "").split()
    kept_words = [word for word in words if word.partition("=")[0] not in settings]
    text = " ".join([*filter(None, [own_data(rest)]), *kept_words])
    if not text and opening[0].endswith(b"/>"):
        # MuJoCo refuses a text without data.
        return data[: opening.start()] + data[opening.end() :]
    return _with(data, opening, {"data": text})


def _with(data: bytes, start: re.Match[bytes] | None, attributes: dict[str, str]) -> bytes:
    """Return the text with these attributes in a start tag."""
    if start is None:
        return data
    tag = start[0]
    for name, value in attributes.items():
        word = f'{name}="{quotable(value)}"'.encode()
        match = re.search(rb"""(?<=\s)%s\s*=\s*("[^"]*"|'[^']*')""" % name.encode(), tag)
        if match:
            tag = tag[: match.start()] + word + tag[match.end() :]
        else:
            cut = len(tag) - (2 if tag.endswith(b"/>") else 1)
            tag = tag[:cut].rstrip() + b" " + word + tag[cut:]
    return data[: start.start()] + tag + data[start.end() :]


def _on_one_line(tag: Tag) -> str:
    inside = "".join(map(_on_one_line, tag.inside))
    return tag.start() + (f"{inside}</{tag.kind}>" if inside else "")
