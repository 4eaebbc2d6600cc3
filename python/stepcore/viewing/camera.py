"""Cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stepcore.viewing.drawing import Drawing, corners
from stepcore.viewing.frames import Instant

# The angle of view from top to bottom [rad].
ANGLE = np.deg2rad(40)
# Where a camera stands that nobody placed: turn, lift [rad], and far, of the extent.
ASIDE = (-0.9, 0.35, 1.7)
# The largest picture, in points.
LARGEST = 8192


@dataclass(frozen=True)
class Camera:
    """Looks at a point from a distance; z is up.

    target: [m], shape (3,). turn: the direction from the target to the camera about z, and lift:
    above the horizon [rad]. far: the distance [m].
    """

    target: NDArray[np.float64]
    turn: float = -0.9
    lift: float = 0.35
    far: float = 1.0

    @property
    def position(self) -> NDArray[np.float64]:
        """Position of the camera [m]."""
        flat = np.cos(self.lift)
        way = np.array([flat * np.cos(self.turn), flat * np.sin(self.turn), np.sin(self.lift)])
        place: NDArray[np.float64] = self.target + self.far * way
        return place


class Following:
    """A camera that follows the moving bodies, at the distance of the first instant."""

    def __init__(self, drawing: Drawing, first: Instant) -> None:
        self.moving = drawing.moving if drawing.moving.any() else ~drawing.moving
        self.camera = camera_of(drawing, first, *ASIDE)
        self.start = self._middle(first)

    def _middle(self, instant: Instant) -> NDArray[np.float64]:
        middle: NDArray[np.float64] = instant.xpos[self.moving].mean(axis=0)
        return middle

    def at(self, instant: Instant) -> Camera:
        """Return the camera at an instant."""
        return replace(self.camera, target=self.camera.target + self._middle(instant) - self.start)


def camera_of(drawing: Drawing, instant: Instant, turn: float, lift: float, far: float) -> Camera:
    """Return a camera that sees what moves; far: in extents of the drawing."""
    moves = drawing.moving if drawing.moving.any() else ~drawing.moving
    points = [
        instant.placed(shape.body, corners(shape))
        for shape in drawing.shapes
        if shape.shown and moves[shape.body]
    ]
    every = np.concatenate([*points, np.empty((0, 3))])
    middle = (every.min(axis=0) + every.max(axis=0)) / 2 if len(every) else np.zeros(3)
    return Camera(middle, turn, lift, far * drawing.extent)
