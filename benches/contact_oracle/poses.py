"""Sizes and poses at which pairs of shapes are tried, and the scene that holds the two."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .convex import AXES, Convex, Posed

# What a trial is about: its sizes, and how the second shape stands to the first.
STYLES = (
    "generic",
    "slabs",  # 4 mm thick
    "needles",  # 2 mm thick
    "aligned",  # parallel faces, edges and axes, up to a quarter turn
    "coplanar",  # aligned, and face to face up to rounding
    "deep",
    "concentric",
    "small",  # 1e-4 m
    "large",  # 1e3 m
    "mixed",  # 1e-3 m against 1 m
    "far",  # 1e4 m from the origin
)


class Trial(NamedTuple):
    """Two shapes and their poses, shape (n, 14): positions and quaternions of both."""

    style: str
    shapes: tuple[Convex, Convex]
    poses: np.ndarray

    @property
    def qpos(self) -> np.ndarray:
        """Of the two free joints, or of the second one's alone: a plane stands still."""
        return self.poses[:, 7:] if self.shapes[0].kind == "plane" else self.poses

    def mjcf(self, options: str = "") -> str:
        """A scene of the two, for either engine."""
        return mjcf(self.shapes, self.poses[0, :7], options)

    @property
    def posed(self) -> Posed:
        """The same poses, seen from the first shape."""
        one, two = self.poses[:, :7], self.poses[:, 7:]
        turn, other = rotation(one[:, 3:]), rotation(two[:, 3:])
        back = turn.transpose(0, 2, 1)
        offset = (back @ (two[:, :3] - one[:, :3])[..., None])[..., 0]
        return Posed(*self.shapes, offset, back @ other)

    def into(self, vectors: np.ndarray) -> np.ndarray:
        """World directions (n, k, 3), seen from the first shape."""
        return vectors @ rotation(self.poses[:, 3:7])

    def points_into(self, points: np.ndarray) -> np.ndarray:
        """World points (n, k, 3), seen from the first shape."""
        return self.into(points - self.poses[:, None, :3])


