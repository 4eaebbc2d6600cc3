"""Where the files of a URDF lie: ``package://name/…``, ``file://…``, or a path."""

from __future__ import annotations

import os

from stepcore.mjcf.nodes import Node

FORMATS = (".stl", ".obj", ".msh")


def mesh_path(node: Node, directory: str | None, extended: bool) -> str:
    """The path of a mesh's file; of a file that is not found, its name, for the reader to look up.

    extended: the file has MuJoCo's extension, whose meshdir and strippath then say where meshes
    lie that are not where the name says.

    Raises MJCFError for a format that is not read.
    """
    name = node.values["filename"].replace("\\", "/")
    if os.path.splitext(name)[1].lower() not in FORMATS:
        words = ", ".join(FORMATS)
        raise node.error(f'<mesh filename="{name}">: meshes are read from {words}; save it as one')
    return file_path(node, directory, extended)


def file_path(node: Node, directory: str | None, extended: bool) -> str:
    """The path of the file that a mesh or a texture names; see `mesh_path`."""
    name = node.values["filename"].replace("\\", "/")
    scheme, found, rest = name.partition("://")
    if not found:
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
    """A file of a package that holds the URDF, or that ROS_PACKAGE_PATH leads to; "" if none."""
    package, _, rest = name.partition("/")
    roots = [place for place in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if place]
    if directory is not None:
        above = os.path.abspath(directory)
        while True:
            roots.append(above)
            if os.path.basename(above) == package:
                roots.append(os.path.dirname(above))
            if os.path.dirname(above) == above:
                break
            above = os.path.dirname(above)
    for root in roots:
        for place in (os.path.join(root, package, rest), os.path.join(root, rest)):
            if os.path.exists(place) and (package in place.split(os.sep)):
                return place
    return ""
