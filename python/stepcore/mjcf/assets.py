"""The section `<asset>`: the meshes and height fields that affect the motion.

A file is opened only if a geom that collides or has mass uses it; all other assets only draw.
MuJoCo documentation, XML reference, asset/mesh, mesh/builtin, asset/hfield and compiler/meshdir.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

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
                    scene.ignored.append(node.listed("only draws"))
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
        given = [name for name in ("file", "vertex", "builtin") if name in values]
        if len(given) != 1:
            what = " and ".join(given) if given else "none of them"
            raise node.error(f"<mesh> needs one of file, vertex and builtin; it has {what}")
        if given == ["file"]:
            self._from_file(scene, node, mesh, values)
        elif given == ["builtin"]:
            _fill_builtin(mesh, node, values)
        else:
            if len(values["vertex"]) % 3:
                raise bad(node, "vertex", values["vertex"], "3 numbers for each vertex")
            mesh.vertices = values["vertex"]
        if "face" in values and given != ["vertex"]:
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
        path = self._path(scene, node, values["file"])
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

    def _path(self, scene: Scene, node: Node, name: str) -> str:
        """Return the path of a file; add a note if it is outside the folder of the main file."""
        if not name or "\0" in name:
            raise bad(node, "file", name, "the name of a file")
        path = self._place(node, name)
        if path is None:
            raise node.error(f'<{node.tag} file="{name}"> in a text needs loads(text, base=folder)')
        real, home = os.path.realpath(path), os.path.realpath(self.compiler.directory or os.sep)
        if os.path.commonpath([real, home]) != home:
            scene.notes.append(
                f"{node.file}:{node.line}: <{node.tag}> reads {cut(str(path), 300)}, which is "
                "outside the folder of the main file"
            )
        return path

    def _place(self, node: Node, name: str, folder: str = "meshdir") -> str | None:
        """Return the path for a file name; None in a text without a folder.

        folder: the compiler attribute that gives the folder of such files.
        """
        compiler = node.compiler or self.compiler
        values, directory = compiler.values, compiler.directory
        name = name.replace("\\", "/")
        within = values.get(folder, values.get("assetdir", ""))
        stripped = bool(values.get("strippath"))
        if stripped:
            name = name.rpartition("/")[2]
        if directory is None and not os.path.isabs(os.path.join(within, name)):
            return None
        # With strippath, the folder of an included file is not searched either.
        path = os.path.join(directory or "", within, name)
        return os.path.normpath(path if stripped else compiler.path(node, name, within))

    def _record(self, scene: Scene) -> None:
        """Record which files were read in the scene's source."""
        files = [
            node for nodes in self.nodes.values() for node in nodes.values() if "file" in node.attrs
        ]
        if not files:
            return
        size = sum(self.sizes.values())
        source = scene._source
        if source is not None:
            unread = {
                self._place(node, node.attrs["file"])
                for node in files
                if node.attrs["file"] not in self.named
            }
            there = [path for path in unread if path and os.path.isfile(path)]
            scene._source = replace(
                source,
                files=(*source.files, *self.sizes),
                unread=tuple(name for name in source.unread if name not in self.named),
                read_bytes=size,
                asset_bytes=size + sum(map(os.path.getsize, there)),
            )


def _is_zero(word: str) -> bool:
    try:
        return float(word) == 0
    except ValueError:
        return False


Array = NDArray[Any]
Surface = tuple[Array, Array | None]
# The maximum resolution; the convex hull would have as many vertices.
MOST_CORNERS = 1000
FLAT = ("plate", "square", "disc")
OTHERS = ("grid", "box", "cylinder", "ellipsoid")


def _fill_builtin(mesh: Mesh, node: Node, values: dict[str, Any]) -> None:
    """Fill a mesh with the vertices and faces of its builtin type."""
    kind, params = values["builtin"], values.get("params", ())
    if kind in FLAT:
        raise node.error(f'builtin="{kind}" lies in a plane, so it has no convex hull')
    if kind in OTHERS:
        raise node.error(
            f'builtin="{kind}" is not built yet: load(mujoco.MjModel.from_xml_path("…")) reads '
            "what MuJoCo makes of it"
        )
    if kind not in _KINDS:
        near = nearest(kind, (*_KINDS, *OTHERS, *FLAT))
        raise node.error(f'<mesh> builtin="{kind}": no such mesh{near}')
    make, limits = _KINDS[kind]
    numbers: list[float] = []
    for word, low, high in limits:
        at, whole = len(numbers), isinstance(low, int)
        if at >= len(params) or not low <= params[at] <= high:
            limit = f"{word} from {low:g} to {high:g} at place {at + 1}"
            raise bad(node, "params", params, limit)
        if whole and params[at] != int(params[at]):
            raise bad(node, "params", params[at], f"{word}: a whole number")
        numbers.append(int(params[at]) if whole else params[at])
    if len(numbers) != len(params):
        raise bad(node, "params", params, f"{len(numbers)} numbers")
    mesh.vertices, mesh.faces = make(*numbers)


def _sphere(subdivision: int) -> Surface:
    """Return an icosphere: an icosahedron with bisected edges, projected onto the unit sphere."""
    golden = (1 + 5**0.5) / 2
    points = {
        tuple(np.roll((0.0, a, b * golden), turn))
        for a, b, turn in product((-1, 1), (-1, 1), (0, 1, 2))
    }
    vertices = _unit(np.array(sorted(points)))
    for _ in range(subdivision):
        apart = np.linalg.norm(vertices[:, None] - vertices[None], axis=2)
        # Edges are at most 1.25 times the shortest; the next larger distance is a third longer.
        shortest = apart[apart > 0].min()
        first, second = np.nonzero(np.triu(apart < 1.3 * shortest, 1))
        vertices = np.concatenate([vertices, _unit(vertices[first] + vertices[second])])
    return vertices, None