def rotation(quat: np.ndarray) -> np.ndarray:
    """Matrices of quaternions w x y z of any length, (n, 3, 3)."""
    w, x, y, z = (quat / np.linalg.norm(quat, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Products of quaternions."""
    w, v, x, u = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    scalar = w * x - (v * u).sum(1, keepdims=True)
    return np.concatenate([scalar, w * u + x * v + np.cross(v, u)], axis=1)


def quaternions(rng: np.random.Generator, n: int) -> np.ndarray:
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def shape(rng: np.random.Generator, kind: str, style: str, scale: float) -> Convex:
    """One shape of a style; its largest size is about `scale` [m]."""
    if kind == "plane":
        return Convex("plane", (0.0, 0.0, 1.0))
    size = scale * rng.uniform(0.3, 1.0, 3)
    thin = {"slabs": 0.004, "needles": 0.002}.get(style)
    if thin and kind not in ("sphere", "mesh"):
        flat = {"capsule": [0], "cylinder": [1], "ellipsoid": [rng.integers(3)], "box": [2]}[kind]
        if style == "needles":
            flat = {"cylinder": [0], "ellipsoid": [0, 2], "box": [0, 1]}.get(kind, flat)
        size[flat] = thin / 2 * scale / 0.5
    used = {"sphere": 1, "capsule": 2, "cylinder": 2, "mesh": 0}.get(kind, 3)
    size[used:] = 0
    if kind != "mesh":
        return Convex(kind, tuple(size.tolist()))
    count = int(rng.integers(4, 13))
    vertices = rng.normal(size=(count, 3))
    vertices *= scale * rng.uniform(0.6, 1, (count, 1)) / np.linalg.norm(vertices, axis=1)[:, None]
    if thin:
        vertices[:, 2 if style == "slabs" else slice(1, 3)] *= thin
    # MuJoCo keeps vertices in single precision.
    return Convex("mesh", vertices=np.float64(np.float32(vertices)))


def trial(rng: np.random.Generator, kinds: tuple[str, str], style: str, n: int) -> Trial:
    """Two shapes of a style and n poses of them: apart, touching and overlapping."""
    scales = {
        "small": (1e-4, 1e-4),
        "large": (1e3, 1e3),
        "mixed": (1e-3, 1.0) if rng.random() < 0.5 else (1.0, 1e-3),
    }.get(style, (0.5, 0.5))
    a, b = (shape(rng, kind, style, scale) for kind, scale in zip(kinds, scales, strict=True))
    one, turn = quaternions(rng, n), quaternions(rng, n)
    if style in ("aligned", "coplanar"):
        quarters = np.sqrt(0.5) * rng.integers(-1, 2, (n, 4))
        quarters[~quarters.any(axis=1)] = (1, 0, 0, 0)
        turn = quarters / np.linalg.norm(quarters, axis=1, keepdims=True)
    matrix = rotation(turn)
    offset = _offset(rng, a, b, matrix, style)
    centre = rng.normal(size=(n, 3)) * max(scales)
    if style == "far":
        centre += 1e4 * rng.choice([-1, 1], (n, 3))
    if style in ("aligned", "coplanar"):
        # No rounding of the frame either: the first shape's axes are the world's.
        one, centre = np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros((n, 3))
    if kinds[0] == "plane":
        one, centre = np.tile(one[0], (n, 1)), np.tile(centre[0], (n, 1))
    there = centre + (rotation(one) @ offset[..., None])[..., 0]
    poses = np.concatenate([centre, one, there, product(one, turn)], axis=1)
    return Trial(style, (a, b), poses)


def _offset(
    rng: np.random.Generator, a: Convex, b: Convex, matrix: np.ndarray, style: str
) -> np.ndarray:
    """Where the second shape's origin is: some point of one lies on some point of the other, or
    ahead of it."""
    n = len(matrix)
    if a.kind == "plane":
        height = b.height(-(AXES[None, 2:] @ matrix))
        nearness = rng.choice([0, 1e-6, 1e-3, 1], (n, 1), p=[0.2, 0.1, 0.2, 0.5])
        over = rng.normal(size=(n, 1)) * nearness * b.reach
        return np.concatenate([rng.normal(size=(n, 2)), height + over], axis=1)
    way = rng.normal(size=(n, 1, 3))
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    if style == "concentric":
        return np.zeros((n, 3))
    if style == "coplanar":
        way = AXES[rng.integers(0, 3, n)][:, None] * rng.choice([-1, 1], (n, 1, 1))
        touch = (a.height(way) + b.height(-(way @ matrix)))[..., None] * way
        slide = rng.normal(size=(n, 3)) * min(a.reach, b.reach) / 2
        slide[rng.random(n) < 0.3] = 0
        return touch[:, 0] + np.where(way[:, 0] != 0, 0.0, slide)
    if style == "deep":
        return 0.2 * rng.uniform(-1, 1, (n, 1)) * way[:, 0] * min(a.reach, b.reach)
    back = matrix.transpose(0, 2, 1)
    from_a = a.support(way)[:, 0]
    other = rng.normal(size=(n, 1, 3))
    other /= np.linalg.norm(other, axis=-1, keepdims=True)
    # Half of them apart, along `way` from surface to surface.
    free = rng.random((n, 1)) < 0.5
    other = np.where(free[:, None], -(way @ matrix), other)
    from_b = (b.support(other) @ back)[:, 0]
    ahead = rng.exponential(0.3, (n, 1)) * np.where(rng.random((n, 1)) < 0.3, 1e-3, 1.0)
    inside = from_a * rng.uniform(0.5, 1, (n, 1)) - from_b * rng.uniform(0.5, 1, (n, 1))
    return np.where(free, from_a - from_b + ahead * way[:, 0] * min(a.reach, b.reach), inside)


def mjcf(shapes: tuple[Convex, Convex], pose: np.ndarray, options: str = "") -> str:
    """A scene of two shapes on free joints; a plane stands still at `pose`."""
    bodies, meshes = [], []
    for name, one in zip("ab", shapes, strict=True):
        if one.kind == "mesh":
            listed = " ".join(map(repr, one.vertices.ravel().tolist()))
            meshes.append(f'<mesh name="{name}" vertex="{listed}"/>')
            geom = f'type="mesh" mesh="{name}"'
        else:
            geom = f'type="{one.kind}" size="{" ".join(map(repr, one.size))}"'
        if one.kind == "plane":
            pos, quat = (" ".join(map(repr, part.tolist())) for part in (pose[:3], pose[3:]))
            bodies.append(f'<geom name="{name}" {geom} pos="{pos}" quat="{quat}"/>')
            continue
        bodies.append(
            f'<body name="{name}"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
            f'<geom name="{name}" {geom}/></body>'
        )
    assets = f"<asset>{''.join(meshes)}</asset>" if meshes else ""
    return f"<mujoco>{options}{assets}<worldbody>{''.join(bodies)}</worldbody></mujoco>"
