"""References of elements that are not read; a misspelt name is an error there too."""

from __future__ import annotations

from stepcore.checks import nearest
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.worldbody import WorldReader

# Attributes by which sensors, cameras and lights refer to named elements.
REFERENCES = {
    **{name: name for name in ("joint", "actuator", "site", "geom", "camera", "body", "mesh")},
    **dict.fromkeys(("body1", "body2", "subtree1", "subtree2", "target"), "body"),
    **dict.fromkeys(("geom1", "geom2"), "geom"),
    "tendon": "tendon",
}


def check_references(world: WorldReader) -> None:
    """Checks that the elements that ignored elements refer to exist."""
    scene, root = world.scene, world.root
    known = {
        **world.names,
        "joint": {element.name for element in scene.joints},
        "site": {element.name for element in scene.sites},
        "actuator": {element.name for element in scene.actuators},
        "tendon": {element.name for element in scene.tendons},
        **_assets(root),
    }
    for node, kind, name in world.references:
        _known(node, kind, name, known[kind])
    for section in root.children:
        if section.tag == "sensor":
            for node in section.children:
                for attribute, name in node.attrs.items():
                    if attribute in REFERENCES:
                        _known(node, attribute, name, known[REFERENCES[attribute]])


def _known(node: Node, attribute: str, name: str, names: set[str]) -> None:
    if name not in names or not name:
        near = nearest(name, sorted(names))
        raise node.error(f'<{node.tag}> {attribute}="{name}": no such {attribute}{near}')


def _assets(root: Node) -> dict[str, set[str]]:
    """Names of materials, meshes and height fields; by default a mesh is named after its file."""
    names: dict[str, set[str]] = {"material": set(), "mesh": set(), "hfield": set()}
    for section in root.children:
        if section.tag == "asset":
            for node in section.children:
                file = node.attrs.get("file", "").replace("\\", "/").rpartition("/")[2]
                stem = file.rpartition(".")[0] or file
                names.setdefault(node.tag, set()).add(node.attrs.get("name", stem))
    return names
