"""Sizes of scenes, geoms and bodies, as scales for errors, depths and gaps."""

from __future__ import annotations

import math

import numpy as np

from stepcore.engine.model import Model
from stepcore.scene.scene import Scene
from stepcore.scene.softness import UNKNOWN, extent


def scene_size(scene: Scene) -> float:
    """Return the size of a scene [m]; 1 if nothing in it has a length.

    The size is the largest distance of a body from its parent plus the largest half size of a geom.
    """
    return extent(scene) or UNKNOWN


class Sizes:
    """Lengths of a model's geoms and bodies [m].

    thick: the smallest half size of each geom (such as a radius).
    reach: the distance from the centre of each geom to its furthest point.
    halves: the half sizes along the axes of each geom; inf for planes and height fields.
    bodies: the reach of each body's largest geom, or its radius of gyration without geoms.
    """

    def __init__(self, model: Model) -> None:
        sizes = zip(model.geom_type, model.geom_size.tolist(), strict=True)
        extents = [_half_sizes(kind, size) for kind, size in sizes]
        self.halves, self.reach = [halves for halves, _ in extents], [reach for _, reach in extents]
        self.thick = [min(halves) for halves in self.halves]
        inertia = np.trace(np.asarray(model.body_inertia), axis1=1, axis2=2)
        self.bodies: list[float] = []
        for body, mass in enumerate(model.body_mass.tolist()):
            geoms = np.flatnonzero(model.geom_body == body)
            reaches = [reach for k in geoms if math.isfinite(reach := self.reach[k])]
            gyration = math.sqrt(inertia[body] / 2 / mass) if mass > 0 else 0.0
            self.bodies.append(max(reaches, default=gyration or UNKNOWN))

    def contact(self, geom1: int, geom2: int) -> float:
        """Return the length scale for the depth of a contact between two geoms [m]."""
        least = min(self.thick[geom1], self.thick[geom2])
        return least if math.isfinite(least) else UNKNOWN


def _half_sizes(kind: str, size: list[float]) -> tuple[tuple[float, ...], float]:
    """Return a geom's half sizes along its axes, and the distance to its furthest point [m]."""
    if kind in ("plane", "hfield"):
        return (math.inf,) * 3, math.inf
    if kind == "sphere":
        return (size[0],) * 3, size[0]
    if kind == "capsule":
        return (size[0], size[0], size[0] + size[1]), size[0] + size[1]
    if kind == "cylinder":
        return (size[0], size[0], size[1]), math.hypot(size[0], size[1])
    return tuple(size), max(size) if kind == "ellipsoid" else math.hypot(*size)
