"""Rays: the first geom that each ray hits, and its distance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.engine.arrays import Floats, numbers

GROUPS = 6


class RayHits(NamedTuple):
    """The first hits of rays; the shape (…) is that of the rays.

    distance: in units of the length of each ray's direction, i.e. metres for a unit vector; −1
        without a hit. Shape (…).
    geom: index of the geom, −1 without a hit. Shape (…).
    normal: the surface's outward unit normal in world axes, zero without a hit. Shape (…, 3).
    """

    distance: Floats
    geom: NDArray[np.int64]
    normal: Floats


def ray_hits(
    core: Any,
    worlds: tuple[int, ...],
    origin: ArrayLike,
    direction: ArrayLike,
    excluded: int | None,
    groups: Sequence[int] | None,
    static: bool,
) -> RayHits:
    """Cast rays; see `World.ray`.

    core: a `_core.Sim` or `_core.Batch`; worlds: () for one world, (n,) for n; excluded: the index
        of a body.
    """
    ends = [_vectors(name, value) for name, value in (("origin", origin), ("direction", direction))]
    if not ends[1].any(axis=-1).all():
        raise ValueError("direction = (0, 0, 0): must have a length")
    try:
        # The axes of rays after that of the worlds.
        further = (1,) * max(max(end.ndim for end in ends) - 1, 1)
        shape = np.broadcast_shapes(*(end.shape for end in ends), (*worlds, *further))
    except ValueError:
        shapes = " and ".join(str(end.shape) for end in ends)
        limit = "shapes that broadcast" + (f", with {worlds[0]} worlds first" if worlds else "")
        raise ValueError(f"origin and direction have shapes {shapes}: must have {limit}") from None
    rays = np.concatenate([np.broadcast_to(end, (*shape[:-1], 3)) for end in ends], axis=-1)
    seen = None if groups is None else _groups(groups)
    distance, geom, normal = core.rays(
        np.ascontiguousarray(rays).ravel(), excluded, seen, not checks.flag("ray", "static", static)
    )
    lead = shape[:-1]
    met = np.array(geom, dtype=np.int64).reshape(lead)
    return RayHits(distance.reshape(lead), met, normal.reshape((*lead, 3)))


def _vectors(name: str, value: ArrayLike) -> Floats:
    table = numbers(name, value)
    if table.ndim == 0 or table.shape[-1] != 3:
        raise ValueError(f"{name} has shape {table.shape}: must be (…, 3)")
    if not np.isfinite(table).all():
        raise ValueError(f"{name}: must be finite")
    return table


def _groups(groups: Sequence[int]) -> list[bool]:
    """Return, for each group, whether its geoms can be hit."""
    seen = [False] * GROUPS
    for group in checks.listed(groups) or [None]:
        if isinstance(group, bool) or group not in range(GROUPS):
            raise checks.refuse("ray", "groups", groups, f"integers from 0 to {GROUPS - 1}")
        seen[group] = True
    return seen
