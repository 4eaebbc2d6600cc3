"""Tables of worlds: contacts and rows as structured arrays; keyframes, hits, sums as tuples."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepcore.engine.arrays import Floats, frozen

if TYPE_CHECKING:
    from stepcore.engine.model import Model

VECTORS = ("pos", "normal", "force", "torque")
# kind, index and part of an element: the arguments of `Model.element_name`.
ELEMENT: list[Any] = [("kind", "U20"), ("index", np.int64), ("part", np.int32)]
ROW_NUMBERS = ("impulse", "velocity", "target", "regulariser", "residual", "lo", "hi")


class Keyframe(NamedTuple):
    """A named state, with defaults for the values that the scene omits.

    time: [s]. qpos: shape (nq,). qvel: shape (nv,). act: shape (na,). ctrl: shape (nu,). mpos,
    mquat: poses of mocap bodies, shapes (3 nmocap,) and (4 nmocap,).
    """

    name: str
    time: float
    qpos: Floats
    qvel: Floats
    act: Floats
    ctrl: Floats
    mpos: Floats
    mquat: Floats


class Energy(NamedTuple):
    """Kinetic and potential energy [J].

    The potential energy is the energy of springs and of gravity on every body, fixed bodies
    included. Gravitational energy is zero at the world's origin.
    """

    kinetic: float
    potential: float

    @property
    def total(self) -> float:
        """The sum of kinetic and potential energy [J]."""
        return self.kinetic + self.potential


class Momentum(NamedTuple):
    """Total momentum of all bodies, in world axes.

    linear: [kg·m/s], shape (3,). angular: about the world's origin [kg·m²/s], shape (3,).
    For a `Batch` both have shape (n, 3).
    """

    linear: Floats
    angular: Floats


class ContactPair(NamedTuple):
    """Two geoms that can collide, and the parameters that their contacts share.

    geoms: their indices. condim and friction (sliding): 1. solref: as in MJCF. invweight0: sum of
    both bodies' mean inverse mass at qpos0 [1/kg].
    """

    geoms: tuple[int, int]
    condim: int
    friction: float
    solref: tuple[float, float]
    invweight0: float


class Touches(NamedTuple):
    """The contacts of two geoms, by pose and then by slot.

    exists: whether the slot has a contact, at any distance, shape (…, slots). Without a contact the
        other entries are undefined.
    dist: signed distance [m], negative = overlap, shape (…, slots).
    pos: halfway between the surfaces [m], shape (…, slots, 3).
    normal: unit vector from the first geom to the second, shape (…, slots, 3).
    feature: an integer that identifies the touching features (a corner, a pair of edges)
        consistently over all poses, shape (…, slots).
    """

    exists: NDArray[np.bool_]
    dist: Floats
    pos: Floats
    normal: Floats
    feature: Floats


class RayHits(NamedTuple):
    """The first hits of rays, with the shape (…) of the rays.

    distance: in units of the length of each ray's direction, i.e. metres for a unit vector; −1
        without a hit. Shape (…).
    geom: index of the geom, −1 without a hit. Shape (…).
    normal: the surface's outward unit normal in world axes, zero without a hit. Shape (…, 3).
    """

    distance: Floats
    geom: NDArray[np.int64]
    normal: Floats


def contact_table(
    geom_names: Sequence[str],
    elements: list[tuple[str, int, int]],
    pairs: list[tuple[int, int]],
    numbers: Floats,
) -> NDArray[Any]:
    """Return the structured array of `Sim.contacts`.

    numbers: dist, pos, normal, force, torque, shape (contacts, 13).
    """
    geoms = np.array(pairs, dtype=np.int32).reshape(-1, 2).T
    table = np.zeros(len(pairs), _contact_type(max(map(len, geom_names), default=0) or 1))
    _put_elements(table, elements)
    for k, indices in enumerate(geoms, 1):
        table[f"geom{k}"], table[f"name{k}"] = indices, [geom_names[geom] for geom in indices]
    table["dist"] = numbers[:, 0]
    for k, field in enumerate(VECTORS):
        table[field] = numbers[:, 1 + 3 * k : 4 + 3 * k]
    return frozen(table)


def contacts_of_body(table: NDArray[Any], model: Model, body: str | int) -> NDArray[Any]:
    """Return the contacts of a table in which a geom of this body takes part."""
    index = model.index("body", body)
    touching = [model.geom_body[table[geom]] == index for geom in ("geom1", "geom2")]
    return table[touching[0] | touching[1]]


def row_table(
    dt: float,
    elements: list[tuple[str, int, int]],
    names: list[str],
    blocks: list[int],
    numbers: Floats,
) -> NDArray[Any]:
    """Return the structured array of `Sim.rows`.

    numbers: the values of `ROW_NUMBERS`, shape (rows, 7).
    """
    table = np.zeros(len(elements), _row_type(max(map(len, names), default=1)))
    _put_elements(table, elements)
    table["name"], table["block"] = names, blocks
    for k, field in enumerate(ROW_NUMBERS):
        table[field] = numbers[:, k]
    table["force"] = table["impulse"] / dt
    return frozen(table)


# The types are cached, because creating the type takes as long as filling the table.
@functools.cache
def _contact_type(width: int) -> np.dtype[np.void]:
    """Return the type of contacts whose geom names have at most `width` characters."""
    fields = ELEMENT + [(field, np.int32) for field in ("geom1", "geom2")]
    fields += [(field, f"U{width}") for field in ("name1", "name2")]
    return np.dtype([*fields, ("dist", float), *((field, float, 3) for field in VECTORS)])


@functools.cache
def _row_type(width: int) -> np.dtype[np.void]:
    """Return the type of rows whose element names have at most `width` characters."""
    fields = [*ELEMENT, ("name", f"U{width}"), ("block", np.int32)]
    return np.dtype([*fields, *((field, float) for field in (*ROW_NUMBERS, "force"))])


def _put_elements(table: NDArray[Any], elements: list[tuple[str, int, int]]) -> None:
    if elements:
        table["kind"], table["index"], table["part"] = zip(*elements, strict=True)
