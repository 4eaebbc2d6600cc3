"""Convex shapes by their support: the farthest point along a direction, in the shape's frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

AXES = np.eye(3)


@dataclass(frozen=True)
class Convex:
    """A shape. kind: MuJoCo's word; size: MuJoCo's sizes; vertices: of a mesh, shape (n, 3)."""

    kind: str
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)
    vertices: np.ndarray | None = field(default=None, compare=False)

    @property
    def reach(self) -> float:
        """The largest distance of a point of the shape from its origin [m]."""
        x, y, _ = self.size
        if self.kind == "plane":
            return 0.0
        if self.kind == "mesh":
            return float(np.linalg.norm(self.vertices, axis=1).max())
        return {
            "sphere": x,
            "capsule": x + y,
            "cylinder": np.hypot(x, y),
            "ellipsoid": max(self.size),
            "box": float(np.linalg.norm(self.size)),
        }[self.kind]

    def support(self, u: np.ndarray) -> np.ndarray:
        """The point farthest along u, shape (…, 3). The shape is symmetric unless it is a mesh."""
        x, y, _ = self.size
        match self.kind:
            case "sphere":
                return x * u / np.linalg.norm(u, axis=-1, keepdims=True)
            case "capsule":
                point = x * u / np.linalg.norm(u, axis=-1, keepdims=True)
                point[..., 2] += y * np.sign(u[..., 2])
                return point
            case "ellipsoid":
                scaled = np.array(self.size) * u
                return np.array(self.size) * (
                    scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)
                )
            case "cylinder":
                across = np.hypot(u[..., 0], u[..., 1])[..., None]
                point = np.empty_like(u)
                point[..., :2] = x * u[..., :2] / np.where(across > 0, across, 1.0)
                point[..., 2] = y * np.sign(u[..., 2])
                return point
            case "box":
                return np.array(self.size) * np.sign(u)
            case "mesh":
                return self.vertices[np.argmax(u @ self.vertices.T, axis=-1)]
        raise ValueError(f"kind = {self.kind!r}: must be a convex shape")

    def height(self, u: np.ndarray) -> np.ndarray:
        """How far the shape reaches along u: u times the support point."""
        x, y, _ = self.size
        match self.kind:
            case "sphere":
                return x * np.linalg.norm(u, axis=-1)
            case "capsule":
                return x * np.linalg.norm(u, axis=-1) + y * np.abs(u[..., 2])
            case "ellipsoid":
                return np.linalg.norm(np.array(self.size) * u, axis=-1)
            case "cylinder":
                return x * np.hypot(u[..., 0], u[..., 1]) + y * np.abs(u[..., 2])
            case "box":
                return np.abs(u) @ np.array(self.size)
            case "plane":
                # A half-space: infinitely far along any direction but its own normal.
                return np.where(np.hypot(u[..., 0], u[..., 1]) < 1e-12 * u[..., 2], 0.0, np.inf)
        return np.max(u @ self.vertices.T, axis=-1)

    def outside(self, points: np.ndarray) -> np.ndarray:
        """How far points stand out of the shape [m], negative inside; exact to first order."""
        x, y, _ = self.size
        match self.kind:
            case "sphere":
                return np.linalg.norm(points, axis=-1) - x
            case "capsule":
                nearest = points.copy()
                nearest[..., 2] -= np.clip(points[..., 2], -y, y)
                return np.linalg.norm(nearest, axis=-1) - x
            case "ellipsoid":
                size = np.array(self.size)
                level = np.linalg.norm(points / size, axis=-1)
                slope = np.linalg.norm(points / size**2, axis=-1)
                # (level − 1) over the slope of the level; at the centre the smallest size.
                return np.where(
                    slope > 0, (level - 1) * level / np.where(slope > 0, slope, 1), -size.min()
                )
            case "cylinder":
                return np.maximum(
                    np.hypot(points[..., 0], points[..., 1]) - x, np.abs(points[..., 2]) - y
                )
            case "box":
                return (np.abs(points) - np.array(self.size)).max(axis=-1)
            case "plane":
                return points[..., 2]
        normals, heights = self.faces
        return (points @ normals.T - heights).max(axis=-1)

    @property
    def faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Outward unit normals of a mesh's faces and their distances from the origin."""
        return _faces(self.vertices)

    @property
    def creases(self) -> np.ndarray:
        """Directions e, shape (n, 3): the support jumps where u crosses the plane across e.

        The edges of a polytope, the axis of a capsule or cylinder. A thin ellipsoid's support all
        but jumps across its axes.
        """
        match self.kind:
            case "box" | "ellipsoid":
                return AXES
            case "capsule" | "cylinder":
                return AXES[2:]
            case "mesh":
                return _edges(self.vertices)
        return np.zeros((0, 3))

    @property
    def poles(self) -> np.ndarray:
        """Directions worth a look of their own: a cylinder's axis, normals of faces, axes."""
        match self.kind:
            case "box" | "ellipsoid" | "cylinder" | "capsule":
                return np.concatenate([AXES, -AXES])
            case "mesh":
                return self.faces[0]
        return np.zeros((0, 3))


