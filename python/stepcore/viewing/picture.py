"""Pictures and videos without a window or a graphics card."""

from __future__ import annotations

import os
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks, files
from stepcore.needs import need
from stepcore.viewing.camera import LARGEST_SIDE, camera_of, following_camera, force_marks, ropes
from stepcore.viewing.drawing import drawing_of
from stepcore.viewing.frames import Replayed, instant_of
from stepcore.viewing.renderers import Renderer

# Containers in which ffmpeg writes H.264.
ENDINGS = (".mp4", ".mov", ".mkv")


def picture(
    sim: Any,
    path: str | os.PathLike[str] | None = None,
    *,
    width: int = 640,
    height: int = 480,
    turn: float = -52.0,
    lift: float = 20.0,
    far: float = 1.7,
    forces: bool = True,
) -> NDArray[np.uint8]:
    """Draw the present state of a Sim, without a window or a graphics card.

    path: file of the picture; its extension is the format.
    width, height: in pixels.
    turn, lift: azimuth and elevation of the camera [degrees].
    far: distance of the camera, in sizes of the moving bodies.
    forces: whether contacts and their forces are drawn.

    Returns the picture, shape (height, width, 3). The state of the Sim is not changed. Needs the
    extra "video". Raises ValueError for sizes and names outside their limits, RuntimeError if
    OpenGL does not work.

    >>> from stepcore import Sim, lesson, picture
    >>> picture(Sim(lesson.stack()), "stack.png", width=160, height=120).shape
    (120, 160, 3)
    """
    if not hasattr(sim, "forward"):
        raise ValueError(f"sim = {checks.shown(sim)}: must be a stepcore.Sim")
    if path is not None:
        image = need("PIL.Image", "writing a picture", "video")
        _check_ending("picture", path, image.registered_extensions(), ".png, .jpg or alike")
    copy = type(sim)(sim.model)
    copy.restore(sim.state())
    instant, drawing = instant_of(copy), drawing_of(copy.model, copy)
    camera = camera_of(drawing, instant, turn, lift, far)
    renderer = Renderer(drawing, width, height)
    try:
        newtons = drawing.weight or instant.strongest
        marks = ropes(drawing, instant) + (force_marks(drawing, instant, newtons) if forces else [])
        drawn: NDArray[np.uint8] = renderer.draw(instant, camera, marks)
    finally:
        renderer.close()
    if path is not None:
        image.fromarray(drawn).save(path)
    return drawn


def save_video(
    run: Replayed,
    path: str | os.PathLike[str],
    fps: float,
    speed: float,
    size: tuple[int, int],
) -> None:
    """See `Trajectory.save_video`."""
    checks.real(1, high=240)("save_video", "fps", fps)
    checks.real(above=0)("save_video", "speed", speed)
    _check_ending("save_video", path, ENDINGS, " or ".join(ENDINGS))
    ffmpeg = need("imageio_ffmpeg", "a video", "video")
    for field, value in zip(("width", "height"), size, strict=True):
        if checks.whole(2, LARGEST_SIDE)("save_video", field, value) % 2:
            raise checks.refuse("save_video", field, value, "an even number")
    drawing, time = run.drawing, run.time
    renderer = Renderer(drawing, *size)
    camera = following_camera(drawing, run.instants[0])
    newtons = drawing.weight or run.strongest
    count = max(1, round((time[-1] - time[0]) / speed * fps) + 1)
    writer = ffmpeg.write_frames(os.fspath(path), size, fps=fps, macro_block_size=2)
    writer.send(None)
    try:
        for k in range(count):
            now = time[0] + k * speed / fps
            instant = run.instants[int(np.argmin(np.abs(time - now)))]
            marks = ropes(drawing, instant) + force_marks(drawing, instant, newtons)
            drawn = renderer.draw(instant, camera(instant), marks)
            writer.send(np.ascontiguousarray(drawn))
    finally:
        writer.close()
        renderer.close()


def _check_ending(
    owner: str, path: str | os.PathLike[str], endings: Collection[str], such: str
) -> None:
    """Refuse a file that cannot be written, before seconds of drawing."""
    if os.path.splitext(files.as_path("path", path))[1].lower() not in endings:
        raise checks.refuse(owner, "path", path, f"a name that ends in {such}")
