"""Stage 2, detect: contacts of the pairs of shapes that the reference knows."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .model import Model, Pair
from .place import Placed, jacobians
from .rotation import Array, cross, matrix, unit

# Planes between two shapes on their way after which they count as met.
PLANES = 32
# Cosine of the angle by which a normal may turn on the way and still stand for the contact.
TURNED = 0.999
# Sine of an angle between a cylinder and a plane's normal that is only rounding.
UPRIGHT = 1e-15

# Distance, position, normal, and what touches: a number by which the contact is known again.
Touch = tuple[float, Array, Array, int]


@dataclass
class Contact:
    """Where two geoms meet: `dist` < 0 is overlap, the frame's first row points from 1 to 2."""

    pair: Pair
    dist: float  # [m]
    pos: Array  # halfway between the surfaces [m], shape (3,)
    frame: Array  # rows: normal, two tangents; shape (3, 3)
    feature: int = 0  # which of the pair's contacts
    ahead: Array = field(default_factory=lambda: np.zeros(3))  # of pos to geom 2's own point [m]


def tangents(normal: Array) -> Array:
    """A frame on the normal, chosen as MuJoCo chooses it, shape (3, 3)."""
    start = np.array([0.0, 1.0, 0.0] if abs(normal[1]) < 0.5 else [0.0, 0.0, 1.0])
    first = unit(start - normal * (normal @ start))
    return np.array([normal, first, cross(normal, first)])


def above(plane: Shape, point: Array, feature: int) -> Touch:
    """A point's height above the plane."""
    normal = plane.turn[:, 2]
    dist = float(normal @ (point - plane.pos))
    return dist, point - normal * (dist / 2), normal, feature


def plane_sphere(plane: Shape, sphere: Shape) -> list[Touch]:
    """Distance of the centre from the plane, less the radius."""
    return [above(plane, sphere.pos - sphere.size[0] * plane.turn[:, 2], 0)]


def plane_box(plane: Shape, box: Shape) -> list[Touch]:
    """The lower corner of each diagonal; corner c has coordinate k positive where c has bit k."""
    normal, touches = plane.turn[:, 2], []
    for corner in range(8):
        signs = np.array([1.0 if corner >> k & 1 else -1.0 for k in range(3)])
        arm = box.turn @ (signs * box.size)
        height = normal @ arm
        if height < 0 or (height == 0 and corner < 4):
            touches.append(above(plane, box.pos + arm, corner))
    return touches


def plane_ellipsoid(plane: Shape, ellipsoid: Shape) -> list[Touch]:
    """The lowest point: along the squared half axes times the normal, which it then touches."""
    local = ellipsoid.size * (ellipsoid.turn.T @ plane.turn[:, 2])
    lowest = -ellipsoid.size * local / np.sqrt(local @ local)
    return [above(plane, ellipsoid.pos + ellipsoid.turn @ lowest, 0)]


def plane_cylinder(plane: Shape, cylinder: Shape) -> list[Touch]:
    """The lowest point of the lower rim and that of the upper; two more of the lower rim, a third
    of a turn to either side."""
    normal, axis = plane.turn[:, 2], cylinder.turn[:, 2]
    radius, half, _ = cylinder.size
    down = -axis if normal @ axis > 0 else axis
    downhill = axis * (normal @ axis) - normal
    length = np.sqrt(downhill @ downhill)
    # Upright there is no lowest point: the cylinder's own x axis stands for it.
    low = downhill / length if length > UPRIGHT else cylinder.turn[:, 0]
    side = np.sqrt(0.75) * cross(low, down)
    rims = [half * down + radius * low, radius * low - half * down]
    thirds = [half * down + radius * (sign * side - low / 2) for sign in (1.0, -1.0)]
    return [above(plane, cylinder.pos + arm, k) for k, arm in enumerate(rims + thirds)]


def sphere_sphere(one: Shape, two: Shape) -> list[Touch]:
    """Distance of the centres, less both radii."""
    gap = two.pos - one.pos
    length = np.sqrt(gap @ gap)
    normal = gap / length if length > 0 else np.array([1.0, 0.0, 0.0])
    dist = length - one.size[0] - two.size[0]
    return [(dist, one.pos + normal * (one.size[0] + dist / 2), normal, 0)]


def sphere_box(sphere: Shape, box: Shape) -> list[Touch]:
    """From the centre to the nearest point of the box; from inside, to the nearest face."""
    radius = sphere.size[0]
    local = box.turn.T @ (sphere.pos - box.pos)
    nearest = np.clip(local, -box.size, box.size)
    towards = nearest - local
    length = np.sqrt(towards @ towards)
    if length > 0:
        normal = box.turn @ (towards / length)
    else:
        depth = box.size - np.abs(local)
        face = int(np.argmin(depth))
        length = -depth[face]
        normal = box.turn[:, face] * (-1.0 if local[face] >= 0 else 1.0)
    dist = length - radius
    return [(dist, sphere.pos + normal * (radius + dist / 2), normal, 0)]