def _planes(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The faces of a convex hull, by trying every three vertices."""
    count = len(vertices)
    extent = np.ptp(vertices, axis=0).max()
    normals, heights = [], []
    for i in range(count):
        for j in range(i + 1, count):
            rest = np.arange(j + 1, count)
            crosses = np.cross(vertices[j] - vertices[i], vertices[rest] - vertices[i])
            lengths = np.linalg.norm(crosses, axis=1)
            crosses = crosses[lengths > 1e-9 * extent**2]
            for normal in crosses / np.linalg.norm(crosses, axis=1, keepdims=True):
                for side in (normal, -normal):
                    heights_all = vertices @ side
                    height = heights_all.max()
                    if height - side @ vertices[i] < 1e-12 * extent and not any(
                        side @ known > 1 - 1e-12 for known in normals
                    ):
                        normals.append(side)
                        heights.append(height)
    return np.array(normals), np.array(heights)


_cache: dict[bytes, tuple] = {}


def _hull(vertices: np.ndarray) -> tuple:
    key = vertices.tobytes()
    if key not in _cache:
        normals, heights = _planes(vertices)
        extent = np.ptp(vertices, axis=0).max()
        on = [
            set(np.flatnonzero(vertices @ n > h - 1e-11 * extent))
            for n, h in zip(normals, heights, strict=True)
        ]
        edges: list[np.ndarray] = []
        for k, one in enumerate(on):
            for m in range(k):
                shared = sorted(one & on[m])
                if len(shared) >= 2:
                    edge = np.cross(normals[k], normals[m])
                    edge /= np.linalg.norm(edge)
                    if not any(abs(edge @ known) > 1 - 1e-13 for known in edges):
                        edges.append(edge)
        _cache[key] = (normals, heights, np.array(edges))
    return _cache[key]


def _faces(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return _hull(vertices)[:2]


def _edges(vertices: np.ndarray) -> np.ndarray:
    return _hull(vertices)[2]


@dataclass(frozen=True)
class Posed:
    """Two shapes at many poses, seen from A: where B's origin is and how it is turned.

    offset: shape (n, 3) [m]; turn: B's axes as columns, shape (n, 3, 3).
    """

    a: Convex
    b: Convex
    offset: np.ndarray
    turn: np.ndarray

    def take(self, which: np.ndarray) -> Posed:
        return Posed(self.a, self.b, self.offset[which], self.turn[which])

    @property
    def scale(self) -> np.ndarray:
        """What a relative error refers to [m]: the larger shape, or their distance."""
        return np.maximum(max(self.a.reach, self.b.reach), np.linalg.norm(self.offset, axis=1))

    def gap(self, n: np.ndarray) -> np.ndarray:
        """g of directions (poses, k, 3) or (k, 3): a lower bound of the distance, (poses, k)."""
        along = np.einsum(
            "pkj,pj->pk", np.broadcast_to(n, (len(self.offset), *n.shape[-2:])), self.offset
        )
        return along - self.a.height(n) - self.b.height(-(n @ self.turn))

    def apart(self, n: np.ndarray) -> np.ndarray:
        """The point b − a of the two supports, so that g = n·(b − a); (poses, k, 3)."""
        b = self.b.support(-(n @ self.turn)) @ self.turn.transpose(0, 2, 1)
        return self.offset[:, None] + b - self.a.support(n)
