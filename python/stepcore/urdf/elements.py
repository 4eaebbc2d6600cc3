"""The schema of URDF, the checks of attributes, and the paths of files.

Format documentation: wiki.ros.org/urdf/XML.
"""

from __future__ import annotations

import os

from stepcore.checks import nearest
from stepcore.mjcf.nodes import MJCFError, Node, Refusals
from stepcore.mjcf.schema import Spec, spec
from stepcore.mjcf.validation import values_of

ORIGIN = spec("xyz:3 rpy:3")
GEOMETRY = spec(
    "",
    {
        "box": spec("size!:3"),
        "sphere": spec("radius!:1"),
        "cylinder": spec("radius!:1 length!:1"),
        "capsule": spec("radius!:1 length!:1"),
        "mesh": spec("filename! scale:3"),
    },
)
INERTIAL = spec(
    "",
    {
        "origin": ORIGIN,
        "mass": spec("value!:1"),
        "inertia": spec("ixx!:1 iyy!:1 izz!:1 ixy:1 ixz:1 iyz:1"),
    },
    once=("origin", "mass", "inertia"),
)
COLLISION = spec(
    "name group", {"origin": ORIGIN, "geometry": GEOMETRY}, once=("origin", "geometry")
)
MATERIAL = spec(
    "name", {"color": spec("rgba:4"), "texture": spec("filename!")}, once=("color", "texture")
)
VISUAL = spec(
    "name group",
    {"origin": ORIGIN, "geometry": GEOMETRY, "material": MATERIAL},
    once=("origin", "geometry", "material"),
)
LINK = {"inertial": INERTIAL, "collision": COLLISION}
JOINT = spec(
    "name! type!:revolute|continuous|prismatic|fixed|floating|planar",
    {
        "origin": ORIGIN,
        "parent": spec("link!"),
        "child": spec("link!"),
        "axis": spec("xyz:3"),
        "limit": spec("lower:1 upper:1 effort:1 velocity:1"),
        "dynamics": spec("damping:1 friction:1"),
        "mimic": spec("joint! multiplier:1 offset:1"),
    },
    once=("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
)
ROBOT = spec("name version", {"link": spec("name! type", LINK, once=("inertial",)), "joint": JOINT})
# The schema with visual elements.
DRAWN_ROBOT = spec(
    "name version",
    {
        "link": spec("name! type", {**LINK, "visual": VISUAL}, once=("inertial",)),
        "joint": JOINT,
        "material": MATERIAL,
    },
)
# Attributes of other programs whose names resemble those of URDF. The last three repeat entries
# of the symmetric inertia matrix.
FOREIGN = ("concave", "iyx", "izx", "izy")
DRAWS = ("visual", "material")
# The program xacro may leave these elements in its output; they have no effect.
XACRO_ONLY = ("xacro:property", "xacro:arg")
MESHES = (".stl", ".obj", ".msh")


def child_of(node: Node, tag: str) -> Node | None:
    return next((child for child in node.children if child.tag == tag), None)


def validate(root: Node, schema: Spec, refusals: Refusals) -> list[str]:
    """Set `values`, remove unread elements and attributes, and return lines for `Scene.ignored`.

    Errors are collected in `refusals`.
    """
    ignored: list[str] = []
    pending: list[tuple[Node, Spec]] = [(root, schema)]
    while pending:
        node, known = pending.pop()
        ignored += _drop_attributes(node, known)
        try:
            node.values = values_of(node, known)
        except MJCFError as error:
            refusals.add(error, node)
            continue
        # Unknown elements are common in URDF files, but the shape of a geom must be known.
        shapeless = node.tag == "geometry" and not any(
            child.tag in known.children for child in node.children
        )
        kept = []
        for child in node.children:
            if child.tag in known.children:
                kept.append(child)
                pending.append((child, known.children[child.tag]))
            elif child.tag.startswith("xacro:") and child.tag not in XACRO_ONLY:
                text = f"<{child.tag}>: this is xacro, from which the program xacro makes URDF"
                refusals.add(child.error(text))
            elif shapeless and child.tag not in XACRO_ONLY:
                near = nearest(child.tag, known.children)
                refusals.add(child.error(f"unknown element <{child.tag}> in <{node.tag}>{near}"))
            else:
                why = "only draws" if child.tag in DRAWS else "says nothing about the motion"
                ignored.append(child.listed(why))
        for tag in known.once:
            same = [child for child in kept if child.tag == tag]
            if len(same) > 1:
                refusals.add(same[1].error(f"a second <{tag}> in the same <{node.tag}>"))
        node.children = kept
    return ignored


def drop_unreadable_visuals(root: Node) -> list[str]:
    """Remove each invalid visual and material; return their errors."""
    links = [node for node in root.children if node.tag == "link"]
    visuals = [node for link in links for node in link.children if node.tag == "visual"]
    errors: list[str] = []
    for parents, tag, schema in (
        ([root, *visuals], "material", MATERIAL),
        (links, "visual", VISUAL),
    ):
        for parent in parents:
            kept = []
            for child in parent.children:
                refusals = Refusals()
                if child.tag == tag:
                    validate(child, schema, refusals)
                errors += map(str, refusals.errors)
                if not refusals.errors:
                    kept.append(child)
            parent.children = kept
    return errors


def _drop_attributes(node: Node, known: Spec) -> list[str]:
    """Remove attributes outside URDF and infinite limits; return lines about the attributes."""
    if node.tag == "limit":
        infinite = [name for name, text in node.attrs.items() if _is_infinite(text)]
        # A joint may be unlimited on both sides, but not on one side.
        free = {"lower", "upper"} if {"lower", "upper"} <= {*infinite} else set()
        for name in {*infinite} & {"effort", "velocity", *free}:
            del node.attrs[name]
    extra = [name for name in node.attrs if name not in known.attrs]
    far = [name for name in extra if "nearest" not in nearest(name, known.attrs)]
    foreign = [name for name in extra if name in far or name in FOREIGN]
    for name in foreign:
        del node.attrs[name]
    return [node.listed(f"{name} is no attribute of URDF") for name in foreign]


def _is_infinite(text: str) -> bool:
    return text.strip().lower().lstrip("+-") in ("inf", "infinity")


def mesh_path(node: Node, directory: str | None, extended: bool) -> str:
    """Return `file_path` of a mesh; raise MJCFError for an unsupported format."""
    name = node.values["filename"].replace("\\", "/")
    if os.path.splitext(name)[1].lower() not in MESHES:
        words = ", ".join(MESHES)
        raise node.error(f'<mesh filename="{name}">: meshes are read from {words}; save it as one')
    return file_path(node, directory, extended)


def file_path(node: Node, directory: str | None, extended: bool) -> str:
    """Return the path of the file that a mesh or texture names, or the name if there is no file.

    The name is ``package://name/…``, ``file://…``, or a path.
    extended: whether the URDF has MuJoCo's extension. The extension's meshdir and strippath then
        determine the path of a file that is not found here.
    """
    name = node.values["filename"].replace("\\", "/")
    scheme, separator, rest = name.partition("://")
    if not separator:
        scheme, rest = "", name
    if scheme == "package":
        place = _in_package(rest, directory)
    elif scheme in ("", "file", "model"):
        place = os.path.join(directory or "", rest)
    else:
        raise node.error(f'<{node.tag} filename="{name}">: {scheme}:// is not known; package:// is')
    if place and os.path.exists(place):
        return os.path.abspath(place)
    return os.path.basename(rest) if extended else rest


def _in_package(name: str, directory: str | None) -> str:
    """Return the path of a file in the URDF's own package or on ROS_PACKAGE_PATH; "" if none."""
    package, _, rest = name.partition("/")
    roots = [place for place in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if place]
    above = None if directory is None else os.path.abspath(directory)
    while above is not None:
        roots.append(above)
        parent = os.path.dirname(above)
        if os.path.basename(above) == package:
            roots.append(parent)
        above = parent if parent != above else None
    for root in roots:
        for place in (os.path.join(root, package, rest), os.path.join(root, rest)):
            if os.path.exists(place) and package in place.split(os.sep):
                return place
    return ""
