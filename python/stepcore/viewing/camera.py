"""The camera of a picture, and its marks for contacts, forces and tendons."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepcore.report.plot.style import VIEW, rgb
from stepcore.viewing.drawing import ARROW, Drawing, corners
from stepcore.viewing.frames import Instant

# The angle of view from top to bottom [degrees].
ANGLE = 40.0
# The largest picture, in points.
LARGEST_SIDE = 8192


@dataclass(frozen=True)
class Camera:
    """A camera that looks at a point from a distance; z is up.

    target: the point [m], shape (3,). turn, lift: the azimuth and the elevation of the camera from
    the target [rad]. far: the distance [m].
    """

    target: NDArray[np.float64]
    turn: float
    lift: float
    far: float

    @property
    def position(self) -> NDArray[np.float64]:
        """Position of the camera [m]."""
        flat = np.cos(self.lift)
        way = np.array([flat * np.cos(self.turn), flat * np.sin(self.turn), np.sin(self.lift)])
        place: NDArray[np.float64] = self.target + self.far * way
        return place


def camera_of(
    drawing: Drawing, instant: Instant, turn: float = -52.0, lift: float = 20.0, far: float = 1.7
) -> Camera:
    """Return a camera that sees the moving bodies; turn, lift: [degrees]. far: in extents."""
    points = [
        instant.placed(shape.body, corners(shape))
        for shape in drawing.shapes
        if shape.shown and drawing.followed[shape.body]
    ]
    every = np.concatenate([*points, np.empty((0, 3))])
    middle = (every.min(axis=0) + every.max(axis=0)) / 2 if len(every) else np.zeros(3)
    return Camera(middle, np.deg2rad(turn), np.deg2rad(lift), far * drawing.extent)


def following_camera(drawing: Drawing, first: Instant) -> Callable[[Instant], Camera]:
    """Return the camera of each instant; it follows the moving bodies at a constant distance."""
    camera, begin = camera_of(drawing, first), drawing.middle(first.xpos)
    return lambda instant: replace(
        camera, target=camera.target + drawing.middle(instant.xpos) - begin
    )


class Mark(NamedTuple):
    """kind: "ball" (start = end), "arrow" or "rod" from start to end [m]. width: radius [m]."""

    kind: str
    start: Any
    end: Any
    width: float
    colour: tuple[float, float, float]


def ropes(drawing: Drawing, instant: Instant) -> list[Mark]:
    """Return the marks of the tendons of an instant."""
    width, colour = 0.004 * drawing.extent, rgb(VIEW["tendon"])
    return [
        Mark("rod", start, end, width, colour)
        for points in instant.tendons
        for start, end in itertools.pairwise(points)
    ]


def force_marks(drawing: Drawing, instant: Instant, newtons: float) -> list[Mark]:
    """Return the marks of the contacts of an instant and of their forces.

    newtons: the force whose arrow has the length `ARROW` × extent.
    """
    extent, result = drawing.extent, []
    scale = ARROW * extent / (newtons or 1.0)
    contact, force = rgb(VIEW["contact"]), rgb(VIEW["force"])
    for place, pushed in zip(instant.places, instant.forces, strict=True):
        result.append(Mark("ball", place, place, 0.009 * extent, contact))
        end = place + scale * pushed
        if np.linalg.norm(end - place) > 0.01 * extent:
            result.append(Mark("arrow", place, end, 0.007 * extent, force))
    return result
