"""`Stage`: moves drawings in a page of viser from instant to instant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.viewing.drawing import ARROW, TINTS, Drawing, Shape
from stepcore.viewing.frames import Instant
from stepcore.viewing.primitives import surface_of

# Strengths of lights in viser's units: the sky, all lights of a file together, and what is around.
SKY, LAMP, SURROUNDINGS = 0.9, 1.8, 0.5
# A motion that goes no further is seen whole, of the extent.
NEAR = 3.0
# The frame in which everything stands, and the opacity of what is seen through.
ROOT, THIN = "/scene", 0.35
AMBER, RED, LINK = (244, 163, 0), (215, 38, 61), (209, 73, 91)


class Stage:
    """Drawings that share one scene of a page; the first keeps its colours.

    server: viser's. show_all: whether hidden groups of geoms are shown.
    """

    def __init__(self, server: Any, drawings: Sequence[Drawing]) -> None:
        self.server, self.drawings = server, drawings
        self.extent = drawings[0].extent
        self.contacts = self.forces = True
        self.hidden: list[Any] = []
        # Meshes of what moves, with their opacities.
        self.solid: list[tuple[Any, float | None]] = []
        # Everything stands in a frame, which follows a motion: the camera is the reader's.
        self.root = server.scene.add_frame(ROOT, show_axes=False)
        self.anchor: NDArray[Any] | None = None
        if drawings[0].lights:
            self._lights(drawings[0])
        self.bodies = [self._bodies(number, each) for number, each in enumerate(drawings)]
        self.marks: dict[str, tuple[tuple[int, ...], Any]] = {}
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
            vertices, faces = surface_of(shape, 20 * self.extent)
            rgba = shape.rgba if not number else (*TINTS[(number - 1) % len(TINTS)], 0.5)
            name = f"{ROOT}/run{number}/body{shape.body}/shape{k}"
            mesh = scene.add_mesh_simple(
                name,
                np.asarray(vertices, np.float32),
                np.asarray(faces, np.uint32),
                color=tuple(round(255 * min(1.0, c)) for c in rgba[:3]),
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

    def _lights(self, drawing: Drawing) -> None:
        """Add the lights of the file and a weak sky; the camera has no headlight."""
        scene = self.server.scene
        scene.configure_default_lights(enabled=False)
        # What surfaces reflect beside the lamps; viser's own washes colours out.
        scene.configure_environment_map("warehouse", environment_intensity=SURROUNDINGS)
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), intensity=SKY)
        brightest = max(1.0, sum(max(light.diffuse) for light in drawing.lights))
        for k, light in enumerate(drawing.lights):
            common: dict[str, Any] = {
                "name": f"{ROOT}/run0/body{light.body}/light{k}",
                "color": tuple(round(255 * min(1.0, c)) for c in light.diffuse),
                "intensity": LAMP / brightest,
                "decay": 0.0,
            }
            if light.kind == "point":
                scene.add_light_point(position=light.pos, **common)
                continue
            wide = light.kind == "directional"
            scene.add_light_spot(
                angle=np.pi / 2 if wide else min(np.pi / 2, np.deg2rad(light.cutoff)),
                penumbra=1.0,
                direction=light.dir,
                # One that shines everywhere alike comes from far away.
                position=tuple(-50 * self.extent * np.array(light.dir)) if wide else light.pos,
                **common,
            )

    def _grid(self, name: str, shape: Shape) -> None:
        """Add lines on a plane, which make motion over it visible."""
        cell = float(2.0 ** np.round(np.log2(self.extent / 2)))
        width, height = (2 * (half or 20 * self.extent) for half in shape.size[:2])
        darker = tuple(round(170 * min(1.0, c)) for c in shape.rgba[:3])
        self.server.scene.add_grid(
            f"{name}/grid",
            width=width,
            height=height,
            cell_size=cell,
            section_size=4 * cell,
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
        """Keep the middle of what moves at its place in the picture, or stop."""
        self.anchor = np.array(self.root.position) + self._middle(instant) if on else None

    def begin_again(self, instant: Instant) -> None:
        """Begin a motion again, with the camera at its first target."""
        self.root.position = (0.0, 0.0, 0.0)
        if self.anchor is not None:
            self.anchor = self._middle(instant)

    def _middle(self, instant: Instant) -> NDArray[Any]:
        moving = self.drawings[0].moving
        places = instant.xpos[moving] if moving.any() else instant.xpos
        middle: NDArray[Any] = places.mean(axis=0)
        return middle

    def look(self, instants: Sequence[Instant]) -> None:
        """Place the camera of a new client in front of and above what moves.

        instants: of the first run; a motion that stays near is seen whole.
        """
        moving = self.drawings[0].moving
        chosen = moving if moving.any() else np.ones_like(moving)
        at, far = self._middle(instants[0]), self.extent
        places = np.concatenate([instant.xpos[chosen] for instant in instants])
        way = float(np.linalg.norm(np.ptp(places, axis=0)))
        if far < way < NEAR * far:
            at, far = (places.min(axis=0) + places.max(axis=0)) / 2, way
        self.server.initial_camera.position = tuple(at + far * np.array([1.0, -1.3, 0.6]))
        self.server.initial_camera.look_at = tuple(at)

    def show(self, instants: Sequence[Instant]) -> None:
        """Move everything to these instants, one for each run."""
        with self.server.atomic():
            if self.anchor is not None:
                self.root.position = self.anchor - self._middle(instants[0])
            for frames, instant in zip(self.bodies, instants, strict=True):
                for frame, pos, quat in zip(frames, instant.xpos, instant.xquat, strict=True):
                    frame.position, frame.wxyz = pos, quat
            for number, instant in enumerate(instants):
                self._contacts(number, instant)
                self._tendons(number, instant)
            for number, other in enumerate(instants[1:], 1):
                moving = self.drawings[0].moving
                ends = np.stack([instants[0].xpos[moving], other.xpos[moving]], axis=1)
                self._lines(f"{ROOT}/links{number}", ends, LINK)

    def _contacts(self, number: int, instant: Instant) -> None:
        scene, extent = self.server.scene, self.extent
        places = instant.places if self.contacts else instant.places[:0]
        name = f"{ROOT}/run{number}/contacts"
        if len(places):
            colours = np.tile(np.array(AMBER, np.uint8), (len(places), 1))
            points = places.astype(np.float32)
            scene.add_point_cloud(name, points, colours, point_size=0.012 * extent)
        else:
            scene.remove_by_name(name)
        self.newtons = self.newtons or float(np.abs(instant.forces).max(initial=0.0))
        scale = ARROW * extent / (self.newtons or 1.0)
        ends = np.stack([instant.places, instant.places + scale * instant.forces], axis=1)
        long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 0.01 * extent
        ends = ends[long] if self.forces else ends[:0]
        name = f"{ROOT}/run{number}/forces"
        if len(ends):
            scene.add_arrows(
                name,
                ends.astype(np.float32),
                RED,
                shaft_radius=0.006 * extent,
                head_radius=0.014 * extent,
                head_length=0.03 * extent,
            )
        else:
            scene.remove_by_name(name)

    def _tendons(self, number: int, instant: Instant) -> None:
        if instant.tendons:
            ends = [np.stack([way[:-1], way[1:]], axis=1) for way in instant.tendons]
            self._lines(f"{ROOT}/run{number}/tendons", np.concatenate(ends), (192, 57, 43))

    def _lines(self, name: str, ends: NDArray[Any], colour: tuple[int, int, int]) -> None:
        self.server.scene.add_line_segments(
            name, ends.astype(np.float32), colour, thickness=0.004 * self.extent
        )
