"""Overlays: contacts as balls, forces as arrows, tendons as rods."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from stepcore.viewing.drawing import ARROW, Drawing
from stepcore.viewing.frames import Instant

AMBER, RED, BRICK = (0.96, 0.64, 0.0), (0.84, 0.15, 0.24), (0.75, 0.22, 0.17)


class Mark(NamedTuple):
    """kind: "ball" (start = end), "arrow" or "rod" from start to end [m]. width: radius [m]."""

    kind: str
    start: Any
    end: Any
    width: float
    colour: tuple[float, float, float]


def ropes(drawing: Drawing, instant: Instant) -> list[Mark]:
    """Return the marks of the tendons of an instant."""
    width = 0.004 * drawing.extent
    return [
        Mark("rod", start, end, width, BRICK)
        for points in instant.tendons
        for start, end in itertools.pairwise(points)
    ]


def loads(drawing: Drawing, instant: Instant, newtons: float) -> list[Mark]:
    """Return the marks of the contacts of an instant and of their forces.

    newtons: the force whose arrow has the length `ARROW` × extent.
    """
    extent, result = drawing.extent, []
    scale = ARROW * extent / (newtons or 1.0)
    for place, force in zip(instant.places, instant.forces, strict=True):
        result.append(Mark("ball", place, place, 0.009 * extent, AMBER))
        end = place + scale * force
        if np.linalg.norm(end - place) > 0.01 * extent:
            result.append(Mark("arrow", place, end, 0.007 * extent, RED))
    return result
