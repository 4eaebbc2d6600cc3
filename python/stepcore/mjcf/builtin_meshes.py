"""Builtin meshes of MuJoCo 4: `<mesh builtin="…" params="…"/>`.

MuJoCo documentation, XML reference, mesh/builtin. A convex mesh consists of vertices alone; its
faces are those of the convex hull. Of 870 public files six use builtin meshes, and all six use
kinds that are built.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.checks import nearest
from stepcore.mjcf.nodes import Node
from stepcore.mjcf.validation import bad
from stepcore.scene.elements import Mesh

Array = NDArray[Any]
Surface = tuple[Array, Array | None]
# The maximum resolution; the convex hull would have as many vertices.
MOST = 1000
FLAT = ("plate", "square", "disc")
OTHERS = ("grid", "box", "cylinder", "ellipsoid")


class _Params:
    """The parameters of a mesh, read and checked in order."""

    def __init__(self, node: Node, values: dict[str, Any]) -> None:
        self.node = node
        self.numbers = values.get("params", ())
        self.at = 0

    def real(self, low: float, high: float, word: str) -> float:
        value = self.numbers[self.at] if self.at < len(self.numbers) else None
        if value is None or not low <= value <= high:
            limit = f"{word} from {low:g} to {high:g} at place {self.at + 1}"
            raise bad(self.node, "params", self.numbers, limit)
        self.at += 1
        return float(value)

    def whole(self, low: int, high: int, word: str) -> int:
        value = self.real(low, high, word)
        if value != int(value):
            raise bad(self.node, "params", value, f"{word}: a whole number")
        return int(value)


def fill(mesh: Mesh, node: Node, values: dict[str, Any]) -> None:
    """Fill a mesh with the vertices and faces of its builtin type."""
    kind = values["builtin"]
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
    params = _Params(node, values)
    mesh.vertices, mesh.faces = _KINDS[kind](params)
    if params.at != len(params.numbers):
        raise bad(node, "params", params.numbers, f"{params.at} numbers")


def _sphere(params: _Params) -> Surface:
    """Return an icosphere: an icosahedron with bisected edges, projected onto the unit sphere."""
    golden = (1 + 5**0.5) / 2
    points = {
        tuple(np.roll((0.0, a, b * golden), turn))
        for a, b, turn in product((-1, 1), (-1, 1), (0, 1, 2))
    }
    vertices = _unit(np.array(sorted(points)))
    for _ in range(params.whole(0, 4, "subdivision")):
        apart = np.linalg.norm(vertices[:, None] - vertices[None], axis=2)
        # Edges are at most 1.25 times the shortest; the next larger distance is a third longer.
        shortest = apart[apart > 0].min()
        first, second = np.nonzero(np.triu(apart < 1.3 * shortest, 1))
        vertices = np.concatenate([vertices, _unit(vertices[first] + vertices[second])])
    return vertices, None


def _hemisphere(params: _Params) -> Surface:
    """Return the points of a subdivided half octahedron on the unit sphere, and the base centre."""
    n = params.whole(0, 10, "resolution") + 1
    quarter = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    points = {(a * i, b * j, k) for i, j, k in quarter for a, b in product((-1, 1), (-1, 1))}
    return np.concatenate([_unit(np.array(sorted(points), float)), np.zeros((1, 3))]), None


def _cone(params: _Params) -> Surface:
    count = params.whole(3, MOST, "nvert")
    radius = params.real(0, 1, "radius")
    ring = _ring(np.arange(count) * 2 * np.pi / count)
    below = np.column_stack([ring, np.full(count, -1.0)])
    if radius == 0:
        return np.concatenate([below, [[0.0, 0.0, 1.0]]]), None
    return np.concatenate([below, np.column_stack([radius * ring, np.ones(count)])]), None


def _supersphere(params: _Params) -> Surface:
    n = params.whole(3, MOST, "resolution")
    east, north = params.real(0, 1e6, "e"), params.real(0, 1e6, "n")
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


def _supertorus(params: _Params) -> Surface:
    n = params.whole(3, MOST, "resolution")
    radius = params.real(1e-6, 1, "radius")
    minor, major = params.real(1e-6, 1e6, "s"), params.real(1e-6, 1e6, "t")
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


def _wedge(params: _Params) -> Surface:
    """Return the cell centres of an angular grid on the unit sphere, around the direction -z."""
    counts = [params.whole(1, MOST, word) for word in ("res_phi", "res_theta")]
    fields = params.real(1e-6, 180, "fov_phi"), params.real(1e-6, 90, "fov_theta")
    gamma = params.real(0, 1, "gamma")
    angles = []
    for count, field in zip(counts, fields, strict=True):
        edges = np.linspace(-1, 1, count + 1)
        # Cells are smaller in the middle of the field of view, as in a fovea.
        edges = (1 - gamma) * edges + gamma * edges**5
        angles.append(np.radians(field) * 0.5 * (edges[1:] + edges[:-1]))
    phi, theta = angles
    phi, theta = (grid.ravel() for grid in np.meshgrid(phi, theta, indexing="ij"))
    flat = np.cos(theta)
    return np.column_stack([flat * np.sin(phi), np.sin(theta), -flat * np.cos(phi)]), None


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
    """Return the triangles a b c and b d c of each quadrangle."""
    first, second = np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)
    return np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


_KINDS: dict[str, Callable[[_Params], Surface]] = {
    "sphere": _sphere,
    "hemisphere": _hemisphere,
    "cone": _cone,
    "supersphere": _supersphere,
    "supertorus": _supertorus,
    "wedge": _wedge,
}
