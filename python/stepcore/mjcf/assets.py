"""The section `<asset>`: the meshes and height fields that affect the motion.

A file is opened only if a geom that collides or has mass uses it; all other assets only draw.
MuJoCo documentation, XML reference, asset/mesh, asset/hfield and compiler/meshdir.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore.checks import cut, nearest
from stepcore.mjcf.defaults import Compiler, Defaults
from stepcore.mjcf.nodes import MJCFError, Node
from stepcore.mjcf.validation import bad
from stepcore.scene import asset_files
from stepcore.scene.elements import HField, Mesh

if TYPE_CHECKING:
    from stepcore.scene.scene import Scene

# The placeholder until an asset is read.
_UNREAD = np.zeros((4, 3))
_FIELDS = ("scale", "refpos", "refquat", "inertia", "maxhullvert")


class Assets:
    """The meshes and height fields of a file by name; `read_used` reads those that geoms use.

    drawn: whether geoms that only draw stay in the scene, for `stepcore.mjcf.appearance`.
    clear: for each material by name, whether its opacity is 0.
    """

    drawn = False

    def __init__(self, sections: Iterable[Node], compiler: Compiler, defaults: Defaults) -> None:
        self.compiler = compiler
        self.defaults = defaults
        self.clear: dict[str, bool] = {}
        self.nodes: dict[str, dict[str, Node]] = {"mesh": {}, "hfield": {}}
        self.known: dict[tuple[str, str], Mesh | HField] = {}
        # The first asset read from each file, by path and content type.
        self.read: dict[tuple[str, str], Mesh | HField] = {}
        # The files that were read: sizes by path [bytes], and names as in the text.
        self.sizes: dict[str, int] = {}
        self.named: set[str] = set()
        # Files outside the folder of the main file, and what reads each.
        self.outside: dict[str, str] = {}
        for node in (node for section in sections for node in section.children):
            if node.tag == "material":
                default: Any = defaults.of(node, kind="material").get("rgba", "")
                rgba: Any = node.attrs.get("rgba", default)
                words = rgba.split() if isinstance(rgba, str) else [str(entry) for entry in rgba]
                self.clear[node.attrs.get("name", "")] = len(words) > 3 and _is_zero(words[3])
            elif node.tag in self.nodes:
                name = node.asset_name()
                if not name:
                    raise node.error(f"<{node.tag}> needs a name or a file")
                if name in self.nodes[node.tag]:
                    raise node.error(f'{node.tag} "{cut(name, 80)}": the name is used twice')
                self.nodes[node.tag][name] = node

    def unseen(self, values: Mapping[str, Any]) -> bool:
        """Return whether a geom's material, or else its colour, has opacity 0."""
        if "material" in values:
            return self.clear.get(values["material"], False)
        rgba = values.get("rgba", ())
        return len(rgba) > 3 and rgba[3] == 0

    def of(self, scene: Scene, node: Node, kind: str, name: str) -> Any:
        """Return the mesh or height field that a geom names; its data is read later."""
        if name not in self.nodes[kind]:
            near = nearest(name, sorted(self.nodes[kind]))
            raise node.error(f'<{node.tag}> {kind}="{name}": no such {kind}{near}')
        if (kind, name) not in self.known:
            if kind == "mesh":
                self.known[kind, name] = mesh = Mesh(name=name, vertices=_UNREAD)
                scene.meshes.append(mesh)
            else:
                hfield = HField(name=name, size=(1.0,) * 4, elevation=_UNREAD)
                self.known[kind, name] = hfield
                scene.hfields.append(hfield)
        return self.known[kind, name]

    def read_used(self, scene: Scene) -> None:
        """Read the assets that geoms use, in document order; list the others as ignored."""
        used = {id(asset) for geom in scene.geoms for asset in (geom.mesh, geom.hfield)}
        scene.meshes, scene.hfields = [], []
        for kind, nodes in self.nodes.items():
            for name, node in nodes.items():
                asset = self.known.get((kind, name))
                if asset is None or id(asset) not in used:
                    scene.ignored.append(node.ignored_line("only draws"))
                    continue
                asset.__dict__["place"] = f"{node.file}:{node.line}"
                self._fill(scene, node, asset)
        self._record(scene)

    def _fill(self, scene: Scene, node: Node, asset: Mesh | HField) -> None:
        """Fill an asset; errors of its file name the line of the asset."""
        try:
            if isinstance(asset, Mesh):
                self._mesh(scene, node, asset)
                scene.meshes.append(asset)
            else:
                self._hfield(scene, node, asset)
                if min(asset.elevation.shape) < 2:
                    raise bad(node, "nrow, ncol", asset.elevation.shape, "at least 2")
                scene.hfields.append(asset)
        except MJCFError:
            raise
        except FileNotFoundError as error:
            raise node.missing(error) from None
        except (IsADirectoryError, ValueError) as error:
            raise node.error(str(error)) from None

    def _mesh(self, scene: Scene, node: Node, mesh: Mesh) -> None:
        values = self.defaults.of(node)
        for field in _FIELDS:
            if field in values:
                setattr(mesh, field, values[field])
        sources = [name for name in ("file", "vertex") if name in values]
        if len(sources) != 1:
            conflict = " and ".join(sources) if sources else "none of them"
            raise node.error(f"<mesh> needs one of file, vertex and builtin; it has {conflict}")
        if sources == ["file"]:
            self._from_file(scene, node, mesh, values)
        else:
            if len(values["vertex"]) % 3:
                raise bad(node, "vertex", values["vertex"], "3 numbers for each vertex")
            mesh.vertices = values["vertex"]
        if "face" in values and sources != ["vertex"]:
            raise node.error("<mesh> has faces, but no vertices of its own")
        if "face" in values:
            face = values["face"]
            if len(face) % 3 or not face:
                raise bad(node, "face", face, "3 indices for each face")
            if min(face) < 0:
                raise bad(node, "face", min(face), "indices of vertices, >= 0")
            mesh.faces = np.array(face).reshape(-1, 3)
        count = len(mesh.vertices)
        if count < 4:
            raise node.error(f"<mesh> has {count} vertices: must be at least 4")
        if mesh.faces is not None and len(mesh.faces) and mesh.faces.max() >= count:
            raise node.error(f"<mesh> has a face with vertex {mesh.faces.max()}, of {count}")

    def _hfield(self, scene: Scene, node: Node, hfield: HField) -> None:
        values = node.values
        counts = nrow, ncol = values.get("nrow", 0), values.get("ncol", 0)
        hfield.size = values["size"]
        if "file" in values:
            if any(counts) or "elevation" in values:
                raise node.error("<hfield> has a file, and so no nrow, ncol or elevation")
            self._from_file(scene, node, hfield, values)
            return
        if not (nrow > 0 and ncol > 0 and nrow * ncol <= asset_files.MOST_POINTS):
            limit = f"above 0, and their product at most {asset_files.MOST_POINTS}, without a file"
            raise bad(node, "nrow, ncol", counts, limit)
        heights = values.get("elevation", np.zeros(nrow * ncol))
        if len(heights) != nrow * ncol:
            raise node.error(
                f"<hfield> elevation has {len(heights)} numbers: must be nrow × ncol = "
                f"{nrow * ncol}"
            )
        hfield.elevation = np.asarray(heights).reshape(nrow, ncol)

    def _from_file(
        self, scene: Scene, node: Node, asset: Mesh | HField, values: Mapping[str, Any]
    ) -> None:
        """Read the file of an asset; assets of the same file share its read-only arrays."""
        path = self._path(node, values["file"])
        key = path, values.get("content_type", "")
        first = self.read.get(key)
        if first is not None:
            for field in ("vertices", "faces", "elevation", "file"):
                if field in first.__dict__ and field in asset.__dict__:
                    asset.__dict__[field] = first.__dict__[field]
        elif isinstance(asset, Mesh):
            surface = asset_files.read_mesh(*key)
            asset.vertices, asset.faces = surface.vertices, surface.faces
            place = f"{node.file}:{node.line}: {values['file']}"
            scene.notes += asset_files.notes(place, surface)
        else:
            asset.elevation = asset_files.read_hfield(*key)
        asset.file = path
        self.read.setdefault(key, asset)
        self.sizes.setdefault(path, os.path.getsize(path))
        self.named.add(node.attrs["file"])

    def _path(self, node: Node, name: str) -> str:
        """Return the path of a file; keep it in mind if it is outside the main file's folder."""
        if not name or "\0" in name:
            raise bad(node, "file", name, "the name of a file")
        path = self.compiler.asset(node, name)
        if path is None:
            raise node.error(f'<{node.tag} file="{name}"> in a text needs loads(text, base=folder)')
        real, home = os.path.realpath(path), os.path.realpath(self.compiler.directory or os.sep)
        if os.path.commonpath([real, home]) != home:
            self.outside.setdefault(path, f"{node.file}:{node.line}: <{node.tag}> reads")
        return path

    def _record(self, scene: Scene) -> None:
        """Record which files were read in the scene's source; note what is outside its folder."""
        if self.outside:
            (path, reads), more = next(iter(self.outside.items())), len(self.outside) - 1
            rest = f" and {more} more files, which are" if more else ", which is"
            note = f"{reads} {cut(str(path), 300)}{rest} outside the folder of the main file"
            scene.notes.append(note)
        files = [
            node for nodes in self.nodes.values() for node in nodes.values() if "file" in node.attrs
        ]
        if not files:
            return
        size = sum(self.sizes.values())
        source = scene._source
        if source is not None:
            unread = {
                self.compiler.asset(node, node.attrs["file"])
                for node in files
                if node.attrs["file"] not in self.named
            }
            existing = [path for path in unread if path and os.path.isfile(path)]
            scene._source = replace(
                source,
                files=(*source.files, *self.sizes),
                unread=tuple(name for name in source.unread if name not in self.named),
                read_bytes=size,
                asset_bytes=size + sum(map(os.path.getsize, existing)),
            )


def _is_zero(word: str) -> bool:
    try:
        return float(word) == 0
    except ValueError:
        return False
