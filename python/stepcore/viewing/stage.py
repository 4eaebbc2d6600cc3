"""`Stage`: moves drawings in a page of viser from instant to instant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.report.plot.style import TINTS, VIEW, rgb
from stepcore.viewing.camera import force_marks
from stepcore.viewing.drawing import Drawing, Shape
from stepcore.viewing.frames import Instant

# The root frame, and the opacity of transparent shapes.
ROOT, THIN = "/scene", 0.4


class Stage:
    """Drawings that share one scene of a page; the first keeps its colours.

    server: viser's. show_all: whether hidden groups of geoms are shown.
    """

    def __init__(self, server: Any, drawings: Sequence[Drawing]) -> None:
        self.server, self.drawings = server, drawings
        self.extent, self.middle = drawings[0].extent, drawings[0].middle
        self.contacts = self.forces = True
        self.hidden: list[Any] = []
        # Meshes of the moving bodies, with their opacities.
        self.solid: list[tuple[Any, float | None]] = []
        # Everything is placed in a root frame, which follows a motion: the camera is the reader's.
        self.root = server.scene.add_frame(ROOT, show_axes=False)
        self.anchor: NDArray[Any] | None = None
        self.bodies = [self._bodies(number, each) for number, each in enumerate(drawings)]
        self.newtons = drawings[0].weight

    def _bodies(self, number: int, drawing: Drawing) -> list[Any]:
        scene = self.server.scene
        frames = []
        for index in range(len(drawing.bodies)):
            name = f"{ROOT}/run{number}/body{index}"
            frames.append(scene.add_frame(name, show_axes=False))
        for k, shape in enumerate(drawing.shapes):
            if number and not drawing.moving[shape.body]:
                # The ground is drawn once.
                continue
            vertices, faces = shape.triangles(drawing.reach)
            rgba = shape.rgba if not number else (*rgb(TINTS[(number - 1) % len(TINTS)]), THIN)
            name = f"{ROOT}/run{number}/body{shape.body}/shape{k}"
            mesh = scene.add_mesh_simple(
                name,
                np.asarray(vertices, np.float32),
                np.asarray(faces, np.uint32),
                color=_bytes(rgba),
                opacity=None if rgba[3] >= 1 else rgba[3],
                flat_shading=shape.kind in ("triangles", "box"),
                side="double",
                wxyz=shape.quat,
                position=shape.pos,
                visible=shape.shown,
                cast_shadow=shape.kind != "plane",
            )
            if not shape.shown:
                self.hidden.append(mesh)
            if drawing.moving[shape.body]:
                self.solid.append((mesh, mesh.opacity))
            if shape.kind == "plane":
                self._grid(name, shape)
        return frames

    def _grid(self, name: str, shape: Shape) -> None:
        """Add lines on a plane, which make motion over it visible."""
        drawing = self.drawings[0]
        width, height = (2 * (half or drawing.reach) for half in shape.size[:2])
        darker = _bytes([c * 2 / 3 for c in shape.rgba])
        self.server.scene.add_grid(
            f"{name}/grid",
            width=width,
            height=height,
            cell_size=drawing.cell,
            section_size=4 * drawing.cell,
            cell_color=darker,
            section_color=darker,
            fade_distance=30 * self.extent,
            position=(0, 0, 3e-3 * self.extent),
        )

    def show_hidden(self, on: bool) -> None:
        """Show or hide the hidden groups of geoms."""
        for mesh in self.hidden:
            mesh.visible = on

    def see_through(self, on: bool) -> None:
        """Make moving bodies transparent, so that forces inside are visible, or opaque again."""
        for mesh, opacity in self.solid:
            mesh.opacity = min(THIN, 1.0 if opacity is None else opacity) if on else opacity

    def follow(self, on: bool, instant: Instant) -> None:
        """Keep the middle of the moving bodies at its place in the picture, or stop."""
        self.anchor = np.array(self.root.position) + self.middle(instant.xpos) if on else None

    def begin_again(self, instant: Instant) -> None:
        """Begin a motion again, with the camera at its first target."""
        self.root.position = (0.0, 0.0, 0.0)
        if self.anchor is not None:
            self.anchor = self.middle(instant.xpos)

    def look(self, instants: Sequence[Instant]) -> None:
        """Place the camera of a new client in front of and above the moving bodies.

        instants: of the first run; a motion of up to three extents is seen whole.
        """
        drawing, far = self.drawings[0], self.extent
        at = self.middle(instants[0].xpos)
        places = np.concatenate([instant.xpos[drawing.followed] for instant in instants])
        way = float(np.linalg.norm(np.ptp(places, axis=0)))
        if far < way < 3 * far:
            at, far = (places.min(axis=0) + places.max(axis=0)) / 2, way
        self.server.initial_camera.position = tuple(at + far * np.array([1.0, -1.3, 0.6]))
        self.server.initial_camera.look_at = tuple(at)

    def show(self, instants: Sequence[Instant]) -> None:
        """Move everything to these instants, one for each run."""
        with self.server.atomic():
            if self.anchor is not None:
                self.root.position = self.anchor - self.middle(instants[0].xpos)
            for frames, instant in zip(self.bodies, instants, strict=True):
                for frame, pos, quat in zip(frames, instant.xpos, instant.xquat, strict=True):
                    frame.position, frame.wxyz = pos, quat
            for number, instant in enumerate(instants):
                self._loads(number, instant)
                if instant.tendons:
                    ends = [np.stack([way[:-1], way[1:]], axis=1) for way in instant.tendons]
                    self._lines(f"run{number}/tendons", np.concatenate(ends), VIEW["tendon"])
            for number, other in enumerate(instants[1:], 1):
                moving = self.drawings[0].moving
                ends_of = [instants[0].xpos[moving], other.xpos[moving]]
                self._lines(f"links{number}", np.stack(ends_of, axis=1), VIEW["link"])

    def _loads(self, number: int, instant: Instant) -> None:
        """Draw the contacts of an instant as points, and their forces as arrows."""
        self.newtons = self.newtons or instant.strongest
        marks = force_marks(self.drawings[0], instant, self.newtons)
        balls = [mark for mark in marks if mark.kind == "ball" and self.contacts]
        arrows = [mark for mark in marks if mark.kind == "arrow" and self.forces]
        scene, name = self.server.scene, f"{ROOT}/run{number}"
        if balls:
            points = np.array([ball.start for ball in balls], np.float32)
            colour, size = _bytes(balls[0].colour), 1.4 * balls[0].width
            scene.add_point_cloud(f"{name}/contacts", points, colour, point_size=size)
        else:
            scene.remove_by_name(f"{name}/contacts")
        if arrows:
            width = arrows[0].width
            scene.add_arrows(
                f"{name}/forces",
                np.array([(arrow.start, arrow.end) for arrow in arrows], np.float32),
                _bytes(arrows[0].colour),
                shaft_radius=width,
                head_radius=2 * width,
                head_length=4 * width,
            )
        else:
            scene.remove_by_name(f"{name}/forces")

    def _lines(self, name: str, ends: NDArray[Any], colour: str) -> None:
        self.server.scene.add_line_segments(
            f"{ROOT}/{name}",
            ends.astype(np.float32),
            _bytes(rgb(colour)),
            thickness=0.004 * self.extent,
        )


def _bytes(colour: Sequence[float]) -> tuple[int, int, int]:
    red, green, blue = (round(255 * min(1.0, c)) for c in colour[:3])
    return red, green, blue
