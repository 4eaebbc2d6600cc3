"""Terrain for legged robots: stairs, slopes and rough ground as one height field with origins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepcore import checks
from stepcore.scene.elements.geom import Geom

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Terrain:
    """A grid of square tiles, each harder than the last along x; `terrain` makes it.

    elevation: heights of the grid points [m], shape (nx, ny), from the lowest x and y. The middle
        of the grid is at x = y = 0.
    cell: distance between grid points [m].
    kinds: the kind of the tiles along y.
    origins: middle of each tile, on its surface [m], shape (levels, kinds, 3). The square around it
        is level, so that a robot can begin there.
    """

    elevation: Floats
    cell: float
    kinds: tuple[str, ...]
    origins: Floats

    def height(self, x: ArrayLike, y: ArrayLike) -> Any:
        """Return the heights at points [m]; points outside have the height of the nearest edge.

        A cell has two triangles, whose common side is a diagonal of the cell.
        """
        last_cell = np.array(self.elevation.shape) - 2
        i = np.clip(np.asarray(x) / self.cell + (last_cell[0] + 1) / 2, 0, last_cell[0] + 1)
        j = np.clip(np.asarray(y) / self.cell + (last_cell[1] + 1) / 2, 0, last_cell[1] + 1)
        low = np.minimum(i.astype(int), last_cell[0])
        left = np.minimum(j.astype(int), last_cell[1])
        across, along, z = i - low, j - left, self.elevation
        first, last = z[low, left], z[low + 1, left + 1]
        # The engine splits a cell along the diagonal from its lowest to its highest x and y.
        right, up = z[low + 1, left], z[low, left + 1]
        below = first + across * (right - first) + along * (last - right)
        above = first + along * (up - first) + across * (last - up)
        return np.where(across > along, below, above)[()]

    def add_to(self, scene: Any, name: str = "terrain", **fields: Any) -> Geom:
        """Add the terrain to a scene's world as a height field and a geom of it; return the geom.

        name: of both. fields: of the `Geom`, such as friction.
        """
        low, high = float(self.elevation.min()), float(self.elevation.max())
        x, y = (np.array(self.elevation.shape) - 1) * self.cell / 2
        rise = max(high - low, self.cell)
        # The rows of a height field run from the largest y; its base is as deep as it is wide.
        scene.add_hfield(name, self.elevation.T[::-1], size=(x, y, rise, y))
        fields = {"name": name, "pos": (0, 0, low)} | fields
        return scene.add_geom("world", "hfield", hfield=name, **fields)


def terrain(
    kinds: Sequence[str] = ("stairs", "pit", "slope", "bowl", "rough"),
    *,
    levels: int = 8,
    tile: float = 8.0,
    cell: float = 0.1,
    step: tuple[float, float] = (0.03, 0.2),
    tread: float = 0.4,
    grade: tuple[float, float] = (0.05, 0.5),
    roughness: tuple[float, float] = (0.01, 0.1),
    seed: int = 0,
) -> Terrain:
    """Return a grid of tiles from easy to hard, one column for each kind.

    The edge of a tile has height 0. Its middle, a square of 2 m, is level.

    kinds: "stairs" and "slope" rise to the middle, "pit" (stairs) and "bowl" (a slope) fall to it,
        "rough" has random heights, "flat" has none. A kind may occur several times.
    levels: the number of tiles of a kind, along x.
    tile: side of a tile [m], a multiple of the cell, > 2. cell: distance of grid points [m].
    step, grade, roughness: the easiest and the hardest value of the height of a step [m], of the
        slope (rise over run) and of the largest random height [m].
    tread: depth of a step of stairs [m], a multiple of the cell.
    seed: of the random heights.

    Raises ValueError for an unknown kind and a size that is no multiple of the cell.

    >>> from stepcore import Scene, terrain
    >>> ground = terrain(("stairs", "rough"), levels=3, tile=4.0)
    >>> ground.origins.shape
    (3, 2, 3)
    >>> scene = Scene()
    >>> ground.add_to(scene, friction=(0.8, 0.005, 0.0001)).type
    'hfield'
    """
    checks.count("levels", levels)
    for kind in kinds:
        if kind not in HARDER:
            near = checks.nearest(checks.word("kinds", kind), HARDER)
            raise ValueError(f"kinds: no kind {checks.quoted(kind)}{near}")
    n, deep = _cells("tile", tile, cell), _cells("tread", tread, cell)
    if tile <= 2:
        raise ValueError(f"tile = {tile} m: must be > 2 m, the level square in its middle")
    rng = np.random.default_rng(seed)
    away = np.abs(np.arange(n + 1) - n / 2)
    # Cells from the edge of the tile, up to the level square.
    inside = n / 2 - np.maximum(away[:, None], away[None])
    inside = np.minimum(inside, n / 2 - 1.0 / cell)
    elevation = np.zeros((levels * n + 1, len(kinds) * n + 1))
    origins = np.zeros((levels, len(kinds), 3))
    ranges = {"step": step, "grade": grade, "roughness": roughness}
    for level in range(levels):
        share = level / max(levels - 1, 1)
        value = {name: low + share * (high - low) for name, (low, high) in ranges.items()}
        for column, kind in enumerate(kinds):
            heights = value[HARDER[kind]] * _shape(kind, inside, deep, cell, rng)
            i, j = level * n, column * n
            elevation[i : i + n + 1, j : j + n + 1] += heights
            middle = (np.array([i, j]) + n / 2 - (np.array(elevation.shape) - 1) / 2) * cell
            origins[level, column] = (*middle, heights[n // 2, n // 2])
    return Terrain(elevation, cell, tuple(kinds), origins)


# The parameter that makes a kind harder.
HARDER = {"stairs": "step", "pit": "step", "slope": "grade", "bowl": "grade"}
HARDER |= {"rough": "roughness", "flat": "step"}


def _shape(kind: str, inside: Floats, deep: int, cell: float, rng: np.random.Generator) -> Floats:
    """Return the heights of a kind at a parameter of 1; inside: cells from the tile's edge."""
    if kind == "flat":
        return np.zeros_like(inside)
    if kind == "rough":
        level = (inside <= 0) | (inside >= inside.max())
        return np.where(level, 0.0, rng.uniform(-1, 1, inside.shape))
    # A step begins at its grid point, whatever the rounding of cells.
    rise = np.floor(inside / deep + 1e-9) if HARDER[kind] == "step" else inside * cell
    return -rise if kind in ("pit", "bowl") else rise


def _cells(name: str, length: float, cell: float) -> int:
    """Return a length in cells; refuse one that is no multiple of them."""
    count = round(length / cell)
    if count < 1 or abs(length - count * cell) > 1e-9 * length:
        raise ValueError(f"{name} = {length} m: must be a multiple of cell = {cell} m")
    return count
