"""Draw a world for `render`, with `stepcore.viewing`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore.engine.sim import Sim

# What `render_mode` may be, besides None.
MODES = ["rgb_array"]
Picture = NDArray[np.uint8]


class WorldCamera:
    """Draws worlds of a model with a camera that follows the moving bodies.

    width, height: of a picture, in points.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._sim: Sim | None = None
        self._renderer: Any = None
        self._drawing: Any = None
        self._camera: Any = None

    def draw(self, world: Any, index: int | None = None) -> Picture:
        """Draw a Sim, or one world of a Batch; returns shape (height, width, 3)."""
        from stepcore.viewing.camera import following, ropes
        from stepcore.viewing.drawing import drawing_of
        from stepcore.viewing.frames import poses_of
        from stepcore.viewing.renderers import renderer_of

        if self._sim is None:
            self._sim = Sim(world.model)
            self._drawing = drawing_of(world.model, self._sim)
            self._renderer = renderer_of(self._drawing, self.width, self.height)
        for name in self._sim._arrays:
            values = world._arrays[name]
            self._sim._arrays[name][...] = values if index is None else values[index]
        instant = poses_of(self._sim)
        if self._camera is None:
            self._camera = following(self._drawing, instant)
        marks = ropes(self._drawing, instant)
        picture: Picture = self._renderer.draw(instant, self._camera(instant), marks)
        return picture

    def close(self) -> None:
        """Frees the renderer."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._sim = None


def camera_for(owner: str, render_mode: Any, width: int, height: int) -> WorldCamera | None:
    """Return the camera of a render mode; ValueError for an unknown mode or impossible size."""
    if render_mode is None:
        return None
    # Drawing takes as long to import as to draw, and few environments are drawn.
    from stepcore.viewing.camera import LARGEST

    checks.one_of(*MODES)(owner, "render_mode", render_mode)
    for name, size in (("width", width), ("height", height)):
        checks.whole(2, LARGEST)(owner, name, size)
    return WorldCamera(width, height)


def metadata_of(dt: float) -> dict[str, Any]:
    """Return gymnasium's metadata: the render modes, and the actions per simulated second."""
    return {"render_modes": MODES, "render_fps": max(1, round(1 / dt))}