SHAPES = {
    ("plane", "sphere"): plane_sphere,
    ("plane", "ellipsoid"): plane_ellipsoid,
    ("plane", "cylinder"): plane_cylinder,
    ("plane", "box"): plane_box,
    ("sphere", "sphere"): sphere_sphere,
    ("sphere", "box"): sphere_box,
}


@dataclass
class Shape:
    """A geom in the world."""

    pos: Array
    turn: Array
    size: Array


def shape(model: Model, placed: Placed, index: int) -> Shape:
    """The geom's world pose."""
    geom = model.scene["geoms"][index]
    b = geom["body"]
    pos = placed.xpos[b] + placed.xmat[b] @ geom["pos"]
    return Shape(pos, placed.xmat[b] @ matrix(unit(geom["quat"])), np.array(geom["size"], float))


def kinds(model: Model, pair: Pair) -> tuple[str, str]:
    """The types of a pair's two geoms."""
    geoms = model.scene["geoms"]
    return geoms[pair.geom1]["kind"], geoms[pair.geom2]["kind"]


def check(model: Model) -> None:
    """Refuses pairs of shapes whose contacts the reference does not know."""
    for pair in model.pairs:
        if kinds(model, pair) not in SHAPES:
            names = [model.scene["geoms"][i]["name"] for i in (pair.geom1, pair.geom2)]
            raise ValueError(
                f"geoms '{names[0]}' and '{names[1]}': the reference has no contact between "
                + " and ".join(kinds(model, pair))
            )


def size(model: Model, pair: Pair) -> float:
    """Radius of the sphere that holds the smaller of a pair's shapes [m]."""
    return min(reach(model.scene["geoms"][i]) for i in (pair.geom1, pair.geom2))


def reach(geom: dict[str, Any]) -> float:
    """Radius of the sphere that holds the shape [m]; infinite for a plane."""
    lengths = np.array(geom["size"], float)
    return {
        "plane": np.inf,
        "sphere": lengths[0],
        "ellipsoid": lengths.max(),
        "cylinder": float(np.hypot(lengths[0], lengths[1])),
        "box": float(np.sqrt(lengths @ lengths)),
    }[geom["kind"]]


def met_ahead(
    model: Model, placed: Placed, contact: Contact, guess: Array, dt: float, near: float
) -> Contact | None:
    """The contact of two convex shapes on their way through the step; None: they pass by.

    From plane to plane that lies between them (conservative advancement), by the motion of
    the round shapes' centres and the flat ones' nearest points.
    """
    pair, normal = contact.pair, contact.frame[0]
    one, two = (shape(model, placed, i) for i in (pair.geom1, pair.geom2))
    moved = []
    for index, side in ((pair.geom1, -1.0), (pair.geom2, 1.0)):
        geom = model.scene["geoms"][index]
        radius = geom["size"][0] if geom["kind"] == "sphere" else 0.0
        core = contact.pos + normal * (side * (contact.dist / 2 + radius))
        moved.append(jacobians(model, placed, geom["body"], core)[0] @ guess)
    way = dt * (moved[1] - moved[0])
    share, dist, pos = 0.0, contact.dist, contact.pos
    for _ in range(PLANES):
        if dist <= near:
            break
        closing = -(normal @ way)
        if closing <= 0 or share + dist / closing > 1:
            return None
        share += dist / closing
        there = Shape(two.pos + share * way, two.turn, two.size)
        dist, pos, normal, _ = SHAPES[kinds(model, pair)](one, there)[0]
    if normal @ contact.frame[0] >= TURNED:
        return contact
    return Contact(pair, -share * float(normal @ way), pos, tangents(normal), 0, share * way)


def detect(model: Model, placed: Placed) -> list[Contact]:
    """Every contact of every candidate pair with its signed distance, near or far, in the model's
    pair order."""
    contacts: list[Contact] = []
    if not model.scene["features"]["contact"]:
        return contacts
    for pair in model.pairs:
        one, two = (shape(model, placed, i) for i in (pair.geom1, pair.geom2))
        for dist, pos, normal, feature in SHAPES[kinds(model, pair)](one, two):
            contacts.append(Contact(pair, dist, pos, tangents(normal), feature))
    return contacts


def contact_jacobian(model: Model, placed: Placed, contact: Contact) -> Array:
    """Velocity of geom 2's point less geom 1's, in the contact's frame, shape (3, nv)."""
    one, two = (model.scene["geoms"][i]["body"] for i in (contact.pair.geom1, contact.pair.geom2))
    first, _ = jacobians(model, placed, one, contact.pos)
    second, _ = jacobians(model, placed, two, contact.pos - contact.ahead)
    return contact.frame @ (second - first)


def friction_jacobian(model: Model, placed: Placed, contact: Contact) -> Array:
    """Velocities of the ways that have friction: along tangents, then about axes, (ways, nv)."""
    one, two = (model.scene["geoms"][i]["body"] for i in (contact.pair.geom1, contact.pair.geom2))
    _, first = jacobians(model, placed, one, contact.pos)
    _, second = jacobians(model, placed, two, contact.pos)
    sliding = contact_jacobian(model, placed, contact)[1:]
    return np.vstack([sliding, contact.frame @ (second - first)])[contact.pair.ways()]