def _hemisphere(resolution: int) -> Surface:
    """Return the points of a subdivided half octahedron on the unit sphere, and the base centre."""
    n = resolution + 1
    quarter = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    points = {(a * i, b * j, k) for i, j, k in quarter for a, b in product((-1, 1), (-1, 1))}
    return np.concatenate([_unit(np.array(sorted(points), float)), np.zeros((1, 3))]), None


def _cone(count: int, radius: float) -> Surface:
    ring = _ring(np.arange(count) * 2 * np.pi / count)
    below = np.column_stack([ring, np.full(count, -1.0)])
    if radius == 0:
        return np.concatenate([below, [[0.0, 0.0, 1.0]]]), None
    return np.concatenate([below, np.column_stack([radius * ring, np.ones(count)])]), None


def _supersphere(n: int, east: float, north: float) -> Surface:
    latitude = -np.pi / 2 + np.pi * np.arange(1, n) / n
    longitude = -np.pi + 2 * np.pi * np.arange(n) / n
    radius, height = _power(np.cos(latitude), north), _power(np.sin(latitude), north)
    ring = np.column_stack([_power(np.cos(longitude), east), _power(np.sin(longitude), east)])
    rings = [
        np.column_stack([r * ring, np.full(n, z)]) for r, z in zip(radius, height, strict=True)
    ]
    vertices = np.concatenate([[[0.0, 0.0, -1.0]], *rings, [[0.0, 0.0, 1.0]]])
    at = 1 + np.arange((n - 1) * n).reshape(n - 1, n)
    top, after = len(vertices) - 1, np.roll(at, -1, axis=1)
    ends = [np.column_stack([np.zeros(n, int), after[0], at[0]])]
    ends += [np.column_stack([at[-1], after[-1], np.full(n, top)])]
    return vertices, np.concatenate([*ends, _quads(at[:-1], after[:-1], at[1:], after[1:])])


def _supertorus(n: int, radius: float, minor: float, major: float) -> Surface:
    angle = 2 * np.pi * np.arange(n) / n
    out = 1 + radius * _power(np.cos(angle), minor)
    up = radius * _power(np.sin(angle), minor)
    around = [_power(np.cos(angle), major), _power(np.sin(angle), major)]
    vertices = np.stack(
        [around[0][:, None] * out, around[1][:, None] * out, np.tile(up, (n, 1))], axis=2
    ).reshape(-1, 3)
    at = np.arange(n * n).reshape(n, n)
    next_ring, after = np.roll(at, -1, axis=0), np.roll(at, -1, axis=1)
    return vertices, _quads(at, next_ring, after, np.roll(next_ring, -1, axis=1))


def _wedge(res_phi: int, res_theta: int, phi: float, theta: float, gamma: float) -> Surface:
    """Return the cell centres of an angular grid on the unit sphere, around the direction -z."""
    angles = []
    for count, field in ((res_phi, phi), (res_theta, theta)):
        edges = np.linspace(-1, 1, count + 1)
        # Cells are smaller in the middle of the field of view, as in a fovea.
        edges = (1 - gamma) * edges + gamma * edges**5
        angles.append(np.radians(field) * 0.5 * (edges[1:] + edges[:-1]))
    across, up = (grid.ravel() for grid in np.meshgrid(*angles, indexing="ij"))
    flat = np.cos(up)
    return np.column_stack([flat * np.sin(across), np.sin(up), -flat * np.cos(across)]), None


def _unit(points: Array) -> Array:
    result: Array = points / np.linalg.norm(points, axis=1, keepdims=True)
    return result


def _ring(angles: Array) -> Array:
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _power(values: Array, exponent: float) -> Array:
    """Return the power of the absolute values, with the original signs."""
    result: Array = np.sign(values) * np.abs(values) ** exponent
    return result


def _quads(a: Array, b: Array, c: Array, d: Array) -> Array:
    first, second = np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)
    return np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


# By type: what makes it, and its parameters in order, with limits (of whole numbers: ints).
_RESOLUTION = ("resolution", 3, MOST_CORNERS)
_KINDS: dict[str, tuple[Callable[..., Surface], tuple[tuple[str, float, float], ...]]] = {
    "sphere": (_sphere, (("subdivision", 0, 4),)),
    "hemisphere": (_hemisphere, (("resolution", 0, 10),)),
    "cone": (_cone, (("nvert", 3, MOST_CORNERS), ("radius", 0.0, 1))),
    "supersphere": (_supersphere, (_RESOLUTION, ("e", 0.0, 1e6), ("n", 0.0, 1e6))),
    "supertorus": (
        _supertorus,
        (_RESOLUTION, ("radius", 1e-6, 1), ("s", 1e-6, 1e6), ("t", 1e-6, 1e6)),
    ),
    "wedge": (
        _wedge,
        (
            *(("res_phi", 1, MOST_CORNERS), ("res_theta", 1, MOST_CORNERS)),
            *(("fov_phi", 1e-6, 180), ("fov_theta", 1e-6, 90), ("gamma", 0.0, 1)),
        ),
    ),
}
